"""One training run on disk: claim the folder, resume, step, save. What is trained comes as a
`Training` from a method of `registry`; this loop knows none.

What it needs to go on is in `ckpt-<step>.npz`, the arrays of weights, optimiser and averages. A
file is written whole or not at all, and its checksums find later damage.
"""

import dataclasses
import os
import re
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import tensorflow as tf
import tqdm

from learning_to_simulate import checkpoints
from learning_to_simulate.registry import TrainOptions
from pca_tools import files
from pca_tools.storage import folder_lock, whole_files

LOG_EVERY = 50  # steps between looks at the losses
KEPT = 2  # checkpoints
_NAME = re.compile(r'ckpt-(\d+)\.npz')


@dataclasses.dataclass
class Training:
    """What a method hands over to be trained.

    Attributes:
      model: with `simulator`; stored by `checkpoints.save_config`.
      trainer: a `schedule.GradientTraining` with `step` and `batch_of`.
      evaluator: its `run(groups, split)` is the validation.
      valid: list of `RunGroup`; may be empty.
      n_rigid: any R the model runs on.
      data: where the training data came from, for config.json.
      title: what is trained, one line for the terminal.
      write_files: called with the model folder it writes what else the model needs, and returns
        name -> sha256.
      close_gates: called with the model folder when the edges have been learned; says what they
        are. None where none are learned.
    """

    model: Any
    trainer: Any
    evaluator: Any
    valid: list
    n_rigid: int
    data: dict
    title: str
    write_files: Callable[[str], dict[str, str]]
    close_gates: Callable[[str], str] | None = None


def run(training: Training, model_path: str, options: TrainOptions) -> dict:
    """Trains to the end of both stages, or resumes; arguments, result and errors as of
    `registry.train`.

    Ctrl-C or SIGTERM end it after the step at hand, with a checkpoint of that step.
    """
    with folder_lock.locked(model_path), StopSignals() as stop:
        open_model_path(model_path, training)
        state = TrainingState(model_path, training.trainer)
        whole_files.remove_temporary(model_path)
        start = state.restore()
        if start:
            print(f'resumed {model_path} at step {start}')
        weights = sum(int(np.prod(v.shape)) for v in training.model.simulator.trainable_variables)
        print(f'{training.title}, {weights} weights, {training.trainer.config.num_steps} steps')
        if training.close_gates and start > training.trainer.config.gate_steps:
            print(training.close_gates(model_path))
        save_every = options.steps_between_saves(training.trainer.config.num_steps)
        return _train_steps(training, model_path, state, start, save_every, stop)


def open_model_path(path: str, training: Training) -> None:
    """Claims a model folder: writes config.json into a new one, compares with that of an old one;
    ValueError for a folder of something else: nothing was written."""
    model = training.model
    fresh = {
        'config': dataclasses.asdict(model.simulator.config),
        'scene': model.simulator.scene.to_json(),
        'data': training.data,
    }
    if not checkpoints.holds_model(path, fresh):
        beside = training.write_files(path)
        checkpoints.save_config(path, model, training.n_rigid, training.data, beside)
        return
    stored = checkpoints.read_config(path)
    if not training.close_gates:  # learned edges change on the way, by themselves
        masks = {'mode_mask': model.mode_mask, 'loaded_mask': model.loaded_mask}
        for name, mask in masks.items():
            if stored[name] != (None if mask is None else mask.astype(int).tolist()):
                raise ValueError(
                    f'{path}: holds a model with other edges ({stored.get("edge_source")} there, '
                    f'{model.edge_source} now); nothing was written, give another --model_path'
                )
    if not stored_steps(path) and os.path.exists(os.path.join(path, checkpoints.WEIGHTS_FILE)):
        raise ValueError(
            f'{path}: holds weights without training state, so training cannot resume; give '
            f'another --model_path'
        )


def _train_steps(training, model_path, state, start, save_every, stop) -> dict:
    trainer, close_gates = training.trainer, training.close_gates
    summary = {}
    total = trainer.config.num_steps
    losses = []  # since the last look at them
    with (
        tqdm.tqdm(total=total, initial=start, unit='step', disable=None, smoothing=0.05) as bar,
        tf.summary.create_file_writer(model_path).as_default(),
    ):
        bar.write('compiling the first step, up to a minute ...')
        clock = time.perf_counter()
        for i in range(start, total):
            if close_gates and i == trainer.config.gate_steps:
                bar.write(close_gates(model_path))
            values = trainer.step(i)
            losses.append(values['loss'])
            bar.update()
            last = i + 1 == total
            save = (i + 1) % save_every == 0 or last
            if (i + 1) % LOG_EVERY == 0 or save or stop.number:
                _refuse_non_finite(losses, i + 1, trainer, model_path)
                losses = []
            if (i + 1) % LOG_EVERY == 0 or last:
                scalars = {k: float(v) for k, v in values.items()}
                bar.set_postfix({k: f'{v:.3g}' for k, v in scalars.items()})
                rate = (i + 1 - start) / (time.perf_counter() - clock)
                for name, value in (
                    scalars.items()
                    | {'steps_per_sec': rate, 'lr': float(trainer.learning_rate(i))}.items()
                ):
                    tf.summary.scalar(name, value, step=i)
            # Weights come before the checkpoint that says that they are there. The first ones come
            # after it: weights alone are a finished model, which no training may go on with.
            due = save or stop.number
            first = due and not stored_steps(model_path)
            if first:
                state.save(i + 1)
            # While the edges are being learned there is no graph yet that weights belong to.
            learns_edges = close_gates and i < trainer.config.gate_steps
            if save and (last or not stop.number) and not learns_edges:
                with trainer.averaging.in_place():
                    if training.valid:
                        _, summary = training.evaluator.run(training.valid, 'valid')
                        _log_rollout(summary, i, bar)
                    checkpoints.save_weights(model_path, checkpoints.weights_of(trainer))
            if due and not first:
                state.save(i + 1)
            if stop.number and not last:
                bar.write(f'stopped; step {i + 1} is saved in {model_path}, go on by the same call')
                raise SystemExit(stop.exit_code)
    if start >= total:
        if not os.path.exists(os.path.join(model_path, checkpoints.WEIGHTS_FILE)):
            with trainer.averaging.in_place():
                checkpoints.save_weights(model_path, checkpoints.weights_of(trainer))
        print(f'{model_path}: already trained to step {total}')
    print(f'trained {total} steps: {model_path}')
    return summary


def _refuse_non_finite(losses, end, trainer, model_path):
    finite = np.isfinite([float(loss) for loss in losses])
    if finite.all():
        return
    at = int(np.argmin(finite))
    step = end - len(losses) + at
    raise ValueError(
        f'loss is {float(losses[at])} at step {step}, batch of (record, first frame) '
        f'{trainer.batch_of(step)}; training stopped, the last checkpoint stays in '
        f'{model_path}'
    )


def _log_rollout(summary, step, bar):
    # A rollout that blew up has no number (null in metrics.json); training goes on and says so.
    mean = {k: float('nan') if v is None else v for k, v in summary['mean']['model'].items()}
    still = summary['mean']['stay_still']['soil_mm']
    text = f'step {step + 1}: valid rollout soil error {mean["soil_mm"]:.4g} mm'
    text += f' {summary["soil_error"]} (persistence {still:.4g})'
    # DeepMind's name, of modes, and ours.
    tf.summary.scalar('rollout_error_mse', mean['soil_mse'], step=step)
    tf.summary.scalar('soil_error_mm', mean['soil_mm'], step=step)
    for name in ('force', 'torque'):
        if f'{name}_relative_l2' in mean:
            tf.summary.scalar(f'{name}_error_mse', mean[f'{name}_rmse'] ** 2, step=step)
            text += f', {name} rel. L2 {mean[f"{name}_relative_l2"]:.3g}'
    bar.write(text)


class StopSignals:
    """Notes the first SIGINT or SIGTERM inside a `with` block as its `number`; a second one acts as
    usual. Outside of the main thread, where Python cannot handle signals, nothing is noted."""

    number: int | None = None

    @property
    def exit_code(self) -> int:
        """What a shell expects: 130 for Ctrl-C, 143 for SIGTERM."""
        return 128 + (self.number or 0)

    def __enter__(self) -> 'StopSignals':
        is_main = threading.current_thread() is threading.main_thread()
        numbers = (signal.SIGINT, signal.SIGTERM) if is_main else ()
        self._before = {number: signal.signal(number, self._note) for number in numbers}
        return self

    def __exit__(self, *_):
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number, _):
        self.number = number
        self.__exit__()


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
