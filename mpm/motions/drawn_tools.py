"""Tools drawn from a seed: blades of other widths and heights, and buckets."""

import math

import numpy as np

from mpm import bodies

WIDTHS = (0.15, 0.60)  # m
BLADE_HEIGHTS = (0.15, 0.40)  # m
EDGE_RADII = (0.008, 0.018)  # m, of blades
BUCKET_RADII = (0.08, 0.16)  # m
SHELL = 0.024  # m, thickness of a bucket's shell: several cells, so that no soil leaks through
SHELL_EDGE = 0.004  # m, radius of its edges
PLATE = 0.02  # m, of its side plates: one long cell
SEGMENTS = 7  # of its back


def draw(rng: np.random.Generator) -> dict:
    """Returns a tool (`bodies.check_tool`): three blades to two buckets."""
    width = round(rng.uniform(*WIDTHS), 3)
    if rng.random() < 0.6:
        radius = round(rng.uniform(*EDGE_RADII), 4)
        height = round(rng.uniform(*BLADE_HEIGHTS), 3)
        outline = [[0.0, 0.0], [0.0, height - 2 * radius]]
        tool = {'name': 'blade', 'outline': outline, 'edge_radius': radius, 'width': width}
        return bodies.check_tool(tool)
    return bucket(rng.uniform(*BUCKET_RADII), width, rng.random() < 0.5)


def bucket(radius: float, width: float, has_plates: bool) -> dict:
    """Returns a bucket of an inner `radius` (m) and a width (m) that opens towards -x; its edge is
    the reference point. A flat floor rises by 15 degrees behind the edge and goes over into half a
    circle; its ends may be closed by plates."""
    rise = math.radians(15.0)
    along = np.array([math.cos(rise), math.sin(rise)])
    normal = np.array([-along[1], along[0]])
    start = 1.6 * radius * along
    middle = start + radius * normal
    turn = rise - math.pi / 2 + np.linspace(0.0, math.radians(165.0), SEGMENTS + 1)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    inner, outer = middle + radius * ring, middle + (radius + SHELL) * ring
    # The floor tapers towards the edge.
    edge = [[0.0, 0.0], (0.3 * SHELL * normal).tolist()]
    outside = [(start - SHELL * normal).tolist()]
    outline = [edge[0], *outside, *outer[1:].tolist(), *inner[::-1].tolist(), edge[1]]
    tool = {
        'name': 'bucket',
        'outline': np.round(outline, 5).tolist(),
        'edge_radius': SHELL_EDGE,
        'width': round(width, 3),
    }
    if has_plates:
        tool['side_plates'] = {'thickness': PLATE}
    return bodies.check_tool(tool)
