"""The height of a bed, read from its particles."""

import os

import numpy as np

from learning_to_simulate.axes import Axes
from pca_tools import subspace


def surface_profile(points, places, axes: Axes, kept_spacing, spacing):
    """Height of a bed along the travel at places u [n], m: the median over columns of the topmost
    particle in the slab about each place, linear over slabs without particles, [n], m.

    Of particles [N, D] of the bed, m; a part of all of them will do. Slabs and columns are twice as
    wide as `kept_spacing` between the given particles, m; the surface lies half of `spacing`
    between all particles of the bed, m, above the centres of the topmost.
    """
    points = np.asarray(points, np.float64)
    z = points[:, axes.across] if points.shape[1] > 2 else np.zeros(len(points))
    u, height = axes.plane(points).T
    size = 2.0 * kept_spacing
    # The topmost particle of each slab along the way and column across it; NaN where none is.
    slab = np.floor((u - u.min()) / size).astype(np.int64)
    column = np.floor((z - z.min()) / size).astype(np.int64)
    top = np.full((slab.max() + 1, column.max() + 1), np.nan)
    np.fmax.at(top, (slab, column), height)
    there = np.flatnonzero(np.isfinite(top).any(axis=1))
    # The median over columns is not raised by single particles that lie on top.
    centres = u.min() + size * (there + 0.5)
    return np.interp(places, centres, np.nanmedian(top[there], axis=1)) + spacing / 2


def height_of_dataset(folder: str, metadata: dict, axes: Axes) -> float | None:
    """Height (m) of the flat bed that the runs of a dataset start from, the median of its profile,
    read from the particles of its subspace; None where it has none. The spacing of the solver's
    particles is that of the first case of the metadata, or where it says none that of those."""
    path = os.path.join(folder, 'subspace.npz')
    if not os.path.exists(path):
        return None
    points = subspace.Subspace.load(path).initial
    # Of particles that fill a box.
    kept = spacing = float((np.prod(np.ptp(points, axis=0)) / len(points)) ** (1 / 3))
    first = next(iter(metadata.get('cases', {}).get('train', [])), {})
    packing = first.get('packing') or {}
    if 'cell_size_m' in first and 'particles_per_cell' in packing:
        spacing = float(first['cell_size_m'] / packing['particles_per_cell'] ** (1 / 3))
    u = axes.plane(np.asarray(points, np.float64))[:, 0]
    places = np.arange(u.min() + kept, u.max(), 2.0 * kept)
    return float(np.median(surface_profile(points, places, axes, kept, spacing)))
