"""The tools of a swept field: what a field must know of a blade, and of a driven wheel.

A tool says what its pose and its size are, keeps the state of its path, gives the inputs of the
networks and what their outputs mean, and knows its own outline. All else is shared.
"""

import abc
import dataclasses

import numpy as np

from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.methods.swept_field import (
    inputs,
    soil_physics,
    tool_path,
    wheel_inputs,
    wheel_path,
)
from learning_to_simulate.methods.swept_field.tool_path import Bed, Frame
from learning_to_simulate.methods.wheel_terramechanics import CONTEXT
from learning_to_simulate.scene import RigidMotion

# A run whose force (N) or change of height (m) is less weighs no more than one that has as much.
LEAST_FORCE, LEAST_SINKAGE = 10.0, 0.001


class Tool(abc.ABC):
    """What a field asks of its tool. B tools go side by side; a pose has K values, a size S.

    Attributes:
      name: under which model folders keep it.
      scalars: names of the scalars of a `Frame`.
      channels: number of those of its bins.
      outputs: of the network of the load.
      predicts_height: whether the height of a pose is the network's and not the user's.
    """

    name: str
    scalars: tuple[str, ...]
    channels: int
    outputs: int
    predicts_height = False

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
    def velocity(self, axes, velocity, size, xp=np) -> np.ndarray:
        """What `begin` takes, of linear and angular velocity [6] of the world, m/s and rad/s; xp:
        numpy or `tensors`."""

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
          ValueError: as `tool_path.advance`.
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
    def inputs(self, grid):
        """`inputs.Inputs`, or what stands for them."""

    @abc.abstractmethod
    def targets(self, episode) -> np.ndarray:
        """float32 [T, O'] that the load's network learns: force, torque, and what else there is."""

    @abc.abstractmethod
    def target_weights(self, episode) -> np.ndarray:
        """float64 [O'] of the squared errors of `targets`."""

    @abc.abstractmethod
    def inside(self, points, pose, size) -> tuple[np.ndarray, np.ndarray]:
        """How deep points [P, 3] lie in the tool at a pose [K], and the way out; see
        `soil_physics.inside`."""

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


@dataclasses.dataclass(frozen=True)
class Blade(Tool):
    """A blade whose lower edge is round, all of its motion given.

    A pose is u, height of the middle of the lower edge (m) and lean (rad), a size the width (m).

    Attributes:
      width: across the way, m, of runs that do not say their own.
      radius: of the edge, half the thickness, m.
      length: from the middle of the lower to that of the upper edge, m.

    Raises:
      ValueError: a length that is not positive.
    """

    width: float = 0.457
    radius: float = 0.014
    length: float = 0.277

    name = 'blade'
    scalars = tool_path.SCALARS
    channels = tool_path.CHANNELS
    outputs = inputs.OUTPUTS

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if not 0 < getattr(self, field.name) < np.inf:
                raise ValueError(
                    f'Blade.{field.name} must be positive, got {getattr(self, field.name)}'
                )

    def size(self, axes, case, points=None, context=None):
        """See `Tool`; the width that the case states, or the usual one."""
        return np.array([float(case.get('blade_width_m', self.width))])

    def width_of(self, size):
        """See `Tool`."""
        return float(size[0])

    def poses(self, axes, pose, context=None, before=None):
        """See `Tool`."""
        return axes.poses(pose)

    def velocity(self, axes, velocity, size, xp=np):
        """See `Tool`."""
        return axes.velocities(velocity, xp)

    def begin(self, grid, bed, size, pose, velocity=None):
        """See `Tool`."""
        state = tool_path.start(grid, bed, pose, velocity)
        return state, tool_path.frame(grid, bed, size[:, 0], state)

    def step(self, grid, bed, size, state, pose, dt, heights=None):
        """See `Tool`."""
        state = tool_path.advance(grid, state, pose, dt)
        return state, np.asarray(pose, np.float64), tool_path.frame(grid, bed, size[:, 0], state)

    def inputs(self, grid):
        """See `Tool`."""
        return inputs.Inputs(grid, self.radius)

    def targets(self, episode):
        """See `Tool`."""
        return episode.load

    def target_weights(self, episode):
        """See `Tool`: runs count alike, whatever their force."""
        size = np.sqrt((episode.load[:, :2].astype(np.float64) ** 2).sum(-1).mean())
        unit = np.array([inputs.FORCE, inputs.FORCE, inputs.TORQUE]) / inputs.FORCE
        return 1.0 / (max(size, LEAST_FORCE) * unit) ** 2

    def inside(self, points, pose, size):
        """See `Tool`."""
        return soil_physics.inside(points, pose, self, self.width_of(size))

    def lowest(self, pose, size):
        """See `Tool`."""
        return float(pose[1]) - self.radius

    def facts(self, episode, pose, frames, loads):
        """Litres that were cut, and the largest force (N) with the blade clear of all soil."""
        bins = frames.bins
        clear = self.clearance(frames) > 0.03
        in_air = clear & (bins[..., tool_path.CUT].max(axis=1) == 0)
        force = np.linalg.norm(loads[:, :2], axis=1)
        area = frames.scalars[-1, tool_path.SCALARS.index('area')]
        return {
            'cut_litre': 1e3 * soil_physics.cut_volume(area, self.width_of(episode.size)),
            'air_force_N': float(force[in_air].max()) if in_air.any() else 0.0,
        }

    def clearance(self, frames) -> np.ndarray:
        """[T] m, height of the lowest point over the untouched bed's highest."""
        height = frames.scalars[:, tool_path.SCALARS.index('height')] - self.radius
        return height - frames.bins[..., tool_path.SURFACE].max(axis=1)


@dataclasses.dataclass(frozen=True)
class Wheel(Tool):
    """A wheel whose turn, travel and load are given, and whose height is predicted.

    A pose is u, height of the axle (m), angle turned (rad, positive where it rolls on) and load
    (N); a size radius and width (m), gravity (m/s2) and tan of the friction angle.
    """

    name = 'wheel'
    scalars = wheel_path.SCALARS
    channels = wheel_path.CHANNELS
    outputs = wheel_inputs.OUTPUTS
    predicts_height = True

    def size(self, axes, case, points=None, context=None):
        """See `Tool`."""
        points = axes.points(points)
        across = points[:, :2] - points[:, :2].mean(axis=0)
        return np.array(
            [
                np.hypot(*across.T).mean(),
                np.ptp(points[:, 2]),
                context['gravity'],
                wheel_path.friction_of(context['friction_angle_deg']),
            ]
        )

    def width_of(self, size):
        """See `Tool`."""
        return float(size[wheel_path.WIDTH])

    def poses(self, axes, pose, context=None, before=None):
        """See `Tool`."""
        u, height, lean = np.moveaxis(axes.poses(pose), -1, 0)
        first = -lean[:1] if before is None else before[None, wheel_path.TURNED]
        turned = np.unwrap(np.concatenate([first, -lean]))[1:]
        return np.stack([u, height, turned, np.broadcast_to(context['load'], u.shape)], axis=-1)

    def velocity(self, axes, velocity, size, xp=np):
        """See `Tool`: of travel and rim."""
        rates = axes.velocities(velocity, xp)
        return xp.stack([rates[0], -rates[2] * size[wheel_path.RADIUS]])

    def begin(self, grid, bed, size, pose, velocity=None):
        """See `Tool`."""
        drive, rut = wheel_path.start(grid, bed, size, pose, velocity)
        return (drive, rut), wheel_path.frame(grid, bed, drive, rut)

    def step(self, grid, bed, size, state, pose, dt, heights=None):
        """See `Tool`."""
        drive, rut = state
        drive = wheel_path.drive_on(grid, drive, pose, dt)
        known = wheel_path.frame(grid, bed, drive)
        pose = self._placed(drive, pose, known, heights)
        rut = wheel_path.sink(grid, drive, rut, pose[:, wheel_path.HEIGHT])
        return (drive, rut), pose, wheel_path.with_rut(grid, bed, known, rut)

    def frames(self, grid, bed, size, pose, dt, velocity=None, heights=None):
        """See `Tool`: all drives, then all heights from one call, then all ruts."""
        pose = np.array(pose, np.float64)
        (drive, rut), first = self.begin(grid, bed, size, pose[0], velocity)
        drives, known = [drive], [wheel_path.frame(grid, bed, drive)]
        for coming in pose[1:]:
            drives.append(wheel_path.drive_on(grid, drives[-1], coming, dt))
            known.append(wheel_path.frame(grid, bed, drives[-1]))
        if heights is not None and len(pose) > 1:
            flat = Frame(*(np.concatenate(x) for x in zip(*known[1:], strict=True)))
            change = heights(flat).reshape(len(pose) - 1, -1)
            pose[1:, :, wheel_path.HEIGHT] = pose[0, :, wheel_path.HEIGHT] + change
        found = [first]
        for k, one, row in zip(known[1:], drives[1:], pose[1:], strict=True):
            rut = wheel_path.sink(grid, one, rut, row[:, wheel_path.HEIGHT])
            found.append(wheel_path.with_rut(grid, bed, k, rut))
        return pose, Frame(*map(np.stack, zip(*found, strict=True)))

    def _placed(self, drive, pose, known, heights):
        pose = np.array(pose, np.float64)
        if heights is not None:
            change = heights(known)
            pose[:, wheel_path.HEIGHT] = drive.first[:, wheel_path.HEIGHT] + change
        return pose

    def inputs(self, grid):
        """See `Tool`."""
        return wheel_inputs.WheelInputs(grid)

    def targets(self, episode):
        """See `Tool`: the last one is the change of the height, m."""
        height = episode.pose[:, wheel_path.HEIGHT]
        return np.concatenate(
            [episode.load, (height - height[0])[:, None]], axis=1, dtype=np.float32
        )

    def target_weights(self, episode):
        """See `Tool`: forces over that of the run, torque over force times radius, height over
        that of the run."""
        force = np.sqrt((episode.load[:, :2].astype(np.float64) ** 2).sum(-1).mean())
        change = self.targets(episode)[:, 3].astype(np.float64)
        height = max(float(np.sqrt((change**2).mean())), LEAST_SINKAGE)
        radius = episode.size[wheel_path.RADIUS]
        return 1.0 / np.array([force, force, force * radius, height]) ** 2

    def inside(self, points, pose, size):
        """See `Tool`."""
        return soil_physics.inside_wheel(
            points, pose, size[wheel_path.RADIUS], size[wheel_path.WIDTH]
        )

    def lowest(self, pose, size):
        """See `Tool`."""
        return float(pose[wheel_path.HEIGHT] - size[wheel_path.RADIUS])

    def facts(self, episode, pose, frames, loads):
        """Errors of the sinkage: root mean square (mm), over the radius, and of a height that is
        held; the relative L2 error of a force that is held, and of the torque."""
        true, said = (p[H:, wheel_path.HEIGHT] for p in (episode.pose, pose))
        held = episode.pose[H - 1, wheel_path.HEIGHT]
        size = np.linalg.norm(episode.load[H:, :2])
        radius = episode.size[wheel_path.RADIUS]
        error = np.sqrt(((said - true) ** 2).mean())
        return {
            'height_mm': float(1e3 * error),
            'height_over_radius': float(error / radius),
            'height_worst_over_radius': float(np.abs(said - true).max() / radius),
            'held_height_mm': float(1e3 * np.sqrt(((held - true) ** 2).mean())),
            'held_force_l2': float(
                np.linalg.norm(episode.load[H:, :2] - episode.load[H - 1, :2]) / size
            ),
            'torque_l2': float(
                np.linalg.norm(loads[H:, 2] - episode.load[H:, 2])
                / max(np.linalg.norm(episode.load[H:, 2]), 1e-9)
            ),
        }


TOOLS = {tool.name: tool for tool in (Blade, Wheel)}


def for_scene(scene) -> Tool:
    """The tool of a scene: a blade where all motion is given, a wheel where it is driven.

    Raises:
      ValueError: neither; a wheel whose load or soil is not known.
    """
    if scene.rigid_motion == RigidMotion.PRESCRIBED:
        return Blade()
    if scene.rigid_motion != RigidMotion.DRIVEN:
        raise ValueError(
            f'swept_field needs a tool whose motion is given: a blade (prescribed) or a wheel '
            f'(driven); the body is {scene.rigid_motion}'
        )
    if not set(CONTEXT) <= set(scene.context_names):
        raise ValueError(
            f'swept_field needs the context {CONTEXT} of a driven wheel; the scene has '
            f'{scene.context_names}'
        )
    return Wheel()
