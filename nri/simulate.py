"""Makes the springs and charged particles of Kipf et al. 2018 (appendix B) as `.npy` files.

All simulations of a batch advance together, in float64. They move in a box with elastic walls and
are integrated by the leapfrog, which is stable up to omega dt = 2. A time step above the limit is
refused before anything is simulated.

Examples:
  python -m nri.simulate --system=springs --n_objects=5 --output_path=/tmp/springs5
  python -m nri.simulate --system=charged --n_objects=10 --num_train=10000 --output_path=/tmp/c10

Writes loc_, vel_ and edges_{train,valid,test}_<system><V>.npy, float32 (S, T, 2, V), (S, T, 2, V)
and (S, V, V). T = length / sample_freq - 1, as Kipf's.
"""

import abc
import dataclasses
import math
import os
import time

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command
from nri.data import write_array
from pca_tools import files
from pca_tools.metadata import SPLITS

LEAPFROG_LIMIT = 2.0  # of omega dt
# Runs that advance together: their pair arrays stay in the processor's cache.
CHUNK = 500


@dataclasses.dataclass(frozen=True)
class _System(abc.ABC):
    """Objects of unit mass in a box. ValueError: a value that is not positive, or omega dt >= 2."""

    n_objects: int = 5  # V
    dt: float = 0.001  # time step
    interaction_strength: float = 0.1  # k
    box_size: float = 5.0  # half the side of the box; walls at +-box_size
    # position_std, speed: of the initial state
    position_std: float = 0.5
    speed: float = 0.5

    def __post_init__(self):
        for name, value in dataclasses.asdict(self).items():
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f'{name} is {value}, must be positive and finite')
        if self.n_objects < 2:
            raise ValueError(f'n_objects is {self.n_objects}, a relation needs at least 2')
        omega = self.highest_frequency()
        if not omega * self.dt < LEAPFROG_LIMIT:
            raise ValueError(
                f'time step {self.dt:.4g} is unstable, as the highest frequency is {omega:.4g}: it '
                f'must be below {LEAPFROG_LIMIT / omega:.4g}'
            )

    @abc.abstractmethod
    def highest_frequency(self) -> float:
        """A bound of omega."""


class Springs(_System):
    """Each pair is joined by an ideal spring of constant k and length zero, or by nothing."""

    def highest_frequency(self):
        """The Laplacian of a graph of V nodes has no eigenvalue above V."""
        return math.sqrt(self.interaction_strength * self.n_objects)

    def relations(self, rng, n_run):
        """[S, V, V], 1 where a spring joins two objects: every other pair."""
        upper = np.triu(rng.integers(0, 2, (n_run, self.n_objects, self.n_objects)), 1)
        return (upper + upper.transpose(0, 2, 1)).astype(np.float64)

    def acceleration(self, position, relations):
        """[S, V, D] from [S, V, D] and [S, V, V]."""
        laplacian = relations - np.eye(self.n_objects) * relations.sum(-1, keepdims=True)
        return self.interaction_strength * (laplacian @ position)


@dataclasses.dataclass(frozen=True)
class Charged(_System):
    """Charges +1 or -1; like charges repel, unlike attract, by a force k q_i q_j / r².

    Inside `core_radius` the force falls linearly to zero, so that it stays finite and conserves
    energy (Kipf et al. cut each component of the force off instead).
    """

    interaction_strength: float = 1.0
    position_std: float = 1.0
    core_radius: float = 0.1

    def highest_frequency(self):
        """omega² <= 2 k V / core³."""
        return math.sqrt(2.0 * self.interaction_strength * self.n_objects / self.core_radius**3)

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
    """Elastic walls: what is beyond +-box_size comes back; in place. ValueError: an object went
    beyond a wall by more than the box is wide."""
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
    """Integrates Newton's equations over `n_steps` steps of dt from positions and velocities
    [S, V, D] and relations [S, V, V]. Returns positions and velocities of the same instants,
    [S, n_steps // sample_every, V, D]; the first frame is at sample_every dt."""
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
    """Draws initial states and relations of a system and simulates them; returns positions and
    velocities [S, T, V, 2] and relations [S, V, V]."""
    relations = system.relations(rng, n_run)
    shape = (n_run, system.n_objects, 2)
    position = rng.normal(0.0, system.position_std, shape).clip(-system.box_size, system.box_size)
    velocity = rng.normal(size=shape)
    velocity *= system.speed / np.linalg.norm(velocity, axis=-1, keepdims=True)
    return (*leapfrog(system, position, velocity, relations, n_steps, sample_every), relations)


def simulate_split(system, n_run, n_steps, sample_every, seed, split):
    """The arrays of one split of S runs, by the prefix of their file names: 'loc', 'vel', 'edges',
    float32, shapes in the module docstring. The last frame is left out, as in Kipf's files. Seed
    and split together decide every random number."""
    parts = []
    starts = tqdm.tqdm(range(0, n_run, CHUNK), split, unit='chunk', disable=None)
    for index, start in enumerate(starts):
        key = [seed, SPLITS.index(split), index]
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
        count = min(CHUNK, n_run - start)
        position, velocity, relations = simulate_particles(
            system, count, n_steps - sample_every, sample_every, rng
        )
        loc, vel = (x.transpose(0, 1, 3, 2) for x in (position, velocity))
        arrays = {'loc': loc, 'vel': vel, 'edges': relations}
        parts.append({k: v.astype(np.float32) for k, v in arrays.items()})
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}


def write_dataset(system, name, counts, n_steps, sample_every, seed, output_path):
    """Simulates splits (`counts`: split -> S) of a system of `SYSTEMS` and writes them with
    `simulation_<system><V>.json`, which holds every setting, into a folder, made if missing.
    ValueError: a setting that makes no frame, or a folder that holds such files already."""
    if not (sample_every >= 1 and n_steps >= 3 * sample_every):
        raise ValueError(
            f'length {n_steps} with sample_freq {sample_every} gives fewer than two frames'
        )
    suffix = f'{name}{system.n_objects}'
    os.makedirs(output_path, exist_ok=True)
    if present := [f for f in os.listdir(output_path) if f.endswith(f'_{suffix}.npy')]:
        raise ValueError(
            f'{output_path}: holds {sorted(present)[0]} already; nothing was written, give another '
            f'--output_path'
        )
    for split, n_run in counts.items():
        arrays = simulate_split(system, n_run, n_steps, sample_every, seed, split)
        for prefix, array in arrays.items():
            write_array(os.path.join(output_path, f'{prefix}_{split}_{suffix}.npy'), array)
    settings = {'runs': counts, 'length': n_steps, 'sample_freq': sample_every, 'seed': seed}
    path = os.path.join(output_path, f'simulation_{suffix}.json')
    files.write_json(path, {'system': name, **dataclasses.asdict(system), **settings})


def define_flags():
    flags.DEFINE_enum('system', 'springs', sorted(SYSTEMS), 'What to simulate.')
    flags.DEFINE_integer('n_objects', 5, 'V, number of objects.')
    for split, count in (('train', 50000), ('valid', 10000), ('test', 10000)):
        flags.DEFINE_integer(f'num_{split}', count, f'Runs of the {split} split.', 1)
    flags.DEFINE_integer('length', 5000, 'Time steps of a run.')
    flags.DEFINE_integer('sample_freq', 100, 'Time steps between frames.')
    flags.DEFINE_float('dt', 0.001, 'Time step.')
    flags.DEFINE_integer('seed', 42, 'Seed.')
    flags.DEFINE_string('output_path', None, 'Folder for the files.', required=True)


def main(given):
    started = time.time()
    counts = {split: getattr(given, f'num_{split}') for split in SPLITS}
    system = SYSTEMS[given.system](given.n_objects, given.dt)
    how = given.length, given.sample_freq, given.seed
    write_dataset(system, given.system, counts, *how, given.output_path)
    print(
        f'{given.system}, {given.n_objects} objects: {sum(counts.values())} runs of '
        f'{given.length // given.sample_freq - 1} frames in {given.output_path}; '
        f'{time.time() - started:.0f} s'
    )


if __name__ == '__main__':
    define_flags()
    command.start(main)
