"""Several processes or machines that train one model, each on its share of every batch.

Started as TensorFlow starts them: `TF_CONFIG` in the environment of each process lists all of them
and says which one this is. The sums over processes are those of `MultiWorkerMirroredStrategy`. The
variables are plain ones: they begin with the same bits (from the seed), and every process applies
the same mean gradient to them, so they stay equal. (Mirrored variables would bind the optimiser to
the strategy's own loop, which Keras 3 does not support over several machines.)
"""

import json
import os

import tensorflow as tf


class Share:
    """This process, number `index` of `count` that train together; alone without `TF_CONFIG`.

    Make it before TensorFlow computes anything: it connects the processes, and waits for them.
    ValueError: `TF_CONFIG` is not one of workers alone.
    """

    def __init__(self):
        text = os.environ.get('TF_CONFIG') or '{}'
        try:
            config = json.loads(text)
            workers = config.get('cluster', {}).get('worker', [])
            self.index, self.count = int(config.get('task', {}).get('index', 0)), len(workers) or 1
            others = set(config.get('cluster', {})) - {'worker'}
        except (ValueError, AttributeError, TypeError) as error:
            raise ValueError(f'TF_CONFIG is not what TensorFlow takes: {text[:200]}') from error
        if others or not 0 <= self.index < self.count:
            raise ValueError(f'TF_CONFIG: a list of workers and an index in it, not {text[:200]}')
        self._strategy = tf.distribute.MultiWorkerMirroredStrategy() if self.count > 1 else None

    def folder(self, model_path: str) -> str:
        """The model folder of this process: the first one has the name, others a copy beside it."""
        if self.index == 0:
            return model_path
        return f'{os.path.normpath(model_path)}.worker{self.index}'

    def refuse_batch(self, size: int) -> None:
        """Raises ValueError if batches of that size cannot be dealt evenly."""
        if size % self.count:
            raise ValueError(f'batch_size is {size}, must be a multiple of {self.count} processes')

    def mean(self, tensors):
        """The mean over all processes of a structure of tensors."""
        if self._strategy is None:
            return tensors

        def reduce():
            context = tf.distribute.get_replica_context()
            # The reduction goes to where its tensor is; inside of a function a tensor has no
            # device of its own.
            with tf.device(self._strategy.extended.worker_devices[0]):
                placed = tf.nest.map_structure(tf.identity, tensors)
            return context.all_reduce(tf.distribute.ReduceOp.MEAN, placed)

        return self._strategy.run(reduce)

    def refuse_other_step(self, step: int, model_path: str) -> None:
        """Raises ValueError if the processes do not all go on from this step."""
        mean = float(self.mean(tf.constant(float(step), tf.float64)))
        if mean != step:
            raise ValueError(
                f'{model_path}: goes on from step {step}, the processes on average from {mean:g}; '
                f'a kill came between their checkpoints: copy the older ckpt-* files to all of '
                f'them, or remove the folders *.worker* and start again'
            )
