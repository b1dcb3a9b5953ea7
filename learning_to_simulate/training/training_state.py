"""What a training run needs to go on: `ckpt-<step>.npz` in the model folder, the arrays of weights,
optimiser and averages. A file is written whole or not at all, and its checksums find later damage.
"""

import os
import re

import numpy as np

from pca_tools import files

KEPT = 2
_NAME = re.compile(r'ckpt-(\d+)\.npz')
_LEFTOVER = re.compile(r'\..*\.tmp')


def stored_steps(path: str) -> list[int]:
    """Steps of the checkpoints in a folder, newest first."""
    names = [_NAME.fullmatch(name) for name in os.listdir(path)]
    return sorted((int(match[1]) for match in names if match), reverse=True)


def file_of(path: str, step: int) -> str:
    """The checkpoint of a step in a folder."""
    return os.path.join(path, f'ckpt-{step}.npz')


def newest(path: str) -> tuple[int, dict, dict[int, ValueError]]:
    """Step and arrays of the newest whole checkpoint of a folder, 0 and none where there is none;
    and what is wrong with newer ones, by step. ValueError where there are checkpoints and all of
    them are damaged."""
    damaged: dict[int, ValueError] = {}
    for step in stored_steps(path):
        try:
            return step, files.read_npz(file_of(path, step)), damaged
        except ValueError as error:
            damaged[step] = error
    if damaged:
        raise ValueError(
            f'{path}: all checkpoints are damaged; nothing was changed. Bring one of them back, '
            f'give another --model_path, or delete the ckpt-* files to start from step 0. '
            + '; '.join(map(str, damaged.values()))
        )
    return 0, {}, {}


class TrainingState:
    """Weights, optimiser, averages and step of a `GradientTraining` in its model folder."""

    def __init__(self, path: str, trainer):
        self._path, gates = path, trainer.gates
        parts = {
            'weight': trainer.simulator.trainable_variables,
            'optimizer': trainer.optimizer.variables,
            'average': trainer.averaging.variables,
            'gate': [gates.log_alpha, *gates.optimizer.variables] if gates else [],
        }
        self._variables = {
            f'{name}/{i}': variable
            for name, variables in parts.items()
            for i, variable in enumerate(variables)
        }

    def restore(self) -> int:
        """Restores the newest whole checkpoint; returns its step, 0 if there is none at all. Newer
        damaged ones are reported and set aside under names that end in `.damaged`. All but the
        newest `KEPT` ones are deleted. ValueError: as `newest`, or that one is of another model."""
        step, arrays, damaged = newest(self._path)
        if not step:
            return 0
        name = file_of(self._path, step)
        forms = (
            {key: (value.shape, value.dtype) for key, value in each.items()}
            for each in (arrays, self._arrays(step))
        )
        if next(forms) != next(forms):
            raise ValueError(f'{name}: is a checkpoint of another model')
        if arrays['step'] != step:
            raise ValueError(f'{name}: holds step {arrays["step"]}, not that of its name')
        for key, variable in self._variables.items():
            variable.assign(arrays[key])
        for number, error in damaged.items():
            print(f'{self._path}: skipped the damaged checkpoint of step {number}: {error}')
            old = file_of(self._path, number)
            os.replace(old, f'{old}.damaged')
        self._remove_old()  # a kill may have come between the last save and its own removal
        return step

    def save(self, step: int) -> None:
        """Writes a checkpoint of `step` steps and deletes all but the newest `KEPT` ones.
        ValueError where a variable is not finite; nothing is written. OSError where the disk is
        full or the folder is gone; older checkpoints stay."""
        arrays = self._arrays(step)
        if bad := [key for key, value in arrays.items() if not np.isfinite(value).all()]:
            raise ValueError(
                f'{self._path}: no checkpoint at step {step}, variables are not finite: {bad[:3]}'
            )
        try:
            files.write_npz(file_of(self._path, step), **arrays)
        except OSError as error:
            raise OSError(
                f'{self._path}: the checkpoint of step {step} could not be written ({error}); '
                f'older ones stay'
            ) from error
        self._remove_old()

    def _arrays(self, step):
        arrays = {key: np.asarray(variable) for key, variable in self._variables.items()}
        return arrays | {'step': np.array(step)}

    def _remove_old(self):
        for old in stored_steps(self._path)[KEPT:]:
            os.remove(file_of(self._path, old))

    def remove_leftovers(self) -> None:
        """Deletes what a writer that was killed left half done."""
        for name in os.listdir(self._path):
            if _LEFTOVER.fullmatch(name):
                os.remove(os.path.join(self._path, name))
