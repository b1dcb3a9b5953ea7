"""The material-point solver: steps on the grid between exchanges with the particles.

Particles and grid exchange what they carry at a fixed interval of physical time (`EXCHANGE`), with
as many explicit steps on the grid in between as the elastic wave needs. APIC smooths once per
exchange: done in every step, its viscosity grows as the step shrinks, and the draft with it (10 %
when the step was halved). Now the smoothing belongs to the model, and a smaller step converges.

One interval, velocity Verlet on nodes that move as the material does:

    (m v)_i from the particles (1);  v_i += dt/2 (f_i / m_i + g)
    each step:  u_i += dt v_i;  L_p (2);  stress;  f_i (3), contact (5, 6);
                v_i += dt (f_i / m_i + g), dt/2 in the last one
    particles take v_i, its gradient and u_i (4)

The half kicks at both ends matter: with whole ones (leapfrog) the periodic smoothing resonates with
elastic waves of the grid and soil at rest gains energy. Equation numbers: `transfers`, `contact`.

A body follows its path, or some of its coordinates q (x, y, angle) are free and obey

    M q'' = soil + external + k (target - q) + c (target' - q')                            (7)

with the same kicks and drifts as the nodes.

Quadratic B-splines, serial: a run takes one core, runs go side by side. Particles are float64; what
nodes carry, and stress and strain between exchanges, is float32 or float64 (`Solver`).
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from mpm.bodies import Body, make_wheel
from mpm.columns import CHUNK, ELASTIC, GRIP, JIT, LEFT_GRID, OK, TURNED_INSIDE_OUT, X
from mpm.constitutive import Soil
from mpm.contact import ContactLaw, contact, make_contact
from mpm.distance import signed_distances
from mpm.grid import Grid, clear, kick, start_nodes
from mpm.stability import damping_time, steps_in
from mpm.transfers import WEIGHTS, grid_to_particles, particles_to_grid, strain_and_force

EXCHANGE = 1.0 / 540.0  # s; 9 intervals are a frame
NEAR = 2.0  # cells from the body's surface within which contact is looked for, at the least
FAR = 1e6  # m, where a body is that touches nothing
FREE_PUSH = 50.0  # m/s2, by which a free body may be pushed during a call of `Solver.advance`


class Block(NamedTuple):
    """The particles that are stepped, and what kernels keep of them during an interval.

    All but the first two are float32 or float64, as the nodes are.
    """

    particles: np.ndarray  # float64 [n, COLUMNS], see `columns`
    base: np.ndarray  # uint64 [n], index of the first of a particle's 27 nodes
    weights: np.ndarray  # [16 n], see `transfers.WEIGHTS`
    # Deviatoric stress (Pa; xx yy zz xy yz zx) and strain of volume, laid out as `columns.ELASTIC`
    # says; `particles` gets them back at the end of an interval
    elastic: np.ndarray
    gradient: np.ndarray  # gradient, stress: [9 CHUNK] and [6 CHUNK], row by row, work space
    stress: np.ndarray


class Nodes(NamedTuple):
    """What nodes carry: four numbers each, three components and one more."""

    velocity: np.ndarray  # [4 nodes]: m/s and 1 / mass (1/kg); momentum and mass while scattering
    force: np.ndarray  # [4 nodes], N
    displacement: np.ndarray  # [4 nodes], m since the last exchange
    asleep: np.ndarray  # bool [nodes], touched by soil that is not stepped: they do not move
    free: np.ndarray  # free, touched: uint64 [nodes], lists of indices into the arrays above
    touched: np.ndarray


class Free(NamedTuple):
    """The coordinates x, y and angle of a body that are free, and what drives them: eq. (7)."""

    state: np.ndarray  # float64 [2, 3], coordinates (m, m, rad) and their rates; changes in place
    # float64 [3]: mass (kg) for x and y, moment of inertia about the reference point (kg m2) for
    # the angle; 0: the coordinate follows the path
    mass: np.ndarray
    stiffness: np.ndarray  # float64 [3], k of the actuator that pulls to the path, N/m, N m/rad
    damping: np.ndarray  # float64 [3], c, N s/m, N m s/rad


class Motion(NamedTuple):
    """A body and how it moves during a call of `advance`."""

    body: Body
    law: ContactLaw
    # float64 [steps + 1, 4]: x, y (m) of the reference point, the angle (rad) and z (m) at the ends
    # of all steps; of free coordinates the actuator's target
    path: np.ndarray
    # float64 [steps + 1, 3]: force (N, N, N m) on free coordinates, at the same times
    external: np.ndarray
    free: Free
    near: np.ndarray  # int64, rows of the block among which contact is looked for
    # float64 [steps, 6], filled: mean force (N) of the soil on the body in each step, and torque (N
    # m) about its reference point
    loads: np.ndarray


def prescribed() -> Free:
    """Returns the `Free` of a body of which nothing is free."""
    return Free(np.zeros((2, 3)), np.zeros(3), np.zeros(3), np.zeros(3))


def make_block(particles: np.ndarray, dtype: type = np.float64) -> Block:
    """Returns the block of particles [n, COLUMNS], a copy, whose steps have numbers of a type."""
    count = len(particles)
    return Block(
        np.array(particles, dtype=np.float64, order='C'),
        np.zeros(count, dtype=np.uint64),
        np.zeros(WEIGHTS * count, dtype),
        np.zeros(ELASTIC * CHUNK * math.ceil(count / CHUNK), dtype),
        np.zeros(9 * CHUNK, dtype),
        np.zeros(6 * CHUNK, dtype),
    )


def make_nodes(grid: Grid, dtype: type = np.float64) -> Nodes:
    """Returns the nodes of a grid, with no soil on them, in numbers of a type."""
    return Nodes(
        *(np.zeros(4 * grid.nodes, dtype) for _ in range(3)),
        np.zeros(grid.nodes, dtype=np.bool_),
        *(np.zeros(grid.nodes, dtype=np.uint64) for _ in range(2)),
    )


@numba.njit(**JIT)
def _act(block, nodes, grid, motion, step, last, dt, share, drift, load):
    """Contact of a body at the beginning of a step, and the kick and drift (7) of what is free."""
    path, free = motion.path, motion.free
    # Rates of the step that comes; at the end of an interval, of the one that was.
    a = min(step, last)
    pose = np.empty(4)
    rates = np.empty(4)
    for axis in range(4):
        pose[axis] = path[step, axis]
        rates[axis] = (path[a + 1, axis] - path[a, axis]) / dt
    for axis in range(3):
        if free.mass[axis] > 0.0:
            pose[axis], rates[axis] = free.state[0, axis], free.state[1, axis]
    since = dt if share == dt or drift == 0.0 else 0.0
    contact(block, nodes, grid, motion.near, motion.body, motion.law, pose, rates, since, load)
    # A step's load is the mean of those at its two ends.
    if drift > 0.0:
        for axis in range(6):
            motion.loads[step, axis] += 0.5 * load[axis]
    if since > 0.0:
        for axis in range(6):
            motion.loads[step - 1, axis] += 0.5 * load[axis]
    for axis in range(3):
        if free.mass[axis] > 0.0:
            target = (path[a + 1, axis] - path[a, axis]) / dt
            force = load[axis] if axis < 2 else load[5]
            force += motion.external[step, axis]
            force += free.stiffness[axis] * (path[step, axis] - free.state[0, axis])
            force += free.damping[axis] * (target - free.state[1, axis])
            free.state[1, axis] += share * force / free.mass[axis]
            free.state[0, axis] += drift * free.state[1, axis]


@numba.njit(**JIT)
def advance(
    block, nodes, grid, intervals, steps, dt, soil, volume, damping_time, along, down, settling,
    motion, status
):  # fmt: skip
    """Advances the soil (and what is free of the bodies) by exchange intervals. Works in place.

    Args:
        nodes: all zero but for `asleep`; zero again afterwards.
        intervals, steps: how many, and steps in each.
        dt: time step, s. The caller has checked it (`stability`).
        volume: m3 of packed soil per particle.
        damping_time: s, of elastic waves (`stability.damping_time`).
        along, down: m/s2, gravity along x and -y.
        settling: factor on grid velocities at each kick (`steps` + 1 an interval): 1, or less to
            settle a packing.
        status: int64 [2]: error code, row of the block.
    """
    load = np.zeros(6)
    for interval in range(intervals):
        box = particles_to_grid(block, nodes.velocity, grid, 0.5 * dt, volume, soil, status)
        free, touched = start_nodes(nodes, grid, box, 0.5 * dt * along, 0.5 * dt * down)
        if status[0] != OK:
            clear(nodes, touched)
            return
        for k in range(steps + 1):
            step = interval * steps + k
            share = dt if 0 < k < steps else 0.5 * dt
            drift = dt if k < steps else 0.0
            if k > 0:
                strain_and_force(block, nodes, grid, dt, volume, soil, damping_time)
            last = interval * steps + steps - 1
            _act(block, nodes, grid, motion, step, last, dt, share, drift, load)
            # The first half kick of gravity and of the soil's own forces is in the velocity.
            pull = 1.0 if k > 0 else 0.0
            kick(nodes, grid, free, share, pull * along, pull * down, settling, drift)
        grid_to_particles(block, nodes.velocity, nodes.displacement, grid)
        clear(nodes, touched)


class Solver:
    """`advance` with its work space, for one soil on one grid.

    Attributes: volume, m3 of packed soil per particle; exchange, s, between two exchanges; steps,
    per exchange interval; dt, the time step, s.
    """

    def __init__(
        self,
        grid: Grid,
        soil: Soil,
        volume: float,
        steps: int = 0,
        dtype: type = np.float64,
        exchange: float = EXCHANGE,
    ):
        """Prepares the work space; `steps` of 0: as few as are stable; `dtype` is float32 or
        float64."""
        self.grid, self.soil, self.volume, self.exchange = grid, soil, volume, exchange
        self.steps = steps or steps_in(exchange, soil, min(grid.dx, grid.dz))
        self.dt = exchange / self.steps
        self.nodes = make_nodes(grid, dtype)
        # Particles of a cell dz / dx times as long across are as much farther apart there.
        spacing = (volume * grid.dx / grid.dz) ** (1.0 / 3.0)
        self.law = make_contact(soil, volume, spacing)

    def block(self, particles: np.ndarray) -> Block:
        """Returns the block of particles [n, COLUMNS] for `advance`, a copy."""
        return make_block(particles, self.nodes.velocity.dtype.type)

    def advance(
        self,
        block: Block,
        intervals: int,
        gravity: float,
        settling: float = 1.0,
        moved: tuple | None = None,
        slope: float = 0.0,
    ) -> np.ndarray:
        """Advances a block by some exchange intervals, in place.

        Args:
            block, intervals, settling: of the kernel `advance`.
            gravity: m/s2.
            moved: `Body`, path, external, `Free` of `Motion`, the last two may be None; None: there
                is no body.
            slope: rad, by which gravity leans to +x: the ground rises towards -x.

        Returns:
            float64 [steps, 6]: force (N) of the soil on the body in each step and torque (N m)
            about its reference point; an impulse is their sum times `dt`.

        Raises:
            ValueError: if a particle leaves the grid or is turned inside out; if a free body is
                thrown.
        """
        count = intervals * self.steps
        if moved is None:
            moved = make_wheel(1e-3), np.full((count + 1, 4), FAR), None, None
        body, path, external, free = moved
        free = prescribed() if free is None else free
        external = np.zeros((count + 1, 3)) if external is None else external
        near, reach = self._near(block, body, path, free)
        before, loads = free.state[0].copy(), np.zeros((count, 6))
        # What no body can touch has lost its grip.
        is_far = np.ones(len(block.particles), dtype=bool)
        is_far[near] = False
        block.particles[is_far, GRIP : GRIP + 3] = 0.0
        status = np.zeros(2, dtype=np.int64)
        advance(
            block, self.nodes, self.grid, intervals, self.steps, self.dt, self.soil, self.volume,
            damping_time(self.soil, self.grid.dx), gravity * math.sin(slope),
            gravity * math.cos(slope), settling,
            Motion(body, self.law, path, external, free, near, loads), status,
        )  # fmt: skip
        if status[0] != OK:
            place = block.particles[status[1], X : X + 3]
            what = {LEFT_GRID: 'left the grid', TURNED_INSIDE_OUT: 'was turned inside out'}
            raise ValueError(f'a particle {what[int(status[0])]} at {place} m')
        way = np.abs(free.state[0] - before) * (free.mass > 0.0)
        way = np.hypot(way[0], way[1]) + way[2] * body.reach
        if not way <= reach:
            raise ValueError(
                f'a free body moved by {way:.3g} m where {reach:.3g} m were expected at its '
                'speed: its load throws it'
            )
        return loads

    def _near(self, block, body, path, free):
        """Rows of the particles that a body can touch during its path, and the way it may go."""
        start, is_free = path[0].copy(), free.mass > 0.0
        start[:3] = np.where(is_free, free.state[0], start[:3])
        # How far body and soil can come closer: the body's way, and the fastest particle's.
        fixed = np.abs(path - path[0])
        fixed[:, :3] = np.where(is_free, 0.0, fixed[:, :3])
        way = np.linalg.norm(fixed[:, [0, 1, 3]], axis=1).max() + fixed[:, 2].max() * body.reach
        seconds = (len(path) - 1) * self.dt
        pushed = np.where(is_free, np.abs(free.state[1]) * seconds, 0.0)
        pushed = np.hypot(pushed[0], pushed[1]) + pushed[2] * body.reach
        if is_free.any():
            pushed += 0.5 * FREE_PUSH * seconds**2
        speed = np.abs(block.particles[:, 3:6]).max(initial=0.0)
        reach = self.law.radius + way + pushed
        reach += max(NEAR * self.grid.dx, 2 * speed * seconds)
        distances = signed_distances(body, start, block.particles[:, :3])
        return np.flatnonzero(distances < reach), float(pushed)
