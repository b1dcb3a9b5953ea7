"""Learns from trajectories which nodes act on which (Neural Relational Inference).

Examples:
  # our datasets: which modes act on which; `nri.export_edges` exports the edges
  python -m nri.train --data_path=datasets/excavation --model_path=/tmp/nri_excavation \\
      --window=50 --hidden=64 --epochs=200

  # springs of Kipf et al., of `nri.simulate`: 99 % of the edges after half an hour of one core
  python -m nri.train --data_path=/tmp/springs5 --model_path=/tmp/nri_springs5 \\
      --hidden=64 --batch_size=64 --learning_rate=1e-3 --epochs=180 --decay_start=100 \\
      --decay_epochs=10

  # the same without an encoder, as springs act along lines between objects: 8000 runs give
  # 99.99 % in three minutes
  python -m nri.train --data_path=/tmp/springs5 --model_path=/tmp/nri_central --central \\
      --hidden=64 --batch_size=64 --learning_rate=2e-3 --segment=16 --epochs=16 --decay_start=10 \\
      --decay_epochs=2

  # the encoder alone with the true edges: what the trajectories tell at all, in a minute
  python -m nri.train --supervised --data_path=/tmp/springs5 --model_path=/tmp/nri_supervised \\
      --hidden=64 --epochs=5

The same command again resumes. The weights of the best validation loss are kept. A posterior that
uses a type for less than 1 % or more than 99 % of the pairs is reported as COLLAPSED.
"""

import dataclasses

from absl import flags

from learning_to_simulate import command
from nri import data
from nri.config import NriConfig

_DEFINE = {
    int: flags.DEFINE_integer,
    float: flags.DEFINE_float,
    bool: flags.DEFINE_bool,
    str: flags.DEFINE_string,
}


def define_flags():
    """Defines the command line: one flag for each field of `NriConfig`."""
    flags.DEFINE_string('data_path', None, 'Dataset folder or folder of .npy files.', required=True)
    flags.DEFINE_string('model_path', None, 'Model folder; training resumes.', required=True)
    for field in dataclasses.fields(NriConfig):
        if field.name == 'nodes':
            flags.DEFINE_enum('nodes', field.default, data.NODE_KINDS, 'Nodes of a dataset.')
            continue
        define = _DEFINE.get(field.type, flags.DEFINE_float)
        define(field.name, field.default, 'See NriConfig in nri/config.py.')


def main(given):
    fields = [field.name for field in dataclasses.fields(NriConfig)]
    config = NriConfig(**{name: getattr(given, name) for name in fields})
    command.import_tensorflow()  # here, so that neither help nor a refusal waits for it
    import tensorflow as tf

    from nri import training

    try:
        training.train(given.data_path, given.model_path, config)
    except tf.errors.OpError as error:
        raise ValueError(str(error)) from error


if __name__ == '__main__':
    define_flags()
    command.start(main)
