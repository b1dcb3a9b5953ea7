"""Transfers between particles and grid: APIC with quadratic B-splines, MLS stress.

Sources:
  APIC: Jiang, Schroeder, Selle, Teran, Stomakhin (2015), ACM Trans. Graph. 34, 51.
  MLS-MPM: Hu et al. (2018), ACM Trans. Graph. 37, 150.
"""

import numba

from mpm.columns import FLUIDITY, IDENTITY, JIT, LEFT_GRID, VOLUME_RATIO, C, S, V, index
from mpm.constitutive import pressure_of, update_stress


@numba.njit(inline='always', **JIT)
def weights(f):
    """Quadratic B-spline weights of three nodes; the first lies f + 0.5 cells below (f < 1)."""
    return 0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2


@numba.njit(**JIT)
def particles_to_grid(particles, grid, shape, origin, dx, dt, mass, volume, bulk_modulus, status):
    """Scatters mass and momentum (stress included) to `grid` [4 nodes]; returns the top row.

    Nodes are numbered (j nx + i) nz + k with j up, so that the rows above the soil, which are
    never touched, lie in one piece at the end. The fourth value of a node is its mass.
    """
    nx, ny, nz = shape
    inverse = 1.0 / dx
    stress_scale = -dt * volume * 4.0 * inverse * inverse
    top = 0
    for n in range(particles.shape[0]):
        gy = (particles[n, 1] - origin[1]) * inverse - 0.5
        # A comparison that is false for NaN too, before anything becomes an index.
        if not (gy >= 0.0 and gy < ny - 2):
            status[0] = LEFT_GRID
            status[1] = int(particles[n, IDENTITY])
            return -1
        if int(gy) > top:
            top = int(gy)
    top += 3
    grid[: top * nx * nz * 4] = 0.0
    for n in range(particles.shape[0]):
        q = particles[n]
        gx = (q[0] - origin[0]) * inverse - 0.5
        gy = (q[1] - origin[1]) * inverse - 0.5
        gz = (q[2] - origin[2]) * inverse - 0.5
        if not (gx >= 0.0 and gx < nx - 2 and gz >= 0.0 and gz < nz - 2):
            status[0] = LEFT_GRID
            status[1] = int(q[IDENTITY])
            return -1
        bi, bj, bk = int(gx), int(gy), int(gz)
        fx, fy, fz = gx - bi, gy - bj, gz - bk
        x0, x1, x2 = weights(fx)
        y0, y1, y2 = weights(fy)
        z0, z1, z2 = weights(fz)

        ratio = q[VOLUME_RATIO]
        pressure = pressure_of(ratio, bulk_modulus)
        scale = stress_scale * ratio
        sxy, syz, szx = scale * q[S + 3], scale * q[S + 4], scale * q[S + 5]
        axx = (scale * (q[S] - pressure) + mass * q[C]) * dx
        axy = (sxy + mass * q[C + 1]) * dx
        axz = (szx + mass * q[C + 2]) * dx
        ayx = (sxy + mass * q[C + 3]) * dx
        ayy = (scale * (q[S + 1] - pressure) + mass * q[C + 4]) * dx
        ayz = (syz + mass * q[C + 5]) * dx
        azx = (szx + mass * q[C + 6]) * dx
        azy = (syz + mass * q[C + 7]) * dx
        azz = (scale * (q[S + 2] - pressure) + mass * q[C + 8]) * dx
        # Momentum carried to node b + (0, 0, 0), then increments per node.
        ox, oy, oz = -fx - 0.5, -fy - 0.5, -fz - 0.5
        mx = mass * q[V] + axx * ox + axy * oy + axz * oz
        my = mass * q[V + 1] + ayx * ox + ayy * oy + ayz * oz
        mz = mass * q[V + 2] + azx * ox + azy * oy + azz * oz
        base = index(((bj * nx + bi) * nz + bk) * 4)
        for j in range(3):
            w_j = y0 if j == 0 else (y1 if j == 1 else y2)
            for i in range(3):
                w_ij = w_j * (x0 if i == 0 else (x1 if i == 1 else x2))
                row = base + index((j * nx + i) * nz * 4)
                px = w_ij * (mx + axx * i + axy * j)
                py = w_ij * (my + ayx * i + ayy * j)
                pz = w_ij * (mz + azx * i + azy * j)
                pm = w_ij * mass
                bx, by, bz = w_ij * axz, w_ij * ayz, w_ij * azz
                grid[row] += z0 * px
                grid[row + index(1)] += z0 * py
                grid[row + index(2)] += z0 * pz
                grid[row + index(3)] += z0 * pm
                px, py, pz = px + bx, py + by, pz + bz
                grid[row + index(4)] += z1 * px
                grid[row + index(5)] += z1 * py
                grid[row + index(6)] += z1 * pz
                grid[row + index(7)] += z1 * pm
                px, py, pz = px + bx, py + by, pz + bz
                grid[row + index(8)] += z2 * px
                grid[row + index(9)] += z2 * py
                grid[row + index(10)] += z2 * pz
                grid[row + index(11)] += z2 * pm
    return top


@numba.njit(**JIT)
def grid_to_particles(particles, grid, shape, origin, dx, dt, soil, fluidity):
    """Gathers velocity and its gradient, moves the particles, updates and relaxes the stress."""
    nx, ny, nz = shape
    inverse = 1.0 / dx
    for n in range(particles.shape[0]):
        q = particles[n]
        gx = (q[0] - origin[0]) * inverse - 0.5
        gy = (q[1] - origin[1]) * inverse - 0.5
        gz = (q[2] - origin[2]) * inverse - 0.5
        bi, bj, bk = int(gx), int(gy), int(gz)
        fx, fy, fz = gx - bi, gy - bj, gz - bk
        x0, x1, x2 = weights(fx)
        y0, y1, y2 = weights(fy)
        z0, z1, z2 = weights(fz)
        vx = vy = vz = 0.0
        cxx = cxy = cxz = cyx = cyy = cyz = czx = czy = czz = 0.0
        g_new = q[FLUIDITY]
        base = index(((bj * nx + bi) * nz + bk) * 4)
        for j in range(3):
            w_j = y0 if j == 0 else (y1 if j == 1 else y2)
            tx = ty = tz = 0.0
            for i in range(3):
                w = w_j * (x0 if i == 0 else (x1 if i == 1 else x2))
                row = base + index((j * nx + i) * nz * 4)
                # Along z first: sum w v and sum w k v.
                mx = z1 * grid[row + index(4)]
                my = z1 * grid[row + index(5)]
                mz = z1 * grid[row + index(6)]
                ax = z2 * grid[row + index(8)]
                ay = z2 * grid[row + index(9)]
                az = z2 * grid[row + index(10)]
                sx = w * (z0 * grid[row] + mx + ax)
                sy = w * (z0 * grid[row + index(1)] + my + ay)
                sz = w * (z0 * grid[row + index(2)] + mz + az)
                cxz += w * (mx + 2.0 * ax)
                cyz += w * (my + 2.0 * ay)
                czz += w * (mz + 2.0 * az)
                tx += sx
                ty += sy
                tz += sz
                cxx += i * sx
                cyx += i * sy
                czx += i * sz
                if fluidity is not None:
                    node = ((bj + j) * nx + bi + i) * nz + bk
                    g_new += w * (
                        z0 * fluidity[node, 2]
                        + z1 * fluidity[node + 1, 2]
                        + z2 * fluidity[node + 2, 2]
                    )
            vx += tx
            vy += ty
            vz += tz
            cxy += j * tx
            cyy += j * ty
            czy += j * tz
        # First moments about the particle, times the inverse inertia of the B-spline.
        d4 = 4.0 * inverse
        ox, oy, oz = fx + 0.5, fy + 0.5, fz + 0.5
        cxx = d4 * (cxx - ox * vx)
        cxy = d4 * (cxy - oy * vx)
        cxz = d4 * (cxz - oz * vx)
        cyx = d4 * (cyx - ox * vy)
        cyy = d4 * (cyy - oy * vy)
        cyz = d4 * (cyz - oz * vy)
        czx = d4 * (czx - ox * vz)
        czy = d4 * (czy - oy * vz)
        czz = d4 * (czz - oz * vz)
        q[V], q[V + 1], q[V + 2] = vx, vy, vz
        q[C], q[C + 1], q[C + 2] = cxx, cxy, cxz
        q[C + 3], q[C + 4], q[C + 5] = cyx, cyy, cyz
        q[C + 6], q[C + 7], q[C + 8] = czx, czy, czz
        q[0] += dt * vx
        q[1] += dt * vy
        q[2] += dt * vz
        update_stress(q, dt, soil, fluidity, g_new)
