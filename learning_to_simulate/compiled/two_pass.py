"""Two passes over the same code: what is known ahead of the loop, and what is left for it.

The code of a model is written once, as named calls whose arguments are values of one frame. In the
first pass the values of all frames that are known ahead (the prescribed motion of a body, the
context) go through it as one large batch, and every call that needs anything else is skipped. In
the loop the results of the first pass are read by frame, and only the skipped calls run.
"""

import tensorflow as tf

# A result of the first pass that is larger than this is computed in the loop instead: reading it
# back from memory would cost as much, and a batch of long rollouts would not fit.
LARGEST_AHEAD = 2**24  # bytes; fits the caches
# So is one that is larger per frame: its products are large enough in the loop, where the rows stay
# in the caches. Measured: with the 400 rigid pairs of a full graph (200 kB) ahead, a whole rollout
# was slower than the plain one; with the 160 pairs of rigid particles and modes (80 kB), faster.
LARGEST_FRAME = 2**17  # bytes


class AheadPass:
    """First pass: runs the calls whose arguments are all known.

    Args:
      n_frame: T'; the values of the pass have T' * B as their leading axis.
    """

    def __init__(self, n_frame: int):
        self._n_frame = n_frame
        self.results: dict = {}

    def __call__(self, name: str, function, *args):
        """`function(*args)`, or None if an argument is None (not known ahead)."""
        if any(a is None for a in args):
            return None
        result = function(*args)
        leaves = tf.nest.flatten(result)
        size = sum(4 * x.shape.num_elements() for x in leaves)
        if size > min(LARGEST_AHEAD, self._n_frame * LARGEST_FRAME):
            return None
        self.results[name] = tf.nest.map_structure(
            lambda x: tf.reshape(x, [self._n_frame, -1, *x.shape[1:]]), result
        )
        return result


class FramePass:
    """Pass of one frame: reads what the first pass left, and runs the rest.

    Args:
      results: of an `AheadPass`; {} runs every call.
      frame: int tensor, the frame to read.
    """

    def __init__(self, results: dict, frame):
        self._results, self._frame = results, frame

    def __call__(self, name: str, function, *args):
        """The value of the call; results of the first pass stay unread until a call needs them."""
        if name in self._results:
            return _Ahead(self._results[name], self._frame)
        return function(*map(self.read, args))

    def read(self, value):
        """The tensors of what a call returned."""
        return value.read() if isinstance(value, _Ahead) else value


class _Ahead:
    """A result of the first pass, read when it is needed."""

    def __init__(self, result, frame):
        self._result, self._frame = result, frame

    def read(self):
        return tf.nest.map_structure(lambda x: x[self._frame], self._result)
