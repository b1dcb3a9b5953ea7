"""Springs and charged particles (Kipf et al. 2018, appendix B), in float64.

All simulations of a batch advance together. They move in a box with elastic walls and are
integrated by the leapfrog, which is stable up to omega dt = 2. A time step above the limit is
refused before anything is simulated.
"""

import dataclasses
import math

import numpy as np

LEAPFROG_LIMIT = 2.0  # of omega dt


def _check_positive(system):
    for name, value in dataclasses.asdict(system).items():
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f'{name} is {value}, must be positive and finite')
    if system.n_objects < 2:
        raise ValueError(f'n_objects is {system.n_objects}, a relation needs at least 2')


def _check_step(omega, dt, what):
    if not omega * dt < LEAPFROG_LIMIT:
        raise ValueError(
            f'time step {dt:.4g} is unstable: {what} = {omega:.4g}, times dt = {omega * dt:.4g}, '
            f'must be below {LEAPFROG_LIMIT}; largest stable step {LEAPFROG_LIMIT / omega:.4g}'
        )


def _random_graphs(rng, n_run, n_objects):
    """Symmetric [S, V, V] of 0 and 1 without diagonal, each pair with probability 1/2."""
    upper = np.triu(rng.integers(0, 2, (n_run, n_objects, n_objects)), 1)
    return (upper + upper.transpose(0, 2, 1)).astype(np.float64)


@dataclasses.dataclass(frozen=True)
class Springs:
    """Unit masses, each pair joined by an ideal spring of length zero or by nothing.

    Attributes:
      n_objects: V.
      dt: time step.
      interaction_strength: spring constant k.
      box_size: half the side of the box; walls at +-box_size.
      position_std, speed: of the initial state.

    Raises:
      ValueError: a value that is not positive, or omega dt >= 2. The Laplacian of a graph of V
        nodes has no eigenvalue above V, so omega <= sqrt(k V).
    """

    n_objects: int = 5
    dt: float = 0.001
    interaction_strength: float = 0.1
    box_size: float = 5.0
    position_std: float = 0.5
    speed: float = 0.5

    def __post_init__(self):
        _check_positive(self)
        omega = math.sqrt(self.interaction_strength * self.n_objects)
        _check_step(omega, self.dt, 'highest frequency sqrt(k V)')

    def relations(self, rng, n_run):
        """[S, V, V], 1 where a spring joins two objects."""
        return _random_graphs(rng, n_run, self.n_objects)

    def acceleration(self, position, relations):
        """[S, V, D] from [S, V, D] and [S, V, V]."""
        laplacian = relations - np.eye(self.n_objects) * relations.sum(-1, keepdims=True)
        return self.interaction_strength * (laplacian @ position)


@dataclasses.dataclass(frozen=True)
class Charged:
    """Unit masses with charge +1 or -1; like charges repel, unlike attract.

    Inside `core_radius` the force falls linearly to zero, so that it stays finite and conserves
    energy (Kipf et al. cut each component of the force off instead).

    Attributes:
      n_objects: V.
      dt: time step.
      interaction_strength: k of the force k q_i q_j / r².
      box_size, position_std, speed: as in `Springs`.
      core_radius: where the force is largest.

    Raises:
      ValueError: a value that is not positive, or omega dt >= 2 with omega² <= 2 k V / core³.
    """

    n_objects: int = 5
    dt: float = 0.001
    interaction_strength: float = 1.0
    box_size: float = 5.0
    position_std: float = 1.0
    speed: float = 0.5
    core_radius: float = 0.1

    def __post_init__(self):
        _check_positive(self)
        omega = math.sqrt(2.0 * self.interaction_strength * self.n_objects / self.core_radius**3)
        _check_step(omega, self.dt, 'highest frequency sqrt(2 k V / core^3)')

    def relations(self, rng, n_run):
        """[S, V, V], product of two objects' charges: 1 repels, -1 attracts."""
        charge = rng.choice([-1.0, 1.0], (n_run, self.n_objects))
        return charge[:, :, None] * charge[:, None]

    def acceleration(self, position, relations):
        """[S, V, D] from [S, V, D] and [S, V, V]."""
        away = position[:, :, None] - position[:, None]
        square = np.maximum((away**2).sum(-1), self.core_radius**2)
        size = self.interaction_strength * relations / (square * np.sqrt(square))
        return (size[..., None] * away).sum(2)


SYSTEMS = {'springs': Springs, 'charged': Charged}


def reflect(position, velocity, box_size):
    """Elastic walls: what is beyond +-box_size comes back; in place.

    Raises:
      ValueError: if an object went beyond a wall by more than the box is wide.
    """
    beyond = np.abs(position) > box_size
    if not beyond.any():
        return
    side = np.sign(position[beyond])
    position[beyond] = 2.0 * side * box_size - position[beyond]
    velocity[beyond] = -side * np.abs(velocity[beyond])
    if np.abs(position).max() > box_size:
        raise ValueError(
            f'an object left the box of half side {box_size} by more than its width in one step; '
            f'take a smaller dt'
        )


def leapfrog(system, position, velocity, relations, n_steps, sample_every):
    """Integrates Newton's equations; positions and velocities belong to the same instant.

    Args:
      system: `Springs` or `Charged`.
      position, velocity: [S, V, D] at time 0.
      relations: [S, V, V].
      n_steps: steps of dt.
      sample_every: steps between frames; the first frame is at sample_every dt.

    Returns:
      positions, velocities: [S, n_steps // sample_every, V, D].
    """
    position, velocity = position.copy(), velocity.copy()
    acceleration = system.acceleration(position, relations)
    positions, velocities = [], []
    for step in range(1, n_steps + 1):
        velocity += 0.5 * system.dt * acceleration
        position += system.dt * velocity
        reflect(position, velocity, system.box_size)
        acceleration = system.acceleration(position, relations)
        velocity += 0.5 * system.dt * acceleration
        if step % sample_every == 0:
            positions.append(position.copy())
            velocities.append(velocity.copy())
    return np.stack(positions, 1), np.stack(velocities, 1)


def simulate_particles(system, n_run, n_steps, sample_every, rng):
    """Draws initial states and relations of `Springs` or `Charged` and simulates them.

    Returns:
      positions, velocities: [S, T, V, 2]; relations: [S, V, V].
    """
    relations = system.relations(rng, n_run)
    shape = (n_run, system.n_objects, 2)
    position = rng.normal(0.0, system.position_std, shape).clip(-system.box_size, system.box_size)
    velocity = rng.normal(size=shape)
    velocity *= system.speed / np.linalg.norm(velocity, axis=-1, keepdims=True)
    return (*leapfrog(system, position, velocity, relations, n_steps, sample_every), relations)
