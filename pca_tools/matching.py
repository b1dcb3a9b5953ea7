"""Which particle is which, where runs start alike but list their particles in different orders."""

import numpy as np

# Nearest neighbours that may be each other's partner; the first number that admits a one-to-one
# matching is taken.
_NEIGHBOURS = (4, 16, 64)
# Added to every distance, relative to the spacing: a sparse matrix takes 0 for no edge.
_OFFSET = 1e-3
# A run has another order than the reference where more than `_SWAPPED` of its particles start
# within `_AT_PLACE` spacings of the place of another one, and not of their own. In beds that sank
# or were cut, particles lie there by chance only: balls of so small a radius around all places fill
# 0.6 % of the densest packing in space and 3.6 % in a plane, and at most half of the particles are
# far from their own, since else the run is refused for that. Measured: 0.5 % at most in the first
# and last frames of 432 runs of cut and rolled beds.
_AT_PLACE, _SWAPPED = 0.1, 0.05


def _tree(points):
    from scipy import spatial  # slow to load, and the help of commands does not wait for it

    return spatial.cKDTree(points)


def median_spacing(points: np.ndarray) -> float:
    """Returns the median distance [m] of points [N, 3] to their nearest neighbours."""
    if len(points) < 2:
        return float('nan')
    return float(np.median(_tree(points).query(points, 2)[0][:, 1]))


def order_fault(points: np.ndarray, reference: np.ndarray, name: str) -> str:
    """Says why points [N, 3] (m) of frame 0 of a run are not those of the reference [N, 3], the run
    `name`, in its order; empty where they may be."""
    if len(points) != len(reference):
        return f'has {len(points)} particles, {name} {len(reference)}'
    spacing = median_spacing(reference)
    own = np.linalg.norm(np.asarray(points, np.float64) - reference, axis=1)
    nearest = _tree(reference).query(points)[0]
    limit = _AT_PLACE * spacing
    swapped = np.mean((nearest < limit) & (own > limit))
    shift = np.median(own)
    if shift > spacing:
        found = (
            f'its particles start {shift:.3g} m (median) from those of {name}, more than their '
            f'spacing of {spacing:.3g} m'
        )
    elif swapped > _SWAPPED:
        found = (
            f'{100 * swapped:.3g} % of its particles start where {name} has other ones, more than '
            f'{100 * _SWAPPED:.0f} %'
        )
    else:
        return ''
    return (
        f'{found}: not the same order (then give --match_particles), or not the same packing '
        '(then train a full-space model: learning_to_simulate.train --model=full_space)'
    )


def match_particles(points: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Finds the one-to-one matching of least total distance among near neighbours: int [N] `order`,
    so that `points[order]` lies near `reference`, row by row; both are [N, 3], m. ValueError:
    numbers differ, or there is no such matching: not the same packing."""
    points, reference = np.asarray(points, np.float64), np.asarray(reference, np.float64)
    count = len(reference)
    if len(points) != count:
        raise ValueError(f'{len(points)} particles cannot be matched with {count}')
    from scipy import sparse

    tree, offset = _tree(points), _OFFSET * max(median_spacing(reference), 1e-12)
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
