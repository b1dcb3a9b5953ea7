"""Diffusion of the granular fluidity on the grid (the nonlocal law only)."""

import numba

from mpm.columns import FLUIDITY, JIT
from mpm.transfers import weights


@numba.njit(**JIT)
def diffuse_fluidity(particles, work, shape, top, origin, dx, dt, soil):
    """Fills work[:, 2] with the diffusive increment of the fluidity over a step, per node.

    The fluidity goes to the nodes as a mass-weighted mean; a 7-point Laplacian between nodes that
    carry soil (no flux elsewhere) gives the increment, which the particles gather. Only the
    increment is gathered: interpolating the fluidity itself would diffuse far more than the law.
    """
    nx, ny, nz = shape
    inverse = 1.0 / dx
    work[: top * nx * nz] = 0.0
    for n in range(particles.shape[0]):
        q = particles[n]
        gx = (q[0] - origin[0]) * inverse - 0.5
        gy = (q[1] - origin[1]) * inverse - 0.5
        gz = (q[2] - origin[2]) * inverse - 0.5
        bi, bj, bk = int(gx), int(gy), int(gz)
        fx, fy, fz = gx - bi, gy - bj, gz - bk
        wx, wy, wz = weights(fx), weights(fy), weights(fz)
        for j in range(3):
            for i in range(3):
                row = ((bj + j) * nx + bi + i) * nz + bk
                for k in range(3):
                    w = wy[j] * wx[i] * wz[k]
                    work[row + k, 0] += w
                    work[row + k, 1] += w * q[FLUIDITY]
    rate = dt * (soil.nonlocal_amplitude * soil.grain_diameter) ** 2 / soil.nonlocal_time
    rate *= inverse * inverse
    for node in range(top * nx * nz):
        if work[node, 0] > 0.0:
            work[node, 1] /= work[node, 0]
    for j in range(1, top - 1):
        for i in range(1, nx - 1):
            for k in range(1, nz - 1):
                node = (j * nx + i) * nz + k
                if work[node, 0] > 0.0:
                    total = 0.0
                    for step in (1, nz, nx * nz):
                        if work[node - step, 0] > 0.0:
                            total += work[node - step, 1] - work[node, 1]
                        if work[node + step, 0] > 0.0:
                            total += work[node + step, 1] - work[node, 1]
                    work[node, 2] = rate * total
