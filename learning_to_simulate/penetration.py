"""Soil inside the tool: how deep, and how many particles, in predictions and in the truth.

The truth is that of the dataset's modes: what is cut off moves particles, into the tool as well. So
the two figures belong side by side. The tool is the stadium of a blade or the disc of a wheel, at
the poses that the records state; of records without poses nothing is
said.
"""

import os
from typing import NamedTuple

import numpy as np

from learning_to_simulate.axes import Axes
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.soil_field.tools import Blade
from pca_tools import dataset
from pca_tools.subspace import Subspace

EVERY = 8  # frames
DEEP = 1e-3  # m; less counts as touching
# Particles of a body lie in the box around its tool, up to 5.8 mm beyond a round edge, m.
SAME_TOOL = 6e-3


class Outline(NamedTuple):
    """A tool: all points within a radius of a segment in the plane of travel, which leads from its
    place up; drawn out across the way. Lengths in m; that of a wheel's segment is 0."""

    width: float
    radius: float
    length: float

    def depth(self, points, pose) -> np.ndarray:
        """How deep [P] points [P, 3] (`Axes.points`) lie in the tool at a pose [3] (`Axes.poses`),
        m; 0 outside."""
        axis = self.length * np.array([-np.sin(pose[2]), np.cos(pose[2])])
        relative = points[:, :2] - pose[:2]
        along = np.clip(relative @ axis / max(axis @ axis, 1e-12), 0.0, 1.0)
        away = relative - along[:, None] * axis
        beside = self.width / 2 - np.abs(points[:, 2])
        return np.maximum(np.minimum(self.radius - np.hypot(*away.T), beside), 0.0)


class Penetration:
    """Measures rollouts over a split of a dataset.

    Args:
      data_path: dataset folder, with a subspace.
      metadata: of it.
      records: `Trajectory`s of the split, with poses.
      split: its name.
      scene: of a blade or a driven wheel.

    Raises:
      ValueError: a body of another shape.
    """

    def __init__(self, data_path: str, metadata: dict, records, split: str, scene):
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
        """`Outline` and poses [T, 3] of the tool of a run, and the particles [R, 3] of its body at
        first."""
        run = self._records[record]
        points = self._axes.points(run.position[0, : run.n_rigid])
        case = self._cases[record] if record < len(self._cases) else {}
        if self._scene.rigid_motion == RigidMotion.DRIVEN:
            spokes = points[:, :2] - points[:, :2].mean(axis=0)
            tool = Outline(float(np.ptp(points[:, 2])), float(np.hypot(*spokes.T).mean()), 0.0)
        else:
            width = float(case.get('blade_width_m', Blade.width))
            tool = Outline(width, Blade.radius, Blade.length)
        return tool, self._axes.poses(run.rigid_pose), points

    def _check(self, record):
        """Raises ValueError where particles of the body lie beside the tool."""
        tool, pose, points = self._tool_of(record)
        wider = Outline(tool.width + 2 * SAME_TOOL, tool.radius + SAME_TOOL, tool.length)
        if not (wider.depth(points, pose[0]) > 0).all():
            name = 'blade' if tool.length else 'wheel'
            raise ValueError(f'record {record}: the body is not the {name} of the solver')

    def __call__(self, record: int, group, rollout) -> dict[str, float]:
        """Of a one-run `RunGroup` and its `Rollout`: `penetration_mm` of the deepest particle and
        `penetration_particles`, how many are deeper than a millimetre, mean over frames; the same
        with `true_` before them."""
        run, n = self._records[record], group.n_rigid
        tool, pose, _ = self._tool_of(record)
        modes = group.with_left_modes(rollout.position)[0, :, n:]
        lift = np.zeros(len(modes))
        if self._scene.rigid_motion == RigidMotion.DRIVEN:
            up = self._scene.up_axis
            lift = (rollout.position[0, :, :n] - group.position[0, H:, :n])[..., up].mean(axis=1)
        said, true = [], []
        for frame in range(0, len(modes), EVERY):
            at = pose[H + frame]
            truth = run.position[H + frame, run.n_rigid :]
            true.append(self._inside(truth, at, tool))
            placed = at.copy()
            placed[1] += lift[frame]
            said.append(self._inside(modes[frame], placed, tool))
        found = {}
        for name, depths in (('', said), ('true_', true)):
            found[f'{name}penetration_mm'] = 1e3 * float(np.max(depths))
            inside = [np.count_nonzero(depth > DEEP) for depth in depths]
            found[f'{name}penetration_particles'] = float(np.mean(inside))
        return found

    def _inside(self, modes, pose, tool):
        return tool.depth(self._axes.points(self._space.decode(modes)), pose)
