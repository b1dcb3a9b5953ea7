"""Whether a change of the code changes what the shipped models compute, to the last bit.

Rolls every shipped model out over the test split of its dataset, trains a small model for a few
steps of both stages, and keeps the sha256 of the results. Bits are those of one machine: other
processors, and other numbers of threads, round differently: one thread is taken. Before and after
a change:

  python -m tests.rollout_bits --write=/tmp/bits.json
  python -m tests.rollout_bits --compare=/tmp/bits.json
"""

import argparse
import glob
import hashlib
import os
import sys

import numpy as np

from learning_to_simulate import command, presets, reading_utils, registry
from learning_to_simulate.subspace import method
from learning_to_simulate.subspace.trainer import Trainer
from pca_tools import dataset, files


def _digest(*arrays):
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def of_rollouts(path: str) -> str:
    """Digest of all test rollouts of the model in a folder `models/<dataset>/<preset>`."""
    data_path = 'datasets/' + path.split('/')[1]
    opened = registry.open_model(path, data_path, 'test')
    rollouts = [opened.evaluator.roll_out(group) for group in opened.groups]
    # Of a soil field the terrain, of a network the modes and the body.
    soils = [r.heights if hasattr(r, 'heights') else r.position for r in rollouts]
    return _digest(*soils, *(r.force for r in rollouts))


def of_training(data_path: str, steps: int = 3) -> str:
    """Digest of the weights after some steps of both training stages."""
    unrolled = {'unroll_length': 3, 'unroll_steps': steps}
    config = presets.make_config('pcg', latent_size=16, num_steps=2 * steps, **unrolled)
    metadata = dataset.read_metadata(data_path)
    groups = reading_utils.read_groups(data_path, 'train', metadata, **config.nodes)
    model = method.make_model(data_path, metadata, groups, config)
    trainer = Trainer(model, groups)
    for step in range(2 * steps):
        trainer.step(step)
    return _digest(
        *(v.numpy() for v in (*model.simulator.trainable_variables, *trainer.averaging.variables))
    )


def main():
    """Runs the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', help='JSON file to keep the digests in')
    parser.add_argument('--compare', help='JSON file of before; a difference ends with exit code 1')
    parser.add_argument('--no_training', action='store_true', help='rollouts only')
    args = parser.parse_args()
    command.import_tensorflow(1)
    found = {path: of_rollouts(path) for path in sorted(glob.glob('models/*/*'))}
    if not args.no_training:
        for path in map(os.path.dirname, sorted(glob.glob('datasets/*/train.tfrecord'))):
            found[f'training on {path}'] = of_training(path)
    before = files.read_json(args.compare) if args.compare else {}
    for name, value in found.items():
        word = '' if name not in before else 'same' if before[name] == value else 'CHANGED'
        print(f'{name:36s} {value[:16]} {word}')
    if args.write:
        files.write_json(args.write, found)
    if any(before.get(name, value) != value for name, value in found.items()):
        sys.exit('error: bits have changed')


if __name__ == '__main__':
    main()
