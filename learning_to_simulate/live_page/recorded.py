"""`RecordedRuns`: the solver's runs of a dataset, to follow and to show beside the model."""

import functools
import os

import numpy as np

from learning_to_simulate import api, checkpoints
from learning_to_simulate.live import poses
from learning_to_simulate.live.soil import Decoder
from pca_tools import rigid_fit

SAME_BODY_M = 1e-4


class RecordedRun:
    """One run of the solver, of a `dataset.Trajectory` and the number of its case (or None).

    Attributes:
      context: [C] or None.
      start: index of the start whose body the run has.
      force: float32 [T, 3], N, or None.

    Raises:
      ValueError: no start of the model has this body.
    """

    def __init__(self, record, number, starts, soil: Decoder):
        self._record, self._soil = record, soil
        self.context = None if record.step_context is None else record.step_context[0].astype(float)
        self.force = record.force
        # The start of the same case, if there is one, is tried first.
        order = sorted(range(len(starts)), key=lambda i: starts.cases[i].get('case') != number)
        fits = ((i, self._fit(starts.body[i], 0)) for i in order)
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
    """The test runs of an `api.Dataset`, for an `api.TrainedModel`.

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
        soil, self.runs = Decoder(data.subspace, scene.up_axis), {}
        cases = metadata.get('cases', {}).get('test', [])
        for index, record in enumerate(data.test.records):
            number = cases[index].get('case') if index < len(cases) else None
            name = f'test {index}' + (f', case {number}' if number is not None else '')
            self.runs[name] = RecordedRun(record, number, model.starts, soil)


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
