"""What the exported functions know of a blade."""

import numpy as np
import tensorflow as tf

from learning_to_simulate.export import field_state
from learning_to_simulate.methods import swept_features, tensors
from learning_to_simulate.methods.swept_features import SweptBed
from learning_to_simulate.methods.swept_field import live, soil_physics, tool_path
from learning_to_simulate.methods.swept_field.tool_path import Bed, ToolState

_MEMORY = tuple(
    f'{name}_{i}' for i in range(len(tool_path.TIME_SCALES)) for name in ('speed', 'rise', 'turn')
)


class BladeForm(field_state.Form):
    """See `Form`."""

    bins = ('surface', 'profile', 'since', 'area_before')
    tool = (
        'started', 'origin', 'origin_low', 'u', 'height', 'lean', 'u_low', 'height_low',
        'speed', 'rise', 'turn', *_MEMORY, 'foremost', 'width', 'level', 'end', 'floor',
    )  # fmt: skip
    start_inputs = {'width': []}
    meaning = {
        'pose': 'position (m) and unit quaternion (w, x, y, z) of the middle of the lower edge, as '
        'rigid_pose of the dataset',
        'width': 'of the blade, m',
    }  # fmt: skip

    def own_inputs(self, size, context):
        """See `Form`."""
        return {'width': size[0]}

    def begun(self, given):
        """See `Form`."""
        axes, grid, width = self.field.axes, self.field.grid, given['width']
        place = axes.poses(given['pose'][None], tensors)  # tf2onnx's angle of a scalar is a vector
        bed = Bed(given['surface'][None], given['level'][None], place[:, 0] + given['end'])
        velocity = self.field.tool.velocity(axes, given['velocity'], None, tensors)[None]
        state = tool_path.start(grid, bed, place, velocity, tensors)
        low = axes.local(given['position_low'], tensors)[:2]
        return *self._packed(state, low[:1], low, width, bed, given['floor']), width > 0

    def moved(self, bins, tool, given):
        """See `Form`."""
        field, at, dt = self.field, self.at, given['dt']
        state, low = self._unpacked(bins, tool)
        place = field.axes.poses(given['pose'][None], tensors)
        next_low = field.axes.local(given['position_low'], tensors)[None, :2]
        move = place[:, :2] - state.swept.position + (next_low - low)
        ends = (state.swept.position, low), (place[:, :2], next_low)
        finer = swept_features.Finer(move, tuple(self._edge(tool, *end) for end in ends))
        after = tool_path.advance(field.grid, state, place, dt, tensors, finer)
        bed = Bed(state.swept.surface, tool[at['level']][None], tool[at['end']][None])
        width, floor, origin_low = tool[at['width']], tool[at['floor']], tool[at['origin_low']]
        then = self._packed(after, origin_low[None], next_low[0], width, bed, floor)
        return *then, self._is_reachable(state, place, move, floor, dt)

    def _edge(self, tool, position, low):
        """[1, n] `field_state.edge` about a centre [1, 2], of which `low` is what float32 cuts
        off."""
        origin, origin_low = (tool[self.at[name]] for name in ('origin', 'origin_low'))
        distance = field_state.gone(position[:, :1], low[:, :1], origin, origin_low)
        high = np.float32(self.field.tool.radius)
        radius = high, np.float32(self.field.tool.radius - high)
        return field_state.edge(self.field.grid, distance, radius)

    def _is_reachable(self, state, place, move, floor, dt):
        """Bool []: as `LiveField` asks, and within the bins."""
        blade, swept = self.field.tool, state.swept
        turn = tf.abs(place[0, 2] - state.lean[0])
        leaves = swept_features.leaves_bins(self.field.grid, swept, place[:, :2])[0]
        return (
            (tensors.hypot(move[0, 0], move[0, 1]) <= live.FASTEST * dt)
            & (turn <= live.FASTEST_TURN * dt)
            & (place[0, 1] - blade.radius >= floor)
            & ~leaves
        )

    def frame(self, bins, tool):
        """See `Form`."""
        state, _ = self._unpacked(bins, tool)
        width, level, end = (tool[self.at[name]][None] for name in ('width', 'level', 'end'))
        bed = Bed(state.swept.surface, level, end)
        return tool_path.frame(self.field.grid, bed, width, state, tensors)

    def way_out(self, tool, points):
        """See `Form`."""
        pose = tool[self.at['u'] : self.at['u'] + 3]
        width = tool[self.at['width']]
        return soil_physics.inside(points, pose, self.field.tool, width, tensors)[1]

    def _packed(self, state: ToolState, origin_low, low, width, bed: Bed, floor):
        """`bins` [4, n] and `tool` [K]; low [2] and origin_low [1] as of `position_low`, along
        and up.

        Distances are counted from now, so that they keep their digits however far the tool goes.
        """
        swept = state.swept
        since = tf.minimum(swept.travelled[:, None] - swept.last, self.field.grid.forget)
        bins = tf.concat([swept.surface, swept.profile, since, state.area_before], axis=0)
        tool = tf.concat(
            [
                tf.ones([1]), swept.origin, origin_low, swept.position[0], state.lean, low,
                state.velocity[0],
                *(state.memory[0, i] for i in range(len(tool_path.TIME_SCALES))),
                swept.foremost, width[None], bed.level, bed.end, floor[None],
            ],
            axis=0,
        )  # fmt: skip
        return bins, tool

    def _unpacked(self, bins, tool):
        """`ToolState` of one tool, and low [2]."""

        def of(first, count=1):
            return tool[self.at[first] : self.at[first] + count][None]

        swept = SweptBed(
            origin=of('origin')[0],
            surface=bins[:1],
            profile=bins[1:2],
            last=-bins[2:3],
            position=of('u', 2),
            velocity=of('speed', 2),
            travelled=tf.zeros([1]),
            foremost=of('foremost')[0],
        )
        memory = tf.reshape(of('speed_0', len(_MEMORY)), [1, len(tool_path.TIME_SCALES), 3])
        state = ToolState(swept, of('lean')[0], of('speed', 3), memory, bins[3:])
        return state, of('u_low', 2)
