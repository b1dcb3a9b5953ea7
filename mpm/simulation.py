"""Soil and body of one run, advanced frame by frame."""

import math
from dataclasses import dataclass

import numpy as np

from mpm import columns, packing, solver, stability
from mpm.constitutive import Soil
from mpm.distance import signed_distances
from mpm.grid import make_grid
from mpm.motions.drive import Drive
from mpm.scenes import FRAME_RATE, Bin
from mpm.sleeping import PERIOD, Sleep
from mpm.solver import EXCHANGE, Solver

SUBFRAMES = 4  # parts of a frame whose mean loads are recorded of a free body
SPRAY = 1e-3  # share of the stepped particles that may fly faster than flowing soil may
STIFFEST = 0.3  # of an actuator: time step times its frequency, and times its rate of damping


@dataclass(frozen=True)
class Settings:
    """What may be set for all runs of a folder."""

    youngs_modulus: float = 1.5e6  # Pa
    seed: int = 0  # of the packing's jitter
    # friction_angle_deg, bulk_density, gravity, slope_deg: of the soil (deg, kg/m3, m/s2, deg), in
    # place of what a run would have; None: that
    friction_angle_deg: float | None = None
    bulk_density: float | None = None
    gravity: float | None = None
    slope_deg: float | None = None
    tool_friction: float | None = None  # Coulomb coefficient between tool and soil, likewise
    exchange: float = EXCHANGE  # s, between two exchanges of particles and grid
    steps: int = 0  # per exchange; 0: from the CFL limit
    sleep: bool = True  # whether soil that rests is left out (`sleeping`)
    # Whether the steps between exchanges are taken in float32; particles are float64
    single: bool = True

    def __post_init__(self):
        for name, low, high in (
            ('youngs_modulus', 1e4, 1e9),
            ('friction_angle_deg', 15.0, 50.0),
            ('bulk_density', 500.0, 4000.0),
            ('gravity', 0.5, 100.0),
            ('slope_deg', -25.0, 25.0),
            ('tool_friction', 0.0, 2.0),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f'{name} is {value}, must lie in [{low:g}, {high:g}]')

    def recorded(self) -> dict:
        """Returns what all runs of a folder share; what is None is named nowhere."""
        return {
            'youngs_modulus_Pa': self.youngs_modulus,
            'seed': self.seed,
            'set_friction_angle_deg': self.friction_angle_deg,
            'set_bulk_density_kg_m3': self.bulk_density,
            'set_gravity_m_s2': self.gravity,
            'set_slope_deg': self.slope_deg,
            'set_tool_friction': self.tool_friction,
        }


class Simulation:
    """Soil and body of one run, advanced frame by frame.

    Attributes:
        drive: the body and its motion.
        gravity: m/s2.
        free: `solver.Free` of the body: its free coordinates, their rates, what drives them.
        dt: time step, s; `steps` of them make a frame.
        time: s since driving began (negative at rest).
        loads: float64 [SUBFRAMES, 6], mean force (N) and torque (N m, about the reference point) of
            the soil on the body in the parts of the last frame.
    """

    def __init__(
        self,
        box: Bin,
        drive: Drive,
        soil: Soil,
        particles: np.ndarray,
        settings: Settings,
        gravity: float,
        slope_deg: float = 0.0,
    ):
        """Puts the body in its first pose; one that has a `rest` sinks in until it rests.

        `particles` is the settled packing, float64 [N, COLUMNS]; gravity (m/s2) leans by slope_deg,
        loads on a tool do not. ValueError: a step that is not stable, or as `frame`.
        """
        self.box, self.soil, self.drive, self.gravity = box, soil, drive, gravity
        self._slope = math.radians(slope_deg)
        self.grid = make_grid(box)
        dtype, exchange = np.float32 if settings.single else np.float64, settings.exchange
        volume = packing.particle_volume(box)
        self._solver = Solver(self.grid, soil, volume, settings.steps, dtype, exchange)
        self._intervals = round(1.0 / (FRAME_RATE * exchange))
        if abs(self._intervals * exchange * FRAME_RATE - 1.0) > 1e-9:
            raise ValueError(f'a frame is no whole number of exchanges of {exchange:.4g} s')
        self.dt, self.steps = self._solver.dt, self._solver.steps * self._intervals
        stability.check_time_step(self.dt, soil, min(self.grid.dx, self.grid.dz))
        self._particles = packing.for_soil(particles, soil, gravity)
        self._sleep = Sleep(self.grid, settings.sleep)
        self._block, self._awake, self._age = None, None, 0
        self.free = solver.prescribed()
        self.time, self._frame = 0.0, 0
        self.loads = np.zeros((SUBFRAMES, 6))
        if drive.machine is not None:
            self._let_go()
        for frame in range(drive.rest):
            self.time = (frame - drive.rest) / FRAME_RATE
            self._advance(min(1.0, (frame + 1) / (drive.rest // 2)))
        self.time = 0.0

    def _let_go(self) -> None:
        machine, body = self.drive.machine, self.drive.body
        mass = machine.masses()
        stiffness, damping = np.array(machine.stiffness), np.array(machine.damping)
        is_free = mass > 0.0
        per_mass = np.divide(1.0, mass, out=np.zeros(3), where=is_free)
        rate = np.maximum(np.sqrt(stiffness * per_mass), damping * per_mass)
        if not (rate * self.dt <= STIFFEST).all():
            raise ValueError(
                f'an actuator of {stiffness} N/m and {damping} N s/m on {mass} kg answers at '
                f'{rate.max():.4g} 1/s; at most {STIFFEST / self.dt:.4g} is stable with steps of '
                f'{self.dt:.4g} s'
            )
        self.free = solver.Free(np.zeros((2, 3)), mass, stiffness * is_free, damping * is_free)
        self.free.state[0] = self.drive.pose(np.zeros(1))[0, :3]
        if self.drive.rest:
            # Just above the grains.
            self.free.state[0, 1] = self.box.surface + body.reach + self._solver.law.radius

    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Advances by one frame.

        Returns force [3] (N) of the soil on the body and its torque [3] (N m) about the body's
        reference point, means over the frame. ValueError: a particle leaves the grid, or it or the
        body moves too fast for the step.
        """
        mean = self._advance(1.0)
        self._frame += 1
        self.time = self._frame / FRAME_RATE
        return mean[:3], mean[3:]

    def _advance(self, share_of_load: float) -> np.ndarray:
        """Advances the steps of a frame from `time`; returns the mean load [6] on the body."""
        times = self.time + np.arange(self.steps + 1) * self.dt
        body, path = self.drive.body, self.drive.pose(times)
        fixed = path.copy()
        fixed[:, :3] = np.where(self.free.mass > 0.0, 0.0, path[:, :3])
        stability.check_body_motion(fixed, body.reach, self.dt, self.grid.dx, self.time)
        if self._awake is None or self._age >= PERIOD:
            self._wake()
        elif self._block is None:
            self._block = self._solver.block(self._particles[self._awake])
        self._age += 1
        machine = self.drive.machine
        external = None if machine is None else share_of_load * machine.force(times)
        moved = body, path, external, self.free
        try:
            loads = self._solver.advance(
                self._block, self._intervals, self.gravity, moved=moved, slope=self._slope
            )
        except ValueError as error:
            raise ValueError(f'{error}, {self.time:.3f} s after the start') from error
        self.loads = _means(loads, SUBFRAMES)
        v = self._block.particles[:, columns.V : columns.V + 3]  # type: ignore[attr-defined]
        cell_speed = self.grid.dx / self._solver.exchange
        cells = np.linalg.norm(v, axis=1) / cell_speed
        many = np.count_nonzero(cells > stability.VELOCITY_CFL) > SPRAY * len(cells)
        if many or not cells.max(initial=0.0) <= stability.SPRAY_CFL:
            raise ValueError(
                f'soil at {cells.max() * cell_speed:.3g} m/s crosses '
                f'{cells.max():.3g} cells between two exchanges at {self.time:.3f} s; at most '
                f'{stability.VELOCITY_CFL} is resolved ({stability.SPRAY_CFL} of single grains)'
            )
        return loads.mean(axis=0)

    def _wake(self) -> None:
        self._put_back()
        times = self.time + np.arange(PERIOD + 1) / FRAME_RATE
        path, q = self.drive.pose(times), self._particles
        coming = self.free.state[0] + (times - self.time)[:, None] * self.free.state[1]
        path[:, :3] = np.where(self.free.mass > 0.0, coming, path[:, :3])
        awake = self._sleep.awake(q[:, :3], self.drive.body, path, PERIOD / FRAME_RATE)
        q[~awake, columns.V : columns.S] = 0.0
        self._solver.nodes.asleep[:] = self._sleep.nodes_asleep(q[~awake, :3])
        rows = np.flatnonzero(awake)
        self._awake = rows[packing.cell_order(q[rows], self.grid)]
        self._block, self._age = self._solver.block(q[self._awake]), 0

    def _put_back(self) -> None:
        if self._block is not None:
            self._particles[self._awake] = self._block.particles

    @property
    def particles(self) -> np.ndarray:
        """The particles, float64 [N, COLUMNS]; what is written into them counts from then on.

        Soil that sleeps stays asleep until the next look.
        """
        self._put_back()
        self._block = None
        return self._particles

    @property
    def target(self) -> np.ndarray:
        """What the drive asks for now: x, y (m), angle (rad), z (m), float64 [4]."""
        return self.drive.pose(np.array([self.time]))[0]

    @property
    def pose(self) -> np.ndarray:
        """x and y (m) of the body's reference point, its angle (rad) and z (m) now, float64 [4]."""
        pose = self.target
        pose[:3] = np.where(self.free.mass > 0.0, self.free.state[0], pose[:3])
        return pose

    def positions(self) -> np.ndarray:
        """Returns the positions [N, 3] of all particles, m."""
        if self._block is not None:
            self._particles[self._awake, :3] = self._block.particles[:, :3]
        return self._particles[:, :3].copy()

    def penetration(self) -> dict:
        """Returns `deepest_cells`, how deep any particle is below the body's surface, in cells (0:
        none is inside), and `inside`, the number of particles deeper than a quarter of a cell."""
        # What sleeps does not move, and is far from the body.
        rows = self._particles if self._block is None else self._block.particles
        depth = -signed_distances(self.drive.body, self.pose, rows[:, :3])
        deepest = max(0.0, float(depth.max(initial=0.0)) / self.grid.dx)
        return {'deepest_cells': deepest, 'inside': int((depth > 0.25 * self.grid.dx).sum())}


def _means(loads: np.ndarray, parts: int) -> np.ndarray:
    """Means [parts, 6] over equal parts of loads [steps, 6] that are constant within a step."""
    total = np.concatenate([np.zeros((1, 6)), np.cumsum(loads, axis=0)])
    ends = np.linspace(0.0, len(loads), parts + 1)
    at = np.stack([np.interp(ends, np.arange(len(total)), c) for c in total.T], axis=1)
    return np.diff(at, axis=0) * (parts / len(loads))
