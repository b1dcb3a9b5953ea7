"""Poses of a rigid body: what a user says, and the particles that the models take.

A pose is a position (m) of the body's reference point (of models in the subspace the centroid of
its particles; of soil fields: docs/axes.md), and a rotation from the body's own frame. It is given
as one of

  (x, y, z, qw, qx, qy, qz)     with a quaternion, scalar first
  ((x, y, z), (qw, qx, qy, qz)) the same as a pair
  (x, height, angle)            of a body that moves in the plane of drive and height; angle in rad,
                                from the drive axis towards the height axis

Inside, poses are float64 [7] of the first form.
"""

import math

import numpy as np

from learning_to_simulate.axes import rotation_rows

# What a unit quaternion may be off by before it is taken for something else.
UNIT_TOLERANCE = 1e-3
LARGEST = float(np.finfo(np.float32).max)  # the models compute in float32


def numbers(name: str, values, *shapes: tuple) -> np.ndarray:
    """A float64 copy of what a user gives, of one of some shapes (None: any length). ValueError
    that says what is wrong: not real numbers (texts, dates, Booleans, complex or masked values),
    another shape, or values that are not finite in float32."""
    try:
        array = np.asanyarray(values)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{name} is not an array of numbers ({error})') from error
    if isinstance(array, np.ma.MaskedArray) or array.dtype.kind not in 'fiu':
        kind = 'masked' if isinstance(array, np.ma.MaskedArray) else array.dtype
        raise ValueError(f'{name} is not an array of numbers: real ones are taken, not {kind}')
    if not any(
        len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape))
        for shape in shapes
    ):
        allowed = ' or '.join(str(shape).replace('None', 'any') for shape in shapes)
        raise ValueError(f'{name} has shape {array.shape}, must be {allowed}')
    array = np.array(array, np.float64)
    good = np.abs(array) <= LARGEST  # false for NaN as well
    if not good.all():
        where = tuple(int(i) for i in np.argwhere(~good)[0])
        raise ValueError(f'{name} holds {array[where]} at {where}, must be finite in float32')
    return array


def read_pose(pose, up_axis: int, lateral: float) -> np.ndarray:
    """float64 [7] of a pose in any of its forms; a body of the plane stands at `lateral` across it,
    m. ValueError for what is no pose."""
    if isinstance(pose, (tuple, list)) and len(pose) == 2:
        position, rotation = numbers('position', pose[0], (3,)), pose[1]
        return np.concatenate([position, _unit(numbers('quaternion', rotation, (4,)))])
    values = numbers('pose', pose, (7,), (3,))
    if len(values) == 7:
        return np.concatenate([values[:3], _unit(values[3:])])
    drive = 0 if up_axis else 1
    position = np.empty(3)
    position[[drive, up_axis, 3 - up_axis - drive]] = values[0], values[1], lateral
    about = np.cross(np.eye(3)[drive], np.eye(3)[up_axis])
    turn = np.append(np.cos(values[2] / 2), np.sin(values[2] / 2) * about + 0.0)  # without -0
    return np.concatenate([position, turn])


def read_velocity(velocity) -> np.ndarray:
    """Linear (m/s) and angular (rad/s) velocity in the world's axes, float64 [6], of [6], of a
    linear one [3], or of None for a body at rest."""
    values = np.zeros(3) if velocity is None else numbers('velocity', velocity, (6,), (3,))
    return np.pad(values, (0, 6 - len(values)))


def _unit(quaternion):
    length = np.linalg.norm(quaternion)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise ValueError(f'quaternion has length {length:.6g}, must be 1')
    return quaternion / length


def rotation_matrix(quaternion) -> np.ndarray:
    """float64 [..., 3, 3] of unit quaternions [..., 4] (w, x, y, z)."""
    rows = rotation_rows(*np.moveaxis(np.asarray(quaternion, np.float64), -1, 0))
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def turned(quaternion, rotation) -> np.ndarray:
    """A quaternion [4] (w, x, y, z) after a further rotation by a vector [3], rad."""
    x, y, z = (float(value) for value in rotation)  # numbers: arrays take five times as long
    angle = math.sqrt(x * x + y * y + z * z)
    share = math.sin(angle / 2) / max(angle, 1e-300)
    w, x, y, z = math.cos(angle / 2), share * x, share * y, share * z
    a, b, c, d = (float(value) for value in quaternion)
    return np.array([
        w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
        w * c + y * a + z * b - x * d, w * d + z * a + x * c - y * b,
    ])  # fmt: skip


def placed(body, pose) -> np.ndarray:
    """Particles [R, 3], m, of a body [R, 3] in its own frame, at a pose [7]."""
    return body @ rotation_matrix(pose[3:]).T + pose[:3]


def moved_back(pose, velocity, seconds: float) -> np.ndarray:
    """The pose [7] of `seconds` ago, of a body whose velocity [6] was constant."""
    shift, turn = -seconds * np.reshape(velocity, (2, 3))
    return np.concatenate([pose[:3] + shift, turned(pose[3:], turn)])


def quaternion_of(matrix) -> np.ndarray:
    """The unit quaternion (w, x, y, z), w >= 0, of a rotation matrix [3, 3]."""
    from scipy.spatial.transform import Rotation  # slow to load, and few scenes need it

    x, y, z, w = Rotation.from_matrix(matrix).as_quat(canonical=True)
    return np.array([w, x, y, z])
