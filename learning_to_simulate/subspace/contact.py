"""Where a body touches no soil it feels none: the share of its force that a body may show.

A network alone shows a few newtons in the air. The modes say where the soil ends: the height of the
surface at places along the way is nearly linear in their scores, and soil stands no steeper than a
heap does. So the clearance of a body is one product and a minimum, a function of a frame alone.

It is fitted to the training runs, where some of them take the tool out of the soil, and is kept in
the model's statistics.
"""

import dataclasses

import numpy as np
import tensorflow as tf

from learning_to_simulate.axes import Axes
from learning_to_simulate.scene import RigidMotion
from pca_tools.subspace import Subspace

PLACES = 32
SLOPE = 0.5  # m per m: soil so far away counts as so much lower
RAMP = 0.005  # m of clearance over which the force fades
# A force below this share of the root mean square one counts as none.
NONE_BELOW = 0.01
# Largest share of the frames with a force that lies above the clearance. A gate that a smaller
# share of all frames than the second is beyond would do nothing but harm.
LOST, LEAST_CLEAR = 0.001, 0.01
STRIDE = 8  # of the training frames whose surface is looked at
RIDGE = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class Contact:
    """Reads the clearance of a body from its particles and the modes."""

    axis: int  # of the way
    up: int  # against gravity
    clear: float  # m, the clearance from which the force fades; after `RAMP` more it is exactly 0
    places: np.ndarray  # float32 [P], m, along the way
    heights: np.ndarray  # float32 [P], m, of the surface at the modes' origin
    weights: np.ndarray  # float32 [r, D, P], its change with their offsets

    @classmethod
    def of_statistics(cls, contact, surface, scene) -> 'Contact':
        surface = np.asarray(surface, np.float32)
        weights = surface[:, 2:].T.reshape(scene.n_modes, -1, len(surface))
        axis, clear = map(float, contact)
        return cls(int(axis), scene.up_axis, clear, surface[:, 0], surface[:, 1], weights)

    def to_statistics(self) -> dict[str, np.ndarray]:
        """`contact` [2], axis and clearance, and `surface` [P, 2 + r D], places, heights and
        weights."""
        flat = self.weights.reshape(-1, len(self.places)).T
        surface = np.concatenate([self.places[:, None], self.heights[:, None], flat], axis=1)
        return {'contact': np.array([self.axis, self.clear]), 'surface': surface.astype(float)}

    def clearance(self, body, modes, total=np.sum, least=np.min):
        """[B] m, of the body above the soil about it; negative where it is in it.

        Args:
          body: [B, R, D] particles of the body that are nodes, m.
          modes: [B, r, D] offsets of the modes from their origin, m.
          total, least: sum and minimum over axes, of numpy or TensorFlow.
        """
        # s_p = h_p + sum over modes and axes of w_p x: the surface at place p, linear in the modes.
        heights = self.heights + total(modes[..., None] * self.weights, axis=(-3, -2))
        # min over particles b and places p of y_b - s_p + SLOPE |u_b - p|.
        apart = abs(body[..., self.axis, None] - self.places)
        above = body[..., self.up, None] - heights[:, None] + np.float32(SLOPE) * apart
        return least(above, axis=(-2, -1))

    def share(self, body, modes):
        """Tensor [B] in [0, 1], of a force; arguments are tensors as of `clearance`."""
        # 1 up to `clear`, then down to 0 along RAMP.
        clearance = self.clearance(body, modes, tf.reduce_sum, tf.reduce_min)
        end = np.float32(self.clear + RAMP)
        return tf.clip_by_value((end - clearance) / np.float32(RAMP), 0.0, 1.0)


def fit(groups, subspace: Subspace, origin, scene) -> Contact | None:
    """The reader for training runs (list of `RunGroup`), with the subspace of the modes that are
    nodes and their origin [r, D], m. None where there is nothing to find: no force, not one body
    whose whole motion is given, or tools that hardly leave the soil."""
    is_one = scene.rigid_motion == RigidMotion.PRESCRIBED and not scene.bodies
    if not is_one or not scene.has_force:
        return None
    bodies = [g.position[:, :, : g.n_rigid] for g in groups]
    offsets = [g.position[:, :, g.n_rigid :] - origin for g in groups]
    axes = Axes.of_bodies(bodies, scene.up_axis)
    rows = np.concatenate([x[:, ::STRIDE].reshape(-1, *x.shape[2:]) for x in offsets])
    places, heights_of = _surface(subspace, origin, axes, bodies)
    inputs = rows.reshape(len(rows), -1)
    mean, std = inputs.mean(axis=0), inputs.std(axis=0)
    std = np.where(std > 0, std, np.inf)  # what never moves says nothing
    heights = np.stack([heights_of(x) for x in rows])
    if np.isnan(heights).any():  # a frame without soil where the bodies are
        return None
    # Ridge regression of the heights on the modes: (X^T X + lambda n I) W = X^T Y.
    x, y = (inputs - mean) / std, heights - heights.mean(axis=0)
    found = np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ y) / std[:, None]
    reader = Contact(
        axes.axis,
        scene.up_axis,
        0.0,
        places.astype(np.float32),
        (heights.mean(axis=0) - mean @ found).astype(np.float32),
        found.reshape(*rows.shape[1:], -1).astype(np.float32),
    )
    clearance = np.concatenate(
        [reader.clearance(b, o) for bs, os in zip(bodies, offsets) for b, o in zip(bs, os)]
    )
    force = np.concatenate([np.linalg.norm(g.force, axis=-1).reshape(-1) for g in groups])
    felt = clearance[force > NONE_BELOW * np.sqrt((force**2).mean())]
    if not len(felt):
        return None
    clear = float(np.quantile(felt, 1.0 - LOST))
    if (clearance > clear + RAMP).mean() < LEAST_CLEAR:
        return None
    return dataclasses.replace(reader, clear=clear)


def _surface(subspace, origin, axes, bodies):
    """Places [P] along the way, and a function of mode offsets: heights [P] of the highest
    particles about them, as wide as the bodies; NaN where there are none at all."""
    mean = np.broadcast_to(subspace.mean, (subspace.n_soil, len(origin[0])))
    mean = mean + subspace.components @ origin
    low = min(body[..., axes.across].min() for body in bodies)
    high = max(body[..., axes.across].max() for body in bodies)
    along = subspace.initial[:, axes.axis]
    edges = np.linspace(along.min(), along.max(), PLACES + 1)
    places = (edges[1:] + edges[:-1]) / 2

    def heights(offsets):
        points = subspace.components @ offsets + mean
        across = points[:, axes.across]
        points = points[(across >= low) & (across <= high)]
        slab = np.searchsorted(edges, points[:, axes.axis]) - 1
        inside = (slab >= 0) & (slab < PLACES)
        top = np.full(PLACES, -np.inf)
        np.maximum.at(top, slab[inside], points[inside, axes.up])
        there = np.isfinite(top)
        if not there.any():
            return np.full(PLACES, np.nan)
        return np.interp(places, places[there], top[there])

    return places, heights
