"""Which particle is which, where runs start alike but list their particles in different orders."""

from __future__ import annotations

import numpy as np
from scipy import sparse, spatial

# Nearest neighbours that may be each other's partner; the first number that admits a one-to-one
# matching is taken.
_NEIGHBOURS = (4, 16, 64)
# Added to every distance, relative to the spacing: a sparse matrix takes 0 for no edge.
_OFFSET = 1e-3


def median_spacing(points: np.ndarray) -> float:
    """Returns the median distance [m] of points [N, 3] to their nearest neighbours."""
    if len(points) < 2:
        return float('nan')
    return float(np.median(spatial.cKDTree(points).query(points, 2)[0][:, 1]))


def median_shift(points: np.ndarray, reference: np.ndarray) -> float:
    """Returns the median distance [m] of points [N, 3] to those of the same index."""
    return float(np.median(np.linalg.norm(np.asarray(points, np.float64) - reference, axis=1)))


def match_particles(points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Finds the one-to-one matching of least total distance among near neighbours.

    Args:
        points: [N, 3] positions in one order.
        reference: [N, 3] nearly the same positions in another.

    Returns:
        int [N] `order`, so that `points[order]` lies near `reference`, row by row.

    Raises:
        ValueError: numbers differ, or there is no such matching: not the same packing.
    """
    points, reference = np.asarray(points, np.float64), np.asarray(reference, np.float64)
    count = len(reference)
    if len(points) != count:
        raise ValueError(f'{len(points)} particles cannot be matched with {count}')
    tree, offset = spatial.cKDTree(points), _OFFSET * max(median_spacing(reference), 1e-12)
    for wanted in _NEIGHBOURS:
        distances, partners = tree.query(reference, min(wanted, count))
        distances, partners = distances.reshape(count, -1), partners.reshape(count, -1)
        rows = np.repeat(np.arange(count), distances.shape[1])
        costs = (distances.ravel() + offset, (rows, partners.ravel()))
        graph = sparse.csr_array(costs, shape=(count, count))
        try:
            found = sparse.csgraph.min_weight_full_bipartite_matching(graph)
        except ValueError:  # none among so few neighbours
            continue
        order = np.empty(count, np.int64)
        order[found[0]] = found[1]
        return order
    raise ValueError(
        f'no one-to-one matching within {_NEIGHBOURS[-1]} nearest neighbours: not the same packing'
    )
