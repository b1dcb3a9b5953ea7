"""The exported functions of a blade's swept field: start, step, particles.

They are those of `swept_field.live.LiveField` without its memory: what a field knows of its tool
goes in and out as two float32 tensors. A graph cannot raise: what `LiveField` refuses leaves the
state as it is, and `status` says so.
"""

import numpy as np
import tensorflow as tf

from learning_to_simulate.export import field_description, field_state
from learning_to_simulate.export.field_state import AT, BINS, LARGEST, STATUS, TOOL
from learning_to_simulate.live.poses import UNIT_TOLERANCE
from learning_to_simulate.methods import swept_features, tensors
from learning_to_simulate.methods.swept_field import live, quality, soil_physics, tool_path
from learning_to_simulate.methods.swept_field.tool_path import Bed
from learning_to_simulate.methods.swept_field.tools import Blade


class FieldFunctions:
    """The functions of one field with shapes that are fixed.

    Args:
      field: `SweptField` of a blade.
      members: networks that answer; None: all.
      n_particles: P of `particles`; None: of the bed at rest.

    Raises:
      ValueError: another tool; so many members or particles there are not.
    """

    def __init__(self, field, members: int | None = None, n_particles: int | None = None):
        if not isinstance(field.tool, Blade):
            raise ValueError(
                f'the swept field of a {field.tool.name} has no SavedModel, LiteRT or ONNX form, '
                f'that of a blade has; it has a C form and an FMU'
            )
        members = field.config.members if members is None else members
        n_particles = len(field.rest) if n_particles is None else n_particles
        for name, value, most in (
            ('members', members, field.config.members),
            ('n_particles', n_particles, len(field.rest)),
        ):
            if not 1 <= value <= most:
                raise ValueError(f'{name} is {value}, must lie in [1, {most}]')
        self.field, self.members, self.n_particles = field, members, n_particles
        self.variables = field.network.trainable_variables
        limits = quality.limits(field.ranges, field.tool.scalars)
        self._limits = limits.astype(np.float32)
        self._concrete: dict[str, dict] = {}

    def start(self, pose, position_low, velocity, width, surface, level, end, floor):
        """The state of a tool that has not moved yet.

        Args:
          pose: float32 [7], position (m) and unit quaternion (w, x, y, z).
          position_low: float32 [3], what float32 cuts off the position, m; or zeros.
          velocity: float32 [6], linear and angular, m/s and rad/s.
          width: float32 [] of the blade, m.
          surface: float32 [n], height of the bed at `bin_offsets` from the tool along its way, m.
          level: float32 [], median height of the bed, m.
          end: float32 [], from the tool to the end of the bed along its way, m.
          floor: float32 [], height of the floor, m.

        Returns:
          dict of `bins` [4, n], `tool` [K] and `status` [].
        """
        is_good = _is_pose(pose, position_low) & (width > 0)
        for values in (velocity, width, surface, level, end, floor):
            is_good &= field_state.is_sane(values)
        axes, grid = self.field.axes, self.field.grid
        place = axes.poses(pose[None], tensors)  # tf2onnx's angle of a scalar is a vector
        bed = Bed(surface[None], level[None], place[:, 0] + end)
        velocity = axes.velocities(velocity, tensors)[None]
        state = tool_path.start(grid, bed, place, velocity, tensors)
        low = axes.local(position_low, tensors)[:2]
        bins, tool = field_state.packed(grid, state, low[:1], low, width, bed, floor)
        return {
            'bins': tf.where(is_good, bins, tf.zeros_like(bins)),
            'tool': tf.where(is_good, tool, tf.zeros_like(tool)),
            'status': tf.where(is_good, STATUS['ok'], STATUS['refused']),
        }

    def step(self, bins, tool, pose, position_low, dt):
        """The tool goes straight to its next pose; what cannot be leaves the state as it is, and
        the loads are again those of the frame before.

        Args:
          bins, tool: the state.
          pose, position_low: see `start`.
          dt: float32 [], s.

        Returns:
          dict of the state, `next_bins` and `next_tool`; `force` [3] (N) and `torque` [3] (N m)
          about the tool's reference point, world; `bound` [] (N) of the force error, where the
          model has one; `status` []; `outside` [S], by how much each scalar of the frame leaves
          its training range.
        """
        field = self.field
        bins, tool, is_whole = field_state.sane(bins, tool)
        next_bins, next_tool, is_good = self._moved(bins, tool, pose, position_low, dt)
        is_good &= is_whole
        bins, tool = tf.where(is_good, next_bins, bins), tf.where(is_good, next_tool, tool)
        frame = self._frame(bins, tool)
        loads = field.network.force(frame.bins, frame.scalars, self.members)
        loads = tf.where(is_whole, loads, tf.zeros_like(loads))
        force, torque = field.axes.world_loads(tf.reduce_mean(loads, axis=0)[0], tensors)
        least, most = self._limits
        scalars = frame.scalars[0]
        outside = tf.maximum(tf.maximum(least - scalars, scalars - most), 0.0)
        status = tf.where(tf.reduce_any(outside > 0), STATUS['extrapolating'], STATUS['ok'])
        status = tf.where(field_state.is_sane(loads), status, STATUS['non_finite'])
        found = {
            'next_bins': bins,
            'next_tool': tool,
            'force': force,
            'torque': torque,
            'status': tf.where(is_good, status, STATUS['refused']),
            'outside': outside,
        }
        if (weights := field.calibration.get('force')) is not None:
            spread, size = (f(loads[..., :2], tensors) for f in (quality.spread, quality.size))
            found['bound'] = quality.bound(spread, size, weights, tensors)[0]
        return found

    def particles(self, bins, tool, rest):
        """Where particles are in the newest frame; none of those that moved is inside the tool.

        Args:
          bins, tool: the state.
          rest: float32 [P, 3], m, where they were at the start.

        Returns:
          dict of `particles` [P, 3], m; what is not finite of `rest` comes back as it is.
        """
        field = self.field
        bins, tool, is_whole = field_state.sane(bins, tool)
        state, _ = field_state.unpacked(bins, tool)
        width, level = tool[AT['width']], tool[AT['level']]
        is_sane = tf.reduce_all(tf.abs(rest) <= LARGEST, axis=1, keepdims=True) & is_whole
        places = field.axes.points(tf.where(is_sane, rest, 0.0), tensors)
        frame = self._frame(bins, tool)
        local = places - tf.stack([tool[AT['origin']], level, 0.0])
        moved = field.network.displacement(frame.bins, frame.scalars, local[None], self.members)
        # As `FieldSoil`: those that rest stay as they were given, to the last bit.
        has_moved = tf.reduce_any(moved[:, 0] != 0.0, axis=[0, 2])[:, None]
        moved = tf.reduce_mean(moved, axis=0)[0]
        pose = tf.concat([state.swept.position[0], state.lean], axis=0)
        _, way = soil_physics.inside(places + moved, pose, field.tool, width, tensors)
        shift = field.axes.world(moved + way, tensors)
        return {'particles': tf.where(has_moved & is_sane, rest + shift, rest)}

    def _moved(self, bins, tool, pose, position_low, dt):
        """`bins` and `tool` at the next pose, and whether a tool can go there."""
        field = self.field
        state, low = field_state.unpacked(bins, tool)
        place = field.axes.poses(pose[None], tensors)
        next_low = field.axes.local(position_low, tensors)[None, :2]
        move = place[:, :2] - state.swept.position + (next_low - low)
        ends = (state.swept.position, low), (place[:, :2], next_low)
        finer = swept_features.Finer(move, tuple(self._away(tool, *end) for end in ends))
        after = tool_path.advance(field.grid, state, place, dt, tensors, finer)
        bed = Bed(state.swept.surface, tool[AT['level']][None], tool[AT['end']][None])
        width, floor, origin_low = tool[AT['width']], tool[AT['floor']], tool[AT['origin_low']]
        then = field_state.packed(
            field.grid, after, origin_low[None], next_low[0], width, bed, floor
        )
        is_good = _is_pose(pose, position_low) & (dt > 0) & field_state.is_sane(dt)
        return *then, is_good & self._is_reachable(state, place, move, tool, dt)

    def _away(self, tool, position, low):
        """[1, n] from a centre [1, 2], of which `low` is what float32 cuts off, to the bins, m."""
        offsets = self.field.grid.offsets
        high = offsets.astype(np.float32)
        origin, origin_low = tool[AT['origin']], tool[AT['origin_low']]
        gone, cut_off = field_state.difference(position[:, :1], origin)
        rest = cut_off + (low[:, :1] - origin_low)
        return (high - gone) + ((offsets - high).astype(np.float32) - rest)

    def _is_reachable(self, state, place, move, tool, dt):
        """Bool []: as `LiveField` asks, and within the bins."""
        blade, swept = self.field.tool, state.swept
        turn = tf.abs(place[0, 2] - state.lean[0])
        leaves = swept_features.leaves_bins(self.field.grid, swept, place[:, :2])[0]
        return (
            (tensors.hypot(move[0, 0], move[0, 1]) <= live.FASTEST * dt)
            & (turn <= live.FASTEST_TURN * dt)
            & (place[0, 1] - blade.radius >= tool[AT['floor']])
            & ~leaves
        )

    def _frame(self, bins, tool):
        """`Frame` of [1, ...] of a state."""
        state, _ = field_state.unpacked(bins, tool)
        width, level, end = (tool[AT[name]][None] for name in ('width', 'level', 'end'))
        bed = Bed(state.swept.surface, level, end)
        return tool_path.frame(self.field.grid, bed, width, state, tensors)

    def signatures(self) -> dict[str, dict[str, tf.TensorSpec]]:
        """Name of a function -> its inputs by name."""
        n = len(self.field.grid.offsets)
        state = {'bins': [len(BINS), n], 'tool': [len(TOOL)]}
        pose = {'pose': [7], 'position_low': [3]}
        bed = {'width': [], 'surface': [n], 'level': [], 'end': [], 'floor': []}
        shapes: dict[str, dict[str, list[int]]] = {
            'start': pose | {'velocity': [6]} | bed,
            'step': state | pose | {'dt': []},
            'particles': state | {'rest': [self.n_particles, 3]},
        }
        return {
            function: {name: tf.TensorSpec(s, tf.float32, name=name) for name, s in rows.items()}
            for function, rows in shapes.items()
        }

    def describe(self, kind: str) -> dict:
        """What a user of the exported model must know; JSON-able."""
        return field_description.describe(self, kind)

    def concrete(self, kind: str) -> dict:
        """Name -> concrete function of a format; those of a SavedModel are compiled by XLA."""
        compiled = kind == 'savedmodel' or None
        if kind not in self._concrete:
            self._concrete[kind] = {
                name: tf.function(
                    getattr(self, name), autograph=False, jit_compile=compiled
                ).get_concrete_function(**specs)
                for name, specs in self.signatures().items()
            }
        return self._concrete[kind]


def _is_pose(pose, position_low):
    """Bool []: as `live.poses` asks; float32 cuts less than this off any place in a scene."""
    length = tf.sqrt(tf.reduce_sum(pose[3:] ** 2))
    is_unit = tf.abs(length - 1.0) <= UNIT_TOLERANCE
    return field_state.is_sane(pose) & is_unit & tf.reduce_all(tf.abs(position_low) <= 1e-3)
