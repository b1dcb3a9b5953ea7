"""Soil inside the tool: how deep, and how many particles, in predictions and in the truth.

The truth is that of the dataset's modes: what is cut off moves particles, into the tool as well. So
the two figures belong side by side. The tool is the stadium of a blade or the disc of a wheel, as
the swept field has them, at the poses that the records state; of records without poses nothing is
said.
"""

import dataclasses
import os

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.tool import Blade, for_scene
from learning_to_simulate.tool.axes import Axes
from pca_tools import dataset
from pca_tools.subspace import Subspace

EVERY = 8  # frames
DEEP = 1e-3  # m; less counts as touching
# Particles of a body lie in the box around its tool, up to 5.8 mm beyond a round edge, m.
SAME_TOOL = 6e-3


class Penetration:
    """Measures rollouts over a split of a dataset.

    Args:
      data_path: dataset folder, with a subspace.
      metadata: of it.
      records: `Trajectory`s of the split, with poses.
      split: its name.
      scene: of a blade or a driven wheel.

    Raises:
      ValueError: a scene of neither, or a body of another shape.
    """

    def __init__(self, data_path: str, metadata: dict, records, split: str, scene):
        self._tool = for_scene(scene)
        self._axes = Axes.of_runs(records, scene.up_axis)
        self._records, self._scene = records, scene
        self._cases = metadata.get('cases', {}).get(split, [])
        self._space = Subspace.load(os.path.join(data_path, 'subspace.npz'))
        for record in range(len(records)):
            self._check(record)

    @classmethod
    def of_dataset(cls, data_path: str, metadata: dict, split: str, scene) -> 'Penetration | None':
        """Of a split, or None where it does not say what the tool is and where."""
        if not scene.rigid_motion.is_known or scene.bodies or scene.n_soil is None:
            return None
        if not os.path.exists(os.path.join(data_path, 'subspace.npz')):
            return None
        records = dataset.read_split(data_path, split)
        if any(r.rigid_pose is None or not r.n_rigid for r in records):
            return None
        try:
            return cls(data_path, metadata, records, split, scene)
        except ValueError:
            return None

    def _tool_of(self, record):
        """Size [S] and poses [T, K] of the tool of a run."""
        run, names, context = self._records[record], self._scene.context_names, None
        if names:
            context = {name: run.step_context[:, i] for i, name in enumerate(names)}
        first = None if context is None else {k: float(v[0]) for k, v in context.items()}
        case = self._cases[record] if record < len(self._cases) else {}
        size = self._tool.size(self._axes, case, run.position[0, : run.n_rigid], first)
        return size, self._tool.poses(self._axes, run.rigid_pose.astype(np.float64), context)

    def _check(self, record):
        """Raises ValueError where particles of the body lie beside the tool."""
        size, pose = self._tool_of(record)
        run, wider = self._records[record], size.copy()
        points = self._axes.points(run.position[0, : run.n_rigid])
        tool = self._tool
        if isinstance(tool, Blade):
            tool = dataclasses.replace(tool, radius=tool.radius + SAME_TOOL)
            wider[0] += 2 * SAME_TOOL
        else:
            wider[:2] += SAME_TOOL, 2 * SAME_TOOL
        if not (tool.inside(points, pose[0], wider)[0] > 0).all():
            raise ValueError(f'record {record}: the body is not the {tool.name} of the solver')

    def __call__(self, record: int, group, rollout) -> dict[str, float]:
        """Of a one-run `RunGroup` and its `Rollout`: `penetration_mm` of the deepest particle and
        `penetration_particles`, how many are deeper than a millimetre, mean over frames; the same
        with `true_` before them."""
        run, n = self._records[record], group.n_rigid
        size, pose = self._tool_of(record)
        modes = group.with_left_modes(rollout.position)[0, :, n:]
        lift = np.zeros(len(modes))
        if self._scene.rigid_motion == RigidMotion.DRIVEN:
            up = self._scene.up_axis
            lift = (rollout.position[0, :, :n] - group.position[0, H:, :n])[..., up].mean(axis=1)
        said, true = [], []
        for frame in range(0, len(modes), EVERY):
            at = pose[H + frame]
            truth = run.position[H + frame, run.n_rigid :]
            true.append(self._inside(truth, at, size))
            placed = at.copy()
            placed[1] += lift[frame]
            said.append(self._inside(modes[frame], placed, size))
        found = {}
        for name, depths in (('', said), ('true_', true)):
            found[f'{name}penetration_mm'] = 1e3 * float(np.max(depths))
            inside = [np.count_nonzero(depth > DEEP) for depth in depths]
            found[f'{name}penetration_particles'] = float(np.mean(inside))
        return found

    def _inside(self, modes, pose, size):
        points = self._axes.points(self._space.decode(modes))
        return self._tool.inside(points, pose, size)[0]
