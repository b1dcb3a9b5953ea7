"""One run of a case: from the settled packing to the arrays of a raw run."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mpm import bodies, columns, packing, scenes, solver, stability
from mpm.constitutive import Soil, make_soil

SORT_EVERY = 4  # frames
REST_FRAMES = 48  # the wheel rests before it drives; the load grows over the first half
RHEOLOGIES = ('local', 'nonlocal')


@dataclass(frozen=True)
class Settings:
    """What may be set for all runs of a folder.

    Attributes:
        youngs_modulus: Pa.
        rheology: 'local' mu(I), or 'nonlocal' granular fluidity.
        seed: of the packing's jitter.
        steps_per_frame: 0: from the CFL limit.
    """

    youngs_modulus: float = 1.5e6
    rheology: str = 'local'
    seed: int = 0
    steps_per_frame: int = 0

    def __post_init__(self):
        if self.rheology not in RHEOLOGIES:
            raise ValueError(f'rheology must be one of {RHEOLOGIES}, got {self.rheology!r}')


@dataclass(frozen=True)
class RawRun:
    """The arrays of one run, as written to disk.

    Attributes:
        positions: float32 [T, N, 3], m.
        rigid_positions: float32 [T, R, 3], m.
        force: float32 [T, 3], N, on the body by the soil, mean over the frame that ends at t.
        parameters: what was run, JSON-compatible.
    """

    positions: np.ndarray
    rigid_positions: np.ndarray
    force: np.ndarray
    parameters: dict


class Simulation:
    """Soil and body of one case, advanced frame by frame.

    Attributes:
        particles: float64 [N, COLUMNS], sorted by cell now and then (see `columns.IDENTITY`).
        rider: float64 [4], see `solver.advance`: the wheel's height, speed, mass and load.
        dt: time step, s.
        time: s since driving began (negative at rest).
    """

    def __init__(
        self,
        scene: scenes.Scene,
        parameters: dict,
        soil: Soil,
        particles: np.ndarray,
        settings: Settings,
    ):
        self._scene = scene
        self.soil = soil
        self.grid = packing.make_grid(scene.bin)
        self.drive = scenes.make_drive(scene, parameters)
        self.gravity = scenes.gravity_of(scene, parameters)
        self.particles = packing.at_gravity(particles, self.gravity)
        is_nonlocal = settings.rheology == 'nonlocal'
        if is_nonlocal:
            stability.check_friction(soil)
        self.steps = settings.steps_per_frame or stability.steps_per_frame(
            1 / scenes.FRAME_RATE, soil, self.grid.dx, is_nonlocal
        )
        self.dt = 1 / scenes.FRAME_RATE / self.steps
        stability.check_time_step(self.dt, soil, self.grid.dx, is_nonlocal)
        self._work = np.zeros(4 * self.grid.nodes)
        self._fluidity = np.zeros((self.grid.nodes, 3)) if is_nonlocal else None
        self._status = np.zeros(3, dtype=np.int64)
        self.rider = np.zeros(4)
        self.time = 0.0
        self.rotation = 0.0
        self._frame = 0
        if self.drive.load > 0.0:
            # Resting on the surface; its mass is that which weighs the load on the Earth.
            self.rider[0] = scene.bin.surface + self.drive.body.dims[3]
            self.rider[2] = self.drive.load / scenes.EARTH_GRAVITY
            self._rest()

    def _rest(self) -> None:
        """Lets the wheel sink into the soil before it drives."""
        for frame in range(REST_FRAMES):
            self.rider[3] = self.drive.load * min(1.0, (frame + 1) / (REST_FRAMES // 2))
            self.time = (frame - REST_FRAMES) / scenes.FRAME_RATE
            self._advance(spin=0.0)
        self.time = 0.0

    def frame(self) -> np.ndarray:
        """Advances by one frame; returns the mean force [3] on the body in it, N.

        Raises:
            ValueError: if a particle leaves the grid or moves too fast for the step; if the body
                does (`stability.UnstableTimeStepError`).
        """
        force = self._advance(self.drive.spin)
        self.rotation += self.drive.spin / scenes.FRAME_RATE
        self._frame += 1
        self.time = self._frame / scenes.FRAME_RATE
        return force

    def _advance(self, spin: float) -> np.ndarray:
        if self._frame % SORT_EVERY == 0:
            self.particles = packing.sort_by_cell(self.particles, self.grid)
        times = self.time + np.arange(self.steps + 1) * self.dt
        body, path = self.drive.body, self.drive.path(times)
        # The height of a free wheel is not prescribed.
        prescribed = path * [1.0, 0.0] if self.rider[2] > 0.0 else path
        rim_speed = spin * (body.dims[2] + body.dims[3])
        stability.check_body_motion(prescribed, rim_speed, self.dt, self.grid.dx)
        impulse = np.zeros(3)
        solver.advance(
            self.particles,
            self._work,
            self._fluidity,
            self.grid.shape,
            self.grid.origin,
            self.grid.dx,
            self.dt,
            self.grid.walls,
            self.soil,
            packing.particle_volume(self._scene.bin),
            self.gravity,
            1.0,
            body.dims,
            body.friction,
            body.outset * self.grid.dx,
            path,
            spin,
            self.rider,
            impulse,
            self._status,
        )
        if self._status[0] != columns.OK:
            raise ValueError(
                f'particle {self._status[1]} left the grid at {self.time:.3f} s '
                f'(step {self._status[2]})'
            )
        speed = np.sqrt((self.particles[:, columns.V : columns.V + 3] ** 2).sum(axis=1).max())
        if not speed * self.dt <= stability.VELOCITY_CFL * self.grid.dx:
            raise ValueError(
                f'soil at {speed:.3g} m/s crosses {speed * self.dt / self.grid.dx:.3g} cells a '
                f'step at {self.time:.3f} s; at most {stability.VELOCITY_CFL} is resolved'
            )
        return impulse * scenes.FRAME_RATE

    def positions(self) -> np.ndarray:
        """Returns the positions [N, 3] of all particles in the order of identity, m."""
        return packing.in_identity_order(self.particles)[:, :3]

    def rigid_points(self) -> np.ndarray:
        """Returns the body's sample points [R, 3], m."""
        x, y = self.drive.path(np.array([self.time]))[0]
        if self.rider[2] > 0.0:
            y = self.rider[0]
        return bodies.sample_points(self.drive.body, x, y, self.rotation)


def run_case(
    scene: scenes.Scene,
    case: int,
    packed: tuple[np.ndarray, dict],
    settings: Settings,
    on_frame: Callable[[int], None] | None = None,
) -> RawRun:
    """Simulates one case.

    Args:
        scene: the scene.
        case: its number.
        packed: the settled particles and their statistics (`packing.settle`).
        settings: stiffness, law, seed.
        on_frame: called with the number of each finished frame.

    Returns:
        The run: T = 321 frames at 60 Hz, the first before driving.

    Raises:
        ValueError: see `Simulation`.
    """
    started = time.process_time()
    parameters = scene.parameters(case)
    soil = make_soil(settings.youngs_modulus, scenes.static_friction(scene, parameters))
    simulation = Simulation(scene, parameters, soil, packed[0], settings)
    kept = slice(None, None, scene.bin.keep_every)
    positions = [simulation.positions()[kept].astype(np.float32)]
    rigid = [simulation.rigid_points()]
    force = []
    for frame in range(1, scenes.FRAMES):
        force.append(simulation.frame())
        positions.append(simulation.positions()[kept].astype(np.float32))
        rigid.append(simulation.rigid_points())
        if on_frame is not None:
            on_frame(frame)
    record = {
        'case': case,
        'seed': settings.seed,
        'context': scenes.context_of(scene, parameters),
        **parameters,
        'youngs_modulus_Pa': settings.youngs_modulus,
        'rheology': settings.rheology,
        'time_step_s': simulation.dt,
        'cell_size_m': simulation.grid.dx,
        'soil': soil._asdict(),
        'body_friction': simulation.drive.body.friction,
        'packing': packed[1],
        'solver_cpu_s': round(time.process_time() - started, 2),
    }
    return RawRun(
        positions=np.asarray(positions, dtype=np.float32),
        rigid_positions=np.asarray(rigid, dtype=np.float32),
        force=np.asarray(force[:1] + force, dtype=np.float32),
        parameters=record,
    )
