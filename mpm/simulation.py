"""Soil and body of one run, advanced frame by frame."""

from dataclasses import dataclass

import numpy as np

from mpm import bodies, columns, packing, solver, stability
from mpm.constitutive import Soil
from mpm.motions.drive import Drive
from mpm.scenes import EARTH_GRAVITY, FRAME_RATE, Bin

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


class Simulation:
    """Soil and body of one run, advanced frame by frame.

    Attributes:
        particles: float64 [N, COLUMNS], sorted by cell now and then (see `columns.IDENTITY`).
        rider: float64 [3], see `solver.advance`: the free body's height, speed and mass.
        dt: time step, s; `steps` of them make a frame.
        time: s since driving began (negative at rest).
    """

    def __init__(
        self,
        box: Bin,
        drive: Drive,
        soil: Soil,
        particles: np.ndarray,
        settings: Settings,
        gravity: float,
    ):
        """Puts the body in its first pose; one that rides freely sinks in until it rests.

        Args:
            box: the bin.
            drive: the body and its motion.
            soil: of the bin.
            particles: float64 [N, COLUMNS], the settled packing.
            settings: stiffness, law, steps.
            gravity: m/s2.

        Raises:
            ValueError: a step that is not stable, or what `frame` raises.
        """
        self._box = box
        self.soil = soil
        self.grid = packing.make_grid(box)
        self.drive = drive
        self.gravity = gravity
        self.particles = packing.at_gravity(particles, gravity)
        is_nonlocal = settings.rheology == 'nonlocal'
        if is_nonlocal:
            stability.check_friction(soil)
        self.steps = settings.steps_per_frame or stability.steps_per_frame(
            1 / FRAME_RATE, soil, self.grid.dx, is_nonlocal
        )
        self.dt = 1 / FRAME_RATE / self.steps
        stability.check_time_step(self.dt, soil, self.grid.dx, is_nonlocal)
        self._work = np.zeros(4 * self.grid.nodes)
        self._fluidity = np.zeros((self.grid.nodes, 3)) if is_nonlocal else None
        self._status = np.zeros(3, dtype=np.int64)
        self.rider = np.zeros(3)
        self.time = 0.0
        self._frame = 0
        if drive.load is not None:
            # Resting on the surface; its mass is that which weighs the first load on the Earth.
            self.rider[0] = box.surface + drive.body.radius
            self.rider[2] = float(drive.load(np.zeros(1))[0]) / EARTH_GRAVITY
            self._rest()

    def _rest(self) -> None:
        """Lets the free body sink into the soil before it drives."""
        for frame in range(REST_FRAMES):
            self.time = (frame - REST_FRAMES) / FRAME_RATE
            self._advance(min(1.0, (frame + 1) / (REST_FRAMES // 2)))
        self.time = 0.0

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Advances by one frame.

        Returns:
            Force [3] (N) of the soil on the body and its torque [3] (N m) about the body's
            reference point, both means over the frame and from the same sum of impulses.

        Raises:
            ValueError: if a particle leaves the grid or moves too fast for the step; if the body
                does (`stability.UnstableTimeStepError`).
        """
        impulse = self._advance(1.0)
        self._frame += 1
        self.time = self._frame / FRAME_RATE
        return impulse[:3] * FRAME_RATE, impulse[3:] * FRAME_RATE

    def _advance(self, share_of_load: float) -> np.ndarray:
        """Advances the steps of a frame from `time`; returns the impulse [6] on the body."""
        if self._frame % SORT_EVERY == 0:
            self.particles = packing.sort_by_cell(self.particles, self.grid)
        times = self.time + np.arange(self.steps + 1) * self.dt
        body, path = self.drive.body, self.drive.pose(times)
        if self.rider[2] > 0.0:
            path = path * [1.0, 0.0, 1.0]  # the height of a free body is not prescribed
        stability.check_body_motion(path, body.reach, self.dt, self.grid.dx, self.time)
        load = np.zeros(0)
        if self.drive.load is not None:
            load = share_of_load * self.drive.load(times)
        impulse = np.zeros(6)
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
            packing.particle_volume(self._box),
            self.gravity,
            1.0,
            body,
            path,
            load,
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
        return impulse

    @property
    def pose(self) -> tuple[float, float, float]:
        """x and y (m) of the body's reference point and its angle theta (rad), now."""
        x, y, theta = self.drive.pose(np.array([self.time]))[0]
        return float(x), float(self.rider[0] if self.rider[2] > 0.0 else y), float(theta)

    def positions(self) -> np.ndarray:
        """Returns the positions [N, 3] of all particles in the order of identity, m."""
        return packing.in_identity_order(self.particles)[:, :3]

    def rigid_points(self) -> np.ndarray:
        """Returns the body's sample points [R, 3], m."""
        return bodies.sample_points(self.drive.body, *self.pose)
