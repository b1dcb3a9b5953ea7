"""Soil and body of one run, advanced frame by frame."""

from dataclasses import dataclass

import numpy as np

from mpm import bodies, columns, packing, stability
from mpm.constitutive import Soil
from mpm.contact import signed_distances
from mpm.grid import make_grid
from mpm.motions.drive import Drive
from mpm.scenes import EARTH_GRAVITY, FRAME_RATE, Bin
from mpm.sleeping import PERIOD, Sleep
from mpm.solver import EXCHANGE, Solver

INTERVALS = round(1.0 / (FRAME_RATE * EXCHANGE))  # exchanges per frame
REST_FRAMES = 48  # the wheel rests before it drives; the load grows over the first half
RHEOLOGIES = ('local', 'nonlocal')


@dataclass(frozen=True)
class Settings:
    """What may be set for all runs of a folder.

    Attributes:
        youngs_modulus: Pa.
        rheology: 'local' mu(I), or 'nonlocal' granular fluidity.
        seed: of the packing's jitter.
        steps_per_frame: a multiple of 18 (`solver.EXCHANGE`); 0: from the CFL limit.
        sleep: whether soil that rests is left out (`sleeping`).
        single: whether the steps between exchanges are taken in float32; particles are float64.
        dilation: K of `constitutive.dilated`, which keeps the volume of soil that is sheared; 0:
            nothing does, as in the data of record.
    """

    youngs_modulus: float = 1.5e6
    rheology: str = 'local'
    seed: int = 0
    steps_per_frame: int = 0
    sleep: bool = True
    single: bool = True
    dilation: float = 0.0

    def __post_init__(self):
        if self.rheology not in RHEOLOGIES:
            raise ValueError(f'rheology must be one of {RHEOLOGIES}, got {self.rheology!r}')
        if self.steps_per_frame % INTERVALS:
            raise ValueError(
                f'steps_per_frame is {self.steps_per_frame}, must be a multiple of {INTERVALS}: '
                f'particles and grid exchange every {EXCHANGE:.3g} s'
            )

    def recorded(self) -> dict:
        """Returns what the record of a run says of them, which all runs of a folder share.

        `dilation` is None without one, and then no record names it: these are the runs of before.
        """
        return {
            'youngs_modulus_Pa': self.youngs_modulus,
            'rheology': self.rheology,
            'sleep': self.sleep,
            'seed': self.seed,
            'dilation': self.dilation or None,
        }


class Simulation:
    """Soil and body of one run, advanced frame by frame.

    Attributes:
        heave: float64 [3], see `solver.Motion`: the free body's height, speed and mass.
        grid: `grid.Grid`.
        soil: of the bin.
        drive: the body and its motion.
        gravity: m/s2.
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
        is_nonlocal = settings.rheology == 'nonlocal'
        if is_nonlocal:
            stability.check_friction(soil)
        self.soil, self.drive, self.gravity = soil, drive, gravity
        self.grid = make_grid(box)
        volume = packing.particle_volume(box)
        self._solver = Solver(
            self.grid,
            soil,
            volume,
            settings.steps_per_frame // INTERVALS,
            is_nonlocal,
            np.float32 if settings.single else np.float64,
        )
        self.dt, self.steps = self._solver.dt, self._solver.steps * INTERVALS
        stability.check_time_step(self.dt, soil, self.grid.dx, is_nonlocal)
        self._particles = packing.at_gravity(particles, gravity)
        self._sleep = Sleep(self.grid, settings.sleep)
        self._block, self._awake, self._age = None, None, 0
        self.heave = np.zeros(3)
        self.time = 0.0
        self._frame = 0
        if drive.load is not None:
            # Just above the grains; its mass is that which weighs the first load on the Earth.
            self.heave[0] = box.surface + drive.body.radius + self._solver.law.radius
            self.heave[2] = float(drive.load(np.zeros(1))[0]) / EARTH_GRAVITY
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
        times = self.time + np.arange(self.steps + 1) * self.dt
        body, path = self.drive.body, self.drive.pose(times)
        if self.heave[2] > 0.0:
            path = path * [1.0, 0.0, 1.0]  # the height of a free body is not prescribed
        stability.check_body_motion(path, body.reach, self.dt, self.grid.dx, self.time)
        if self._awake is None or self._age >= PERIOD:
            self._wake()
        elif self._block is None:
            self._block = self._solver.block(self._particles[self._awake])
        self._age += 1
        weight = None
        if self.drive.load is not None:
            weight = share_of_load * self.drive.load(times)
        self._solver.impulse[:] = 0.0
        try:
            self._solver.advance(
                self._block, INTERVALS, self.gravity, 1.0, body, path, weight, self.heave
            )
        except ValueError as error:
            raise ValueError(f'{error}, {self.time:.3f} s after the start') from error
        v = self._block.particles[:, columns.V : columns.V + 3]
        speed = np.sqrt((v * v).sum(axis=1).max(initial=0.0))
        if not speed * EXCHANGE <= stability.VELOCITY_CFL * self.grid.dx:
            raise ValueError(
                f'soil at {speed:.3g} m/s crosses {speed * EXCHANGE / self.grid.dx:.3g} cells '
                f'between two exchanges at {self.time:.3f} s; at most {stability.VELOCITY_CFL} is '
                'resolved'
            )
        return self._solver.impulse.copy()

    def _wake(self) -> None:
        """Chooses the particles that the next frames step."""
        self._put_back()
        times = self.time + np.arange(PERIOD + 1) / FRAME_RATE
        path = self.drive.pose(times)
        if self.heave[2] > 0.0:
            path[:, 1] = self.heave[0]
        q = self._particles
        awake = self._sleep.awake(q[:, :3], self.drive.body, path, PERIOD / FRAME_RATE)
        q[~awake, columns.V : columns.S] = 0.0
        self._solver.nodes.asleep[:] = self._sleep.nodes_asleep(q[~awake, :3])
        rows = np.flatnonzero(awake)
        self._awake = rows[packing.cell_order(q[rows], self.grid)]
        self._block, self._age = self._solver.block(q[self._awake]), 0

    def _put_back(self) -> None:
        """Brings the rows of the particles up to date with those that were stepped."""
        if self._block is not None:
            self._particles[self._awake] = self._block.particles

    @property
    def particles(self) -> np.ndarray:
        """The particles, float64 [N, COLUMNS]; what is written into them counts from then on.

        Soil that sleeps stays asleep until the next look; to look at it all anew, set them.
        """
        self._put_back()
        self._block = None
        return self._particles

    @particles.setter
    def particles(self, rows: np.ndarray) -> None:
        self._particles, self._block, self._awake = rows, None, None

    @property
    def share_awake(self) -> float:
        """Share of the particles that the last frame stepped."""
        return len(self._awake) / len(self._particles)

    @property
    def pose(self) -> tuple[float, float, float]:
        """x and y (m) of the body's reference point and its angle theta (rad), now."""
        x, y, theta = self.drive.pose(np.array([self.time]))[0]
        return float(x), float(self.heave[0] if self.heave[2] > 0.0 else y), float(theta)

    def positions(self) -> np.ndarray:
        """Returns the positions [N, 3] of all particles, m."""
        if self._block is not None:
            self._particles[self._awake, :3] = self._block.particles[:, :3]
        return self._particles[:, :3].copy()

    def penetration(self) -> dict:
        """Returns how deep soil lies in the body now.

        Returns:
            `deepest_cells`: of any particle below the surface, in cells (0: none is inside);
            `inside`: number of particles deeper than a quarter of a cell.
        """
        depth = -signed_distances(self.drive.body, self.pose, self.positions())
        deepest = max(0.0, float(depth.max()) / self.grid.dx)
        return {'deepest_cells': deepest, 'inside': int((depth > 0.25 * self.grid.dx).sum())}

    def rigid_points(self) -> np.ndarray:
        """Returns the body's sample points [R, 3], m."""
        return bodies.sample_points(self.drive.body, *self.pose)
