"""Diffusion of the granular fluidity on the grid (the nonlocal law only)."""

import numba

from mpm.columns import FLUIDITY, JIT, index
from mpm.transfers import WEIGHTS, WX, WY, WZ, strides_of


@numba.njit(**JIT)
def diffuse_fluidity(block, work, grid, box, interval, soil):
    """Adds the diffusive increment of the fluidity over an exchange interval to the particles.

    The fluidity goes to the nodes as a mass-weighted mean; a 7-point Laplacian between nodes that
    carry soil (no flux elsewhere) gives the increment, which the particles gather. Only the
    increment is gathered: interpolating the fluidity itself would diffuse far more than the law.

    Args:
        block: `solver.Block`, its places those of this interval.
        work: float64 [nodes, 3], overwritten: weight, mean fluidity, increment of each node.
        grid: `grid.Grid`.
        box: first and last node (exclusive) per axis that can have been touched.
        interval: s.
        soil: `Soil`.
    """
    q = block.particles
    nx, nz = grid.shape[0], grid.shape[2]
    work[:] = 0.0
    for n in range(len(q)):
        for node, w in _around(block, n, grid):
            work[node, 0] += w
            work[node, 1] += w * q[n, FLUIDITY]
    length = soil.nonlocal_amplitude * soil.grain_diameter
    rate = interval * length * length / soil.nonlocal_time / (grid.dx * grid.dx)
    for node in range(len(work)):
        if work[node, 0] > 0.0:
            work[node, 1] /= work[node, 0]
    for j in range(box[2], box[3]):
        for i in range(box[0], box[1]):
            for k in range(box[4], box[5]):
                node = (j * nx + i) * nz + k
                if work[node, 0] > 0.0:
                    total = 0.0
                    for step in (1, nz, nx * nz):
                        if work[node - step, 0] > 0.0:
                            total += work[node - step, 1] - work[node, 1]
                        if work[node + step, 0] > 0.0:
                            total += work[node + step, 1] - work[node, 1]
                    work[node, 2] = rate * total
    for n in range(len(q)):
        for node, w in _around(block, n, grid):
            q[n, FLUIDITY] += w * work[node, 2]


@numba.njit(**JIT)
def _around(block, n, grid):
    """Yields (node, weight) of the 27 nodes around a particle."""
    kept, at = block.weights, index(WEIGHTS * n)
    strides = strides_of(grid.shape)
    for j in range(3):
        for i in range(3):
            row = block.base[n] + index(j) * strides[1] + index(i) * strides[0]
            for k in range(3):
                yield (
                    row // index(4) + index(k),
                    kept[at + WY + index(j)] * kept[at + WX + index(i)] * kept[at + WZ + index(k)],
                )
