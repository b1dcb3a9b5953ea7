"""Kernel ridge regression on the path of the tool so far: no dynamics, nothing fed back.

Modes, force and (of a driven body) height are functions of some numbers that the known motion alone
decides: the pose, its velocity, how deep and how far the tool has been, what it has swept. A method
with a state has to beat this before its dynamics can be said to be learned. It knows the path since
the start and not the soil, so it serves bounded episodes from a known bed only.

Each output has its own width of the kernel, ridge and inputs. The valid runs choose them; or, where
a dataset has a dozen runs, each run of train and valid as judge of what the others give; the mean
of the best few is then less a matter of luck than the best.

What a regression sees are functions of the known motion up to a frame. `path`: pose, velocity,
deepest and foremost point so far, swept area (a blade), or travel, turn, slip, their rates,
logarithms of the context and the size (a wheel). `swept` adds the profile of the deepest cut, from
where the tool began; `bed` adds where on the bed that was and the profile at places that are the
same in all runs, as the particles of the modes are (a blade; a wheel's height is not known, so nor
is its rut).
"""

import dataclasses
import itertools
import json

import numpy as np

from learning_to_simulate.baselines import open_loop
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.tool import swept
from learning_to_simulate.tool.axes import Axes, blade_pose, hidden_height, wheel_pose
from learning_to_simulate.tool.blade import EDGE_RADIUS
from pca_tools import files

FILE_NAME = 'path_ridge.npz'
# Widths and ridges that are chosen from; widths per number of inputs.
GAMMAS = (0.01, 0.03, 0.1, 0.3, 1.0)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Samples that choose where runs are left out; what is chosen is fitted to all `max_samples`.
_CHOOSING_SAMPLES = 800
# The force itself as a target, beside its change since the last given frame.
_FREE_FORCE = 'free force'
SETS = ('path', 'swept', 'bed')
PROFILE_BINS = 15


@dataclasses.dataclass(frozen=True)
class PathInputs:
    """Reads the inputs of a scene's runs.

    Attributes:
      scene: what exists.
      axes: of the training runs.
      surface: height of the resting bed, m.
      reach: [2] smallest and largest travel of the training runs from their start, m; the profile
        of `swept` is spread over it.
      places: [2] smallest and largest place along the way of the training runs, m; of `bed`.
      grid: bins of the swept profile.
    """

    scene: Scene
    axes: Axes
    surface: float
    reach: tuple[float, float]
    places: tuple[float, float]
    grid: swept.SweptGrid

    @classmethod
    def of(cls, groups, scene: Scene, surface=None) -> 'PathInputs':
        """The reader for training groups; see `PathRidge.fit`."""
        bodies = [g.position[:, :, : g.n_rigid] for g in groups]
        axes = Axes.of_bodies(bodies, scene.up_axis)
        u = [axes.plane(b).mean(axis=2)[..., 0] for b in bodies]
        travel = np.concatenate([(x - x[:, :1]).reshape(-1) for x in u])
        if surface is None:
            surface = float(np.mean([b[:, 0, :, scene.up_axis].min() for b in bodies]))
        span = max(float(np.ptp(travel)), 10 * EDGE_RADIUS)
        # Runs to come may go farther than those of training did, by half of their span.
        grid = swept.SweptGrid(
            radius=EDGE_RADIUS,
            behind=float(-travel.min()) + span / 2 + 0.2,
            ahead=float(travel.max()) + span / 2 + 0.2,
        )
        reach = (float(travel.min()), float(travel.max()))
        places = (min(float(x.min()) for x in u), max(float(x.max()) for x in u))
        return cls(scene, axes, float(surface), reach, places, grid)

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets of inputs that the scene has."""
        return SETS if self.scene.rigid_motion == RigidMotion.PRESCRIBED else SETS[:1]

    def read(self, group, name: str) -> np.ndarray:
        """Inputs [S, T, I] of the runs of a group.

        Raises:
          ValueError: a path that leaves the bins.
        """
        body = group.position[:, :, : group.n_rigid]
        if self.scene.rigid_motion == RigidMotion.PRESCRIBED:
            parts = self._blade(body, name)
        else:
            hidden = hidden_height(body, self.scene, H)
            parts = [self._wheel(hidden)]
        if group.context is not None:
            by_frame = group.context if group.context.ndim == 3 else group.context[:, None]
            shape = (*body.shape[:2], by_frame.shape[-1])
            parts.append(np.broadcast_to(_context(by_frame), shape))
        return np.concatenate(parts, axis=-1)

    def _blade(self, body, name):
        tip, lean = blade_pose(body, self.axes)
        dt, n_frame = self.scene.dt, body.shape[1]
        state = swept.start(self.grid, tip[:, 0], self.surface)
        begun = tip[:, :1, 0]
        if name == 'bed':
            places = np.broadcast_to(
                np.linspace(*self.places, PROFILE_BINS), (len(tip), PROFILE_BINS)
            )
        else:
            places = begun + np.linspace(*self.reach, PROFILE_BINS)
        path, profile = [], []
        lowest = tip[:, 0, 1]
        for t in range(n_frame):
            if t:
                state = swept.advance(self.grid, state, tip[:, t], dt)
            lowest = np.minimum(lowest, tip[:, t, 1])
            path.append(
                [
                    tip[:, t, 0] - tip[:, 0, 0],
                    tip[:, t, 1] - self.surface,
                    lean[:, t],
                    lowest - self.surface,
                    state.foremost - tip[:, t, 0],
                    swept.swept_area(self.grid, state),
                    *state.velocity.T,
                    np.hypot(*state.velocity.T),
                ]
            )
            cut = swept.profile_at(self.grid, state, places) - self.surface
            profile.append(cut)
        parts = [np.moveaxis(np.array(path), 2, 0)]
        if name != 'path':
            parts.append(np.stack(profile, axis=1))
        if name == 'bed':
            parts.append(np.broadcast_to(begun[:, None], (len(tip), n_frame, 1)))
        return parts

    def _wheel(self, body):
        centre, turned, radius, width = wheel_pose(body, self.axes)
        dt = self.scene.dt
        travel = centre[..., 0] - centre[:, :1, 0]
        rolled = radius[:, None] * turned
        speed, spin = (np.diff(x, axis=1, prepend=x[:, :1]) / dt for x in (travel, rolled))
        slid = np.cumsum(np.abs(spin - speed), axis=1) * dt
        rows = [travel, rolled, rolled - travel, np.maximum.accumulate(travel, axis=1), slid]
        rows += [speed, spin]
        start = np.broadcast_to(centre[:, H - 1, 1] - self.surface, (1, len(body)))
        size = np.stack([np.log(radius), np.log(width), (start[0] - radius)], axis=1)
        return np.concatenate(
            [np.stack(rows, axis=-1), np.repeat(size[:, None], body.shape[1], axis=1)], axis=-1
        )

    def to_json(self) -> dict:
        """Values of `from_json`."""
        return {
            'frame': dataclasses.asdict(self.axes),
            'surface': self.surface,
            'reach': list(self.reach),
            'places': list(self.places),
            'grid': dataclasses.asdict(self.grid),
        }

    @classmethod
    def from_json(cls, values: dict, scene: Scene) -> 'PathInputs':
        """Rebuilds the reader; raises KeyError, TypeError or ValueError on foreign values."""
        return cls(
            scene,
            Axes(**values['frame']),
            float(values['surface']),
            tuple(map(float, values['reach'])),
            tuple(map(float, values['places'])),
            swept.SweptGrid(**values['grid']),
        )


def _context(context):
    """Context [..., C], as logarithms where it is positive: loads and gravities span decades."""
    positive = context > 0
    return np.where(positive, np.log(np.where(positive, context, 1.0)), context)


@dataclasses.dataclass(frozen=True)
class Regression:
    """One fitted kernel ridge: `y(x) = offset + sum_i dual_i k(x', x'_i)`.

    Attributes:
      inputs: which inputs it sees, a name of `SETS`.
      gamma: width of the kernel on scaled inputs, 1 / (2 length²).
      alpha: ridge.
      shift, scale: [I], x' = (x - shift) / scale.
      samples: [n, I] scaled inputs of training.
      dual: [n, O].
      offset: [O], the mean of training; None where the output is the change since the last given
        frame.
      kernel: a name of `KERNELS`.
    """

    inputs: str
    gamma: float
    alpha: float
    shift: np.ndarray
    scale: np.ndarray
    samples: np.ndarray
    dual: np.ndarray
    offset: np.ndarray | None = None
    kernel: str = 'gaussian'

    @classmethod
    def fit(
        cls, inputs: str, x, y, gamma: float, alphas, kernel: str = 'gaussian'
    ) -> list['Regression']:
        """Fits outputs y [n, O] to inputs x [n, I], once with each ridge and all with one kernel.

        `gamma` is per number of inputs.
        """
        from sklearn.kernel_ridge import KernelRidge  # slow to load, and only fits need it

        shift, scale = _scaling(x)
        parts = (shift, scale, (x - shift) / scale)
        gamma = gamma / x.shape[1]
        gram = gram_matrix(parts[2], parts[2], gamma, kernel)
        return [
            cls(inputs, gamma, alpha, *parts,
                np.asarray(KernelRidge(alpha=alpha, kernel='precomputed').fit(gram, y).dual_coef_),
                kernel=kernel)
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

    def gram(self, x) -> np.ndarray:
        """[..., n] of inputs [..., I] and the samples."""
        flat = ((x - self.shift) / self.scale).reshape(-1, x.shape[-1])
        found = gram_matrix(flat, self.samples, self.gamma, self.kernel)
        return found.reshape(*x.shape[:-1], -1)

    def __call__(self, x) -> np.ndarray:
        """Outputs [..., O] at inputs [..., I]."""
        return self.gram(x) @ self.dual

    def check(self) -> None:
        """Refuses arrays that do not fit each other.

        Raises:
          ValueError: they do not.
        """
        n, inputs = self.samples.shape
        if (
            self.shift.shape != (inputs,)
            or self.scale.shape != (inputs,)
            or self.dual.ndim != 2
            or len(self.dual) != n
            or (self.offset is not None and self.offset.shape != self.dual.shape[1:])
            or not all(
                np.isfinite(v).all() for v in (self.shift, self.scale, self.samples, self.dual)
            )
            or not (self.scale > 0).all()
            or self.kernel not in KERNELS
        ):
            raise ValueError('arrays do not fit each other')


def errors_left_out(x, y, run, gamma: float, alphas, kernel: str = 'gaussian') -> list[np.ndarray]:
    """What the samples of each run are off when the others alone are fitted, for each ridge.

    With G = (K + alpha I)^-1 and c = G y, a fit without the samples g is off by G_gg^-1 c_g on
    them (Rasmussen & Williams 2006, 5.12, has it for one sample), so that one eigendecomposition
    serves all runs and ridges.

    Args:
      x: [n, I] inputs, scaled here as `Regression.fit` does.
      y: [n, O] outputs.
      run: int [n], the run of each sample.
      gamma: width per number of inputs.
      alphas: ridges.
      kernel: a name of `KERNELS`.

    Returns:
      of each ridge [n, O].
    """
    shift, scale = _scaling(x)
    scaled = (x - shift) / scale
    values, vectors = np.linalg.eigh(gram_matrix(scaled, scaled, gamma / x.shape[1], kernel))
    along = vectors.T @ y
    found = []
    for alpha in alphas:
        inverse = 1.0 / (np.maximum(values, 0.0) + alpha)
        dual = vectors @ (inverse[:, None] * along)
        errors = np.empty_like(y)
        for g in np.unique(run):
            own = run == g
            block = (vectors[own] * inverse) @ vectors[own].T
            errors[own] = np.linalg.solve(block, dual[own])
        found.append(errors)
    return found


def _scaling(x):
    """Shift and scale [I] of inputs; what does not vary is not blown up."""
    shift, scale = x.mean(axis=0), x.std(axis=0)
    return shift, np.where(scale > 1e-9 * np.maximum(np.abs(shift), 1.0), scale, 1.0)


def gram_matrix(a, b, gamma: float, kernel: str) -> np.ndarray:
    """k(a_i, b_j) [n_a, n_b] of scaled inputs [n, I]; in place, since these are large."""
    square = a @ b.T
    square *= -2.0
    square += (a**2).sum(axis=1)[:, None]
    square += (b**2).sum(axis=1)
    np.maximum(square, 0.0, out=square)
    return KERNELS[kernel](square, gamma)


def _gaussian(square, gamma):
    square *= -gamma
    return np.exp(square, out=square)


def _matern(square, gamma):
    """Matérn's with smoothness 3/2 (Rasmussen & Williams 2006, 4.17)."""
    square *= 6.0 * gamma
    r = np.sqrt(square, out=square)
    return (1.0 + r) * np.exp(-r)


def _exponential(square, gamma):
    """Matérn's with smoothness 1/2."""
    square *= 2.0 * gamma
    r = np.sqrt(square, out=square)
    r *= -1.0
    return np.exp(r, out=r)


# Name -> function of squared distances, which it may overwrite, and gamma; all of one length. The
# rougher, the sooner a regression goes back to the mean away from its samples.
KERNELS = {'gaussian': _gaussian, 'matern': _matern, 'exponential': _exponential}


class PathRidge:
    """Fitted regressions of one scene.

    Args:
      scene: what exists.
      reader: `PathInputs` of the scene.
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
          kernels: names of `KERNELS`.
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
        reader = PathInputs.of(groups, scene, surface)
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
                each = {f'{name}/{i}/': of_one for i, of_one in enumerate(values)}
                if not each:
                    raise ValueError(f'no regression of {name}')
                regressions[name] = [_loaded(v, arrays, prefix) for prefix, v in each.items()]
            reader = PathInputs.from_json(about['reader'], scene)
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
      reader: `PathInputs` of the scene.
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
