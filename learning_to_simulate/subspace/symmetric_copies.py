"""More runs out of symmetries of the bed: a run that is shifted along a flat bed, or mirrored
across the way, is a run as well.

A field of displacements that is shifted by d along the way moves the particle at x as the field
moved the one at x - d. Displacements are linear in the scores, and so is the shift: with modes W
[N, r] and weights S [N, N] that interpolate between the nearest particles, scores s counted from
the resting bed become W^T S W s, a product with an [r, r] matrix. So does the mirror, which also
turns the sign of what points across. Walls do not move, so a body stays where bodies of training
have been. The packing is random: a shift is true of the soil as a whole, not of single particles.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy import spatial

from learning_to_simulate.axes import Axes
from pca_tools.subspace import Subspace

_STREAM = 6  # see the random streams of `trainer`
NEIGHBOURS = 4
LARGEST_SHIFT = 0.3  # m
SHIFTS = 32  # different ones of a training; each costs a product with all particles


class Shift(NamedTuple):
    """A shift along the way, with the mirror or not."""

    distance: float  # m along the axis of travel
    is_mirrored: bool  # across the way as well
    matrix: np.ndarray  # float64 [r, r], of scores counted from the resting bed


def shift_of(space: Subspace, axis: int, across: int, distance, is_mirrored) -> Shift:
    """One shift in a subspace; what comes from outside of the bed has not moved."""
    points = space.initial
    origin = points.copy()
    origin[:, axis] -= distance
    low, high = points.min(axis=0), points.max(axis=0)
    if is_mirrored:
        origin[:, across] = low[across] + high[across] - origin[:, across]
    apart, nearest = spatial.KDTree(points).query(origin, NEIGHBOURS)
    weight = 1.0 / (apart + 1e-4) ** 2  # 0.1 mm keeps a particle on a particle finite
    weight /= weight.sum(axis=1, keepdims=True)
    spacing = apart[:, -1].mean()
    outside = (origin[:, axis] < low[axis] - spacing) | (origin[:, axis] > high[axis] + spacing)
    weight[outside] = 0.0
    moved = sum(weight[:, k, None] * space.components[nearest[:, k]] for k in range(NEIGHBOURS))
    # W^T S W of the modes W and the interpolation S, without the [N, N] matrix.
    return Shift(float(distance), bool(is_mirrored), space.components.T @ moved)


def with_copies(groups, space: Subspace, up: int, copies: int, seed: int) -> list:
    """A list of `RunGroup` of a body with a known motion, each followed by `copies` of its runs, as
    far as there is room for them; `record` says which run a copy is of. `space` is that of their
    modes, `up` the axis against gravity, `seed` that of the shifts."""
    rng = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, _STREAM, 0]))
    frame = Axes.of_bodies([groups[0].position[:, :, : groups[0].n_rigid]], up)
    axis, across = frame.axis, 3 - frame.axis - up
    places = [g.position[:, :, : g.n_rigid, axis] for g in groups]
    low, high = min(p.min() for p in places), max(p.max() for p in places)
    middle = float(np.mean([g.position[:, :, : g.n_rigid, across].mean() for g in groups]))
    largest = min(LARGEST_SHIFT, high - low)
    shifts = [
        shift_of(space, axis, across, rng.uniform(-largest, largest), k % 2) for k in range(SHIFTS)
    ]
    rest = space.encode(space.initial)
    found = []
    for group in groups:
        parts = [group]
        for run in range(len(group.position)):
            place = group.position[run, :, : group.n_rigid, axis]
            order = rng.permutation(SHIFTS)
            room = [
                k
                for k in order
                if place.min() + shifts[k].distance >= low
                and place.max() + shifts[k].distance <= high
            ]
            for k in room[:copies]:
                parts.append(_shifted(group.select(run), shifts[k], rest, axis, across, middle))
        found.append(_joined(parts))
    return found


def _shifted(group, shift, rest, axis, across, middle):
    n = group.n_rigid
    body = group.position[:, :, :n].copy()
    body[..., axis] += shift.distance
    # Scores count from the resting bed: s' = rest + M (s - rest).
    modes = np.einsum('qr,strd->stqd', shift.matrix, group.position[:, :, n:] - rest)
    force = None if group.force is None else group.force.copy()
    if shift.is_mirrored:
        body[..., across] = 2.0 * middle - body[..., across]
        modes[..., across] *= -1.0
        if force is not None:
            force[..., across] *= -1.0
    position = np.concatenate([body, modes + rest], axis=2)
    return dataclasses.replace(group, position=position, force=force)


def _joined(groups):
    """One group of all; what training does not read of them is that of the first."""
    parts = {n: [getattr(g, n) for g in groups] for n in ('position', 'force', 'context', 'record')}
    joined = {n: None if part[0] is None else np.concatenate(part) for n, part in parts.items()}
    return dataclasses.replace(groups[0], **joined, body=None, kept=None, left_modes=None)
