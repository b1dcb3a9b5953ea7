"""`LiveField`: a swept field that follows a tool pose by pose, at a cost that does not grow.

    live = LiveField.load('models/excavation/swept_field')
    live.start(pose)                      # on the flat bed; or start(pose, bed)
    answer = live.step(next_pose)         # force and torque; no particle is computed
    points = live.particles()             # only where they are asked for

A step may last any time: nothing is integrated.
"""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.methods.swept_field import (
    episodes,
    model_files,
    quality,
    soil_physics,
    tool_path,
)
from learning_to_simulate.methods.swept_field.tool_path import Bed, ToolState
from learning_to_simulate.rollout_status import Judgement

# A pose that is farther than this from the one before is a jump, m/s and rad/s.
FASTEST, FASTEST_TURN = 3.0, 20.0
UNIT_TOLERANCE = 1e-3


class HeightMap(NamedTuple):
    """Heights of a bed along the way, the same across it.

    Attributes:
      places: [n] coordinates on the world's axis of travel, m, in any order.
      heights: [n] m.
    """

    places: np.ndarray
    heights: np.ndarray


class Answer(NamedTuple):
    """One frame.

    Attributes:
      force: float64 [3] on the tool, world, N.
      torque: float64 [3] about its reference point, N m.
      force_bound: N, root mean square per component that 95 % of frames like those of valid keep;
        NaN where the model was not calibrated.
      judgement: status, and where it is not `ok` the reason.
    """

    force: np.ndarray
    torque: np.ndarray
    force_bound: float
    judgement: Judgement


class LiveField:
    """Steps a field with poses.

    Args:
      field: `SweptField`.
      members: networks that answer; fewer are faster, their mean is what was measured.
    """

    def __init__(self, field, members: int | None = None):
        if members is not None and not 1 <= members <= field.config.members:
            raise ValueError(f'members is {members}, must lie in [1, {field.config.members}]')
        self._field, self._members = field, members
        self._state: ToolState | None = None

    @classmethod
    def load(cls, model_path: str, members: int | None = None) -> 'LiveField':
        """Of a model folder; raises as `model_files.load`."""
        return cls(model_files.load(model_path), members)

    @property
    def state(self) -> ToolState:
        """Of the tool; what is kept can be put back, and goes on from there to the same bits."""
        if self._state is None:
            raise ValueError('call start() first')
        return self._state

    @state.setter
    def state(self, state: ToolState) -> None:
        self._state = state
        self._frame = tool_path.frame(
            self._field.grid, self._bed, np.array([self._blade_width]), state
        )

    def start(self, pose, bed=None, blade_width: float | None = None) -> Judgement:
        """Begins where the tool is.

        Args:
          pose: [7] position (m) of the middle of the blade's lower edge, unit quaternion
            (w, x, y, z).
          bed: None for the flat bed of the training; [N, 3] particles, m; or a `HeightMap`.
          blade_width: m; None for the usual one.

        Returns:
          how the start is to be judged.

        Raises:
          ValueError: not a pose, a bed or a width; the state stays as it was.
        """
        field, axes = self._field, self._field.axes
        plane = axes.poses(_pose(pose))
        width = field.blade.width if blade_width is None else float(blade_width)
        if not 0 < width < np.inf:
            raise ValueError(f'blade_width is {blade_width}, must be positive')
        points = field.rest
        if isinstance(bed, HeightMap):
            points = _stretched(axes, field.rest, *_map(bed), field.spacing)
        elif bed is not None:
            points = _finite('bed', bed)
            if points.ndim != 2 or points.shape[1] != 3 or not len(points):
                raise ValueError(f'bed has shape {points.shape}, [N, 3] particles were expected')
        kept = field.kept_spacing
        if bed is not None and not isinstance(bed, HeightMap):
            kept *= (len(field.rest) / len(points)) ** (1 / 3)
        reader = episodes.BedReader(axes, field.grid, kept, field.spacing)
        surface, level, end = reader.read(points, plane[0], width)
        bed = Bed(surface[None], np.array([level]), np.array([end]))
        state = tool_path.start(field.grid, bed, plane[None])
        self._bed, self._blade_width, self._level = bed, width, level
        self._points = points
        self._rest = axes.points(points)
        self._origin = np.array([plane[0], level, 0.0])
        self._pose = plane
        self.state = state
        return self._judged()

    def step(self, pose, dt: float | None = None) -> Answer:
        """Moves the tool in a straight line to its next pose.

        Args:
          pose: [7].
          dt: s; None for the frame time of the training data.

        Raises:
          ValueError: before `start`; not a pose, a jump, a time that does not pass, a place beyond
            the bins or under the floor. The state stays as it was.
        """
        before, field = self.state, self._field
        dt = field.scene.dt if dt is None else float(dt)
        plane = field.axes.poses(_pose(pose))
        if not 0 < dt < np.inf:
            raise ValueError(f'dt is {dt} s: time must go on')
        change = np.abs(plane - self._pose) / dt
        if np.hypot(change[0], change[1]) > FASTEST or change[2] > FASTEST_TURN:
            raise ValueError(
                f'the pose jumps: {np.hypot(change[0], change[1]):.3g} m/s and {change[2]:.3g} '
                f'rad/s, at most {FASTEST} and {FASTEST_TURN} are taken; call start() anew'
            )
        floor = self._rest[:, 1].min()
        if plane[1] - field.blade.radius < floor:
            raise ValueError(
                f'the edge would be at {plane[1] - field.blade.radius:.4g} m, under the floor of '
                f'the bed at {floor:.4g} m'
            )
        state = tool_path.advance(field.grid, before, plane[None], dt)
        self._pose = plane
        self.state = state
        loads = field.loads(self._frame, self._members)
        force, torque = field.axes.world_loads(loads.mean(axis=0)[0].astype(np.float64))
        bound = float('nan')
        if (factor := field.calibration.get('force')) is not None:
            bound = float(quality.bound(quality.spread(loads[..., :2])[0], factor, 'force'))
        return Answer(force, torque, bound, self._judged())

    def particles(self) -> np.ndarray:
        """float64 [N, 3] of the soil now, world, m; none of it inside the blade."""
        field = self._field
        moved = field.displacement(
            self._frame, (self._rest - self._origin).astype(np.float32), self._members
        )
        # Those that rest are as they were given, to the last bit.
        now = np.flatnonzero(moved[:, 0].any(axis=(0, 2)))
        points = self._points.copy()
        there = self._rest[now] + moved[:, 0, now].mean(axis=0)
        there = soil_physics.pushed_out(there, self._pose, field.blade, self._blade_width)
        points[now] += field.axes.world(there - self._rest[now])
        return points

    def height_map(self, nx: int, nz: int) -> np.ndarray:
        """Heights [nx, nz] (m) of the highest particle of each cell, along the way and across it,
        from the start of the bed to its end; NaN where a cell has none."""
        if nx < 1 or nz < 1:
            raise ValueError(f'a height map of {nx} x {nz} cells has none')
        points = self._field.axes.points(self.particles())
        low, high = (f(self._rest[:, [0, 2]], axis=0) for f in (np.min, np.max))
        cell = ((points[:, [0, 2]] - low) / (high - low) * (nx, nz)).astype(int)
        cell = np.clip(cell, 0, (nx - 1, nz - 1))
        heights = np.full(nx * nz, -np.inf)
        np.maximum.at(heights, cell[:, 0] * nz + cell[:, 1], points[:, 1])
        return np.where(np.isinf(heights), np.nan, heights).reshape(nx, nz)

    def explain(self) -> str:
        """What the newest frame leaves out."""
        moving = self._field.may_move(
            self._frame, (self._rest - self._origin).astype(np.float32)
        ).sum()
        n = len(self._rest)
        return (
            f'{moving} of {n} particles may have moved; the other {n - moving} '
            f'({100 * (1 - moving / n):.0f} %) are left out, exactly'
        )

    def _judged(self):
        return quality.judge(self._frame.scalars, self._field.ranges)


def _finite(name, values):
    try:
        values = np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} is not an array of numbers ({error})') from error
    if not np.isfinite(values).all():
        raise ValueError(f'{name} holds NaN or infinite numbers')
    return values


def _pose(pose):
    pose = _finite('pose', pose)
    if pose.shape != (7,):
        raise ValueError(f'pose has shape {pose.shape}, (7,) was expected')
    if abs(np.linalg.norm(pose[3:]) - 1) > UNIT_TOLERANCE:
        raise ValueError(f'the quaternion {pose[3:]} has not length 1')
    return pose


def _map(bed):
    places, heights = _finite('places', bed.places), _finite('heights', bed.heights)
    if places.ndim != 1 or places.shape != heights.shape or len(places) < 2:
        raise ValueError(
            f'a height map has places {places.shape} and heights {heights.shape}: two rows of one '
            f'length of at least 2 were expected'
        )
    return places, heights


def _stretched(axes, rest, places, heights, spacing):
    """The bed at rest [N, 3] with its columns stretched to the heights of a map."""
    points = axes.points(rest)
    order = np.argsort(axes.sign * places)
    wanted = np.interp(points[:, 0], axes.sign * places[order], heights[order])
    floor, top = points[:, 1].min(), points[:, 1].max() + spacing / 2
    if (heights <= floor).any():
        raise ValueError(f'a height map goes below the floor of the bed at {floor:.4g} m')
    stretched = rest.copy()
    stretched[:, axes.up] = floor + (points[:, 1] - floor) * (wanted - floor) / (top - floor)
    return stretched
