"""One rollout, with its truth where there is one, ready to be drawn.

Reads the `rollout_{split}_{i}.npz` of `train --mode=eval_rollout` (DeepMind's key names). The truth
of the soil is that of `soil_truth`: the solver's own particles where the dataset holds a sample of
them. A prediction has the same particles: its own, where the method has no modes, else decoded.
"""

import dataclasses
import functools
import json
import os
import re
from typing import Any

import numpy as np

from learning_to_simulate import metrics, soil_truth
from learning_to_simulate.scene import Scene
from pca_tools import dataset, files
from pca_tools.metadata import metadata_problems

DIM = 3
TRUTH, PREDICTION = 'truth', 'prediction'
# What pictures call the truth and the trivial predictors.
TRUE_NAME, STILL, CONSTANT = 'solver', 'persistence', 'constant velocity'
# What they call the parts of the force.
FORCE_NAMES = 'against the way', 'up'
# Views: indices of the horizontal and the vertical axis.
PLANES = {'xy': (0, 1), 'xz': (0, 2), 'zy': (2, 1), 'yz': (1, 2), 'yx': (1, 0), 'zx': (2, 0)}
_FILE_NAME = re.compile(r'rollout_(?P<split>[a-z]+)_(?P<record>\d+)\.npz')
# A rigid error below this is round-off of a motion that was given.
_GIVEN_MOTION_MM = 1e-3
_TEXTS = ('metadata', 'scene', 'status', 'status_reason', 'model_digest', 'split')
_POSITIONS = {PREDICTION: 'predicted_rollout', TRUTH: 'ground_truth_rollout'}
_FORCES = {PREDICTION: 'predicted_forces', TRUTH: 'ground_truth_forces'}


@dataclasses.dataclass(frozen=True)
class RolloutFrames:
    """A run of T frames (H given, T - H predicted), as it is drawn.

    Attributes:
        name: file name without its ending.
        title: what the picture shows, a sentence.
        label: name of the model that predicted, or ''.
        frames: int [F], the frames in which there is soil to see; all frames where there is none.
        soil: {truth, prediction} -> [F, P, 3] particles, m; of a path that nobody recorded, the
            prediction alone, as in the next two; {} where there is no subspace.
        start: [P, 3] the particles in the first frame, m; None where there are none.
        rigid: {truth, prediction} -> float64 [T, R, 3], m.
        force: {truth, prediction} -> float64 [T, 3], N, or None.
        rigid_type: particle type of the rigid points.
        first_predicted: H, index of the first predicted frame.
        dt: seconds per frame.
        notes: what the reader of a picture should know, one sentence each.
        up_axis: axis against gravity, 0, 1 or 2.
        is_driven: whether the body is driven under a load, as a wheel is.
        soil_mm: error of the soil over all frames, mm; None without a truth.
        soil_rms_mm: name -> [F] its root mean square by frame, mm: prediction, persistence and
            constant velocity; {} without a truth.
        space: what the error is taken over, in words.
    """

    name: str
    title: str
    label: str
    frames: np.ndarray
    soil: dict[str, np.ndarray]
    start: np.ndarray | None
    rigid: dict[str, np.ndarray]
    force: dict[str, np.ndarray] | None
    rigid_type: int
    first_predicted: int
    dt: float
    notes: tuple[str, ...] = ()
    up_axis: int = 1
    is_driven: bool = False
    soil_mm: float | None = None
    soil_rms_mm: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    space: str = ''

    @property
    def side_view(self) -> str:
        """Key of `PLANES`: the view from the side, upward axis up, along the way of the body."""
        along, up, _ = self.axes
        return 'xyz'[along] + 'xyz'[up]

    @functools.cached_property
    def axes(self) -> tuple[int, int, int]:
        """Along the body's way, up, and across."""
        return metrics.travel_axes(self.rigid[self.reference], self.up_axis)

    @property
    def heading(self) -> float:
        """1 or -1, along the first of `axes`: to where the body is farthest from its start."""
        body = self.rigid[self.reference]
        if not body.shape[1]:
            return -1.0
        moved = (body - body[0]).mean(axis=1)[:, self.axes[0]]
        return 1.0 if moved[np.abs(moved).argmax()] > 0 else -1.0

    @property
    def n_frames(self) -> int:
        return len(self.rigid[PREDICTION])

    @property
    def shown(self) -> tuple[str, ...]:
        """What there is to see: truth and prediction, or the prediction alone."""
        return tuple(which for which in (TRUTH, PREDICTION) if which in self.rigid)

    @property
    def reference(self) -> str:
        """What limits, scales and bodies are taken from: the truth where there is one."""
        return self.shown[0]

    @property
    def has_truth(self) -> bool:
        """Whether the run was recorded."""
        return TRUTH in self.rigid

    @property
    def model(self) -> str:
        return self.label or PREDICTION

    @functools.cached_property
    def time(self) -> np.ndarray:
        return self.dt * np.arange(self.n_frames)

    def soil_velocity(self, which: str, i: int) -> np.ndarray:
        """[P, 3] m/s over the interval that ends at the i-th shown frame (first one: zero)."""
        last = max(i - 1, 0)
        seconds = self.dt * max(self.frames[i] - self.frames[last], 1)
        return (self.soil[which][i] - self.soil[which][last]) / seconds

    def soil_error(self, i: int) -> np.ndarray:
        """[P, 3] prediction minus truth in the i-th shown frame, m."""
        return self.soil[PREDICTION][i] - self.soil[TRUTH][i]

    @functools.cached_property
    def rigid_rms_mm(self) -> np.ndarray:
        """[T] RMS error of the rigid points per coordinate, mm; zero where they are given."""
        n_rigid = self.rigid[PREDICTION].shape[1]
        if not n_rigid or not self.has_truth:
            return np.zeros(self.n_frames)
        prediction, truth = (self.rigid[which][:, None] for which in (PREDICTION, TRUTH))
        return metrics.rms_mm(metrics.rigid_mse(prediction, truth, n_rigid))

    @property
    def body_is_predicted(self) -> bool:
        """Whether the body's motion is predicted, at least in part."""
        return bool(self.rigid_rms_mm.max() > _GIVEN_MOTION_MM)

    def load_errors(self, last: int | None = None) -> dict[str, float]:
        """Errors of the force, as `metrics.load_errors`, from the first predicted frame to `last`;
        {} without a force or a truth."""
        if self.force is None or not self.has_truth:
            return {}
        so_far = slice(self.first_predicted, None if last is None else last + 1)
        force, truth = (self.force[which][None, so_far] for which in (PREDICTION, TRUTH))
        found = metrics.load_errors(force, truth, self.axes)
        return {name: float(value[0]) for name, value in found.items()}


def load(rollout_path: str, data_path: str | None, label: str = '') -> RolloutFrames:
    """Reads a rollout file `rollout_{split}_{i}.npz` and, from the dataset folder, what its soil
    did; cut before the first frame that is not finite. Without a folder, or without `subspace.npz`
    in it, there is no soil. The label is the name of the model, for titles.

    FileNotFoundError: a file or the folder is missing. ValueError: not an `.npz`, missing keys,
    shapes that do not fit, NaN in the truth, nothing finite predicted, or a subspace other than the
    rollout's.
    """
    if rollout_path.endswith(('.pkl', '.pickle')):
        raise ValueError(f'{rollout_path}: is a pickle, which is never read; give the .npz of it')
    arrays = files.read_npz(rollout_path)
    for name, array in arrays.items():
        if name not in _TEXTS and array.dtype.kind not in 'fiu':
            raise ValueError(f'{rollout_path}: {name} holds {array.dtype}, no real numbers')
    metadata = _metadata(rollout_path, arrays)
    nodes, force = _nodes(rollout_path, arrays)
    start = len(arrays['initial_positions'])
    n_rigid, has_modes = _split_nodes(rollout_path, arrays, metadata)
    finite = np.isfinite(nodes[PREDICTION]).all(axis=(1, 2))
    if force is not None:
        finite &= np.isfinite(force[PREDICTION]).all(axis=1)
    notes, length = [], len(finite) if finite.all() else int(np.argmin(finite))
    if length <= start:
        raise ValueError(f'{rollout_path}: no predicted frame is finite, there is nothing to draw')
    if length < len(finite):
        notes.append(f'The prediction is not finite from frame {length} on; drawn up to there.')
    split, record = _place(rollout_path, arrays)
    reader = _reader(data_path, metadata)
    has_soil = not has_modes or reader.subspace is not None
    if not has_soil:
        notes.append('Without subspace.npz there are no particles to draw.')
        if not n_rigid:
            raise ValueError(
                f'{rollout_path}: has modes only, and {data_path} no subspace.npz to rebuild the '
                'soil with: there is nothing to draw'
            )
    scores = {which: values[:, n_rigid:] for which, values in nodes.items()}
    recorded = scores.get(TRUTH, scores[PREDICTION])
    if has_modes:
        found = reader.read(split, record, recorded, metadata.get('n_soil'))
    else:
        found = soil_truth.of_nodes(recorded, recorded.shape[1], space=soil_truth.PARTICLES)
    own = arrays if has_soil and TRUTH in nodes else {}
    predicted = found.of_rollout(scores[PREDICTION][start:length], own)
    frames = found.frames[found.frames < length]
    soil = {TRUTH: found.particles[: len(frames)], PREDICTION: predicted[: len(frames)]}
    scene = metadata.get('scene', {})
    return RolloutFrames(
        name=os.path.splitext(os.path.basename(rollout_path))[0],
        title=_title(metadata, split, record),
        label=label,
        frames=frames,
        soil={which: soil[which] for which in nodes} if has_soil else {},
        start=found.start if has_soil else None,
        rigid={which: values[:length, :n_rigid] for which, values in nodes.items()},
        force=None if force is None else {which: f[:length] for which, f in force.items()},
        rigid_type=int(arrays['particle_types'][0]),
        first_predicted=start,
        dt=float(metadata['dt']),
        notes=tuple(notes),
        up_axis=scene.get('up_axis', 1),
        is_driven=scene.get('rigid_motion') == 'driven',
        **(errors(found, soil[PREDICTION], scores[TRUTH], start) if TRUTH in nodes else {}),
    )


def errors(found: soil_truth.SoilTruth, predicted, scores, start: int) -> dict[str, Any]:
    """The errors of `RolloutFrames`, of predicted particles [F, P, 3] and recorded scores [T, r, 3]
    (or particles of a record without modes); `start` is H."""
    given, n_frame = scores[None, :start], len(scores) - start
    curves = {PREDICTION: predicted}
    for name, guess in ((STILL, metrics.stay_still), (CONSTANT, metrics.constant_velocity)):
        curves[name] = found.of_modes(guess(given, n_frame)[0])[: len(predicted)]
    return {
        'soil_mm': found.soil_mm(predicted),
        'soil_rms_mm': {k: metrics.rms_mm(found.mean_square(x)) for k, x in curves.items()},
        'space': found.space,
    }


def of_rollout(rollout, step_stride: int = 1) -> RolloutFrames:
    """A `paths.SoilRollout` ready to be drawn. Of a path there is no truth, and particles are
    computed in every step_stride-th frame."""
    start, scene, truth = len(rollout.history), rollout.scene, rollout.soil_truth
    frames = np.arange(start, len(rollout.body), step_stride)
    true_modes, true_body, true_force = rollout.truth or (None, None, None)
    rigid, soil, force, first, found = {PREDICTION: rollout.body}, {}, None, None, {}
    if rollout.force is not None:
        given = np.zeros((start, DIM)) if true_force is None else true_force[:start]
        force = {PREDICTION: np.concatenate([given, rollout.force])}
    kind, title = 'wheel' if str(scene.rigid_motion) == 'driven' else 'tool', 'a given path'
    if rollout.truth:
        title = f'recorded run {rollout.name.removeprefix("rollout_")}'
        rigid[TRUTH], predicted = true_body, rollout.sampled
        if force is not None:
            force[TRUTH] = true_force
        frames, first = truth.frames[: len(predicted)], truth.start
        found = errors(truth, predicted, true_modes, start)
        if truth.components is not None or truth.count == truth.particles.shape[1]:
            soil = {TRUTH: truth.particles[: len(predicted)], PREDICTION: predicted}
    elif rollout.has_particles:
        soil = {PREDICTION: np.stack([rollout.particles(int(f) - start) for f in frames])}
        first = soil[PREDICTION][0]
    return RolloutFrames(
        name=rollout.name,
        title=f'{scene.name.capitalize()}: the {kind} follows {title}',
        label='',
        frames=frames,
        soil=soil,
        start=first,
        rigid=rigid,
        force=force,
        rigid_type=0,
        first_predicted=start,
        dt=scene.dt,
        notes=() if rollout.status == 'ok' else (f'{rollout.status}: {rollout.reason}.',),
        up_axis=scene.up_axis,
        is_driven=kind == 'wheel',
        **found,
    )


def refuse_other_run(frames: RolloutFrames, other: RolloutFrames) -> None:
    """Raises ValueError unless another rollout is one of the same run, over the same particles."""
    same = frames.has_truth and other.has_truth and frames.title == other.title
    for given, theirs in ((frames.rigid, other.rigid), (frames.soil, other.soil)):
        if same and TRUTH in given:
            # The shorter one may have been cut before a frame that is not finite.
            length = min(len(given[TRUTH]), len(theirs.get(TRUTH, ())))
            same = length and np.array_equal(given[TRUTH][:length], theirs[TRUTH][:length])
    if not same:
        raise ValueError(
            f'{other.name} ({other.label}) is no rollout of the run of {frames.name}: {other.title}'
        )


def _metadata(path: str, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """The dataset's metadata of a rollout, or what a drawing needs of them."""
    stated = 'scene' if 'scene' in arrays else 'metadata'
    wanted = ('initial_positions', 'predicted_rollout', 'particle_types', stated)
    missing = [key for key in wanted if key not in arrays]
    if missing:
        raise ValueError(f'{path}: is not a rollout, it lacks {missing}; it has {sorted(arrays)}')
    try:
        found = json.loads(str(arrays[stated]))
    except (ValueError, RecursionError) as error:
        raise ValueError(f'{path}: its {stated} is not JSON: {error}') from error
    if stated == 'metadata':
        if problems := metadata_problems(found):
            raise ValueError(f'{path}: its metadata: {"; ".join(problems)}')
        return found
    try:  # of a path that nobody recorded
        scene = Scene.from_json(found)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f'{path}: its scene is none ({error})') from error
    found = {'dt': scene.dt, 'mode_number': scene.n_modes, 'n_soil': scene.n_soil}
    return found | {'scene': scene.to_json()}


def _split_nodes(path, arrays, metadata) -> tuple[int, bool]:
    """R, and whether the soil's nodes are modes; else they are particles, of a full-space model."""
    count, n_modes = len(arrays['particle_types']), metadata['mode_number']
    n_soil = int((arrays['particle_types'] == dataset.MODE_PARTICLE_ID).sum())
    if n_soil > n_modes > 0:
        return count - n_soil, False
    if not 0 < n_modes <= count:
        raise ValueError(f'{path}: has {count} nodes but its metadata says mode_number {n_modes!r}')
    return count - n_modes, True


def _nodes(path: str, arrays: dict[str, np.ndarray]):
    """{truth, prediction} -> [T, V, 3], and {truth, prediction} -> forces [T, 3] or None; without
    the truth where there is none. Forces of the given frames of a path are zero."""
    count, n_frames = len(arrays['particle_types']), len(arrays['predicted_rollout'])
    n_given = len(arrays['initial_positions'])
    which = [w for w, key in _POSITIONS.items() if key in arrays]
    nodes = {'initial_positions': n_given} | {_POSITIONS[w]: n_frames for w in which}
    forces = {'initial_forces': n_given} if TRUTH in which else {}
    forces |= {_FORCES[w]: n_frames for w in which}
    has_force = any(key in arrays for key in forces)
    if missing := [key for key in forces if has_force and key not in arrays]:
        raise ValueError(f'{path}: has forces but lacks {missing}')
    shapes = {key: (length, count, DIM) for key, length in nodes.items()}
    shapes |= {key: (length, DIM) for key, length in forces.items() if has_force}  # type: ignore[misc]
    values = {}
    for key, shape in shapes.items():
        if arrays[key].shape != shape:
            raise ValueError(f'{path}: {key} has shape {arrays[key].shape}, {shape} was expected')
        values[key] = np.asarray(arrays[key], np.float64)
        if not key.startswith('predicted') and not np.isfinite(values[key]).all():
            raise ValueError(f'{path}: {key} has NaN or infinite values')
    before = values.get('initial_forces', np.zeros((n_given, DIM)))
    given = values['initial_positions']
    return (
        {w: np.concatenate([given, values[_POSITIONS[w]]]) for w in which},
        {w: np.concatenate([before, values[_FORCES[w]]]) for w in which} if has_force else None,
    )


def _reader(data_path: str | None, metadata) -> soil_truth.TruthReader:
    """Of the dataset folder, whose subspace must be that of the rollout."""
    if data_path is None:
        return soil_truth.TruthReader('', metadata)
    if not os.path.isdir(data_path):
        raise FileNotFoundError(f'{data_path}: no such dataset folder')
    # A rollout of the API states its scene alone.
    reader = soil_truth.TruthReader(data_path, metadata if 'bounds' in metadata else None)
    space, path = reader.subspace, os.path.join(data_path, 'subspace.npz')
    if space is None:
        return reader
    if space.n_modes < metadata['mode_number'] or (
        'bounds' in metadata and space.n_modes != metadata['mode_number']
    ):
        raise ValueError(
            f'{path}: has {space.n_modes} modes, the rollout has {metadata["mode_number"]}; give '
            'the dataset folder that the rollout was made from'
        )
    digest = metadata.get('pca', {}).get('digest')
    if digest not in (None, space.digest):
        raise ValueError(
            f'{path}: is not the subspace of this rollout (digest {space.digest[:12]}..., the '
            f'rollout has {digest[:12]}...); give the dataset folder that it was made from'
        )
    return reader


def _place(rollout_path: str, arrays) -> tuple[str | None, int | None]:
    """Split and record number that the file states, in it or by its name."""
    if 'split' in arrays and 'record' in arrays:
        return str(arrays['split']), int(arrays['record'])
    match = _FILE_NAME.fullmatch(os.path.basename(rollout_path))
    return (match['split'], int(match['record'])) if match else (None, None)


def _title(metadata: dict[str, Any], split: str | None, record: int | None) -> str:
    scene = metadata.get('scene', {}).get('name') or 'rollout'
    case = soil_truth.of_run(metadata.get('cases'), split, record) or {}
    name = case.get('case', f'{split} record {record}' if record is not None else '')
    where = f' ({name if isinstance(name, str) else f"case {name}"})' if name != '' else ''
    if {'depth_m', 'speed_m_s', 'angle_deg'} <= case.keys():
        text = f'A blade cuts {1e3 * case["depth_m"]:g} mm deep at {case["speed_m_s"]:g} m/s, '
        return f'{text}leaning by {case["angle_deg"]:g}°{where}'
    if {'diameter_m', 'load_N'} <= case.keys():
        text = f'A wheel of {case["diameter_m"]:g} m'
        load = case.get('context', {}).get('load', case['load_N'])
        if 'slip_percent' in case:
            return f'{text} drives at {case["slip_percent"]:g} % slip under {load:g} N{where}'
        low, high = case.get('load_min_N', load), case.get('load_max_N', load)
        span = f'{high:g} N' if low == high else f'{low:.3g} to {high:.3g} N'
        return f'{text} is driven freely under {span}{where}'
    if 'depth_max_m' in case:
        text = f'A blade is driven freely, up to {1e3 * case["depth_max_m"]:.0f} mm deep'
        return f'{text} and {case.get("speed_max_m_s", 0):.2f} m/s{where}'
    return f'{scene.capitalize()}{where}'
