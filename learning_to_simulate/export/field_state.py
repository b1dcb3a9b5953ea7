"""The state of an exported swept field: what it knows of its tool, as two float32 tensors.

Float32 resolves 6e-8 m within a metre. That is enough of a position and too little of a difference:
of a velocity over a short frame, and of which bins the upright edge of the circle has reached. So
the state keeps what float32 cuts off places, and of a wheel off its turns and off all that is
summed up over frames.
"""

import abc

import numpy as np
import tensorflow as tf

STATUS = {'ok': 0, 'extrapolating': 1, 'non_finite': 2, 'refused': 3}
# No scene is larger, m, and no tool faster, m/s: what is beyond is refused, as NaN is.
LARGEST = 1e6


class Form(abc.ABC):
    """What `FieldFunctions` asks of a tool. The first value of every state is 1.

    Attributes:
      bins, tool: names of the rows and of the values of the state, `origin` (m, along the way) and
        `level` (m) among them.
      at: name of such a value -> its place.
      start_inputs, pose_inputs, step_inputs: name -> shape of inputs of `start` alone, of whatever
        takes a pose, and of `step` alone, beside those that all tools have.
      meaning: name of an input or output -> what it is, where that is the tool's own.
      refused: what is, beside what of all tools is.
    """

    bins: tuple[str, ...]
    tool: tuple[str, ...]
    start_inputs: dict[str, list[int]]
    pose_inputs: dict[str, list[int]] = {}
    step_inputs: dict[str, list[int]] = {}
    meaning: dict[str, str]
    refused = ''

    def __init__(self, field, members: int):
        self.field, self.members = field, members

    @property
    def at(self) -> dict[str, int]:
        """See above."""
        return {name: i for i, name in enumerate(self.tool)}

    @abc.abstractmethod
    def own_inputs(self, size, context) -> dict:
        """`start_inputs` of a size [S] (see `swept_field.tools`) and a context [C]."""

    @abc.abstractmethod
    def begun(self, given: dict) -> tuple:
        """`bins`, `tool` of a tool that has not moved, and whether there can be one; given: the
        inputs of `start`."""

    @abc.abstractmethod
    def moved(self, bins, tool, given: dict) -> tuple:
        """`bins`, `tool` at the next pose, and whether a tool can go there; given: the inputs of
        `step`."""

    @abc.abstractmethod
    def frame(self, bins, tool):
        """`Frame` of [1, ...] of a state."""

    @abc.abstractmethod
    def way_out(self, tool, points):
        """The shortest way [P, 3] out of the tool of points [P, 3], m; as `soil_physics.inside`."""

    def outputs(self, tool) -> dict:
        """What `step` gives of a state beside what it gives of all tools."""
        return {}


def is_sane(values):
    """Bool []: no NaN, nothing infinite or huge."""
    return tf.reduce_all(tf.abs(values) <= LARGEST)


def difference(one, other):
    """A difference, and exactly what float32 cuts off it (Knuth 1997, TAOCP 2, 4.2.2)."""
    found = one - other
    back = found - one
    return found, (one - (found - back)) - (other + back)


def added(high, low, more):
    """A sum, and what float32 cuts off it: high and low, and more on top."""
    found, cut_off = difference(high, -more)
    return difference(found, -(cut_off + low))


def gone(place, low, origin, origin_low):
    """How far a place is from the origin, m, and what float32 cuts off that; low: off both."""
    found, cut_off = difference(place, origin)
    return found, cut_off + (low - origin_low)


def edge(grid, distance, radius):
    """[1, n] how far the bins lie within a circle, as `swept_features.Finer` has it, m.

    Args:
      grid: the bins.
      distance: `gone` of the circle's centre, [1, 1] each.
      radius: of it and what float32 cuts off that, m.
    """
    high = grid.offsets.astype(np.float32)
    away, cut_off = difference(tf.constant(high[None]), distance[0])
    cut_off += (grid.offsets - high).astype(np.float32) - distance[1]
    return (radius[0] - tf.abs(away)) + (radius[1] - tf.sign(away) * cut_off)


def sane(bins, tool):
    """The state, zeros in place of one that `start` did not make, and which of both it is: places
    that are not finite must not become indices of bins."""
    is_whole = is_sane(bins) & is_sane(tool) & (tool[0] == 1.0)
    return *(tf.where(is_whole, x, tf.zeros_like(x)) for x in (bins, tool)), is_whole
