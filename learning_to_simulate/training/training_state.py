"""What a training run needs to go on: `ckpt-<step>.*` in the model folder.

A checkpoint is the files that `tf.train.Checkpoint` writes and, last of all, `ckpt-<step>.json`
with their bytes and sha256: without it, or where it disagrees, the checkpoint does not count. So a
damaged file is never handed to TensorFlow, and TensorFlow's own `checkpoint` file, which names the
newest one and may itself be damaged, is neither needed nor written.
"""

import contextlib
import os
import re
import shutil
import tempfile

import numpy as np
import tensorflow as tf

from pca_tools import files

KEPT = 2
_NAME = re.compile(r'ckpt-(\d+)\.(json|index|data-\d+-of-\d+)')
_LEFTOVER = re.compile(r'ckpt-\d+_temp|\..*\.tmp')


def stored_steps(path: str) -> list[int]:
    """Steps of which any checkpoint file lies in a folder, newest first."""
    names = [_NAME.fullmatch(name) for name in os.listdir(path)]
    return sorted({int(match[1]) for match in names if match}, reverse=True)


def check(path: str, step: int) -> None:
    """Raises ValueError if a file of the checkpoint of a step is missing or is not the one that was
    written."""
    entries = files.check_manifest(path, manifest_name=f'ckpt-{step}.json')
    if entries is None:
        raise ValueError(f'{path}/ckpt-{step}.json: is missing, the checkpoint was not finished')
    if f'ckpt-{step}.index' not in entries:
        raise ValueError(f'{path}/ckpt-{step}.json: lists no ckpt-{step}.index')


class TrainingState:
    """Weights, optimiser, averages and step of a `GradientTraining` in its model
    folder."""

    def __init__(self, path: str, trainer):
        self._path = path
        self._step = tf.Variable(0, dtype=tf.int64)
        gates = trainer.gates
        self._checkpoint = tf.train.Checkpoint(
            simulator=trainer.simulator,
            optimizer=trainer.optimizer,
            averages=trainer.averaging.variables,
            step=self._step,
            **({'gates': gates} if gates else {}),
        )
        self._variables = [
            *trainer.simulator.trainable_variables,
            *trainer.optimizer.variables,
            *trainer.averaging.variables,
            *(gates.variables if gates else ()),
        ]

    def restore(self) -> int:
        """Restores the newest whole checkpoint; returns its step, 0 if there is none at all.

        Newer damaged ones are reported and set aside under names that end in `.damaged`, and so is
        a first one that was never finished. All but the newest `KEPT` ones are deleted.

        Raises:
          ValueError: there are checkpoints and all of them are damaged, or the newest whole one is
            of another model.
        """
        damaged = {}
        for step in stored_steps(self._path):
            try:
                check(self._path, step)
            except ValueError as error:
                damaged[step] = error
                continue
            self._read(step)
            self._set_aside(damaged)
            self._remove_old()  # a kill may have come between the last save and its own removal
            return step
        if len(damaged) == 1 and not os.path.exists(
            os.path.join(self._path, f'ckpt-{next(iter(damaged))}.json')
        ):
            # Killed while it wrote the first one: there is nothing to go on from.
            self._set_aside(damaged)
            return 0
        if damaged:
            raise ValueError(
                f'{self._path}: all checkpoints are damaged; nothing was changed. Bring one of '
                'them back, give another --model_path, or delete the ckpt-* files to start from '
                'step 0. ' + '; '.join(str(error) for error in damaged.values())
            )
        return 0

    def _read(self, step):
        name = os.path.join(self._path, f'ckpt-{step}')
        try:
            with self._plainly_named(step) as folder:
                self._checkpoint.read(os.path.join(folder, f'ckpt-{step}')).assert_consumed()
        # AssertionError: other objects; ValueError: other shapes.
        except (AssertionError, ValueError, tf.errors.OpError) as error:
            reason = str(error).strip().splitlines()[0]
            raise ValueError(f'{name}: is a checkpoint of another model ({reason})') from error
        if int(self._step) != step:
            raise ValueError(f'{name}: holds step {int(self._step)}, not that of its name')

    @contextlib.contextmanager
    def _plainly_named(self, step):
        """A folder with the checkpoint: TensorFlow takes the name of what it reads as a pattern."""
        if not set('*?[') & set(self._path):
            yield self._path
            return
        with tempfile.TemporaryDirectory() as folder:
            for name in self._files_of(step):
                shutil.copyfile(os.path.join(self._path, name), os.path.join(folder, name))
            yield folder

    def _set_aside(self, damaged):
        for step, error in damaged.items():
            print(f'{self._path}: skipped the damaged checkpoint of step {step}: {error}')
            for name in self._files_of(step):
                old = os.path.join(self._path, name)
                os.replace(old, f'{old}.damaged')

    def _files_of(self, step):
        """Names of the files of a checkpoint, the one that makes it count first."""
        names = [_NAME.fullmatch(name) for name in os.listdir(self._path)]
        mine = [match[0] for match in names if match and int(match[1]) == step]
        return sorted(mine, key=lambda name: not name.endswith('.json'))

    def save(self, step: int) -> None:
        """Writes a checkpoint of `step` steps and deletes all but the newest `KEPT` ones.

        Raises:
          ValueError: a variable is not finite; nothing is written.
          OSError: the disk is full or the folder is gone; older checkpoints stay.
        """
        bad = [v.name for v in self._variables if not np.isfinite(v.numpy()).all()]
        if bad:
            raise ValueError(
                f'{self._path}: no checkpoint at step {step}, variables are not finite: {bad[:3]}'
            )
        self._step.assign(step)
        name = f'ckpt-{step}'
        try:
            self._checkpoint.write(os.path.join(self._path, name))
            written = [n for n in self._files_of(step) if not n.endswith('.json')]
            files.write_manifest(self._path, {n: {} for n in written}, f'{name}.json')
        except (tf.errors.OpError, OSError) as error:
            for file in self._files_of(step):
                os.remove(os.path.join(self._path, file))
            self.remove_leftovers()
            reason = getattr(error, 'message', None) or error
            raise OSError(
                f'{self._path}: the checkpoint of step {step} could not be written ({reason}); '
                'older ones stay'
            ) from error
        self._remove_old()

    def _remove_old(self):
        for old in stored_steps(self._path)[KEPT:]:
            for file in self._files_of(old):
                os.remove(os.path.join(self._path, file))

    def remove_leftovers(self) -> None:
        """Deletes what a writer that was killed or failed left half done."""
        for name in os.listdir(self._path):
            if _LEFTOVER.fullmatch(name):
                path = os.path.join(self._path, name)
                shutil.rmtree(path) if os.path.isdir(path) else os.remove(path)
