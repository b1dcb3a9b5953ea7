"""The solver on stiffer and softer soil, at other gravities and steps: a small driven scene.

The excavation on cells twice as long (2940 particles), case 186: 8 cm deep, 10 cm/s.
"""

import time

import numpy as np

from mpm import columns, experiments, packing, run, scenes, stability
from mpm.constitutive import make_soil
from mpm.simulation import Settings
from mpm.solver import EXCHANGE
from reports.stability.cases import REFUSED, Case, judged

PART = 'Solver'
CASE = 186
STIFFNESS = (0.1, 1.0, 10.0, 100.0)
GRAVITIES = (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0)
STEP_SHARES = (1.0, 0.5, 0.25)
# Beyond the limit that `stability` enforces, to show where the scheme itself gives way.
CFL_NUMBERS = (0.4, 0.8, 1.0, 1.2, 1.6, 2.0)
REST = 0.15  # s that soil at rest is stepped
YOUNGS_MODULUS = Settings().youngs_modulus


class _Driven:
    """The scene with one soil; advances frame by frame and keeps the balance of energy."""

    def __init__(self, modulus=YOUNGS_MODULUS, gravity_factor=1.0, steps_per_frame=0):
        self.scene = experiments.coarse(scenes.EXCAVATION)
        parameters = self.scene.parameters(CASE)
        soil = make_soil(modulus, scenes.static_friction(self.scene, parameters))
        particles, _ = packing.settle(self.scene.bin, soil, 0)
        settings = Settings(youngs_modulus=modulus, steps_per_frame=steps_per_frame)
        self.simulation = run.make_simulation(self.scene, parameters, soil, particles, settings)
        self.gravity = gravity_factor * scenes.EARTH_GRAVITY
        if gravity_factor != 1.0:
            self.simulation.gravity = self.gravity
            self.simulation.particles = packing.at_gravity(particles, self.gravity)
        self.volume = packing.particle_volume(self.scene.bin)
        self.fastest = 0.0

    def energy(self):
        s = self.simulation
        return experiments.energy(s.particles, s.soil, self.volume, s.grid.dx, self.gravity)

    def drive(self, frames, progress):
        """Advances; returns force [frames, 3] in N and the work of the blade in J after each.

        `fastest` is then the largest speed of soil at the end of any frame, m/s.
        """
        s = self.simulation
        path = s.drive.pose(np.arange(frames + 1) / scenes.FRAME_RATE)
        force = []
        for _ in progress(range(frames)):
            force.append(s.frame()[0])
            velocity = s.particles[:, columns.V : columns.V + 3]
            self.fastest = max(self.fastest, float(np.linalg.norm(velocity, axis=1).max()))
        force = np.array(force)
        # The force is a mean over the frame, in which the blade keeps its speed (almost).
        return force, -np.cumsum((force[:, :2] * np.diff(path[:, :2], axis=0)).sum(axis=1))


def stiffness_sweep(frames, progress):
    """Rows and curves of E x 0.1 to x 100: time step, cost, force, energy that is created."""
    rows, curves = [], []
    _Driven().simulation.frame()  # compiles the kernels before the clock
    for factor in STIFFNESS:
        driven = _Driven(factor * YOUNGS_MODULUS)
        before, started = driven.energy(), time.process_time()
        force, work = driven.drive(frames, progress)
        gained = driven.energy() - before
        curve = {
            'factor': factor,
            'time_step_s': driven.simulation.dt,
            'steps_per_frame': driven.simulation.steps,
            'cpu_s_per_simulated_s': (time.process_time() - started) * scenes.FRAME_RATE / frames,
            'mean_draft_N': force[frames // 3 :, 0].mean(),
            'force_N': force[:, 0],
            'work_J': work[-1],
            'energy_gained_J': gained,
        }
        curves.append(curve)
        rows.append(
            judged(
                PART,
                f'E x {factor:g}: energy gained over work of the blade',
                gained / work[-1],
                'of the work',
                1.0,
                f'dt {driven.simulation.dt:.3g} s, {driven.simulation.steps} steps a frame, mean '
                f'draft {curve["mean_draft_N"]:.0f} N',
            )
        )
        rows.append(_refused_step(factor, driven))
    return rows, curves


def _refused_step(factor, driven):
    name = f'E x {factor:g}: step of 1.5 times the limit'
    limit = stability.max_time_step(driven.simulation.soil, driven.simulation.grid.dx)
    try:
        stability.check_time_step(1.5 * limit, driven.simulation.soil, driven.simulation.grid.dx)
    except stability.UnstableTimeStepError as error:
        return Case(PART, name, None, '', None, REFUSED, str(error).split(' (dx')[0])
    return judged(PART, name, 1.5, 'x limit', 1.0, 'was taken')


def gravity_sweep(frames, progress):
    """Rows and curves of 0 to 1000 g: cells that soil crosses between exchanges, or the refusal."""
    rows, curves = [], []
    for factor in GRAVITIES:
        name = f'gravity x {factor:g}: cells crossed between exchanges'
        driven = _Driven(gravity_factor=factor)
        s = driven.simulation
        surface = np.quantile(s.particles[:, 1], 0.99)
        try:
            force, _ = driven.drive(frames, progress)
        except ValueError as error:
            rows.append(Case(PART, name, None, '', None, REFUSED, str(error)))
            curves.append({'factor': factor, 'crossed': None})
            continue
        crossed = driven.fastest * EXCHANGE / s.grid.dx
        settled = surface - np.quantile(s.particles[:, 1], 0.99)
        note = f'soil up to {driven.fastest:.3g} m/s, draft at the end {force[-1, 0]:.3g} N, '
        note += f'surface sinks by {1e3 * settled:.1f} mm'
        rows.append(judged(PART, name, crossed, 'cells', stability.VELOCITY_CFL, note))
        curves.append({'factor': factor, 'crossed': crossed, 'draft_N': force[:, 0]})
    return rows, curves


def step_sensitivity(frames, progress):
    """Rows and curves of smaller steps: how far the draft depends on the step."""
    rows, curves = [], []
    steps = _Driven().simulation.steps
    for share in STEP_SHARES:
        force, _ = _Driven(steps_per_frame=round(steps / share)).drive(frames, progress)
        curves.append({'share': share, 'mean_draft_N': force[frames // 3 :, 0].mean()})
    for curve in curves[1:]:
        change = curve['mean_draft_N'] / curves[0]['mean_draft_N'] - 1
        note = 'particles and grid exchange at a fixed interval, see mpm/README.md'
        name = f'step x {curve["share"]:g}: change of the mean draft'
        rows.append(judged(PART, name, abs(change), 'of the draft', 0.01, note))
    return rows, curves


def onset_of_divergence(progress):
    """Rows and curves of soil at rest, stepped beyond the limit: its largest speed after 0.15 s."""
    driven = _Driven()
    rows, curves = [], []
    for number in progress(CFL_NUMBERS):
        box = driven.scene.bin
        experiment = experiments.Experiment(box, box, driven.simulation.soil)
        experiment.particles = driven.simulation.particles.copy()
        solver = experiment.solver
        solver.dt = number / stability.CFL * stability.max_time_step(solver.soil, box.dx)
        solver.steps = max(1, round(EXCHANGE / solver.dt))
        try:
            experiment.advance(REST)
            velocity = experiment.particles[:, columns.V : columns.V + 3]
            speed = float(np.linalg.norm(velocity, axis=1).max())
        except ValueError:
            speed = None
        curves.append({'cfl': number, 'speed_m_s': speed})
        name = f'soil at rest, CFL {number:g}: largest speed after {REST} s'
        if speed is None:
            rows.append(Case(PART, name, None, '', None, REFUSED, 'a particle left the grid'))
        else:
            # Free fall reaches 1.5 m/s; measured 1 mm/s at rest.
            limit = 0.05 if number <= stability.CFL else None
            rows.append(judged(PART, name, speed, 'm/s', limit))
    return rows, curves


def run_all(is_quick, progress):
    """All rows and the curves by name."""
    frames = 10 if is_quick else 90
    rows, curves = [], {}
    for name, make in (
        ('stiffness', lambda: stiffness_sweep(frames, progress)),
        ('gravity', lambda: gravity_sweep(max(frames // 3, 5), progress)),
        ('step', lambda: step_sensitivity(frames, progress)),
        ('divergence', lambda: onset_of_divergence(progress)),
    ):
        new, curves[name] = make()
        rows += new
    return rows, curves
