"""Height of a bed from its particles."""

import os

import numpy as np

from pca_tools import subspace


def surface_profile(points, places, frame, kept_spacing: float, spacing: float, half_width=np.inf):
    """Height of a bed along the travel.

    Args:
      points: [N, D] particles of the bed, m; a part of all of them will do.
      places: [n] u at which the height is asked for, m.
      frame: `tool_motion.TravelFrame`.
      kept_spacing: between the given particles, m; slabs and columns are twice as wide.
      spacing: between all particles of the bed, m; its surface lies half of it above the centres
        of the topmost.
      half_width: of the strip across that counts, about the middle of the bed, m.

    Returns:
      [n] heights, m: the median over columns of the topmost particle in the slab about each place,
      linear over slabs without particles.

    Raises:
      ValueError: no particle is within the strip.
    """
    points = np.asarray(points, np.float64)
    across = [a for a in range(points.shape[1]) if a not in (frame.axis, frame.up)]
    z = points[:, across[0]] if across else np.zeros(len(points))
    inside = np.abs(z - (z.min() + z.max()) / 2) <= half_width
    if not inside.any():
        raise ValueError(f'no particle lies within {half_width} m of the middle of the bed')
    u, height = frame.plane(points[inside]).T
    size = 2.0 * kept_spacing
    slab = np.floor((u - u.min()) / size).astype(np.int64)
    column = np.floor((z[inside] - z[inside].min()) / size).astype(np.int64)
    top = np.full((slab.max() + 1, column.max() + 1), np.nan)
    np.fmax.at(top, (slab, column), height)
    there = np.flatnonzero(np.isfinite(top).any(axis=1))
    centres = u.min() + size * (there + 0.5)
    return np.interp(places, centres, np.nanmedian(top[there], axis=1)) + spacing / 2


def flat_surface(points, frame, kept_spacing: float, spacing: float) -> float:
    """Height of a flat bed, m: the median of its profile; arguments as in `surface_profile`."""
    u = frame.plane(np.asarray(points, np.float64))[:, 0]
    places = np.arange(u.min() + kept_spacing, u.max(), 2.0 * kept_spacing)
    return float(np.median(surface_profile(points, places, frame, kept_spacing, spacing)))


def solver_spacing(case: dict) -> float | None:
    """Spacing (m) of the solver's particles in a case of the metadata; None if it does not say."""
    packing = case.get('packing') or {}
    if 'cell_size_m' not in case or 'particles_per_cell' not in packing:
        return None
    return float(case['cell_size_m'] / packing['particles_per_cell'] ** (1 / 3))


def kept_spacing(points) -> float:
    """Spacing (m) of particles [N, 3] that fill a box."""
    return float((np.prod(np.ptp(points, axis=0)) / len(points)) ** (1 / 3))


def of_dataset(folder: str, metadata: dict, frame) -> float | None:
    """Height (m) of the flat bed that the runs of a dataset start from, read from the particles of
    its subspace; None where it has none."""
    path = os.path.join(folder, 'subspace.npz')
    if not os.path.exists(path):
        return None
    points = subspace.Subspace.load(path).initial
    kept = kept_spacing(points)
    first = next(iter(metadata.get('cases', {}).get('train', [])), {})
    return flat_surface(points, frame, kept, solver_spacing(first) or kept)
