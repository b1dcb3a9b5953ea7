"""Steady flow of mu(I) soil down an incline, periodic along and across it (Bagnold's profile).

The grid of the solver has no periodic ends, and a finite layer feels its ends before its flow is
steady. Here the solver's own kernels are called in its own order, and after each scatter the
nodes that lie past an end are folded onto those of the start: both copies hold the sum.

With tau = p tan(theta) at every depth the inertial number is the same everywhere, and for
I = gamma_dot d sqrt(rho_s / p) (`constitutive`) with p = phi rho_s g cos(theta) (h - y)

    I    = I0 (tan(theta) - mu_s) / (mu_2 - tan(theta))
    u(y) = 2/3 I / d sqrt(phi g cos(theta)) (h^1.5 - (h - y)^1.5)

That flow is stable at the scale of the cells only where the law is well-posed (`posedness`). For
the beads it is; for the soil of the blade, whose friction hardly grows with I, it is at no I.

Sources:
  flow: GDR MiDi (2004), Eur. Phys. J. E 14, 341.
  beads: Jop, Forterre, Pouliquen (2006), Nature 441, 727.
  posedness: Barker, Schaeffer, Bohorquez, Gray (2015), J. Fluid Mech. 779, 794.
"""

import math
from collections.abc import Callable

import numpy as np
from tqdm import tqdm

from mpm import columns, packing, scenes
from mpm.constitutive import Soil, make_soil
from mpm.grid import PAD, clear, kick, make_grid, start_nodes
from mpm.scenes import CORNER, EARTH_GRAVITY, EXCAVATION, Bin, sampled
from mpm.solver import EXCHANGE, Solver
from mpm.stability import VELOCITY_CFL, damping_time
from mpm.transfers import grid_to_particles, particles_to_grid, strain_and_force

FIRST = PAD - 1  # the first node that soil of the first cell touches
COPIES = 3  # nodes of the start that soil of the last cell touches
NO_WALL = 10**6  # index of a node that no grid has
# Grains so large that the layers flow at the speed of a tool: with the 0.3 mm of the scenes the one
# of beads would run at 60 m/s.
GRAIN_DIAMETER = 0.02  # m
CELL = 0.8 / 60  # m, cubic; flow that is even along the incline needs no finer ones
CELLS = 4  # that the period is long, along and across
FLOWING_DEG = 26.0  # of the beads, which rest up to 20.9
SETTLE_S, SETTLE_DAMPING = 0.3, 20.0  # s; 1/s
LAYERS = 10  # of the profile
HALTING_SPEED = 0.2  # m/s


def beads() -> Soil:
    """The glass beads of Jop et al. (2006), as stiff and dense as the soil of the scenes."""
    soil = make_soil(1.5e6, math.tan(math.radians(20.9)))
    mu_2 = math.tan(math.radians(32.76))
    return soil._replace(mu_2=mu_2, inertial_number_0=0.279, grain_diameter=GRAIN_DIAMETER)


def soil_of_blade() -> Soil:
    """The soil of the excavation, of larger grains."""
    soil = make_soil(1.5e6, math.tan(math.radians(scenes.EXCAVATION_FRICTION_DEG)))
    return soil._replace(grain_diameter=GRAIN_DIAMETER)


def inertial_number(soil: Soil, angle_deg: float) -> float:
    """Returns I of the steady flow down an incline; negative where the soil rests."""
    slope = math.tan(math.radians(angle_deg))
    return soil.inertial_number_0 * (slope - soil.mu_s) / (soil.mu_2 - slope)


def posedness(soil: Soil, number: float) -> float:
    """Returns C of Barker et al. (2015) at an inertial number: mu(I) is well-posed where C <= 0.

    C = 4 (n^2 - n) + mu^2 (1 - n / 2)^2 with n = I mu' / mu.
    """
    rise = number / soil.inertial_number_0
    mu = soil.mu_s + (soil.mu_2 - soil.mu_s) * rise / (1.0 + rise)
    n = (soil.mu_2 - soil.mu_s) * rise / (1.0 + rise) ** 2 / mu
    return 4.0 * (n * n - n) + mu * mu * (1.0 - n / 2.0) ** 2


def layer_bin(per_cell: float = 2.0) -> Bin:
    """Returns a layer as deep as the soil of the excavation, `per_cell` particles in each cell."""
    side = CELLS * CELL
    return sampled((side, EXCAVATION.bin.size[1], side), CELL, CELL, 1, 0.2, (), per_cell)


def closed_form(height, depth: float, angle_deg: float, soil: Soil):
    """Returns the speed (m/s) at heights above the floor (m) of a layer of a depth (m)."""
    number = inertial_number(soil, angle_deg)
    weight = soil.bulk_density / soil.grain_density * EARTH_GRAVITY
    weight *= math.cos(math.radians(angle_deg))
    below = np.maximum(depth - height, 0.0)
    shape = depth**1.5 - below**1.5
    return 2.0 / 3.0 * number / soil.grain_diameter * math.sqrt(weight) * shape


class Incline:
    """A layer of soil, periodic along x and z, on a rough floor, the only wall of its grid."""

    def __init__(self, box: Bin, soil: Soil):
        walls = (-NO_WALL, NO_WALL, PAD, -NO_WALL, NO_WALL, 0)
        self.grid = make_grid(box)._replace(walls=walls)
        self.soil, self.depth = soil, box.size[1]  # m, as packed
        self.period = np.array([box.size[0], box.size[2]])  # along x and z, m
        self._cells = np.round(self.period / box.dx).astype(int)
        self._solver = Solver(self.grid, soil, packing.particle_volume(box), dtype=np.float32)
        self.particles = packing.lattice(box, seed=0)
        self.advance(SETTLE_S, 0.0, settling=1.0 - SETTLE_DAMPING * self._solver.dt)
        self.particles[:, columns.V : columns.S] = 0.0

    def _fold(self, array: np.ndarray) -> None:
        """Adds what lies past an end of `array` [4 nodes] to the start; both copies get the sum."""
        nx, ny, nz = self.grid.shape
        nodes = array.reshape(ny, nx, nz, 4)
        for axis, count in enumerate(self._cells, 1):
            view = np.moveaxis(nodes, axis, 0)
            view[FIRST : FIRST + COPIES] += view[FIRST + count : FIRST + count + COPIES]
            view[FIRST + count : FIRST + count + COPIES] = view[FIRST : FIRST + COPIES]

    def _interval(self, along: float, down: float, settling: float) -> None:
        """One exchange interval under a gravity `along` x and `down` (m/s2); see `solver`."""
        solver, grid, status = self._solver, self.grid, np.zeros(2, dtype=np.int64)
        nodes, dt, volume = solver.nodes, solver.dt, solver.volume
        block = solver.block(self.particles)
        touched_box = particles_to_grid(
            block, nodes.velocity, grid, 0.5 * dt, volume, self.soil, status
        )
        if status[0] != columns.OK:
            raise ValueError(f'particle {status[1]} left the layer')
        self._fold(nodes.velocity)
        last_x, last_z = FIRST + self._cells + COPIES
        box = (FIRST, last_x, *touched_box[2:4], FIRST, last_z)
        free, touched = start_nodes(nodes, grid, box, 0.5 * dt * along, 0.5 * dt * down)
        for k in range(solver.steps + 1):
            if k > 0:
                damping = damping_time(self.soil, grid.dx)
                strain_and_force(block, nodes, grid, dt, volume, self.soil, damping)
                self._fold(nodes.force)
            share = dt if 0 < k < solver.steps else 0.5 * dt
            drift = dt if k < solver.steps else 0.0
            pull = 1.0 if k > 0 else 0.0
            kick(nodes, grid, free, share, pull * along, pull * down, settling, drift)
        grid_to_particles(block, nodes.velocity, nodes.displacement, grid)
        clear(nodes, touched)
        self.particles = block.particles
        self.wrap()

    def wrap(self) -> None:
        across = self.particles[:, [0, 2]] - CORNER
        self.particles[:, [0, 2]] = CORNER + np.mod(across, self.period)

    @property
    def height(self) -> np.ndarray:
        """Height [N] (m) of the particles above the floor."""
        return self.particles[:, 1] - CORNER

    def advance(
        self,
        seconds: float,
        angle_deg: float,
        settling: float = 1.0,
        on_interval: Callable[[], None] = lambda: None,
    ) -> None:
        """Advances by whole exchange intervals, at least `seconds`, and calls `on_interval` after
        each; `settling` is a factor on the nodes' velocities at each kick. ValueError: soil leaves
        the layer, or crosses half a cell between exchanges."""
        angle = math.radians(angle_deg)
        along, down = EARTH_GRAVITY * math.sin(angle), EARTH_GRAVITY * math.cos(angle)
        for _ in tqdm(range(math.ceil(seconds / EXCHANGE - 1e-9)), leave=False):
            self._interval(along, down, settling)
            fastest = np.abs(self.particles[:, columns.V]).max() * EXCHANGE / self.grid.dx
            if not fastest < VELOCITY_CFL:
                raise ValueError(f'soil crosses {fastest:.2g} cells between two exchanges')
            on_interval()

    def start(self, speed: Callable[[np.ndarray], np.ndarray]) -> None:
        """Gives the soil a speed (m/s) along x by its height (m), its gradient included."""
        step = 1e-4 * self.depth
        at, above = speed(self.height), speed(self.height + step)
        self.particles[:, columns.V] = at
        self.particles[:, columns.C + 1] = (above - at) / step


def bagnold(per_cell: float, start: float, end: float) -> dict[str, float]:
    """Lets beads flow that begin at the closed form's speed; looks at them from `start` to `end`
    (s).

    Returns, against the closed form at the same particles: `surface`, the speed of the uppermost of
    `LAYERS` over it; `profile`, the RMS difference of all layers over its speed at the surface; and
    `depth`, twice the mean height of the soil over the depth as packed.
    """
    layer = Incline(layer_bin(per_cell), beads())
    sums = np.zeros((4, LAYERS))

    def closed(height):
        return closed_form(height, layer.depth, FLOWING_DEG, layer.soil)

    def add():
        height = layer.height
        which = np.clip((height / layer.depth * LAYERS).astype(int), 0, LAYERS - 1)
        values = (np.ones(len(height)), height, layer.particles[:, columns.V], closed(height))
        for total, value in zip(sums, values):
            total += np.bincount(which, value, LAYERS)

    layer.start(closed)
    layer.advance(start, FLOWING_DEG)
    layer.advance(end - start, FLOWING_DEG, on_interval=add)
    count, height, speed, exact = sums[:, sums[0] > 0]
    apart = (speed - exact) / count
    return {
        'surface': float(speed[-1] / exact[-1]),
        'profile': float(np.sqrt((apart**2).mean()) / closed(layer.depth)),
        'depth': float(2.0 * height.sum() / count.sum() / layer.depth),
    }


def halt(soil: Soil, angle_deg: float, per_cell: float, seconds: float = 3.0) -> float:
    """Returns the mean speed (m/s) that is left of a layer after some seconds.

    It begins with a speed that grows linearly to `HALTING_SPEED` at the surface.
    """
    layer = Incline(layer_bin(per_cell), soil)
    layer.start(lambda y: HALTING_SPEED * y / layer.depth)
    layer.advance(seconds, angle_deg)
    return float(layer.particles[:, columns.V].mean())
