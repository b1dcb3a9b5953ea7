"""The state of an exported swept field: what it knows of its tool, as two float32 tensors.

Float32 resolves 6e-8 m within a metre. That is enough of a position and too little of a difference:
of a velocity over a short frame, and of which bins the upright edge of the circle has reached. So
the state keeps what float32 cuts off the places along the way and up.
"""

import tensorflow as tf

from learning_to_simulate.methods.swept_features import SweptBed
from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.methods.swept_field.tool_path import Bed, ToolState

STATUS = {'ok': 0, 'extrapolating': 1, 'non_finite': 2, 'refused': 3}
# Rows of the state's `bins` and values of its `tool`.
BINS = ('surface', 'profile', 'since', 'area_before')
_MEMORY = tuple(
    f'{name}_{i}' for i in range(len(tool_path.TIME_SCALES)) for name in ('speed', 'rise', 'turn')
)
TOOL = (
    'started', 'origin', 'origin_low', 'u', 'height', 'lean', 'u_low', 'height_low',
    'speed', 'rise', 'turn', *_MEMORY, 'foremost', 'width', 'level', 'end', 'floor',
)  # fmt: skip
AT = {name: i for i, name in enumerate(TOOL)}
# No scene is larger, m, and no tool faster, m/s: what is beyond is refused, as NaN is.
LARGEST = 1e6


def is_sane(values):
    """Bool []: no NaN, nothing infinite or huge."""
    return tf.reduce_all(tf.abs(values) <= LARGEST)


def difference(one, other):
    """A difference, and exactly what float32 cuts off it (Knuth 1997, TAOCP 2, 4.2.2)."""
    found = one - other
    back = found - one
    return found, (one - (found - back)) - (other + back)


def sane(bins, tool):
    """The state, zeros in place of one that `start` did not make, and which of both it is: places
    that are not finite must not become indices of bins."""
    is_whole = is_sane(bins) & is_sane(tool) & (tool[AT['started']] == 1.0)
    return *(tf.where(is_whole, x, tf.zeros_like(x)) for x in (bins, tool)), is_whole


def packed(grid, state: ToolState, origin_low, low, width, bed: Bed, floor):
    """`bins` [4, n] and `tool` [K]; low [2] and origin_low [1] as of `position_low`, along
    and up.

    Distances are counted from now, so that they keep their digits however far the tool goes.
    """
    swept = state.swept
    since = tf.minimum(swept.travelled[:, None] - swept.last, grid.forget)
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


def unpacked(bins, tool):
    """`ToolState` of one tool, and low [2]."""

    def of(first, count=1):
        return tool[AT[first] : AT[first] + count][None]

    zero = tf.zeros([1])
    swept = SweptBed(
        origin=of('origin')[0],
        surface=bins[:1],
        profile=bins[1:2],
        last=-bins[2:3],
        position=of('u', 2),
        velocity=of('speed', 2),
        travelled=zero,
        foremost=of('foremost')[0],
    )
    memory = tf.reshape(of('speed_0', len(_MEMORY)), [1, len(tool_path.TIME_SCALES), 3])
    return ToolState(swept, of('lean')[0], of('speed', 3), memory, bins[3:]), of('u_low', 2)
