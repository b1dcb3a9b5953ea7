"""Checks of whole runs: published laws of blade and wheel, presses, free tools, leak, saw-tooth."""

import math
import os

import numpy as np

from mpm import bodies, earthmoving, experiments, packing, raw_run, run, scenes
from mpm.batch import generate
from mpm.constitutive import make_soil
from mpm.motions import catalogue, grid
from mpm.motions.drive import Drive, Machine
from mpm.simulation import Settings
from mpm.verification.convergence import packed
from mpm.verification.rows import Check, reported

# Upright blades (lean up to 10 degrees), both motions, several depths.
EARTHMOVING_CASES = (123, 146, 186, 213, 216)
EXPONENT_CASES = (22, 123, 146, 186, 216)
EXPONENT_TRAVEL = (0.15, 0.3)  # m of travel over which the draft is averaged
SAW_TOOTH_CASES = (123, 186, 146)
LEVEL = 0.35  # largest slope of a cut that counts as level
# Slip 20, "40", 70 % with the middle load, diameter and friction, on the Earth.
SLIP_CASES = (176, 203, 230)
# Simulated for the rows of all runs of a folder that holds none: those of other rows.
FIRST_CASES = {scenes.EXCAVATION.name: EARTHMOVING_CASES, scenes.WHEEL.name: SLIP_CASES}


def run_of(scene: scenes.Scene, case: int, raw_path: str) -> raw_run.RawRun:
    """Returns a run of a folder, simulated into it if it is absent."""
    folder = os.path.join(raw_path, scene.name)
    generate(scene, (case,), folder, Settings())
    return raw_run.read_run(os.path.join(folder, raw_run.file_name(case)))


def runs_held(scene: scenes.Scene, raw_path: str) -> list[dict]:
    """Returns the manifest's entries of all runs of a folder, after a few are simulated into an
    empty one."""
    folder = os.path.join(raw_path, scene.name)
    if not (raw_run.read_manifest(folder) or {}).get('runs'):
        generate(scene, FIRST_CASES[scene.name], folder, Settings())
    return raw_run.read_manifest(folder)['runs']


def packed_soil(scene: scenes.Scene, raw_path: str) -> list[Check]:
    """The settled soil carries its weight."""
    settings, folder = Settings(), os.path.join(raw_path, scene.name)
    os.makedirs(folder, exist_ok=True)
    soil = make_soil(settings.youngs_modulus, scenes.PACKING_MU_S)
    particles, _ = packing.settled(scene.bin, soil, settings.seed, folder)
    found = experiments.settled_soil(scene.bin, particles, soil)
    stress, middle = f'{scene.name} soil: vertical stress over rho g h', 'middle of the bin'
    return [
        Check(f'{scene.name} soil: reaction of walls and floor over weight',
              found['reaction_over_weight'], 1.0, 0.01, 'm g'),
        Check(stress, found['stress_over_rho_g_h'], 1.0, 0.02, f'{middle}, above the lowest cell'),
        # Nodes below the floor are held, so the grid has no linear field in the lowest cell: its
        # particles state 9 % more than they carry. The floor's reaction is the weight (first row).
        Check(stress, found['stress_at_floor_over_rho_g_h'], 1.0, 0.12,
              f'{middle}, in the lowest cell'),
    ]  # fmt: skip


def earthmoving_ratio(run: raw_run.RawRun) -> float:
    """Returns mean draft over that of the fundamental equation, heap included, while cutting."""
    p = run.parameters
    scene = scenes.EXCAVATION
    box = scene.bin
    path = grid.make_drive(scene, p).pose(np.arange(scenes.FRAMES) / scenes.FRAME_RATE)
    lean = math.radians(p['angle_deg'])
    unit_weight = p['soil']['bulk_density'] * scenes.EARTH_GRAVITY
    kept_weight = unit_weight * packing.particle_volume(box) * box.keep_every
    ours, theirs = [], []
    for t in range(5, scenes.FRAMES - 5, 10):
        tip = path[t, :2] - [0.0, bodies.BLADE_THICKNESS / 2]
        depth = box.surface - tip[1]
        is_moving = path[t, 0] != path[t - 1, 0]
        is_ramp = p['motion'] == 1 and path[t, 1] != path[t - 1, 1]
        if not is_moving or is_ramp or depth < box.dx:
            continue
        soil = run.positions[t].astype(np.float64)
        ahead = tip[0] + (soil[:, 1] - tip[1]) * math.tan(lean) - soil[:, 0]
        is_heap = (
            (soil[:, 1] > box.surface)
            & (ahead > 0.0)
            & (np.abs(soil[:, 2] - box.z_middle) < bodies.BLADE_WIDTH / 2)
        )
        reach = tip[0] - soil[is_heap, 0]
        ours.append(run.force[t - 5 : t + 5, 0].mean())
        theirs.append(
            earthmoving.draft_force(
                depth,
                bodies.BLADE_WIDTH,
                math.pi / 2 - lean,
                math.asin(p['soil']['mu_s']),
                math.atan(bodies.BLADE_FRICTION),
                unit_weight,
                lambda limit, reach=reach: kept_weight * np.count_nonzero(reach < limit),
            )
        )
    return float(np.mean(ours) / np.mean(theirs))


def earthmoving_case(case: int, raw_path: str) -> list[Check]:
    """The draft of one case against the fundamental equation."""
    ratio = earthmoving_ratio(run_of(scenes.EXCAVATION, case, raw_path))
    name = f'excavation {case}: draft over the equation of earthmoving'
    return [Check(name, ratio, 1.0, 0.3, 'phi = asin(mu_s), heap included')]


def depth_exponent(raw_path: str) -> list[Check]:
    """The exponent of the draft in depth, over the same stretch of travel.

    Contact begins half a particle spacing below the edge, which matters for the shallow cuts.
    """
    scene = scenes.EXCAVATION
    depths, drafts = [], []
    for case in EXPONENT_CASES:
        run = run_of(scene, case, raw_path)
        drive = grid.make_drive(scene, run.parameters)
        path = drive.pose(np.arange(scenes.FRAMES) / scenes.FRAME_RATE)
        travel = path[0, 0] - path[:, 0]
        chosen = (travel > EXPONENT_TRAVEL[0]) & (travel < EXPONENT_TRAVEL[1])
        edge = path[chosen, 1] - bodies.BLADE_THICKNESS / 2
        depths.append(scene.bin.surface - edge.mean())
        drafts.append(run.force[chosen, 0].mean())
    # Contact begins half a spacing of particles below the edge.
    radius = 0.5 * scene.bin.size[1] / scene.bin.lattice[1]
    nominal, exponent = (
        float(np.polyfit(np.log(np.array(depths) + extra), np.log(drafts), 1)[0])
        for extra in (0.0, radius)
    )
    note = f'between 1.5 and 2.2; {nominal:.2f} in the depth of the edge'
    return [Check('blade draft: exponent in depth of contact', exponent, 1.85, 0.35, note)]


def saw_tooth(force: np.ndarray, speed: float, dx: float) -> float:
    """Returns the amplitude of a force at the rate at which cells are crossed, over its mean.

    Args:
        force: float64 [T], N, at the frame rate, while the body cuts at constant speed.
        speed: m/s.
        dx: cell size, m.

    Raises:
        ValueError: if fewer than four cells are crossed.
    """
    frames = len(force)
    crossings = speed * frames / scenes.FRAME_RATE / dx
    if crossings < 4.0:
        raise ValueError(f'{frames} frames at {speed} m/s cross {crossings:.2g} cells; 4 needed')
    t = np.linspace(-1.0, 1.0, frames)
    window = np.hanning(frames)
    rest = force - np.polyval(np.polyfit(t, force, 3), t)
    rate = np.arange(frames) / scenes.FRAME_RATE
    # Within a tenth of the rate, as fine as the window tells apart.
    tones = speed / dx * np.linspace(0.9, 1.1, 21)
    waves = np.exp(-2j * np.pi * tones[:, None] * rate)
    amplitude = 2.0 * np.abs(waves @ (window * rest)).max() / window.sum()
    return float(amplitude / abs(force.mean()))


def cutting_frames(parameters: dict, count: int) -> np.ndarray:
    """Returns which of the first `count` frames cut at the run's speed and about level, int [K].

    The first quarter of that stretch is left out: the draft still builds up.
    """
    path = grid.make_drive(scenes.EXCAVATION, parameters).pose(np.arange(count) / scenes.FRAME_RATE)
    step = np.diff(path[:, :2], axis=0)
    way = parameters['speed_m_s'] / scenes.FRAME_RATE
    is_steady = (np.abs(-step[:, 0] - way) < 1e-6 * way) & (np.abs(step[:, 1]) < LEVEL * way)
    steady = np.flatnonzero(is_steady) + 1
    return steady[len(steady) // 4 :]


def cutting_force(run: raw_run.RawRun) -> np.ndarray:
    """Returns the force [K] (N) along x of a run in its `cutting_frames`."""
    return run.force[cutting_frames(run.parameters, len(run.force)), 0].astype(np.float64)


def saw_tooth_case(case: int, raw_path: str) -> list[Check]:
    """The force's saw-tooth at the cell-crossing rate."""
    run = run_of(scenes.EXCAVATION, case, raw_path)
    speed, dx = run.parameters['speed_m_s'], run.parameters['cell_m'][0]
    share = saw_tooth(cutting_force(run), speed, dx)
    name = f'excavation {case}: saw-tooth over the mean force'
    return [Check(name, share, 0.0, 0.05, f'at {speed / dx:.1f} Hz')]


def leak(scene: scenes.Scene, raw_path: str) -> list[Check]:
    """The deepest particle in the body, of all runs that the folder holds."""
    found = [run['parameters'] for run in runs_held(scene, raw_path)]
    deepest = max(p['penetration_deepest_cells'] for p in found)
    inside = sum(p['penetration_inside'] for p in found)
    note = f'{len(found)} runs, all frames; {inside} particles deeper than a quarter of a cell'
    return [Check(f'{scene.name}: deepest particle in the body, cells', deepest, 0.0, 0.25, note)]


def wheel_load(raw_path: str) -> list[Check]:
    """The soil carries the wheel: mean vertical force over load, of all runs of the folder."""
    folder = os.path.join(raw_path, scenes.WHEEL.name)
    ratios = {}
    for entry in runs_held(scenes.WHEEL, raw_path):
        run = raw_run.read_run(os.path.join(folder, entry['file']))
        load = run.step_context[1:, scenes.WHEEL.context_names.index('load')]
        ratios[entry['case']] = float(run.force[1:, 1].mean() / load.mean())
    worst = max(ratios, key=lambda case: abs(ratios[case] - 1.0))
    note = f'worst of {len(ratios)} runs: {worst}'
    name = 'wheel: mean vertical force over load'
    return [Check(name, ratios[worst], 1.0, 0.03, note)]


def wheel_slip(raw_path: str) -> list[Check]:
    """The drawbar pull grows with slip."""
    pulls = [
        -float(run_of(scenes.WHEEL, case, raw_path).force[1:, 0].mean()) for case in SLIP_CASES
    ]
    note = 'at 20, 38.5, 70 %: ' + ', '.join(f'{pull:.1f} N' for pull in pulls)
    name = 'wheel: smallest rise of drawbar pull with slip, N'
    return [Check(name, float(np.diff(pulls).min()), 100.0, 100.0, note)]


PRESS_SPEEDS = (0.01, 0.04, 0.16)  # m/s
PRESS_FROM, PRESS_BAND = 0.004, (0.012, 0.016)  # m: above the bed, and depths whose force counts
FREE_MASS = 20.0  # kg


def _upright_blade(height, machine=None):
    """The blade in the middle of the bin; `height` (m above the bed) is a function of times (s)."""
    box, body = scenes.EXCAVATION.bin, bodies.make_blade()

    def pose(times):
        path = np.zeros((len(times), 4))
        path[:, 0], path[:, 3] = scenes.CORNER + box.size[0] / 2, box.z_middle
        path[:, 1] = box.surface + body.radius + height(np.maximum(times, 0.0))
        return path

    motion = catalogue.Motion('row', Drive(body, pose, machine), {}, 0, scenes.Ground())
    settings = Settings()
    particles = packed(box, settings.youngs_modulus)
    return run.make_simulation(scenes.EXCAVATION, motion, particles, settings)


def press_rate() -> list[Check]:
    """Dry soil answers a press as strongly when it is fast: F ~ v^n with n near 0."""
    forces = []
    for speed in PRESS_SPEEDS:
        simulation = _upright_blade(lambda t, speed=speed: PRESS_FROM - speed * t)
        seen = []
        while (depth := (simulation.time * speed) - PRESS_FROM) < PRESS_BAND[1]:
            simulation.frame()
            quarters = depth + speed / scenes.FRAME_RATE * (np.arange(4) + 0.5) / 4
            is_in = (quarters >= PRESS_BAND[0]) & (quarters <= PRESS_BAND[1])
            seen += simulation.loads[is_in, 1].tolist()
        forces.append(float(np.mean(seen)))
    exponent = float(np.polyfit(np.log(PRESS_SPEEDS), np.log(forces), 1)[0])
    note = ', '.join(f'{1e3 * v:g} mm/s {f:.0f} N' for v, f in zip(PRESS_SPEEDS, forces))
    return [Check('press: exponent of the force in the speed', exponent, 0.0, 0.05, note)]


def set_down() -> list[Check]:
    """A blade that is free in height comes to rest under its weight, and the soil carries it."""
    weight = FREE_MASS * scenes.EARTH_GRAVITY

    def force(times):
        return -weight * np.clip(times / 0.4, 0.0, 1.0)[:, None] * [0.0, 1.0, 0.0]

    machine = Machine((False, True, False), FREE_MASS, force)
    simulation = _upright_blade(lambda t: np.full(len(t), 0.003), machine)
    heights, forces = [], []
    for _ in range(210):
        forces.append(simulation.frame()[0][1])
        heights.append(simulation.pose[1])
    drift = 1e3 * abs(heights[-1] - heights[179]) / 0.5
    box = scenes.EXCAVATION.bin
    depth = 1e3 * (box.surface + bodies.BLADE_THICKNESS / 2 - heights[-1])
    name = f'blade of {FREE_MASS:g} kg, free in height'
    return [
        Check(f'{name}: drift after 3 s, mm/s', drift, 0.0, 0.05, f'{depth:.1f} mm deep'),
        Check(
            f'{name}: force over weight', np.mean(forces[180:]) / weight, 1.0, 0.005, '3 to 3.5 s'
        ),
        reported(f'{name}: depth of the edge, mm', depth, 'after 3.5 s'),
    ]
