"""Small springs data and models, for the tests of NRI."""

import numpy as np

from nri import data, simulate
from nri.config import NriConfig
from nri.model import NriModel

TINY = {'hidden': 8, 'window': 15, 'segment': 2, 'batch_size': 16}


def springs(n_run=32, n_objects=3, seed=0, split='train', n_frame=15):
    """`NriData` of springs, frames 0.1 apart as in Kipf's data."""
    system = simulate.Springs(n_objects=n_objects, dt=0.02)
    arrays = simulate.simulate_split(system, n_run, 5 * (n_frame + 1), 5, seed, split)
    features = np.concatenate([arrays['loc'], arrays['vel']], axis=2).transpose(0, 3, 1, 2)
    return data.NriData(
        np.ascontiguousarray(features),
        data.edge_types(arrays['edges']),
        tuple(f'node_{i}' for i in range(n_objects)),
        True,
        'digest',
        split,
    )


def model(held, **settings):
    """An untrained model of the data."""
    offset, scale = data.normalization(held)
    config = NriConfig(**(TINY | settings))
    return NriModel(config, held.node_names, offset, scale, held.digest)


def write_springs(folder, n_objects=3, counts=(32, 16, 16)):
    """Writes Kipf's files of 15 frames; returns the folder as a string."""
    made = simulate.Springs(n_objects=n_objects, dt=0.02)
    counts = dict(zip(simulate.SPLITS, counts, strict=True))
    simulate.write_dataset(made, 'springs', counts, 80, 5, 0, str(folder))
    return str(folder)
