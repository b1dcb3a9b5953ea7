"""Kernel ridge regression on the path of the tool so far: no dynamics, nothing fed back.

Modes, force and (of a driven body) height are functions of some numbers that the known motion alone
decides: the pose, its velocity, how deep and how far the tool has been, what it has swept. A method
with a state has to beat this before its dynamics can be said to be learned. It knows the path since
the start and not the soil, so it serves bounded episodes from a known bed only.

Each output has its own width of the kernel, ridge and inputs; the valid runs choose them.
"""

import dataclasses
import itertools
import json

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods import open_loop, path_inputs
from learning_to_simulate.scene import RigidMotion, Scene
from pca_tools import files

FILE_NAME = 'path_ridge.npz'
# Widths and ridges that the valid runs choose from; widths per number of inputs.
GAMMAS = (0.01, 0.03, 0.1, 0.3, 1.0)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# The force itself as a target, beside its change since the last given frame.
_FREE_FORCE = 'free force'


@dataclasses.dataclass(frozen=True)
class Regression:
    """One fitted kernel ridge: `y(x) = offset + sum_i dual_i exp(-gamma |x' - x'_i|^2)`.

    Attributes:
      inputs: which inputs it sees, a name of `path_inputs.SETS`.
      gamma: width of the kernel on scaled inputs.
      alpha: ridge.
      shift, scale: [I], x' = (x - shift) / scale.
      samples: [n, I] scaled inputs of training.
      dual: [n, O].
      offset: [O], the mean of training; None where the output is the change since the last given
        frame.
    """

    inputs: str
    gamma: float
    alpha: float
    shift: np.ndarray
    scale: np.ndarray
    samples: np.ndarray
    dual: np.ndarray
    offset: np.ndarray | None = None

    @classmethod
    def fit(cls, inputs: str, x, y, gamma: float, alphas) -> list['Regression']:
        """Fits outputs y [n, O] to inputs x [n, I], once with each ridge and all with one kernel.

        `gamma` is per number of inputs.
        """
        from sklearn.kernel_ridge import KernelRidge  # slow to load, and only fits need it

        shift, scale = x.mean(axis=0), x.std(axis=0)
        scale = np.where(scale > 1e-9 * np.maximum(np.abs(shift), 1.0), scale, 1.0)
        parts = (shift, scale, (x - shift) / scale)
        gamma = gamma / x.shape[1]
        gram = _kernel(parts[2], parts[2], gamma)
        return [
            cls(inputs, gamma, alpha, *parts,
                np.asarray(KernelRidge(alpha=alpha, kernel='precomputed').fit(gram, y).dual_coef_))
            for alpha in alphas
        ]  # fmt: skip

    def columns(self, which: slice, offset) -> 'Regression':
        """The regression of some of the outputs; they share all but the dual coefficients."""
        return dataclasses.replace(
            self, dual=np.ascontiguousarray(self.dual[:, which]), offset=offset
        )

    def predict(self, x) -> np.ndarray:
        """Outputs [S, T - H, O] of frames H .. T - 1 from inputs [S, T, I] of all frames."""
        return self.since_start(self(x[:, H - 1 :]))

    def since_start(self, values) -> np.ndarray:
        """Outputs [S, T - H, O] from what is regressed for frames H - 1 .. T - 1.

        Changes since the last given frame begin there: what is regressed for it is taken off.
        """
        return values[:, 1:] - values[:, :1] if self.offset is None else values[:, 1:] + self.offset

    def kernel(self, x) -> np.ndarray:
        """[..., n] of inputs [..., I] and the samples."""
        flat = ((x - self.shift) / self.scale).reshape(-1, x.shape[-1])
        return _kernel(flat, self.samples, self.gamma).reshape(*x.shape[:-1], -1)

    def __call__(self, x) -> np.ndarray:
        """Outputs [..., O] at inputs [..., I]."""
        return self.kernel(x) @ self.dual


class PathRidge:
    """Fitted regressions of one scene.

    Args:
      scene: what exists.
      reader: `path_inputs.PathInputs` of the scene.
      regressions: output ('soil', 'force', 'height') -> `Regression`.
      choices: what was tried on the valid runs, for the record.
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

        Raises:
          ValueError: no runs, or a body whose motion is not known (the path is all there is).
        """
        if not scene.rigid_motion.is_known:
            raise ValueError(
                f'path_ridge needs a body whose motion is given; it is {scene.rigid_motion}'
            )
        if not train or not valid:
            raise ValueError('path_ridge needs train runs to fit and valid runs to choose by')
        reader = path_inputs.PathInputs.of(train, scene, surface)
        stride = max(1, -(-sum(g.position[:, H:, 0, 0].size for g in train) // max_samples))
        targets = [_targets(g, scene) for g in train]
        y = {name: _samples([t[name] for t in targets], stride) for name in targets[0]}
        # Only a force has a mean to begin from; what has changed since the start begins from 0.
        offsets = {name: y[name].mean(axis=0) if name == _FREE_FORCE else None for name in y}
        ends = np.cumsum([0, *(values.shape[1] for values in y.values())])
        y = np.concatenate(
            [v if offsets[n] is None else v - offsets[n] for n, v in y.items()], axis=1
        )
        truth = [{n: v[:, H:] for n, v in _targets(g, scene).items()} for g in valid]
        seen = {
            name: [[reader.read(g, name) for g in groups] for groups in (train, valid)]
            for name in reader.sets
        }
        best: dict[str, tuple] = {}
        choices = []
        for inputs, gamma in progress(list(itertools.product(reader.sets, gammas))):
            wholes = Regression.fit(inputs, _samples(seen[inputs][0], stride), y, gamma, alphas)
            kernels = [wholes[0].kernel(x[:, H - 1 :]) for x in seen[inputs][1]]
            for whole in wholes:
                values = [kernel @ whole.dual for kernel in kernels]
                for i, (target, offset) in enumerate(offsets.items()):
                    which = slice(*ends[i : i + 2])
                    regression = whole.columns(which, offset)
                    output = open_loop.FORCE if target == _FREE_FORCE else target
                    error = _error(
                        [regression.since_start(v[..., which]) for v in values],
                        [t[target] for t in truth],
                    )
                    choices.append(
                        {'output': output, 'target': target, 'inputs': inputs, 'gamma': gamma,
                         'alpha': whole.alpha, 'valid_error': error}
                    )  # fmt: skip
                    if output not in best or error < best[output][0]:
                        best[output] = (error, regression)
        return cls(scene, reader, {n: r for n, (_, r) in best.items()}, choices)

    def predict(self, group, cases=None) -> open_loop.Prediction:
        """Frames H .. T - 1 of the S runs of a group; their cases add nothing."""
        del cases
        predicted = {}
        for name, regression in self.regressions.items():
            x = self.reader.read(group, regression.inputs)
            predicted[name] = regression.predict(x)
        n_rigid, dim = group.n_rigid, group.position.shape[-1]
        height = force = None
        if 'height' in predicted:
            start = group.position[:, H - 1, :n_rigid, self.scene.up_axis].mean(axis=1)
            height = start[:, None] + predicted['height'][..., 0]
        position = open_loop.held_position(group, self.scene, height)
        soil = predicted['soil'].reshape(*position.shape[:2], self.scene.n_modes, dim)
        position[:, :, n_rigid:] += soil
        if 'force' in predicted:
            force = predicted['force']
            if self.regressions['force'].offset is None:
                force = group.force[:, H - 1 : H] + force
        return open_loop.Prediction(position, force, frozenset(predicted))

    def save(self, path: str) -> None:
        """Writes the regressions as one `.npz`, whole or not at all."""
        arrays = {}
        about = {'scene': self.scene.to_json(), 'reader': self.reader.to_json(), 'outputs': {}}
        for name, regression in self.regressions.items():
            about['outputs'][name] = {
                'inputs': regression.inputs,
                'gamma': regression.gamma,
                'alpha': regression.alpha,
            }
            for part in ('shift', 'scale', 'samples', 'dual', 'offset'):
                if (values := getattr(regression, part)) is not None:
                    arrays[f'{name}/{part}'] = values
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
                parts = {
                    key.removeprefix(f'{name}/'): array.astype(np.float64)
                    for key, array in arrays.items()
                    if key.startswith(f'{name}/')
                }
                regressions[name] = Regression(**values, **parts)
                _check(regressions[name])
            reader = path_inputs.PathInputs.from_json(about['reader'], scene)
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise ValueError(f'{path}: is not a path_ridge model ({error!r})') from error
        return cls(scene, reader, regressions, about['choices'])


def _kernel(a, b, gamma):
    """exp(-gamma |a - b|^2) [n_a, n_b] of scaled inputs; in place, since these are large."""
    square = a @ b.T
    square *= -2.0
    square += (a**2).sum(axis=1)[:, None]
    square += (b**2).sum(axis=1)
    np.maximum(square, 0.0, out=square)
    square *= -gamma
    return np.exp(square, out=square)


def _check(r):
    n, inputs = r.samples.shape
    if (
        r.shift.shape != (inputs,)
        or r.scale.shape != (inputs,)
        or r.dual.ndim != 2
        or len(r.dual) != n
        or (r.offset is not None and r.offset.shape != r.dual.shape[1:])
        or not all(np.isfinite(v).all() for v in (r.shift, r.scale, r.samples, r.dual))
        or not (r.scale > 0).all()
    ):
        raise ValueError('arrays do not fit each other')


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


def _samples(groups, stride):
    """Every `stride`-th of all frames from the last given one on, [n, ...].

    Successive runs begin one frame later, so that together they cover all frames.
    """
    runs = (run for values in groups for run in values)
    return np.concatenate([run[H - 1 + i % stride :: stride] for i, run in enumerate(runs)])


def _error(predicted, truth):
    """What the valid runs choose by: mean over runs of the RMS error.

    Not relative to the force: that of runs which hardly touch the soil would decide.
    """
    errors = [((p - t) ** 2).mean(axis=(1, 2)) for p, t in zip(predicted, truth, strict=True)]
    return float(np.sqrt(np.concatenate(errors)).mean())
