"""Kernel ridge regression on the path of the tool so far: no dynamics, nothing fed back.

Modes, force and (of a driven body) height are functions of numbers that the known motion alone
decides: the pose, its velocity, how deep and how far the tool has been, what it has swept. A method
with a state has to beat this before its dynamics can be said to be learned. It knows the path since
the start and not the soil, so it serves bounded episodes from a known bed only.

Each output has its own width of the kernel, ridge and inputs. The valid runs choose them. Where a
dataset has a dozen runs, each run of train and valid judges what the others give; the mean of the
best few is then less a matter of luck than the best.

The sets of inputs: `path` is pose, velocity, deepest and foremost point so far, swept area (a
blade), or travel, turn, slip, their rates, logarithms of the context and the size (a wheel).
`swept` adds the profile of the deepest cut, from where the tool began. `bed` adds where on the bed
that was, and the profile at places that are the same in all runs, as the particles of the modes are
(a blade; a wheel's height is not known, so nor is its rut).
"""

import dataclasses
import itertools
import json

import numpy as np
import tqdm

from learning_to_simulate import metrics, swept
from learning_to_simulate.axes import Axes, blade_pose, wheel_pose
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.swept import EDGE_RADIUS

SOIL, FORCE, HEIGHT = 'soil', 'force', 'height'  # outputs; the height is that of a driven body
# Widths and ridges that are chosen from; widths per number of inputs.
GAMMAS = (0.01, 0.03, 0.1, 0.3, 1.0)
ALPHAS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# Name of a kernel -> smoothness nu of Matérn's (Rasmussen & Williams 2006, 4.14). The rougher, the
# sooner a regression goes back to the mean away from its samples.
KERNELS = {'gaussian': np.inf, 'matern': 1.5, 'exponential': 0.5}
BEST = 10  # of a dozen runs, regressions of each kernel that are averaged
UNITS = {SOIL: 'm of a score', FORCE: 'N', HEIGHT: 'm'}
# Samples that choose where runs are left out; what is chosen is fitted to all `max_samples`.
_CHOOSING_SAMPLES = 800
# The force itself as a target, beside its change since the last given frame.
_FREE_FORCE = 'free force'
SETS = ('path', 'swept', 'bed')
PROFILE_BINS = 15


def seen_body(body, scene, height=None) -> np.ndarray:
    """Bodies [S, T, R, D] as a method may see them: of a driven one the height is held from the
    last given frame on, or is `height` [S, T - H] (of the mean particle, m)."""
    if scene.rigid_motion != RigidMotion.DRIVEN:
        return body
    centre = body[..., scene.up_axis].mean(axis=2)
    known = centre.copy()
    known[:, H:] = centre[:, H - 1 : H] if height is None else height
    seen = body.copy()
    seen[..., scene.up_axis] += (known - centre)[:, :, None]
    return seen


def held_position(group, scene, height=None) -> np.ndarray:
    """Positions [S, T - H, V, D] of soil that stays still and of the body as it is known; `height`
    as of `seen_body`."""
    position = metrics.stay_still(group.position[:, :H], group.position.shape[1] - H)
    if scene.rigid_motion.is_known:
        body = seen_body(group.position[:, :, : group.n_rigid], scene, height)
        position[:, :, : group.n_rigid] = body[:, H:]
    return position


@dataclasses.dataclass(frozen=True)
class PathInputs:
    """Reads the inputs of a scene's runs."""

    scene: Scene
    axes: Axes  # of the training runs
    surface: float  # height of the resting bed, m
    # Smallest and largest travel of the training runs from their start, over which the profile of
    # `swept` is spread, and place along the way, for `bed`, m.
    reach: tuple[float, float]
    places: tuple[float, float]
    grid: swept.SweptGrid  # bins of the swept profile

    @classmethod
    def of(cls, groups, scene: Scene, surface: float | None = None) -> 'PathInputs':
        """The reader for training groups; arguments as of `PathRidge.fit`."""
        bodies = [g.position[:, :, : g.n_rigid] for g in groups]
        axes = Axes.of_bodies(bodies, scene.up_axis)
        u = [axes.plane(b).mean(axis=2)[..., 0] for b in bodies]
        travel = np.concatenate([(x - x[:, :1]).reshape(-1) for x in u])
        if surface is None:
            surface = np.mean([b[:, 0, :, scene.up_axis].min() for b in bodies])
        reach = (float(travel.min()), float(travel.max()))
        span = max(float(np.ptp(travel)), 10 * EDGE_RADIUS)
        # Runs to come may go farther than those of training did, by half of their span.
        beyond = span / 2 + 0.2
        grid = swept.SweptGrid(
            radius=EDGE_RADIUS, behind=-reach[0] + beyond, ahead=reach[1] + beyond
        )
        places = (min(float(x.min()) for x in u), max(float(x.max()) for x in u))
        return cls(scene, axes, float(surface), reach, places, grid)

    @property
    def sets(self) -> tuple[str, ...]:
        """Names of the sets of inputs that the scene has."""
        return SETS if self.scene.rigid_motion == RigidMotion.PRESCRIBED else SETS[:1]

    def read(self, group, name: str) -> np.ndarray:
        """Inputs [S, T, I] of the runs of a group; ValueError for a path that leaves the bins."""
        body = group.position[:, :, : group.n_rigid]
        if self.scene.rigid_motion == RigidMotion.PRESCRIBED:
            parts = self._blade(body, name)
        else:
            parts = self._wheel(seen_body(body, self.scene))
        if group.context is not None:
            # Loads and gravities span decades: logarithms of what is positive.
            values, positive = group.context_by_frame, group.context_by_frame > 0
            parts.append(np.where(positive, np.log(np.where(positive, values, 1.0)), values))
        return np.concatenate(parts, axis=-1)

    def _blade(self, body, name):
        tip, lean = blade_pose(body, self.axes)
        n_run, n_frame = body.shape[:2]
        state = swept.start(self.grid, tip[:, 0], self.surface)
        begun = tip[:, :1, 0]
        places = begun + np.linspace(*self.reach, PROFILE_BINS)
        if name == 'bed':
            places = np.tile(np.linspace(*self.places, PROFILE_BINS), (n_run, 1))
        path, profile = [], []
        lowest = np.minimum.accumulate(tip[..., 1], axis=1)
        for t in range(n_frame):
            if t:
                state = swept.advance(self.grid, state, tip[:, t], self.scene.dt)
            path.append(
                [
                    tip[:, t, 0] - begun[:, 0],
                    tip[:, t, 1] - self.surface,
                    lean[:, t],
                    lowest[:, t] - self.surface,
                    state.foremost - tip[:, t, 0],
                    swept.swept_area(self.grid, state),
                    *state.velocity.T,
                    np.hypot(*state.velocity.T),
                ]
            )
            profile.append(swept.profile_at(self.grid, state, places) - self.surface)
        parts = [np.moveaxis(np.array(path), 2, 0)]
        if name != 'path':
            parts.append(np.stack(profile, axis=1))
        if name == 'bed':
            parts.append(np.broadcast_to(begun[:, None], (n_run, n_frame, 1)))
        return parts

    def _wheel(self, body):
        centre, turned, radius, width = wheel_pose(body, self.axes)
        travel = centre[..., 0] - centre[:, :1, 0]
        rolled = radius[:, None] * turned
        dt = self.scene.dt
        speed, spin = (np.diff(x, axis=1, prepend=x[:, :1]) / dt for x in (travel, rolled))
        slid = np.cumsum(np.abs(spin - speed), axis=1) * dt
        foremost = np.maximum.accumulate(travel, axis=1)
        rows = [travel, rolled, rolled - travel, foremost, slid, speed, spin]
        height = centre[:, H - 1, 1] - self.surface - radius
        size = np.stack([np.log(radius), np.log(width), height], axis=1)
        return [np.stack(rows, axis=-1), np.repeat(size[:, None], body.shape[1], axis=1)]

    @classmethod
    def from_json(cls, values: dict, scene: Scene) -> 'PathInputs':
        """Of its fields but the scene; KeyError, TypeError or ValueError on foreign values."""
        reach, places = (tuple(map(float, values[name])) for name in ('reach', 'places'))
        axes, grid = Axes(**values['axes']), swept.SweptGrid(**values['grid'])
        return cls(scene, axes, float(values['surface']), reach, places, grid)


@dataclasses.dataclass(frozen=True)
class Regression:
    """A fitted kernel ridge: y(x) = offset + sum_i dual_i k(x', x'_i), x' = (x - shift) / scale;
    ValueError for arrays that do not fit each other."""

    inputs: str  # which inputs it sees, a name of `SETS`
    gamma: float  # width of the kernel on scaled inputs, 1 / (2 length²)
    alpha: float  # ridge
    kernel: str  # a name of `KERNELS`
    shift: np.ndarray  # [I]
    scale: np.ndarray  # [I]
    samples: np.ndarray  # [n, I] scaled inputs of training
    dual: np.ndarray  # [n, O]
    # [O], the mean of training; None where the output is the change since the last given frame.
    offset: np.ndarray | None = None

    def __post_init__(self):
        n, inputs = self.samples.shape
        arrays = (self.shift, self.scale, self.samples, self.dual)
        if (
            not self.shift.shape == self.scale.shape == (inputs,)
            or self.dual.ndim != 2
            or len(self.dual) != n
            or (self.offset is not None and self.offset.shape != self.dual.shape[1:])
            or not all(np.isfinite(v).all() for v in arrays)
            or not (self.scale > 0).all()
            or self.kernel not in KERNELS
        ):
            raise ValueError('arrays do not fit each other')

    @classmethod
    def fit(cls, inputs: str, x, y, gamma: float, alphas, kernel: str) -> list['Regression']:
        """Fits outputs y [n, O] to inputs x [n, I], once with each ridge; `gamma` is per number of
        inputs."""
        from sklearn.kernel_ridge import KernelRidge  # slow to load, and only fits need it

        shift, scale = _scaling(x)
        samples, gamma = (x - shift) / scale, gamma / x.shape[1]
        gram = gram_matrix(samples, samples, gamma, kernel)
        ridges = [KernelRidge(alpha=alpha, kernel='precomputed').fit(gram, y) for alpha in alphas]
        return [
            cls(inputs, gamma, alpha, kernel, shift, scale, samples, np.asarray(ridge.dual_coef_))
            for alpha, ridge in zip(alphas, ridges, strict=True)
        ]

    def columns(self, which: slice, offset) -> 'Regression':
        """The regression of some of the outputs; they share all but the dual coefficients."""
        dual = np.ascontiguousarray(self.dual[:, which])
        return dataclasses.replace(self, dual=dual, offset=offset)

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


def _scaling(x):
    """Shift and scale [I] of inputs; what does not vary is not blown up."""
    shift, scale = x.mean(axis=0), x.std(axis=0)
    return shift, np.where(scale > 1e-9 * np.maximum(np.abs(shift), 1.0), scale, 1.0)


def gram_matrix(a, b, gamma: float, kernel: str) -> np.ndarray:
    """k(a_i, b_j) [n_a, n_b] of scaled inputs [n, I]."""
    from sklearn.gaussian_process.kernels import Matern

    return Matern(1.0 / np.sqrt(2.0 * gamma), nu=KERNELS[kernel])(a, b)


class PathRidge:
    """Fitted regressions of one scene: output ('soil', 'force', 'height') -> list of `Regression`,
    whose mean it is; `choices` say what was tried, for the record."""

    def __init__(self, scene: Scene, reader, regressions: dict, choices=()):
        self.scene, self.reader, self.regressions = scene, reader, regressions
        self.choices = list(choices)

    @classmethod
    def fit(
        cls, train, valid, scene, surface=None, max_samples=3000, few_runs=False
    ) -> 'PathRidge':
        """Fits all outputs, and chooses inputs, width and ridge by the error on the valid runs.

        Args:
          train, valid: lists of `RunGroup`.
          scene: of the dataset.
          surface: height of the resting bed, m; None takes where the tools begin.
          max_samples: frames of training that are taken, evenly spread; the time of a fit grows
            with their cube.
          few_runs: train on the valid runs, too, and choose by the error on each run of a fit to
            all others (errors on valid are then errors of training); the mean of the `BEST` choices
            of each kernel predicts.

        Raises:
          ValueError: no runs, or a body whose motion is not known (the path is all there is).
        """
        if not scene.rigid_motion.is_known:
            raise ValueError(
                f'path_ridge needs a body whose motion is given; it is {scene.rigid_motion}'
            )
        if not train or not valid:
            raise ValueError('path_ridge needs train runs to fit and valid runs to choose by')
        groups = [*train, *valid] if few_runs else train
        reader = PathInputs.of(groups, scene, surface)
        samples = _Samples(groups, reader, max_samples)
        kernels = tuple(KERNELS) if few_runs else ('gaussian',)
        grid = list(itertools.product(kernels, reader.sets, GAMMAS))
        grid = tqdm.tqdm(grid, unit='choice', desc='path ridge', disable=None)
        if few_runs:
            few = _Samples(groups, reader, min(max_samples, _CHOOSING_SAMPLES))
            choices = list(_left_out(few, grid))
        else:
            choices = list(_on_valid(samples, valid, reader, grid))
        regressions: dict = {}
        choices_of = {}
        for choice in choices:
            choices_of.setdefault((choice['output'], choice['kernel']), []).append(choice)
        for (name, _), tried in choices_of.items():
            best = sorted(tried, key=lambda choice: choice['error'])[: BEST if few_runs else 1]
            regressions.setdefault(name, []).extend(map(samples.fitted, best))
        return cls(scene, reader, regressions, choices)

    def predict(self, group) -> tuple[np.ndarray, np.ndarray | None]:
        """Frames H .. T - 1 of S runs: positions float64 [S, T - H, V, D], m, where what is not
        predicted stays still, and forces float64 [S, T - H, D], N, or None."""
        seen: dict = {}
        predicted = {}
        for name, regressions in self.regressions.items():
            each = []
            for one in regressions:
                if one.inputs not in seen:
                    seen[one.inputs] = self.reader.read(group, one.inputs)
                values = one.since_start(one(seen[one.inputs][:, H - 1 :]))
                if name == FORCE and one.offset is None:
                    values += group.force[:, H - 1 : H]
                each.append(values)
            predicted[name] = np.mean(each, axis=0)
        n_rigid, height = group.n_rigid, None
        if HEIGHT in predicted:
            start = group.position[:, H - 1, :n_rigid, self.scene.up_axis].mean(axis=1)
            height = start[:, None] + predicted[HEIGHT][..., 0]
        position = held_position(group, self.scene, height)
        soil = position[:, :, n_rigid:]
        soil += predicted[SOIL].reshape(soil.shape)
        return position, predicted.get(FORCE)

    def least_errors(self) -> dict[str, float]:
        """Output -> error of its best choice: mean over the judging runs of the RMS, m or N."""
        found: dict[str, float] = {}
        for choice in self.choices:
            name = choice['output']
            found[name] = min(found.get(name, choice['error']), choice['error'])
        return found

    def parts(self) -> tuple[dict, dict]:
        """Values for JSON, and arrays; `of_parts` is the inverse."""
        arrays, outputs = {}, {}
        for name, regressions in self.regressions.items():
            outputs[name] = [
                {key: getattr(r, key) for key in ('inputs', 'gamma', 'alpha', 'kernel')}
                for r in regressions
            ]
            for i, regression in enumerate(regressions):
                for part in ('shift', 'scale', 'samples', 'dual', 'offset'):
                    if (values := getattr(regression, part)) is not None:
                        arrays[f'{name}/{i}/{part}'] = values
        # JSON as text: what was tried is thousands of lines otherwise.
        reader = dataclasses.asdict(dataclasses.replace(self.reader, scene=None))
        about = {'reader': reader, 'outputs': outputs}
        return about | {'choices': json.dumps(self.choices)}, arrays

    @classmethod
    def of_parts(cls, values: dict, arrays: dict, scene: Scene) -> 'PathRidge':
        """Rebuilds a method; raises KeyError, TypeError or ValueError on foreign values."""
        regressions = {}
        for name, each in values['outputs'].items():
            if not each:
                raise ValueError(f'no regression of {name}')
            regressions[name] = []
            for i, about in enumerate(each):
                prefix = f'{name}/{i}/'
                own = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
                arrays_of = {k: v.astype(np.float64) for k, v in own.items()}
                regressions[name].append(Regression(**about, **arrays_of))
        reader = PathInputs.from_json(values['reader'], scene)
        return cls(scene, reader, regressions, json.loads(values['choices']))


def _targets(group, scene) -> dict[str, np.ndarray]:
    """Target -> [S, T, O]: changes since the last given frame, and the force as it is.

    Which of both forms of the force is better depends on the scene: a wheel's force at the start
    says much of its load, a blade's begins from nothing.
    """
    body, modes = np.split(group.position, [group.n_rigid], axis=2)
    values = {SOIL: modes.reshape(*modes.shape[:2], -1)}
    if scene.has_force:
        values[FORCE] = group.force
    if scene.rigid_motion == RigidMotion.DRIVEN:
        values[HEIGHT] = body[..., scene.up_axis].mean(axis=2)[..., None]
    targets = {name: v - v[:, H - 1 : H] for name, v in values.items()}
    return targets | ({_FREE_FORCE: group.force} if scene.has_force else {})


class _Samples:
    """Frames of runs that regressions are fitted to, with all targets side by side: y [n, O], less
    their offsets ([O'] or None, see `Regression`), in `columns` by target, and the run of each
    sample, int [n].

    Every `stride`-th frame from the last given one on, of about `max_samples` in all; successive
    runs begin one frame later, so that together they cover all frames.
    """

    def __init__(self, groups, reader, max_samples):
        self._groups, self._reader = groups, reader
        self._inputs: dict[str, np.ndarray] = {}
        count = sum(g.position[:, H:, 0, 0].size for g in groups)
        self._stride = max(1, -(-count // max_samples))
        targets = [_targets(g, reader.scene) for g in groups]
        y = {name: self._taken([t[name] for t in targets]) for name in targets[0]}
        # Only a force has a mean to begin from; what has changed since the start begins from 0.
        self.offsets = {n: v.mean(axis=0) if n == _FREE_FORCE else None for n, v in y.items()}
        ends = np.cumsum([0, *(values.shape[1] for values in y.values())])
        self.columns = {n: slice(*ends[i : i + 2]) for i, n in enumerate(y)}
        self.y = np.concatenate(
            [v if self.offsets[n] is None else v - self.offsets[n] for n, v in y.items()], axis=1
        )
        number = itertools.count()
        self.run = self._taken(
            [[np.full(len(run), next(number)) for run in g.position] for g in groups]
        )

    def _taken(self, groups):
        runs = (run for values in groups for run in values)
        return np.concatenate(
            [r[H - 1 + i % self._stride :: self._stride] for i, r in enumerate(runs)]
        )

    def inputs(self, name: str) -> np.ndarray:
        if name not in self._inputs:
            self._inputs[name] = self._taken([self._reader.read(g, name) for g in self._groups])
        return self._inputs[name]

    def fitted(self, choice: dict) -> Regression:
        inputs, target = choice['inputs'], choice['target']
        (whole,) = Regression.fit(
            inputs, self.inputs(inputs), self.y, choice['gamma'], [choice['alpha']],
            choice['kernel'],
        )  # fmt: skip
        return whole.columns(self.columns[target], self.offsets[target])


def _on_valid(samples, valid, reader, grid):
    truth = [{n: v[:, H:] for n, v in _targets(g, reader.scene).items()} for g in valid]
    seen = {name: [reader.read(g, name)[:, H - 1 :] for g in valid] for name in reader.sets}
    for kernel, inputs, gamma in grid:
        wholes = Regression.fit(inputs, samples.inputs(inputs), samples.y, gamma, ALPHAS, kernel)
        grams = [wholes[0].gram(x) for x in seen[inputs]]
        for whole in wholes:
            values = [gram @ whole.dual for gram in grams]
            for target, which in samples.columns.items():
                of_target = whole.columns(which, samples.offsets[target])
                errors = [
                    ((of_target.since_start(v[..., which]) - t[target]) ** 2).mean(axis=(1, 2))
                    for v, t in zip(values, truth, strict=True)
                ]
                yield _choice(target, kernel, inputs, gamma, whole.alpha, np.concatenate(errors))


def _left_out(samples, grid):
    """Every choice with its error on each run of a fit to all others."""
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

    for kernel, inputs, gamma in grid:
        x = samples.inputs(inputs)
        shift, scale = _scaling(x)
        scaled = (x - shift) / scale
        gram = gram_matrix(scaled, scaled, gamma / x.shape[1], kernel)
        for alpha in ALPHAS:
            ridge = KernelRidge(alpha=alpha, kernel='precomputed')
            predicted = cross_val_predict(
                ridge, gram, samples.y, groups=samples.run, cv=LeaveOneGroupOut()
            )
            for target, which in samples.columns.items():
                square = ((predicted - samples.y)[:, which] ** 2).mean(axis=1)
                runs = [square[samples.run == run].mean() for run in np.unique(samples.run)]
                yield _choice(target, kernel, inputs, gamma, alpha, np.array(runs))


def _choice(target, kernel, inputs, gamma, alpha, square):
    """A choice by the mean over runs of the RMS error, from mean squares of the runs.

    Not relative to the force: that of runs which hardly touch the soil would decide.
    """
    output = FORCE if target == _FREE_FORCE else target
    return {'output': output, 'target': target, 'kernel': kernel, 'inputs': inputs, 'gamma': gamma,
            'alpha': alpha, 'error': float(np.sqrt(square).mean())}  # fmt: skip
