"""Height and shape of a body: where the height is predicted, the rest is given without it.

Without TensorFlow, so that statistics and judgements can use it; TensorFlow's mean is handed in.
"""

import numpy as np


def up_vector(dim: int, up_axis: int) -> np.ndarray:
    """float32 [D], 1 along the axis against gravity."""
    return np.eye(dim, dtype=np.float32)[up_axis]


def without_height(values, up_axis: int, mean=np.mean):
    """Values [..., R, D] of the particles of a body less the mean of their up component, which is
    the body's height or its change."""
    return values - up_vector(values.shape[-1], up_axis) * mean(values, axis=-2, keepdims=True)


def height_of(values, up_axis: int, mean=np.mean, axis: int = -1):
    """Mean of the up component [...] of values [..., R, D] of the particles of a body; `axis` is
    that of the particles where others lie between them and the components."""
    return mean(values[..., up_axis], axis=axis)
