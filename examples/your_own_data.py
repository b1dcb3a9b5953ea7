"""Data of one's own from arrays to a trained model: raw runs, dataset, training, errors.

A plate of nine points pushes a bed of 400 particles. Put your own positions in place of `run`.
"""

import os
import sys

import numpy as np

import learning_to_simulate as lts
from pca_tools import convert, write_raw


def run(depth: float, speed: float, frames: int = 60) -> dict:
    """Soil [T, 400, 3] and plate [T, 9, 3], m, and force [T, 3], N, of a made-up push."""
    bed = np.random.default_rng(0).uniform([0.0, 0.0, 0.0], [1.0, 0.1, 0.5], (400, 3))
    plate = np.stack(np.meshgrid([0.0], [0.05, 0.1, 0.15], [0.1, 0.25, 0.4]), -1).reshape(-1, 3)
    travel = (speed * np.arange(frames) / 60)[:, None]
    body = plate + np.stack([0.1 + travel, -depth + 0 * travel, 0 * travel], axis=-1)
    ahead = np.clip(0.1 + travel - bed[:, 0], 0, None) * (bed[:, 1] > 0.1 - depth)
    soil = bed + np.stack([ahead, 0.3 * ahead, 0 * ahead], axis=-1)
    force = np.concatenate([-80 * depth - 9 * travel, 20 * travel, 0 * travel], axis=1)
    return {'positions': soil, 'rigid_positions': body, 'force': force}


def main(folder: str = 'own', **settings):
    """Writes raw runs, dataset and model into a folder; returns the errors on its test runs.

    Args:
      folder: absent or empty.
      **settings: fields of the preset, such as `num_steps`.
    """
    raw, data, model = (os.path.join(folder, name) for name in ('raw', 'data', 'model'))
    rng = np.random.default_rng(1)
    runs = (run(depth, speed) for depth, speed in rng.uniform([0.02, 0.1], [0.08, 0.4], (6, 2)))
    write_raw(raw, runs, dt=1 / 60, up_axis='y', body='prescribed')
    convert.convert(raw, data)
    dataset = lts.Dataset(data)
    trained = lts.train(lts.preset('pcg', **settings), dataset, model)
    errors = trained.evaluate(dataset.test)
    print(errors)
    return errors


if __name__ == '__main__':
    main(*sys.argv[1:])
