"""One rollout, with its truth where there is one, ready to be drawn.

Reads the `rollout_{split}_{i}.npz` of `learning_to_simulate.train --mode=eval_rollout` (DeepMind's
key names) and, where the dataset has one, the subspace that turns mode scores back into particles.
Decoding is linear: velocities and errors of particles are decoded from differences of scores.
"""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from typing import Any

import numpy as np

from learning_to_simulate import metrics
from learning_to_simulate.rendering import rollout_arrays
from learning_to_simulate.rendering.rollout_arrays import DIM, PREDICTION, TRUTH
from pca_tools.subspace import Subspace

SUBSPACE_NAME = 'subspace.npz'
SOIL_PARTICLE_TYPE = 6
# Views: indices of the horizontal and the vertical axis.
PLANES = {'xy': (0, 1), 'xz': (0, 2), 'zy': (2, 1), 'yz': (1, 2), 'yx': (1, 0), 'zx': (2, 0)}
# From the side, by the upward axis: the other two are the first horizontal one and the depth.
SIDE_VIEWS = 'yx', 'xy', 'xz'
_FILE_NAME = re.compile(r'rollout_(?P<split>[a-z]+)_(?P<record>\d+)\.npz')
# A rigid error below this is round-off of a motion that was given.
_GIVEN_MOTION_MM = 1e-3
_SEPARATOR = '  ·  '
# Numbers of a run that belong to its making and not to its case.
_NOT_A_PARAMETER = (
    'case', 'seed', 'solver_cpu_s', 'time_step_s', 'cell_size_m', 'youngs_modulus_Pa',
    'body_friction',
)  # fmt: skip
# Longest first, so that m_s2 is not read as s2.
_UNITS = {'_m_s2': ' m/s²', '_m_s': ' m/s', '_deg': '°', '_percent': ' %', '_m': ' m', '_N': ' N'}


@dataclasses.dataclass(frozen=True)
class RolloutFrames:
    """A run of T frames (H given, T - H predicted), as it is drawn.

    Attributes:
        name: file name without its ending.
        title: scene, case and its parameters, one line.
        label: name of the model that predicted, or ''.
        scores: {truth, prediction} -> float64 [T, r, 3], m; of a path that nobody recorded, the
            prediction alone, as in the next two.
        rigid: {truth, prediction} -> float64 [T, R, 3], m.
        force: {truth, prediction} -> float64 [T, 3], N, or None.
        rigid_type: particle type of the rigid points.
        first_predicted: H, index of the first predicted frame.
        dt: seconds per frame.
        n_soil: N, or None if neither the subspace nor the metadata says it.
        projection_mse: m², what the subspace cuts off this run, or None if it is not known.
        subspace: rebuilds the particles, or None: then there is no soil to draw.
        notes: what the reader of a picture should know, one sentence each.
        up_axis: axis against gravity, 0, 1 or 2.
    """

    name: str
    title: str
    label: str
    scores: dict[str, np.ndarray]
    rigid: dict[str, np.ndarray]
    force: dict[str, np.ndarray] | None
    rigid_type: int
    first_predicted: int
    dt: float
    n_soil: int | None
    projection_mse: float | None
    subspace: Subspace | None
    notes: tuple[str, ...]
    up_axis: int

    @property
    def side_view(self) -> str:
        """Key of `PLANES`: the view from the side, upward axis up."""
        return SIDE_VIEWS[self.up_axis]

    @property
    def n_frames(self) -> int:
        """T."""
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
        """Whether there are errors to show."""
        return TRUTH in self.rigid

    @functools.cached_property
    def time(self) -> np.ndarray:
        """[T] s."""
        return self.dt * np.arange(self.n_frames)

    def soil(self, which: str, frame: int) -> np.ndarray:
        """[N, 3] particle positions of a frame, m."""
        return self.subspace.decode(self.scores[which][frame])

    def soil_displacement(self, which: str, frame: int) -> np.ndarray:
        """[N, 3] way of the particles since the first frame, m."""
        return self.subspace.components @ (self.scores[which][frame] - self.scores[which][0])

    def soil_velocity(self, which: str, frame: int) -> np.ndarray:
        """[N, 3] velocity over the frame interval that ends at `frame`, m/s (first frame: zero)."""
        before = self.scores[which][max(frame - 1, 0)]
        return self.subspace.components @ ((self.scores[which][frame] - before) / self.dt)

    def soil_error(self, frame: int) -> np.ndarray:
        """[N, 3] prediction minus truth within the subspace, m."""
        return self.subspace.components @ (
            self.scores[PREDICTION][frame] - self.scores[TRUTH][frame]
        )

    def rigid_velocity(self, which: str, frame: int) -> np.ndarray:
        """[R, 3] velocity over the frame interval that ends at `frame`, m/s (first frame: zero)."""
        before = self.rigid[which][max(frame - 1, 0)]
        return (self.rigid[which][frame] - before) / self.dt

    @functools.cached_property
    def soil_rms_mm(self) -> dict[str, np.ndarray]:
        """[T] RMS soil error per coordinate in mm: prediction and its trivial neighbours.

        Keys `prediction`, `persistence`, `constant velocity`. Without N the RMS is that of the mode
        scores. Empty without a truth.
        """
        if TRUTH not in self.scores:
            return {}
        truth, start = self.scores[TRUTH], self.first_predicted
        given, n_predicted = truth[None, :start], self.n_frames - start
        predictions = {
            PREDICTION: self.scores[PREDICTION][start:],
            'persistence': metrics.stay_still(given, n_predicted)[0],
            'constant velocity': metrics.constant_velocity(given, n_predicted)[0],
        }
        count = self.n_soil or truth.shape[1]
        # Frames take the place of runs: one error for each of them.
        later = truth[start:, None]
        return {
            name: np.concatenate(
                [np.zeros(start), metrics.rms_mm(metrics.soil_mse(x[:, None], later, 0, count))]
            )
            for name, x in predictions.items()
        }

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

    @functools.cached_property
    def errors(self) -> dict[str, float]:
        """Errors of the whole rollout, as `metrics.run_errors` names them."""
        position, truth = (
            np.concatenate([self.rigid[which], self.scores[which]], axis=1)[None]
            for which in (PREDICTION, TRUTH)
        )
        force, true_force = (
            (None, None)
            if self.force is None
            else (self.force[which][None] for which in (PREDICTION, TRUTH))
        )
        later = slice(self.first_predicted, None)
        errors = metrics.run_errors(
            position[:, later],
            truth[:, later],
            None if force is None else force[:, later],
            None if true_force is None else true_force[:, later],
            self.rigid[TRUTH].shape[1],
            self.n_soil or self.scores[TRUTH].shape[1],
        )
        return {name: float(value[0]) for name, value in errors.items()}


def load(rollout_path: str, data_path: str | None, label: str = '') -> RolloutFrames:
    """Reads a rollout and, from the dataset folder, the subspace it was made in.

    Args:
        rollout_path: `rollout_{split}_{i}.npz`.
        data_path: dataset folder; without one, or without `subspace.npz` in it, there is no soil.
        label: name of the model, for titles.

    Returns:
        The rollout, cut before the first frame that is not finite.

    Raises:
        FileNotFoundError: a file or the folder is missing.
        ValueError: not an `.npz`, a git-lfs pointer, missing keys, shapes that do not fit, NaN in
            the truth, nothing finite predicted, or a subspace other than the rollout's.
    """
    if rollout_path.endswith(('.pkl', '.pickle')):
        raise ValueError(f'{rollout_path}: is a pickle, which is never read; give the .npz of it')
    arrays, metadata, nodes, force = rollout_arrays.read(rollout_path)
    prediction = nodes[PREDICTION]
    n_modes = metadata['mode_number']
    if not 0 < n_modes <= prediction.shape[1]:
        raise ValueError(
            f'{rollout_path}: has {prediction.shape[1]} nodes but its metadata says mode_number '
            f'{n_modes!r}'
        )
    start = len(arrays['initial_positions'])
    notes = []
    length = rollout_arrays.finite_length(prediction, None if force is None else force[PREDICTION])
    if length <= start:
        raise ValueError(f'{rollout_path}: no predicted frame is finite, there is nothing to draw')
    if length < len(prediction):
        notes.append(f'The prediction is not finite from frame {length} on; drawn up to there.')
    subspace = _subspace(data_path, metadata, n_modes)
    if subspace is None:
        notes.append('Without subspace.npz there are no particles: mode scores are drawn instead.')
    n_rigid = prediction.shape[1] - n_modes
    if subspace is None and not n_rigid:
        raise ValueError(
            f'{rollout_path}: has modes only, and {data_path} no {SUBSPACE_NAME} to rebuild the '
            'soil with: there is nothing to draw'
        )
    split, record = _place(rollout_path)
    floors = metadata.get('projection_mse', {}).get(split, [])
    nodes = {which: values[:length] for which, values in nodes.items()}
    return RolloutFrames(
        name=os.path.splitext(os.path.basename(rollout_path))[0],
        title=_title(metadata, split, record),
        label=label,
        scores={which: values[:, n_rigid:] for which, values in nodes.items()},
        rigid={which: values[:, :n_rigid] for which, values in nodes.items()},
        force=None if force is None else {which: f[:length] for which, f in force.items()},
        rigid_type=int(arrays['particle_types'][0]),
        first_predicted=start,
        dt=float(metadata['dt']),
        n_soil=metadata.get('n_soil') if subspace is None else subspace.n_soil,
        projection_mse=floors[record] if record is not None and record < len(floors) else None,
        subspace=subspace,
        notes=tuple(notes),
        up_axis=metadata.get('scene', {}).get('up_axis', 1),
    )


def refuse_other_run(frames: RolloutFrames, other: RolloutFrames) -> None:
    """Raises ValueError unless another rollout is one of the same run, in the same subspace."""
    same = frames.has_truth and other.has_truth and frames.title == other.title
    for given, theirs in ((frames.rigid, other.rigid), (frames.scores, other.scores)):
        # The shorter one may have been cut before a frame that is not finite.
        length = min(frames.n_frames, other.n_frames)
        same = same and np.array_equal(given[TRUTH][:length], theirs[TRUTH][:length])
    if not same:
        raise ValueError(
            f'{other.name} ({other.label}) is no rollout of the run of {frames.name}: {other.title}'
        )


def of_rollout(rollout) -> RolloutFrames:
    """A `path_rollout.SoilRollout` ready to be drawn; of a path there is no truth."""
    start, n_modes = len(rollout.history), rollout.scene.n_modes
    given = rollout.history[:, rollout.history.shape[1] - n_modes :]
    scores = {PREDICTION: np.concatenate([given, rollout.modes])}
    rigid = {PREDICTION: rollout.body}
    force = None
    if rollout.force is not None:
        before = np.zeros((start, DIM))
        if rollout.truth and rollout.truth[2] is not None:
            before = rollout.truth[2][:start]
        force = {PREDICTION: np.concatenate([before, rollout.force])}
    if rollout.truth:
        scores[TRUTH], rigid[TRUTH], true_force = rollout.truth
        if force is not None:
            force[TRUTH] = true_force
    return RolloutFrames(
        name=rollout.name,
        title=rollout.scene.name.capitalize(),
        label='',
        scores=scores,
        rigid=rigid,
        force=force,
        rigid_type=0,
        first_predicted=start,
        dt=rollout.scene.dt,
        n_soil=rollout.scene.n_soil,
        projection_mse=None,
        subspace=rollout.subspace,
        notes=() if rollout.status == 'ok' else (f'{rollout.status}: {rollout.reason}.',),
        up_axis=rollout.scene.up_axis,
    )


def _subspace(data_path: str | None, metadata: dict[str, Any], n_modes: int) -> Subspace | None:
    if data_path is None:
        return None
    if not os.path.isdir(data_path):
        raise FileNotFoundError(f'{data_path}: no such dataset folder')
    path = os.path.join(data_path, SUBSPACE_NAME)
    if not os.path.exists(path):
        return None
    subspace = Subspace.load(path)
    if subspace.n_modes != n_modes:
        raise ValueError(
            f'{path}: has {subspace.n_modes} modes, the rollout has {n_modes}; give the dataset '
            'folder that the rollout was made from'
        )
    digest = metadata.get('pca', {}).get('digest')
    if digest not in (None, subspace.digest):
        raise ValueError(
            f'{path}: is not the subspace of this rollout (digest {subspace.digest[:12]}..., the '
            f'rollout has {digest[:12]}...); give the dataset folder that it was made from'
        )
    return subspace


def _place(rollout_path: str) -> tuple[str | None, int | None]:
    """Split and record number that the file name states."""
    match = _FILE_NAME.fullmatch(os.path.basename(rollout_path))
    return (match['split'], int(match['record'])) if match else (None, None)


def _title(metadata: dict[str, Any], split: str | None, record: int | None) -> str:
    """Scene, case and its parameters."""
    parts = [str(metadata.get('scene', {}).get('name', 'rollout')).capitalize()]
    if record is not None:
        cases = metadata.get('cases', {}).get(split, [])
        case = cases[record] if record < len(cases) else {}
        parts.append(f'case {case["case"]}' if 'case' in case else f'{split} record {record}')
        parts += [
            _with_unit(key, value)
            for key, value in case.items()
            if key not in _NOT_A_PARAMETER and isinstance(value, (int, float))
        ]
    return _SEPARATOR.join(parts)


def _with_unit(key: str, value: float) -> str:
    for ending, unit in _UNITS.items():
        if key.endswith(ending):
            return f'{key[: -len(ending)].replace("_", " ")} {value:g}{unit}'
    return f'{key.replace("_", " ")} {value:g}'
