"""`RecordedRuns`: the solver's runs of a dataset, to follow and to show beside the model."""

import functools
import os

import numpy as np

from learning_to_simulate import api, checkpoints
from learning_to_simulate.live import poses
from learning_to_simulate.live.soil import Decoder
from pca_tools import rigid_fit

SAME_BODY_M = 1e-4
ANGLE_STRIDE = 20  # of the frames in which the angles of all runs are looked at


class RecordedRun:
    """One run of the solver.

    Args:
      record: `pca_tools.dataset.Trajectory`.
      case: of the dataset's metadata, {} if it states none.
      starts: of the model.
      soil: of the dataset's subspace.

    Attributes:
      case: as given.
      context: [C] or None.
      start: index of the start whose body the run has.
      force: float32 [T, 3], N, or None.

    Raises:
      ValueError: no start of the model has this body.
    """

    def __init__(self, record, case: dict, starts, soil: Decoder):
        self.case, self._record, self._soil = case, record, soil
        self.context = None if record.step_context is None else record.step_context[0].astype(float)
        self.force = record.force
        number = case.get('case')
        same = [i for i, c in enumerate(starts.cases) if number is not None and c['case'] == number]
        fits = ((i, self._fit(starts.body[i], 0)) for i in [*same, *range(len(starts))])
        found = next((i for i, fit in fits if fit and fit.residual < SAME_BODY_M), None)
        if found is None:
            raise ValueError(f'no start of the model has the body of the recorded run {number}')
        self.start, self._body = found, starts.body[found]

    def __len__(self) -> int:
        return len(self._record.position)

    def _fit(self, body, frame):
        points = self._record.position[frame, : self._record.n_rigid]
        if points.shape != body.shape or len(points) < rigid_fit.MIN_POINTS:
            return None
        return rigid_fit.fit_rigid_motion(body, points)

    def pose(self, frame: int) -> np.ndarray:
        """float64 [7] of the body in the frame."""
        if self._record.rigid_pose is not None:
            return self._record.rigid_pose[frame].astype(np.float64)
        motion = self._fit(self._body, frame)
        return np.concatenate([motion.translation, poses.quaternion_of(motion.rotation)])

    @functools.cached_property
    def poses(self) -> np.ndarray:
        """float64 [T, 7] of the body."""
        return np.stack([self.pose(frame) for frame in range(len(self))])

    def particles(self, frame: int) -> np.ndarray:
        """float32 [N, 3] of the solver's soil, as far as the dataset's modes hold it, m."""
        return self._soil.particles(self._record.position[frame, self._record.n_rigid :])


class RecordedRuns:
    """The runs of the split `test` that fit a model.

    Args:
      model: `api.TrainedModel`.
      data: `api.Dataset`.

    Attributes:
      runs: name -> `RecordedRun`.

    Raises:
      FileNotFoundError, ValueError: a damaged dataset, or one that the model does not fit.
    """

    def __init__(self, model, data):
        scene, metadata = model.scene, data.metadata
        if metadata['scene']['name'] != scene.name:
            raise ValueError(f'{data.path} is of the scene {metadata["scene"]["name"]}')
        if hasattr(model.config, 'modes'):  # a model in the subspace
            checkpoints.check_dataset(model.path, model.model, data.path, metadata)
        if data.subspace is None:
            raise ValueError(f'{data.path} has no subspace')
        soil = Decoder(data.subspace, scene.up_axis)
        self.runs, self._data, self._model = {}, data, model
        cases = metadata.get('cases', {}).get('test', [])
        for index, record in enumerate(data.test.records):
            case = cases[index] if index < len(cases) else {}
            run = RecordedRun(record, case, model.starts, soil)
            self.runs[f'test {index}' + (f', case {case["case"]}' if 'case' in case else '')] = run

    def angles(self, reader) -> tuple[float, float]:
        """Lowest and highest angle, rad, of the body over the training runs and these.

        Args:
          reader: `poses.PoseReader` of the scene.
        """
        soil = Decoder(self._data.subspace, self._model.scene.up_axis)
        train = (RecordedRun(r, {}, self._model.starts, soil) for r in self._data.train.records)
        found = [
            reader.plane(run.pose(frame))[2]
            for run in (*train, *self.runs.values())
            for frame in range(0, len(run), ANGLE_STRIDE)
        ]
        return min(found), max(found)


def of_model(model, data_path: str | None = None) -> RecordedRuns | None:
    """Runs of a dataset for a model.

    Args:
      model: `api.TrainedModel`.
      data_path: dataset folder or name; None for the shipped one of the scene, if it fits.

    Raises:
      FileNotFoundError, ValueError: a dataset was named that is not there or does not fit.
    """
    if data_path:
        return RecordedRuns(model, api.Dataset(data_path))
    # A shipped model lies in a folder of its dataset's name.
    for name in (os.path.basename(os.path.dirname(os.path.abspath(model.path))), model.scene.name):
        try:
            return RecordedRuns(model, api.Dataset(name))
        except (FileNotFoundError, ValueError):
            continue
    return None
