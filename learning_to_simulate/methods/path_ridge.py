"""Kernel ridge regression on the path of the tool so far: no dynamics, nothing fed back.

Modes, force and (of a driven body) height are functions of some numbers that the known motion alone
decides: the pose, its velocity, how deep and how far the tool has been, what it has swept. A method
with a state has to beat this before its dynamics can be said to be learned. It knows the path since
the start and not the soil, so it serves bounded episodes from a known bed only.

Each output has its own width of the kernel, ridge and inputs. The valid runs choose them; or, where
a dataset has a dozen runs, each run of train and valid as judge of what the others give; the mean
of the best few is then less a matter of luck than the best.
"""

import itertools
import json

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import open_loop, path_inputs
from learning_to_simulate.methods.kernel_ridge import Regression, errors_left_out
from learning_to_simulate.scene import RigidMotion, Scene
from pca_tools import files

FILE_NAME = 'path_ridge.npz'
# Widths and ridges that are chosen from; widths per number of inputs.
GAMMAS = (0.01, 0.03, 0.1, 0.3, 1.0)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Samples that choose where runs are left out; what is chosen is fitted to all `max_samples`.
_CHOOSING_SAMPLES = 800
# The force itself as a target, beside its change since the last given frame.
_FREE_FORCE = 'free force'


class PathRidge:
    """Fitted regressions of one scene.

    Args:
      scene: what exists.
      reader: `path_inputs.PathInputs` of the scene.
      regressions: output ('soil', 'force', 'height') -> list of `Regression`, whose mean it is.
      choices: what was tried, for the record.
    """

    def __init__(self, scene: Scene, reader, regressions: dict, choices=()):
        self.scene, self.reader, self.regressions = scene, reader, regressions
        self.choices = list(choices)

    @classmethod
    def fit(
        cls,
        train,
        valid,
        scene,
        surface=None,
        max_samples=3000,
        gammas=GAMMAS,
        alphas=ALPHAS,
        progress=iter,
        leave_one_out=False,
        kernels=('gaussian',),
        n_best=1,
    ) -> 'PathRidge':
        """Fits all outputs, and chooses inputs, width and ridge by the error on the valid runs.

        Args:
          train, valid: lists of `RunGroup`.
          scene: of the dataset.
          surface: height of the resting bed, m; None takes where the tools begin.
          max_samples: frames of training that are taken, evenly spread; the time of a fit grows
            with their cube.
          gammas, alphas: to choose from; `gammas` are divided by the number of inputs.
          progress: wraps the list of choices, e.g. `tqdm.tqdm`.
          leave_one_out: train on the valid runs, too, and choose by the error on each run of a fit
            to all others. Errors on valid are then errors of training.
          kernels: names of `kernel_ridge.KERNELS`.
          n_best: so many of the best choices with each kernel, fitted, are averaged.

        Raises:
          ValueError: no runs, or a body whose motion is not known (the path is all there is).
        """
        if not scene.rigid_motion.is_known:
            raise ValueError(
                f'path_ridge needs a body whose motion is given; it is {scene.rigid_motion}'
            )
        if not train or not valid:
            raise ValueError('path_ridge needs train runs to fit and valid runs to choose by')
        groups = [*train, *valid] if leave_one_out else train
        reader = path_inputs.PathInputs.of(groups, scene, surface)
        samples = _Samples(groups, scene, reader, max_samples)
        grid = progress(list(itertools.product(kernels, reader.sets, gammas)))
        if leave_one_out:
            few = _Samples(groups, scene, reader, min(max_samples, _CHOOSING_SAMPLES))
            tried = _left_out(few, grid, alphas)
        else:
            tried = _on_valid(samples, valid, scene, reader, grid, alphas)
        choices = list(tried)
        of_kernel = {}
        for choice in choices:
            of_kernel.setdefault((choice['output'], choice['kernel']), []).append(choice)
        regressions = {}
        for (name, _), of_one in of_kernel.items():
            best = sorted(of_one, key=lambda choice: choice['error'])[:n_best]
            regressions.setdefault(name, []).extend(map(samples.fitted, best))
        return cls(scene, reader, regressions, choices)

    def predict(self, group, cases=None) -> open_loop.Prediction:
        """Frames H .. T - 1 of the S runs of a group; their cases add nothing."""
        del cases
        predicted = {}
        sets = {r.inputs for regressions in self.regressions.values() for r in regressions}
        seen = {name: self.reader.read(group, name) for name in sets}
        for name, regressions in self.regressions.items():
            each = []
            for regression in regressions:
                values = regression.predict(seen[regression.inputs])
                if name == open_loop.FORCE and regression.offset is None:
                    values += group.force[:, H - 1 : H]
                each.append(values)
            predicted[name] = np.mean(each, axis=0)
        n_rigid, dim = group.n_rigid, group.position.shape[-1]
        height = None
        if 'height' in predicted:
            start = group.position[:, H - 1, :n_rigid, self.scene.up_axis].mean(axis=1)
            height = start[:, None] + predicted['height'][..., 0]
        position = open_loop.held_position(group, self.scene, height)
        soil = predicted['soil'].reshape(*position.shape[:2], self.scene.n_modes, dim)
        position[:, :, n_rigid:] += soil
        return open_loop.Prediction(position, predicted.get(open_loop.FORCE), frozenset(predicted))

    def least_errors(self) -> dict[str, float]:
        """Output -> error of its best choice: mean over the judging runs of the RMS, m or N."""
        found: dict[str, float] = {}
        for choice in self.choices:
            name = choice['output']
            found[name] = min(found.get(name, choice['error']), choice['error'])
        return found

    def save(self, path: str) -> None:
        """Writes the regressions as one `.npz`, whole or not at all."""
        arrays = {}
        about = {'scene': self.scene.to_json(), 'reader': self.reader.to_json(), 'outputs': {}}
        for name, regressions in self.regressions.items():
            about['outputs'][name] = [
                {key: getattr(r, key) for key in ('inputs', 'gamma', 'alpha', 'kernel')}
                for r in regressions
            ]
            for i, regression in enumerate(regressions):
                for part in ('shift', 'scale', 'samples', 'dual', 'offset'):
                    if (values := getattr(regression, part)) is not None:
                        arrays[f'{name}/{i}/{part}'] = values
        about['choices'] = self.choices
        files.write_npz(path, about=np.array(json.dumps(about)), **arrays)

    @classmethod
    def load(cls, path: str) -> 'PathRidge':
        """Reads what `save` wrote.

        Raises:
          FileNotFoundError: there is no such file.
          ValueError: a damaged or foreign file.
        """
        arrays = files.read_npz(path)
        try:
            about = json.loads(str(arrays['about']))
            scene = Scene.from_json(about['scene'])
            regressions = {}
            for name, values in about['outputs'].items():
                # Before there could be several, an output was no list and its arrays had no number.
                each = {f'{name}/': values} if isinstance(values, dict) else {
                    f'{name}/{i}/': of_one for i, of_one in enumerate(values)
                }  # fmt: skip
                if not each:
                    raise ValueError(f'no regression of {name}')
                regressions[name] = [_loaded(v, arrays, prefix) for prefix, v in each.items()]
            reader = path_inputs.PathInputs.from_json(about['reader'], scene)
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise ValueError(f'{path}: is not a path_ridge model ({error!r})') from error
        return cls(scene, reader, regressions, about['choices'])


def _loaded(values, arrays, prefix):
    """One regression out of the arrays of a file."""
    parts = {
        key.removeprefix(prefix): array.astype(np.float64)
        for key, array in arrays.items()
        if key.startswith(prefix)
    }
    regression = Regression(**values, **parts)
    regression.check()
    return regression


def _targets(group, scene) -> dict[str, np.ndarray]:
    """Target -> [S, T, O]: changes since the last given frame, and the force as it is.

    Which of both forms of the force is better depends on the scene: a wheel's force at the start
    says much of its load, a blade's begins from nothing.
    """
    body, modes = np.split(group.position, [group.n_rigid], axis=2)
    values = {open_loop.SOIL: modes.reshape(*modes.shape[:2], -1)}
    if scene.has_force:
        values[open_loop.FORCE] = group.force
    if scene.rigid_motion == RigidMotion.DRIVEN:
        values[open_loop.HEIGHT] = body[..., scene.up_axis].mean(axis=2)[..., None]
    targets = {name: v - v[:, H - 1 : H] for name, v in values.items()}
    return targets | ({_FREE_FORCE: group.force} if scene.has_force else {})


class _Samples:
    """Frames of runs that regressions are fitted to, with all targets side by side.

    Every `stride`-th frame from the last given one on; successive runs begin one frame later, so
    that together they cover all frames.

    Args:
      groups: lists of `RunGroup`.
      scene: of the dataset.
      reader: `path_inputs.PathInputs` of the scene.
      max_samples: n is not more than it by much.

    Attributes:
      run: int [n], the run of each sample.
      y: [n, O], all targets less their offsets.
      columns: target -> its columns in y.
      offsets: target -> [O'] or None, see `Regression`.
    """

    def __init__(self, groups, scene, reader, max_samples):
        self._groups, self._reader = groups, reader
        self._inputs: dict[str, np.ndarray] = {}
        count = sum(g.position[:, H:, 0, 0].size for g in groups)
        self._stride = max(1, -(-count // max_samples))
        targets = [_targets(g, scene) for g in groups]
        y = {name: self._taken([t[name] for t in targets]) for name in targets[0]}
        # Only a force has a mean to begin from; what has changed since the start begins from 0.
        self.offsets = {n: v.mean(axis=0) if n == _FREE_FORCE else None for n, v in y.items()}
        ends = np.cumsum([0, *(values.shape[1] for values in y.values())])
        self.columns = {n: slice(*ends[i : i + 2]) for i, n in enumerate(y)}
        self.y = np.concatenate(
            [v if self.offsets[n] is None else v - self.offsets[n] for n, v in y.items()], axis=1
        )
        shapes = [t[open_loop.SOIL].shape[:2] for t in targets]
        starts = np.cumsum([0, *(n_run for n_run, _ in shapes)])
        numbers = [start + np.arange(n_run) for start, (n_run, _) in zip(starts, shapes)]
        self.run = self._taken([np.repeat(n[:, None], s[1], 1) for n, s in zip(numbers, shapes)])

    def _taken(self, groups):
        runs = (run for values in groups for run in values)
        return np.concatenate(
            [r[H - 1 + i % self._stride :: self._stride] for i, r in enumerate(runs)]
        )

    def inputs(self, name: str) -> np.ndarray:
        """Inputs [n, I] of a set."""
        if name not in self._inputs:
            self._inputs[name] = self._taken([self._reader.read(g, name) for g in self._groups])
        return self._inputs[name]

    def fitted(self, choice: dict) -> Regression:
        """The regression of a choice."""
        x = self.inputs(choice['inputs'])
        (whole,) = Regression.fit(
            choice['inputs'], x, self.y, choice['gamma'], [choice['alpha']], choice['kernel']
        )
        return whole.columns(self.columns[choice['target']], self.offsets[choice['target']])


def _on_valid(samples, valid, scene, reader, grid, alphas):
    """Every choice with its error on the valid runs."""
    truth = [{n: v[:, H:] for n, v in _targets(g, scene).items()} for g in valid]
    seen = {name: (samples.inputs(name), [reader.read(g, name) for g in valid])
            for name in reader.sets}  # fmt: skip
    for kernel, inputs, gamma in grid:
        wholes = Regression.fit(inputs, seen[inputs][0], samples.y, gamma, alphas, kernel)
        grams = [wholes[0].gram(x[:, H - 1 :]) for x in seen[inputs][1]]
        for whole in wholes:
            values = [gram @ whole.dual for gram in grams]
            for target, which in samples.columns.items():
                of_target = whole.columns(which, samples.offsets[target])
                errors = [
                    ((of_target.since_start(v[..., which]) - t[target]) ** 2).mean(axis=(1, 2))
                    for v, t in zip(values, truth, strict=True)
                ]
                yield _choice(target, kernel, inputs, gamma, whole.alpha, np.concatenate(errors))


def _left_out(samples, grid, alphas):
    """Every choice with its error on each run of a fit to all others."""
    runs = np.unique(samples.run)
    for kernel, inputs, gamma in grid:
        x = samples.inputs(inputs)
        off = errors_left_out(x, samples.y, samples.run, gamma, alphas, kernel)
        for alpha, errors in zip(alphas, off, strict=True):
            for target, which in samples.columns.items():
                square = (errors[:, which] ** 2).mean(axis=1)
                of_run = np.array([square[samples.run == run].mean() for run in runs])
                yield _choice(target, kernel, inputs, gamma, alpha, of_run)


def _choice(target, kernel, inputs, gamma, alpha, square):
    """A choice by the mean over runs of the RMS error, from mean squares of the runs.

    Not relative to the force: that of runs which hardly touch the soil would decide.
    """
    output = open_loop.FORCE if target == _FREE_FORCE else target
    return {'output': output, 'target': target, 'kernel': kernel, 'inputs': inputs, 'gamma': gamma,
            'alpha': alpha, 'error': float(np.sqrt(square).mean())}  # fmt: skip
