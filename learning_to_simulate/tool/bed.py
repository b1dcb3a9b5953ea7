"""Beds: the height of a bed read from its particles, and the beds that a tool may begin on."""

import os
from typing import NamedTuple

import numpy as np

from learning_to_simulate.tool.axes import Axes
from learning_to_simulate.tool.swept import Bed
from pca_tools import subspace


def surface_profile(points, places, axes: Axes, kept_spacing, spacing, half_width=np.inf):
    """Height of a bed along the travel.

    Args:
      points: [N, D] particles of the bed, m; a part of all of them will do.
      places: [n] u at which the height is asked for, m.
      axes: of the scene.
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
    z = points[:, axes.across] if points.shape[1] > 2 else np.zeros(len(points))
    inside = np.abs(z - (z.min() + z.max()) / 2) <= half_width
    if not inside.any():
        raise ValueError(f'no particle lies within {half_width} m of the middle of the bed')
    u, height = axes.plane(points[inside]).T
    size = 2.0 * kept_spacing
    # The topmost particle of each slab along the way and column across it; NaN where none is.
    slab = np.floor((u - u.min()) / size).astype(np.int64)
    column = np.floor((z[inside] - z[inside].min()) / size).astype(np.int64)
    top = np.full((slab.max() + 1, column.max() + 1), np.nan)
    np.fmax.at(top, (slab, column), height)
    there = np.flatnonzero(np.isfinite(top).any(axis=1))
    # The median over columns is not raised by single particles that lie on top.
    centres = u.min() + size * (there + 0.5)
    return np.interp(places, centres, np.nanmedian(top[there], axis=1)) + spacing / 2


def flat_surface(points, axes: Axes, kept_spacing: float, spacing: float) -> float:
    """Height of a flat bed, m: the median of its profile; arguments as in `surface_profile`."""
    u = axes.plane(np.asarray(points, np.float64))[:, 0]
    places = np.arange(u.min() + kept_spacing, u.max(), 2.0 * kept_spacing)
    return float(np.median(surface_profile(points, places, axes, kept_spacing, spacing)))


def solver_spacing(case: dict) -> float | None:
    """Spacing (m) of the solver's particles in a case of the metadata; None if it does not say."""
    packing = case.get('packing') or {}
    if 'cell_size_m' not in case or 'particles_per_cell' not in packing:
        return None
    return float(case['cell_size_m'] / packing['particles_per_cell'] ** (1 / 3))


def kept_spacing(points) -> float:
    """Spacing (m) of particles [N, 3] that fill a box."""
    return float((np.prod(np.ptp(points, axis=0)) / len(points)) ** (1 / 3))


def spacings(points, metadata: dict) -> tuple[float, float]:
    """Spacing (m) of the particles [N, 3] of a bed and of those of the solver, as the metadata of
    their dataset say, or the same."""
    kept = kept_spacing(points)
    first = next(iter(metadata.get('cases', {}).get('train', [])), {})
    return kept, solver_spacing(first) or kept


def height_of_dataset(folder: str, metadata: dict, axes: Axes) -> float | None:
    """Height (m) of the flat bed that the runs of a dataset start from, read from the particles of
    its subspace; None where it has none."""
    path = os.path.join(folder, 'subspace.npz')
    if not os.path.exists(path):
        return None
    points = subspace.Subspace.load(path).initial
    return flat_surface(points, axes, *spacings(points, metadata))


class Ground(NamedTuple):
    """The bed that a tool begins on: all that an episode starts from.

    Attributes:
      points: float64 [N, 3], world, m.
      places: float64 [N, 3] the same as u, height, distance from the middle plane.
      origin: float64 [3] u of the tool's first place, level of the bed, 0; m.
      size: float64 [S] of the tool, see `tool`.
      bed: `swept.Bed` of one tool.
    """

    points: np.ndarray
    places: np.ndarray
    origin: np.ndarray
    size: np.ndarray
    bed: Bed

    @property
    def local(self) -> np.ndarray:
        """float32 [N, 3]: `places` from the origin, as the networks take them."""
        return (self.places - self.origin).astype(np.float32)


def ground(points, u, size, width: float, axes: Axes, grid, kept_spacing, spacing) -> Ground:
    """The one place where a bed is read for a tool.

    Args:
      points: [N, 3] particles of the bed, world, m.
      u: where the tool begins along the way, m.
      size: [S] of the tool, see `tool`.
      width: of the strip that it passes, m.
      axes, kept_spacing, spacing: as of `surface_profile`.
      grid: bins along the way.

    Returns:
      `Ground`, whose level is the median surface within the bed.

    Raises:
      ValueError: no particle lies where the tool passes.
    """
    places = u + grid.offsets
    surface = surface_profile(points, places, axes, kept_spacing, spacing, width / 2)
    along = axes.plane(points)[:, 0]
    there = (places >= along.min()) & (places <= along.max())
    level = float(np.median(surface[there] if there.any() else surface))
    end = float(along.max() + spacing / 2)
    bed = Bed(surface[None], np.array([level]), np.array([end]))
    return Ground(points, axes.points(points), np.array([u, level, 0.0]), np.asarray(size), bed)


class HeightMap(NamedTuple):
    """Heights of a bed along the way, the same across it.

    Attributes:
      places: [n] coordinates on the world's axis of travel, m, in any order.
      heights: [n] m.
    """

    places: np.ndarray
    heights: np.ndarray


def stretched(bed: HeightMap, rest, axes: Axes, spacing: float) -> np.ndarray:
    """The bed at rest [N, 3] (m) with its columns stretched to the heights of a map.

    Raises:
      ValueError: not a map; heights that are not above the floor of the bed.
    """
    places, heights = (np.asarray(x, np.float64) for x in bed)
    if not (np.isfinite(places).all() and np.isfinite(heights).all()):
        raise ValueError('a height map holds NaN or infinite places or heights')
    if places.ndim != 1 or places.shape != heights.shape or len(places) < 2:
        raise ValueError(
            f'a height map has places {places.shape} and heights {heights.shape}: two rows of one '
            f'length of at least 2 were expected'
        )
    points = axes.points(rest)
    order = np.argsort(axes.sign * places)
    wanted = np.interp(points[:, 0], axes.sign * places[order], heights[order])
    floor, top = points[:, 1].min(), points[:, 1].max() + spacing / 2
    if (heights <= floor).any():
        raise ValueError(f'a height map goes below the floor of the bed at {floor:.4g} m')
    # Each column is stretched about its floor: as many particles, in a lower or higher bed.
    found = rest.copy()
    found[:, axes.up] = floor + (points[:, 1] - floor) * (wanted - floor) / (top - floor)
    return found
