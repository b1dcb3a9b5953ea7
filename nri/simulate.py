"""Makes the springs and charged data of Kipf et al. 2018 as `.npy` files.

Examples:
  python -m nri.simulate --system=springs --n_objects=5 --output_path=/tmp/springs5
  python -m nri.simulate --system=charged --n_objects=10 --num_train=10000 --output_path=/tmp/c10

Writes loc_, vel_ and edges_{train,valid,test}_<system><V>.npy, float32 (S, T, 2, V), (S, T, 2, V)
and (S, V, V). T = length / sample_freq - 1, as Kipf's.
"""

import dataclasses
import os
import time

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command
from nri import particle_systems
from pca_tools import files

SPLITS = ('train', 'valid', 'test')
# Runs that advance together: their pair arrays stay in the processor's cache.
CHUNK = 500


def simulate_split(system, n_run, n_steps, sample_every, seed, split, progress=None):
    """The arrays of one split, by the prefix of their file names: 'loc', 'vel', 'edges', float32,
    shapes in the module docstring.

    Args:
      system: one of `particle_systems.SYSTEMS`.
      n_run: S.
      n_steps: simulated steps; the last frame is left out, as in Kipf's files.
      sample_every: steps between frames.
      seed, split: together decide every random number.
      progress: called with the number of runs done, or None.
    """
    parts = []
    for index, start in enumerate(range(0, n_run, CHUNK)):
        key = [seed, SPLITS.index(split), index]
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
        count = min(CHUNK, n_run - start)
        position, velocity, relations = particle_systems.simulate_particles(
            system, count, n_steps - sample_every, sample_every, rng
        )
        loc, vel = (x.transpose(0, 1, 3, 2) for x in (position, velocity))
        arrays = {'loc': loc, 'vel': vel, 'edges': relations}
        parts.append({k: v.astype(np.float32) for k, v in arrays.items()})
        if progress:
            progress(count)
    return {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}


def write_dataset(system, name, counts, n_steps, sample_every, seed, output_path):
    """Simulates all splits and writes them with `simulation.json`, which holds every setting.

    Args:
      system: the system.
      name: its name, one of `particle_systems.SYSTEMS`.
      counts: {split: S}.
      n_steps, sample_every, seed: see `simulate_split`.
      output_path: folder; made if missing.

    Raises:
      ValueError: a setting that makes no frame, or a folder that holds such files already.
    """
    if not (sample_every >= 1 and n_steps >= 3 * sample_every):
        raise ValueError(
            f'length {n_steps} with sample_freq {sample_every} gives fewer than two frames'
        )
    if bad := {k: v for k, v in counts.items() if v < 1}:
        raise ValueError(f'every split needs at least one run, got {bad}')
    suffix = f'{name}{system.n_objects}'
    os.makedirs(output_path, exist_ok=True)
    if present := [f for f in os.listdir(output_path) if f.endswith(f'_{suffix}.npy')]:
        raise ValueError(
            f'{output_path}: holds {sorted(present)[0]} already; nothing was written, give another '
            f'--output_path'
        )
    with tqdm.tqdm(total=sum(counts.values()), unit='run', disable=None) as bar:
        for split, n_run in counts.items():
            arrays = simulate_split(system, n_run, n_steps, sample_every, seed, split, bar.update)
            for prefix, array in arrays.items():
                path = os.path.join(output_path, f'{prefix}_{split}_{suffix}.npy')
                files.write_atomically(path, lambda temporary, a=array: _save(temporary, a))
    settings = {'runs': counts, 'length': n_steps, 'sample_freq': sample_every, 'seed': seed}
    path = os.path.join(output_path, f'simulation_{suffix}.json')
    files.write_json(path, {'system': name, **dataclasses.asdict(system), **settings})


def _save(path, array):
    with open(path, 'wb') as file:
        np.save(file, array)


def define_flags():
    flags.DEFINE_enum('system', 'springs', sorted(particle_systems.SYSTEMS), 'What to simulate.')
    flags.DEFINE_integer('n_objects', 5, 'V, number of objects.')
    for split, count in (('train', 50000), ('valid', 10000), ('test', 10000)):
        flags.DEFINE_integer(f'num_{split}', count, f'Runs of the {split} split.')
    flags.DEFINE_integer('length', 5000, 'Time steps of a run.')
    flags.DEFINE_integer('sample_freq', 100, 'Time steps between frames.')
    flags.DEFINE_float('dt', 0.001, 'Time step.')
    flags.DEFINE_integer('seed', 42, 'Seed.')
    flags.DEFINE_string('output_path', None, 'Folder for the files.', required=True)


def main(given):
    started = time.time()
    counts = {split: getattr(given, f'num_{split}') for split in SPLITS}
    system = particle_systems.SYSTEMS[given.system](given.n_objects, given.dt)
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
