"""Where a run may begin: the starts of a model folder, and what a user says of a start.

Beside the weights lie, so that the model runs without its dataset:

  start.npz      the body's particles in its own frame, which of them are nodes, and beds at rest
  subspace.npz   the dataset's, of the modes that the model predicts

Beds, and bodies where their size differs by case, are those of the first frames of the records; of
records that start alike one is kept. The digests of both files are in `config.json`.
"""

import dataclasses
import json
import os
from typing import Any

import numpy as np

from learning_to_simulate import checkpoints, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.live import poses
from pca_tools import dataset, files, rigid_fit
from pca_tools.metadata import SPLITS
from pca_tools.subspace import Subspace

START_FILE, SUBSPACE_FILE = checkpoints.START_FILE, checkpoints.SUBSPACE_FILE
# Two records start alike where no coordinate differs by more than this, m: float32 scores of
# several metres round to 5e-7.
SAME_START_M = 1e-5


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Starts:
    """K ways to begin; those of a model folder cannot be written to.

    Attributes:
      cases: per start, the parameters that the dataset states of its case ({} if it states none).
      body: float64 [K][R', D], all particles of the body in its own frame, m.
      kept: int [K][R], which of them are nodes.
      pose: float64 [K, 7], where the body is in the record's first frame.
      modes: float64 [K, r', D], all modes of the dataset, m; the bed at rest.
      context: float64 [K, C] of the first frame, or None.
      force_limit: N, the largest force of the training runs; None where there is no force.
    """

    cases: tuple[dict, ...]
    body: tuple[np.ndarray, ...]
    kept: tuple[np.ndarray, ...]
    pose: np.ndarray
    modes: np.ndarray
    context: np.ndarray | None
    force_limit: float | None

    def __len__(self) -> int:
        return len(self.cases)

    def index(self, case: int | str | None) -> int:
        """The start of a case of the dataset, by number or name; for None, the first on a bed that
        no run before has disturbed. ValueError for an unknown case."""
        if case is None:
            calm = (i for i, values in enumerate(self.cases) if values.get('kind') != 'disturbed')
            return next(calm, 0)
        names = [str(values.get('case')) for values in self.cases]
        if str(case) not in names:
            raise ValueError(f'no start of case {case!r}; there are {", ".join(names)}')
        return names.index(str(case))


def collect(data_path: str, nodes: dict) -> Starts:
    """The different starts of a dataset's records; raises as `reading_utils.read_groups`. `nodes`
    are of `TrainConfig`, but for the modes: starts hold all of them."""
    metadata = dataset.read_metadata(data_path)
    by_split = {
        split: reading_utils.read_groups(data_path, split, metadata, **nodes | {'modes': 0})
        for split in SPLITS
        if os.path.exists(dataset.split_path(data_path, split))
    }
    return of_groups(data_path, by_split)


def of_groups(data_path: str, by_split: dict[str, list]) -> Starts:
    """The different starts of a dataset's runs: split -> `RunGroup`s; the modes are their soil."""
    metadata = dataset.read_metadata(data_path)
    found: list[tuple] = []
    force_limit = None
    for split, groups in by_split.items():
        cases = metadata.get('cases', {}).get(split, [])
        stated = [r.rigid_pose for r in dataset.read_split(data_path, split)]
        if split == 'train':
            force_limit = largest_force(groups)
        for group in groups:
            for run, record in enumerate(group.record):
                case = _parameters(cases[record]) if record < len(cases) else {}
                pose = stated[record]
                _add(found, case, group, run, None if pose is None else pose[0].astype(float))
    cases, bodies, kept, first, modes, contexts = zip(*found)
    context = None if contexts[0] is None else np.stack(contexts)
    return Starts(cases, bodies, kept, np.stack(first), np.stack(modes), context, force_limit)


def largest_force(groups) -> float | None:
    """N, of the runs of a list of `RunGroup`; None where there is no force."""
    forces = [g.force for g in groups if g.force is not None]
    return max((float(np.linalg.norm(f, axis=-1).max()) for f in forces), default=None)


def _parameters(case):
    """The numbers that tell a case from others, without how it was computed."""
    return {
        k: v
        for k, v in case.items()
        if isinstance(v, (int, float, str)) and not k.startswith(('solver', 'time_step', 'seed'))
    }


def _add(found, case, group, run, pose):
    """Adds the start of a run unless one like it is there.

    Where the records state no pose, the body's frame is that of the first one: its centroid, and
    its orientation in the first frame.
    """
    n = group.n_rigid
    points = group.position[run, 0, :n] if group.body is None else group.body[run][0]
    kept = np.arange(n) if group.kept is None else group.kept[run]
    if pose is None:
        centre = points.mean(axis=0) if len(points) else np.zeros(3)
        pose = np.concatenate([centre, [1.0, 0.0, 0.0, 0.0]])
    body = (points - pose[:3]) @ poses.rotation_matrix(pose[3:])  # R^T (x - p), row by row
    modes = group.position[run, 0, n:]
    context = group.context_at(0, run)
    for _, other, other_kept, _, other_modes, other_context in found:
        if (
            other.shape == body.shape
            and np.array_equal(kept, other_kept)
            and np.abs(modes - other_modes).max() <= SAME_START_M
            and (context is None or np.array_equal(context, other_context))
            and (
                len(body) < rigid_fit.MIN_POINTS
                or rigid_fit.fit_rigid_motion(other, body).residual <= SAME_START_M
            )
        ):
            return
    found.append((case, body, kept, pose, modes, context))


def write(model_path: str, data_path: str, nodes: dict) -> dict[str, str]:
    """Writes the files of this module into a model folder; returns their sha256 by name. A dataset
    folder without a subspace gives none; `nodes` are of the model's `TrainConfig`."""
    source, space = os.path.join(data_path, SUBSPACE_FILE), None
    if os.path.exists(source):
        space = Subspace.load(source)
        space = space.truncated(nodes['modes'] or space.n_modes)
    return write_parts(model_path, collect(data_path, nodes), space)


def write_parts(model_path: str, starts: Starts, space: Subspace | None = None) -> dict[str, str]:
    """As `write`, of what is there."""
    flat = {'modes': starts.modes, 'pose': starts.pose}
    for name in ('body', 'kept'):
        parts = getattr(starts, name)
        flat[name] = np.concatenate(parts)
        flat[f'{name}_counts'] = np.array([len(p) for p in parts])
    if starts.context is not None:
        flat['context'] = starts.context
    if starts.force_limit is not None:
        flat['force_limit'] = np.array(starts.force_limit)
    flat['cases'] = np.array([json.dumps(case) for case in starts.cases])
    files.write_npz(os.path.join(model_path, START_FILE), **flat)
    written = [START_FILE]
    if space is not None:
        space.save(os.path.join(model_path, SUBSPACE_FILE))
        written.append(SUBSPACE_FILE)
    return {n: files.sha256_of_file(os.path.join(model_path, n)) for n in written}


def read(model_path: str) -> tuple[Starts, Subspace | None]:
    """The starts and the subspace of a self-contained model folder. FileNotFoundError: it holds no
    starts. ValueError: a file is damaged or is not the one of this model."""
    starts, space = (_checked(model_path, name) for name in (START_FILE, SUBSPACE_FILE))
    if starts is None:
        raise FileNotFoundError(
            f'{model_path}: holds no {START_FILE}, which comes with a training; train it again'
        )
    return _parse(starts), None if space is None else Subspace.load(space)


def read_force_limit(model_path: str) -> float | None:
    """The largest force of the training runs of a model folder, N; None where there is no force, or
    no file of starts. ValueError: that is damaged or is not the one of this model."""
    starts = _checked(model_path, START_FILE)
    return None if starts is None else _parse(starts).force_limit


def _checked(model_path, name):
    """The path of a file that came with a model, or None; ValueError for another file."""
    stored = checkpoints.read_config(model_path).get('files')
    if not isinstance(stored, dict) or name not in stored:
        return None
    path = os.path.join(model_path, name)
    if files.sha256_of_file(path) != stored[name]:
        raise ValueError(f'{path}: is not the file of this model (sha256 differs)')
    return path


def _parse(path):
    arrays = files.read_npz(path)
    for values in arrays.values():  # a stepper shares them with whoever looks at them
        values.setflags(write=False)
    try:
        parts = {
            name: tuple(np.split(arrays[name], np.cumsum(arrays[f'{name}_counts'])[:-1]))
            for name in ('body', 'kept')
        }
        starts = Starts(
            cases=tuple(json.loads(str(text)) for text in arrays['cases']),
            **parts,
            pose=arrays['pose'],
            modes=arrays['modes'],
            context=arrays.get('context'),
            force_limit=float(arrays['force_limit']) if 'force_limit' in arrays else None,
        )
        lengths = {len(x) for x in (starts.body, starts.kept, starts.pose, starts.modes)}
        finite = all(np.isfinite(x).all() for x in (arrays['body'], starts.pose, starts.modes))
        pairs = zip(starts.kept, starts.body)
        indices = all(np.all((kept >= 0) & (kept < len(body))) for kept, body in pairs)
        if lengths != {len(starts)} or starts.pose.shape[1:] != (7,) or not (finite and indices):
            raise ValueError('shapes or values do not fit')
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f'{path}: is not the start of a model ({error})') from error
    return starts


def read_context(scene, context) -> np.ndarray:
    """float64 [C] of a context [C] or {name: value}; ValueError for a scene without one, other
    names, no numbers."""
    names = scene.context_names
    if not names:
        raise ValueError(f'the scene {scene.name} takes no context')
    if isinstance(context, dict):
        if set(context) != set(names):
            raise ValueError(f'context names {sorted(context)}, must name {list(names)}')
        context = [context[name] for name in names]
    return poses.numbers('context', context, (len(names),))


class Start:
    """Checked input of a start: what a user gives to `Stepper.start`, and the rest from that of a
    case. ValueError for no such case, not a pose, a velocity or a context.

    Attributes:
      body, kept: particles of the body in its own frame, and which are nodes.
      pose: float64 [7].
      velocity: float64 [6], m/s and rad/s.
      context: float64 [C] or None.
    """

    def __init__(self, scene, starts: Starts, pose=None, velocity=None, case=None, context=None):
        self._scene, self._starts = scene, starts
        contexts: Any = starts.context  # there is one for every start, or the scene names none
        self._index = starts.index(case)
        if context is not None:
            context = read_context(scene, context)
            if case is None:  # the bed of the most similar case
                spread = contexts.std(axis=0)
                far = (contexts - context) / np.where(spread > 0, spread, 1.0)
                self._index = int((far**2).sum(axis=1).argmin())
        elif scene.context_names:
            context = contexts[self._index]
        self.context = context
        self.body, self.kept = starts.body[self._index], starts.kept[self._index]
        self.pose = starts.pose[self._index] if pose is None else self.read(pose)
        self.velocity = poses.read_velocity(velocity)

    def read(self, pose) -> np.ndarray:
        """float64 [7]: see `poses.read_pose`."""
        up = self._scene.up_axis
        return poses.read_pose(pose, up, self._starts.pose[self._index, 2 if up != 2 else 1])

    def nodes(self, pose) -> np.ndarray:
        """float64 [R, 3], m, at a pose."""
        return poses.placed(self.body[self.kept], pose)

    def past(self) -> np.ndarray:
        """float64 [H, 7]: the poses of a body on its way at constant velocity, newest last."""
        seconds = self._scene.dt * np.arange(H - 1, -1, -1)
        return np.stack([poses.moved_back(self.pose, self.velocity, t) for t in seconds])

    def history(self) -> np.ndarray:
        """float64 [H, V, 3], m: the bed at rest, the body on its way."""
        modes = self._starts.modes[self._index][: self._scene.n_modes]
        return np.stack([np.concatenate([self.nodes(pose), modes]) for pose in self.past()])


class RecordedStart:
    """A start from recorded frames, whose body is given by its particles, not by a pose: history
    [H, V, D], m, R rigid particles, then r modes, newest last; context [C], where the scene has
    one. ValueError for wrong shapes or kinds of values, or values that are not finite in
    float32."""

    velocity = None

    def __init__(self, scene, n_rigid: int, history, context=None):
        self._n = n_rigid
        shape = (H, n_rigid + scene.n_modes, None)
        self._history = poses.numbers('history', history, shape)
        self._history.setflags(write=False)
        names = scene.context_names
        if (context is None) == bool(names):
            raise ValueError(f'the scene takes context {list(names)}, got {context}')
        self.context = None if context is None else read_context(scene, context)
        self.kept = np.arange(n_rigid)
        self.pose = None

    def read(self, body) -> np.ndarray:
        """float64 [R, D] of the particles of a body."""
        return poses.numbers('rigid_pose', body, (self._n, self._history.shape[2]))

    def nodes(self, body) -> np.ndarray:
        return body

    def history(self) -> np.ndarray:
        return self._history
