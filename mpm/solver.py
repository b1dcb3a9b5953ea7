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

Quadratic B-splines, serial: a run takes one core, runs go side by side. Particles are float64; what
nodes carry, and stress and strain between exchanges, is float32 or float64 (`Solver`).
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from mpm.bodies import Body
from mpm.columns import (
    CHUNK,
    ELASTIC,
    GRIP,
    JIT,
    LEFT_GRID,
    OK,
    TURNED_INSIDE_OUT,
    X,
)
from mpm.constitutive import Soil
from mpm.contact import ContactLaw, contact, list_near, make_contact
from mpm.fluidity import diffuse_fluidity
from mpm.grid import Grid
from mpm.grid_update import clear, kick, start_nodes
from mpm.stability import damping_time, max_time_step
from mpm.transfers import WEIGHTS, grid_to_particles, particles_to_grid, strain_and_force

EXCHANGE = 1.0 / 1080.0  # s; 18 intervals are a frame
NO_BODY = Body(0.0, 0.0, 0.0, 0.0, 0.0, np.zeros((0, 3)))
NEAR = 2.0  # cells from the body's surface within which contact is looked for, at the least


class Block(NamedTuple):
    """The particles that are stepped, and what kernels keep of them during an interval.

    Attributes:
        particles: float64 [n, COLUMNS], see `columns`.
        base: uint64 [n], index of the first of a particle's 27 nodes.
        weights: [16 n], see `transfers.WEIGHTS`.
        elastic: deviatoric stress (Pa; xx yy zz xy yz zx) and strain of volume, laid out as
            `columns.ELASTIC` says; `particles` gets them back at the end of an interval.
        gradient, stress: [9 CHUNK] and [6 CHUNK], row by row, work space.

    All but the first two are float32 or float64, as the nodes are.
    """

    particles: np.ndarray
    base: np.ndarray
    weights: np.ndarray
    elastic: np.ndarray
    gradient: np.ndarray
    stress: np.ndarray


class Nodes(NamedTuple):
    """What nodes carry: four numbers each, three components and one more.

    Attributes:
        velocity: float64 [4 nodes]: m/s and 1 / mass (1/kg); momentum and mass while scattering.
        force: float64 [4 nodes], N.
        displacement: float64 [4 nodes], m since the last exchange.
        asleep: bool [nodes], touched by soil that is not stepped: they do not move.
        free, touched: uint64 [nodes], lists of indices into the arrays above.
    """

    velocity: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    asleep: np.ndarray
    free: np.ndarray
    touched: np.ndarray


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
def advance(
    block,
    nodes,
    grid,
    steps,
    dt,
    soil,
    volume,
    damping_time,
    gravity,
    settling,
    motion,
    fluidity,
    impulse,
    status,
    second=None,
):
    """Advances the soil (and the body's height) by whole exchange intervals. Works in place.

    Args:
        block: `Block`, of the nodes' type.
        nodes: `Nodes`, all zero but for `asleep`; zero again afterwards.
        grid: `grid.Grid`.
        steps: per interval.
        dt: time step, s. The caller has checked it (`stability`).
        soil: `Soil`.
        volume: m3 of packed soil per particle.
        damping_time: s, of elastic waves (`stability.damping_time`).
        gravity: m/s2, along -y.
        settling: factor on grid velocities at each kick (`steps` + 1 an interval): 1, or less to
            settle a packing.
        motion: `Motion`.
        fluidity: float64 [nodes, 3], work space of the nonlocal law; None: local mu(I).
        impulse: float64 [6], impulse (N s) and angular impulse (N m s, about the reference point)
            of the soil on the body (added to).
        status: int64 [2]: error code, row of the block.
        second: None, or `Motion` of a second body on its path and its float64 [6] impulse; no
            particle is near both.
    """
    mass = volume * soil.bulk_density
    heave, path = motion.heave, motion.path
    load = np.zeros(6)
    for interval in range((len(path) - 1) // steps):
        box = particles_to_grid(
            block, nodes.velocity, grid, 0.5 * dt, mass, volume, soil.bulk_modulus, status
        )
        free, touched = start_nodes(nodes, grid, box, 0.5 * dt * gravity)
        if status[0] != OK:
            clear(nodes, touched)
            return
        if fluidity is not None:
            diffuse_fluidity(block, fluidity, grid, box, steps * dt, soil)
        for k in range(steps + 1):
            step = interval * steps + k
            share = dt if 0 < k < steps else 0.5 * dt
            if k > 0:
                strain_and_force(block, nodes, grid, dt, volume, soil, damping_time, fluidity)
            is_free = heave[2] > 0.0
            # Rates of the step that comes; at the end of an interval, of the one that was.
            a = step if k < steps else step - 1
            vx, vy = (path[a + 1, 0] - path[a, 0]) / dt, (path[a + 1, 1] - path[a, 1]) / dt
            spin, y = (path[a + 1, 2] - path[a, 2]) / dt, path[step, 1]
            if is_free:
                y, vy = heave[0], heave[1]
            contact(
                block,
                nodes,
                grid,
                motion.near,
                motion.body,
                motion.law,
                (path[step, 0], y, path[step, 2]),
                (vx, vy, spin),
                dt if k > 0 else 0.0,
                load,
            )
            for axis in range(6):
                impulse[axis] += share * load[axis]
            if is_free:
                heave[1] += share * (load[1] - motion.weight[step]) / heave[2]
                if k < steps:
                    heave[0] += dt * heave[1]
            if second is not None:  # decided when compiled
                other, other_impulse = second
                at, way = other.path[step], (other.path[a + 1] - other.path[a]) / dt
                contact(
                    block,
                    nodes,
                    grid,
                    other.near,
                    other.body,
                    other.law,
                    (at[0], at[1], at[2]),
                    (way[0], way[1], way[2]),
                    dt if k > 0 else 0.0,
                    load,
                )
                for axis in range(6):
                    other_impulse[axis] += share * load[axis]
            # The first half kick of gravity and of the soil's own forces is in the velocity.
            fall = gravity if k > 0 else 0.0
            kick(nodes, grid, free, share, fall, settling, dt if k < steps else 0.0)
        grid_to_particles(block, nodes.velocity, nodes.displacement, grid, steps * dt, soil)
        clear(nodes, touched)


class Motion(NamedTuple):
    """A body and how it moves during a call of `advance`.

    Attributes:
        body: `bodies.Body`.
        law: `contact.ContactLaw`.
        path: float64 [steps + 1, 3]: x, y (m) of the reference point and the angle (rad) at the
            ends of all steps; its y is not used if the height is free.
        weight: float64 [steps + 1], N on the free height at the same times.
        heave: float64 [3]: height y (m), vertical speed (m/s), mass (kg). A positive mass makes
            the vertical motion free under `weight`.
        near: int64, rows of the block among which contact is looked for; none without a body.
    """

    body: Body
    law: ContactLaw
    path: np.ndarray
    weight: np.ndarray
    heave: np.ndarray
    near: np.ndarray


class Solver:
    """`advance` with its work space, for one soil on one grid.

    Attributes:
        grid: `grid.Grid`.
        soil: `Soil`.
        volume: m3 of packed soil per particle.
        steps: per exchange interval.
        dt: time step, s.
        law: `contact.ContactLaw`.
        impulse: float64 [6], given to the body so far (N s; N m s about its reference point).
        second_impulse: likewise, to a second body.
    """

    def __init__(
        self,
        grid: Grid,
        soil: Soil,
        volume: float,
        steps: int = 0,
        is_nonlocal: bool = False,
        dtype: type = np.float64,
    ):
        """Prepares the work space.

        Args:
            grid: the grid.
            soil: of all particles.
            volume: m3 of packed soil per particle.
            steps: per exchange interval; 0: as few as are stable.
            is_nonlocal: whether the granular fluidity diffuses.
            dtype: of what nodes carry and of stresses between exchanges, float32 or float64.
        """
        self.grid, self.soil, self.volume = grid, soil, volume
        limit = max_time_step(soil, grid.dx, is_nonlocal)
        self.steps = steps or max(1, math.ceil(EXCHANGE / limit - 1e-9))
        self.dt = EXCHANGE / self.steps
        self.nodes = make_nodes(grid, dtype)
        self.impulse, self.second_impulse = np.zeros(6), np.zeros(6)
        self.law = make_contact(soil, volume)
        self._fluidity = np.zeros((grid.nodes, 3)) if is_nonlocal else None

    def block(self, particles: np.ndarray) -> Block:
        """Returns the block of particles [n, COLUMNS] for `advance`, a copy."""
        return make_block(particles, self.nodes.velocity.dtype.type)

    def advance(
        self,
        block: Block,
        intervals: int,
        gravity: float,
        settling: float = 1.0,
        body: Body | None = None,
        path: np.ndarray | None = None,
        weight: np.ndarray | None = None,
        heave: np.ndarray | None = None,
        second: tuple[Body, np.ndarray] | None = None,
    ) -> None:
        """Advances a block by some exchange intervals, in place; see `advance` and `Motion`.

        Args:
            block: `Block`.
            intervals: how many.
            gravity, settling: of `advance`.
            body, path, weight, heave: of `Motion`.
            second: a second body and its path.

        Raises:
            ValueError: if a particle leaves the grid or is turned inside out; bodies so close that
                both may touch one particle.
        """
        count = intervals * self.steps
        if body is None:
            body, path = NO_BODY, np.zeros((count + 1, 3))
            near = np.zeros(0, dtype=np.int64)
        else:
            grip = None if second is None else block.particles[:, GRIP : GRIP + 3].copy()
            near = self._near(block, body, path, heave)
        motion = Motion(
            body,
            self.law,
            path,
            np.zeros(count + 1) if weight is None else weight,
            np.zeros(3) if heave is None else heave,
            near,
        )
        beside = None
        if second is not None:
            if body is NO_BODY:
                raise ValueError('a second body needs a first one')
            beside = self._beside(block, near, grip, *second), self.second_impulse
        status = np.zeros(2, dtype=np.int64)
        advance(
            block,
            self.nodes,
            self.grid,
            self.steps,
            self.dt,
            self.soil,
            self.volume,
            damping_time(self.soil, self.grid.dx),
            gravity,
            settling,
            motion,
            self._fluidity,
            self.impulse,
            status,
            beside,
        )
        if status[0] != OK:
            place = block.particles[status[1], X : X + 3]
            what = {LEFT_GRID: 'left the grid', TURNED_INSIDE_OUT: 'was turned inside out'}
            raise ValueError(f'a particle {what[int(status[0])]} at {place} m')

    def _beside(self, block, near, grip, body, path):
        """`Motion` of a second body; `near` the first one, particles keep the `grip` they had."""
        mine = self._near(block, body, path, None)
        if shared := np.intersect1d(near, mine).size:
            raise ValueError(f'two bodies are so close that both may touch {shared} particles')
        # Looking for those near one body took the grip of those near the other.
        block.particles[near, GRIP : GRIP + 3] = grip[near]
        block.particles[mine, GRIP : GRIP + 3] = grip[mine]
        still = np.zeros(len(path))
        return Motion(body, self.law, path, still, np.zeros(3), mine)

    def _near(self, block, body, path, heave):
        """Rows of the particles that the body can touch during the path."""
        start = path[0].copy()
        if heave is not None and heave[2] > 0.0:
            start[1] = heave[0]
        # How far body and soil can come closer: the body's way, and the fastest particle's.
        turn = np.abs(path[:, 2] - path[0, 2]).max() * (body.length + body.radius)
        way = np.linalg.norm(path[:, :2] - path[0, :2], axis=1).max() + turn
        speed = np.abs(block.particles[:, 3:6]).max(initial=0.0)
        reach = self.law.radius + way + max(NEAR * self.grid.dx, 2 * speed * len(path) * self.dt)
        near = np.zeros(len(block.particles), dtype=np.int64)
        return near[: list_near(block.particles, body, start, reach, near)]
