"""The rigid body in a frame: what is given of its motion, and the correction that keeps a
predicted one rigid."""

from typing import NamedTuple

import tensorflow as tf

from learning_to_simulate.axes import rotation_rows, without_height
from learning_to_simulate.scene import RigidMotion, Scene


class KnownMotion(NamedTuple):
    """What is given of the coming frame of the rigid body, and of its run so far.

    Where the motion is driven, the up component holds the shape only: its mean over the R particles
    is 0, and the predicted height is added to it.
    """

    offset: tf.Tensor  # float32 [B, R, D], m
    velocity: tf.Tensor  # float32 [B, R, D], m/frame
    # For models that have the path as an input: `path_memory` of the coming frame, float32 [B, P],
    # and the offset of the modes in the last given frame, float32 [B, r, D], m.
    path: tf.Tensor | None = None
    start: tf.Tensor | None = None

    def at(self, frame) -> 'KnownMotion':
        """One frame of a motion whose fields but `start` have a leading axis of frames."""
        path = None if self.path is None else self.path[frame]
        return KnownMotion(self.offset[frame], self.velocity[frame], path, self.start)


def known_motion(offset, velocity, scene: Scene) -> KnownMotion | None:
    """The given part of true rigid motion: all of it, or all but the mean height of a driven body;
    None where nothing is given. Of [..., R, D] offsets from the origin and displacements of the
    frame, numpy or TensorFlow."""
    if not scene.rigid_motion.is_known:
        return None
    if scene.rigid_motion == RigidMotion.DRIVEN:
        offset, velocity = (
            without_height(x, scene.up_axis, tf.reduce_mean) for x in (offset, velocity)
        )
    return KnownMotion(offset, velocity)


def rigid_correction(shape, position):
    """Nearest rigid placement float64 [B, R, D] of a body to predicted particles (Usmani &
    Skonieczny 2023, Algorithm 3), both float64 [B, R, D]; `shape` is relative to its centroid in a
    reference frame.

    Horn's quaternion form (J. Opt. Soc. Am. A 4, 1987) instead of an SVD: its result is a proper
    rotation for coplanar bodies too, and XLA compiles it. The thesis places the particles of the
    frame before; placing the body's first shape is the same map without the drift of the shape.
    """
    # S = sum over particles of a b^T: a of the shape, b of the predicted ones about their mean.
    centroid = tf.reduce_mean(position, axis=1, keepdims=True)
    s = tf.einsum('bri,brj->bij', shape, position - centroid)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (
        tf.unstack(row, axis=-1) for row in tf.unstack(s, axis=1)
    )
    # Horn's 4 x 4 matrix N of S: q^T N q is largest for the quaternion q of the best rotation, the
    # eigenvector of the largest eigenvalue (`eigh` lists it last).
    rows = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
    _, vectors = tf.linalg.eigh(tf.stack([tf.stack(row, -1) for row in rows], 1))
    rows = rotation_rows(*tf.unstack(vectors[..., -1], axis=-1))
    rotation = tf.stack([tf.stack(row, -1) for row in rows], 1)
    # x' = mean(b) + R a.
    return centroid + tf.einsum('bij,brj->bri', rotation, shape)


def shape_of(offset, layout, scene: Scene):
    """Shape float64 [B, R, D], m, relative to its centroid, of bodies whose motion is predicted,
    which they keep; of offsets float32 [B, V, D] of the nodes of a `Layout`. None of others."""
    if scene.rigid_motion != RigidMotion.PREDICTED:
        return None
    n = layout.n_rigid
    position = tf.cast(offset[:, :n], tf.float64) + layout.origin[:n]
    return position - tf.reduce_mean(position, axis=1, keepdims=True)
