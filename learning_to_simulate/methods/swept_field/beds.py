"""The beds that a tool may begin on: flat, that of a case, particles, or a height map."""

from typing import NamedTuple

import numpy as np

from learning_to_simulate.live.poses import numbers
from learning_to_simulate.methods.swept_field.episodes import BedReader
from learning_to_simulate.methods.swept_field.field_soil import Ground
from learning_to_simulate.methods.swept_field.tool_path import Bed


class HeightMap(NamedTuple):
    """Heights of a bed along the way, the same across it.

    Attributes:
      places: [n] coordinates on the world's axis of travel, m, in any order.
      heights: [n] m.
    """

    places: np.ndarray
    heights: np.ndarray


def ground(field, plane, size, bed=None, recorded=None) -> tuple[Ground, Bed]:
    """A bed as the soil and as the path need it.

    Args:
      field: `SweptField`.
      plane: [K] first pose and size: [S] of the tool, see `tools`.
      bed: [N, 3] particles, m, or a `HeightMap`; None: see `recorded`.
      recorded: (subspace, modes [r', 3]) of a case's bed; None for the flat bed of the training.

    Raises:
      ValueError: not a bed.
    """
    axes = field.axes
    # A view, so that who closes it for writing does not close the field's own.
    points, kept = field.rest.view(), field.kept_spacing
    if isinstance(bed, HeightMap):
        points = _stretched(field, *_checked(bed))
    elif bed is not None:
        points = numbers('bed', bed, (None, 3))
        if not len(points):
            raise ValueError('a bed of no particles')
        kept *= (len(field.rest) / len(points)) ** (1 / 3)
    elif recorded is not None and recorded[0] is not None:
        space, modes = recorded
        points = space.decode(modes[: space.n_modes]).astype(np.float64)
    reader = BedReader(axes, field.grid, kept, field.spacing)
    surface, level, end = reader.read(points, plane[0], field.tool.width_of(size))
    origin = np.array([plane[0], level, 0.0])
    return (
        Ground(points, axes.points(points), origin, np.asarray(size)),
        Bed(surface[None], np.array([level]), np.array([end])),
    )


def _checked(bed):
    places, heights = (numbers(n, x, (None,)) for n, x in zip(HeightMap._fields, bed))
    if len(places) != len(heights) or len(places) < 2:
        raise ValueError(
            f'a height map has {len(places)} places and {len(heights)} heights: two rows of one '
            f'length of at least 2 were expected'
        )
    return places, heights


def _stretched(field, places, heights):
    """The bed at rest [N, 3] with its columns stretched to the heights of a map."""
    axes, points = field.axes, field.axes.points(field.rest)
    order = np.argsort(axes.sign * places)
    wanted = np.interp(points[:, 0], axes.sign * places[order], heights[order])
    floor, top = points[:, 1].min(), points[:, 1].max() + field.spacing / 2
    if (heights <= floor).any():
        raise ValueError(f'a height map goes below the floor of the bed at {floor:.4g} m')
    stretched = field.rest.copy()
    stretched[:, axes.up] = floor + (points[:, 1] - floor) * (wanted - floor) / (top - floor)
    return stretched
