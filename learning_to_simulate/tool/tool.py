"""`Tool`: what a field must know of a blade or a driven wheel; all else is shared."""

import abc
from typing import ClassVar

import numpy as np

from learning_to_simulate.tool.inputs import Tables
from learning_to_simulate.tool.swept import Bed, Frame, SweptGrid


class Tool(abc.ABC):
    """What a field asks of its tool. B tools go side by side; a pose has K values, a size S.

    Attributes:
      name: under which model folders keep it.
      scalars, channels: names of the scalars of a `Frame` and of the channels of its bins.
      tables: inputs of the networks.
      grid: bins of a field that is trained anew.
      below, below_ramp: soil that lies `below` under what may have been disturbed rests; above it
        its share grows over `below_ramp`; m.
      beside, beside_ramp: the same beside the tool, m.
      displacement: order of that of particles, m.
      outputs: of the network of the load.
      predicts_height: whether the height of a pose is the network's and not the user's.
    """

    name: ClassVar[str]
    scalars: ClassVar[tuple[str, ...]]
    channels: ClassVar[tuple[str, ...]]
    tables: ClassVar[Tables]
    grid: ClassVar[SweptGrid]
    below: ClassVar[float]
    below_ramp: ClassVar[float]
    beside: ClassVar[float]
    beside_ramp: ClassVar[float]
    displacement: ClassVar[float]
    outputs: ClassVar[int] = 4
    predicts_height: ClassVar[bool] = False

    @abc.abstractmethod
    def size(self, axes, case: dict, points=None, context: dict | None = None) -> np.ndarray:
        """float64 [S] of the tool of a run.

        Args:
          axes: `Axes`.
          case: its parameters in the metadata.
          points: [R, 3] of the body, upright or at any turn in the plane of travel, m.
          context: name -> first value.
        """

    @abc.abstractmethod
    def width_of(self, size) -> float:
        """Across the way, m."""

    @abc.abstractmethod
    def poses(self, axes, pose, context: dict | None = None, before=None) -> np.ndarray:
        """float64 [T, K] of poses [T, 7] of the world.

        Args:
          axes: `Axes`.
          pose: position (m) and unit quaternion (w, x, y, z).
          context: name -> [T] values.
          before: [K] of the frame before the first.
        """

    @abc.abstractmethod
    def velocity(self, axes, velocity, size) -> np.ndarray:
        """What `begin` takes, of linear and angular velocity [6] of the world, m/s and rad/s."""

    @abc.abstractmethod
    def begin(self, grid, bed: Bed, size, pose, velocity=None):
        """State and `Frame` of B tools that have not moved yet; size [B, S], pose [B, K]."""

    @abc.abstractmethod
    def step(self, grid, bed: Bed, size, state, pose, dt: float, heights=None):
        """State, poses and `Frame` one frame later.

        Args:
          grid, bed, size, pose: see `begin`.
          state: before; it is not changed.
          dt: duration, s.
          heights: called with a `Frame` of [B, ...] gives the change [B] of the height since the
            start, m; None takes that of the poses.

        Raises:
          ValueError: as `swept.advance`.
        """

    def frames(self, grid, bed: Bed, size, pose, dt: float, velocity=None, heights=None):
        """Poses [T, B, K] and `Frame` of [T, B, ...] of whole paths; arguments as of `step`."""
        pose = np.asarray(pose, np.float64)
        state, first = self.begin(grid, bed, size, pose[0], velocity)
        rows = [(pose[0], first)]
        for coming in pose[1:]:
            state, *row = self.step(grid, bed, size, state, coming, dt, heights)
            rows.append(tuple(row))
        stacked = Frame(*map(np.stack, zip(*(f for _, f in rows), strict=True)))
        return np.stack([p for p, _ in rows]), stacked

    @abc.abstractmethod
    def touches(self, grid, frames: Frame) -> np.ndarray:
        """bool [T]: whether the tool may feel soil in frames of [T, ...]."""

    @abc.abstractmethod
    def targets(self, episode) -> np.ndarray:
        """float32 [T, O'] that the load's network learns: force, torque, and what else there is."""

    @abc.abstractmethod
    def target_weights(self, episode) -> np.ndarray:
        """float64 [O'] of the squared errors of `targets`."""

    @abc.abstractmethod
    def inside(self, points, pose, size) -> tuple[np.ndarray, np.ndarray]:
        """How deep points [P, 3] (u, height, distance from the middle plane, m) lie in the tool at
        a pose [K]: depth [P], m, 0 outside, and the shortest way out [P, 3] of that length."""

    @abc.abstractmethod
    def lowest(self, pose, size) -> float:
        """Height of the lowest point of the tool, m."""

    @abc.abstractmethod
    def facts(self, episode, pose, frames: Frame, loads) -> dict:
        """What is judged of this tool alone.

        Args:
          episode: of a run.
          pose: [T, K] with the predicted height.
          frames: of the run.
          loads: [T, O'] mean of the members.
        """


def way_out(points, in_plane, normal, width) -> tuple[np.ndarray, np.ndarray]:
    """Depth [P] and way [P, 3] out of a body drawn out across the way over a width (m), from depths
    [P] and outward normals [P, 2] in the plane of travel: by the nearer of rim and side."""
    across = points[:, 2]
    beside = width / 2 - np.abs(across)
    depth = np.maximum(np.minimum(in_plane, beside), 0.0)
    is_plane = in_plane <= beside
    way = np.where(is_plane, depth, 0.0)[:, None] * normal
    way_across = np.where(is_plane, 0.0, depth) * np.where(across < 0, -1.0, 1.0)
    return depth, np.concatenate([way, way_across[:, None]], axis=1)
