"""The few functions of numpy that path features are written in, on TensorFlow tensors.

A function that takes `xp`, numpy or this module, is one definition for both. Tensors keep the type
that they have, float32 or float64; shapes are static. What such a function refuses in numpy a graph
cannot: whoever builds the graph looks at the values in it. All operations here have a form in
LiteRT and in ONNX.
"""

import tensorflow as tf

abs = tf.abs  # numpy's names, here as there
sqrt, exp, sin, cos, sign = tf.sqrt, tf.exp, tf.sin, tf.cos, tf.sign
arctan2, minimum, clip, where = tf.atan2, tf.minimum, tf.clip_by_value, tf.where
stack, broadcast_to, ones_like, zeros_like = tf.stack, tf.broadcast_to, tf.ones_like, tf.zeros_like
any, sum, mean, std = tf.reduce_any, tf.reduce_sum, tf.reduce_mean, tf.math.reduce_std


class _Maximum:
    """`numpy.maximum`, which is called and which accumulates."""

    def __call__(self, one, other):
        return tf.maximum(one, other)

    def accumulate(self, values, axis: int):
        """Largest of all values [B, n] so far along axis 1; log2 n steps, no loop."""
        if axis != 1:
            raise ValueError(f'axis is {axis}, only 1 is accumulated along')
        reach = 1
        while reach < values.shape[1]:
            before = tf.concat([values[:, :reach], values[:, :-reach]], axis=1)
            values, reach = tf.maximum(values, before), 2 * reach
        return values


maximum = _Maximum()


def asarray(values, dtype=None):
    """The values as they are: the type is that of the graph."""
    return tf.convert_to_tensor(values)


def concatenate(values, axis):
    return tf.concat(values, axis)


def full_like(values, value):
    return tf.fill(values.shape, tf.constant(value, values.dtype))


def hypot(one, other):
    return tf.sqrt(one**2 + other**2)


def tan(angle):
    return tf.sin(angle) / tf.cos(angle)  # LiteRT has none


def dot(one, other):
    """Product of [..., n] with a vector [n]."""
    return tf.reduce_sum(one * other, axis=-1)
