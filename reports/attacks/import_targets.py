"""Readers of other projects' data that are fuzzed, and the particle sample of a dataset."""

import os
from collections.abc import Callable

import numpy as np

from pca_tools import packing, particles
from pca_tools.formats import detect, full_space
from reports.attacks.target import Promise, Target

FRAMES, PARTICLES, LARGEST = 5, 4, 1e30


def _data() -> full_space.FullSpaceData:
    """Two small runs with a body, a force and a context."""
    rng = np.random.default_rng(0)
    types = np.array([3, 6, 6, 6])

    def runs():
        for number, split in enumerate(('train', 'test')):
            positions = rng.uniform(0.2, 0.8, (FRAMES, PARTICLES, 3)).astype(np.float32)
            force = rng.normal(size=(FRAMES, 3)).astype(np.float32)
            yield full_space.FullSpaceRun(f'{split}_{number}', split, positions, types, force)

    held = list(runs())
    return full_space.FullSpaceData(
        'here', lambda: iter(held), 0.1, bounds=[[0.0, 1.0]] * 3, up_axis=1, radius=0.1
    )


def _writer(name: str) -> Callable[[str], None]:
    return lambda folder: detect.FORMATS[name].write(folder, _data())


def _reader(name: str) -> Callable[[str], list]:
    def read(folder: str) -> list:
        data = detect.FORMATS[name].read(folder, 0.1)
        return [(run.positions, run.particle_type, run.force, run.context) for run in data.runs()]

    return read


def _possible_runs(runs: list) -> bool:
    """Shapes that fit each other; values are the business of `write_raw`."""
    return all(
        positions.ndim == 3
        and positions.shape[2] in (2, 3)
        and positions.dtype.kind in 'fiu'
        and types.shape == positions.shape[1:2]
        and (force is None or len(force) == len(positions))
        for positions, types, force, _ in runs
    )


def _write_sample(folder: str) -> None:
    positions = np.random.default_rng(0).uniform(0.0, 1.0, (FRAMES, PARTICLES, 3))
    packed = [(packing.pack_steps(positions, positions[0], particles.RESOLUTION), FRAMES)]
    particles.write_sample(
        os.path.join(folder, 'particles_train.npz'), packed, np.arange(PARTICLES), positions[0]
    )


def _read_sample(folder: str) -> list:
    return list(particles.ParticleSample(os.path.join(folder, 'particles_train.npz')))


def _possible_sample(runs: list) -> bool:
    return all(run.ndim == 3 and run.dtype == np.float64 for run in runs)


# MPM-NGF and VTP keep folders of files, the bench single ones.
_CHANGED = {
    'deepmind': ('train.tfrecord', 'metadata.json'),
    'geoelements': ('train.npz', 'metadata.json'),
    'lagrangebench': ('train.h5', 'metadata.json'),
    'npz': ('train_0.npz',),
}

IMPORT_TARGETS = (
    *(
        Target(f'import {name}', Promise.OPEN, _writer(name), files, _reader(name), _possible_runs,
               share={'deepmind': 2, 'npz': 4}.get(name, Target.share))
        for name, files in _CHANGED.items()
    ),
    Target('particle sample', Promise.CHECKSUM, _write_sample, ('particles_train.npz',),
           _read_sample, _possible_sample),
)  # fmt: skip
