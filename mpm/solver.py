"""The material point kernels: MLS/APIC transfers, grid contact, stress update.

One explicit step is: particles to grid, grid update (gravity, walls, contact with the body), grid
to particles with the stress update. Quadratic B-splines, float64, serial: a run takes one
core, runs go side by side. The interface is plain arrays and a `Soil`, nothing else, so that
another backend can take the place of `advance`.

Sources:
  APIC: Jiang, Schroeder, Selle, Teran, Stomakhin (2015), ACM Trans. Graph. 34, 51.
  MLS-MPM: Hu et al. (2018), ACM Trans. Graph. 37, 150.
  stress: rotated elastic deviator (Jaumann rate), pressure from the volume (no tension), relaxed
  by mu(I) or by the granular fluidity, see `constitutive`.
"""

import math

import numba
import numpy as np

from mpm.bodies import signed_distance
from mpm.constitutive import fluidity_source, relax_local, relax_nonlocal

# Columns of the particle array [N, COLUMNS], float64. One row is three cache lines.
X, V, C, S, VOLUME_RATIO, FLUIDITY, IDENTITY, COLUMNS = 0, 3, 6, 15, 21, 22, 23, 24
# Fluidity (1/s) from which flow starts: zero would be a fixed point. Creep at it is 1e-4 a second.
FLUIDITY_SEED = 1.0e-4
# Columns of the status array: error code, particle, steps done.
OK, LEFT_GRID, NOT_FINITE = 0, 1, 2

# Fused multiply-adds only: reordering sums made the gather a third slower, and keeps NaN visible.
_JIT = dict(cache=True, fastmath={'contract'}, error_model='numpy')
# Node numbers are unsigned: Numba then leaves out the test for an index counted from the end.
_index = numba.uintp


@numba.njit(inline='always', **_JIT)
def weights(f):
    """Quadratic B-spline weights of three nodes; the first lies f + 0.5 cells below, f in [0, 1)."""
    return 0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2


@numba.njit(inline='always', **_JIT)
def pressure_of(ratio, bulk_modulus):
    """Pressure (Pa) of soil at `ratio` of its packed volume: linear in density, no tension."""
    if ratio >= 1.0:
        return 0.0
    return bulk_modulus * (1.0 / ratio - 1.0)


@numba.njit(**_JIT)
def particles_to_grid(
    particles, grid, shape, origin, dx, dt, mass, volume, bulk_modulus, status
):
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
        base = _index(((bj * nx + bi) * nz + bk) * 4)
        for j in range(3):
            w_j = y0 if j == 0 else (y1 if j == 1 else y2)
            for i in range(3):
                w_ij = w_j * (x0 if i == 0 else (x1 if i == 1 else x2))
                row = base + _index((j * nx + i) * nz * 4)
                px = w_ij * (mx + axx * i + axy * j)
                py = w_ij * (my + ayx * i + ayy * j)
                pz = w_ij * (mz + azx * i + azy * j)
                pm = w_ij * mass
                bx, by, bz = w_ij * axz, w_ij * ayz, w_ij * azz
                grid[row] += z0 * px
                grid[row + _index(1)] += z0 * py
                grid[row + _index(2)] += z0 * pz
                grid[row + _index(3)] += z0 * pm
                px, py, pz = px + bx, py + by, pz + bz
                grid[row + _index(4)] += z1 * px
                grid[row + _index(5)] += z1 * py
                grid[row + _index(6)] += z1 * pz
                grid[row + _index(7)] += z1 * pm
                px, py, pz = px + bx, py + by, pz + bz
                grid[row + _index(8)] += z2 * px
                grid[row + _index(9)] += z2 * py
                grid[row + _index(10)] += z2 * pz
                grid[row + _index(11)] += z2 * pm
    return top


@numba.njit(**_JIT)
def update_grid(grid, shape, top, dt, gravity, walls, keep):
    """Turns momentum into velocity; applies gravity and the sticky walls.

    `walls` are node indices (i low, i high, j low, k low, k high): soil at rest on and beyond
    them. The plane of a wall is the plane of its nodes. `keep` scales velocities (settling).
    """
    nx, ny, nz = shape
    fall = -gravity * dt
    for j in range(top):
        for i in range(nx):
            row = (j * nx + i) * nz
            is_wall = j <= walls[2] or i <= walls[0] or i >= walls[1]
            for k in range(nz):
                node = _index(4 * (row + k))
                m = grid[node + _index(3)]
                if m > 0.0:
                    if is_wall or k <= walls[3] or k >= walls[4]:
                        grid[node] = 0.0
                        grid[node + _index(1)] = 0.0
                        grid[node + _index(2)] = 0.0
                    else:
                        r = keep / m
                        grid[node] *= r
                        grid[node + _index(1)] = grid[node + _index(1)] * r + fall
                        grid[node + _index(2)] *= r


@numba.njit(**_JIT)
def contact(grid, shape, top, origin, dx, walls, dims, friction, outset, pose, motion, impulse):
    """Coulomb contact on the nodes inside the body; adds the momentum it removes to `impulse`.

    A node is constrained only if it lies inside (signed distance < 0), never one outside: a
    condition one node too low would let the soil sink by a cell.

    Args:
        pose: (x, y) of the body's reference point, m.
        motion: (vx, vy, omega) of the body, m/s and rad/s.
        impulse: float64 [3], N s, momentum given to the body (added to).
    """
    nx, ny, nz = shape
    reach = dims[3] + outset
    x_low, x_high = pose[0] - reach, pose[0] + dims[2] * dims[0] + reach
    y_low, y_high = pose[1] - reach, pose[1] + dims[2] * dims[1] + reach
    z_low, z_high = dims[5] - dims[4] - outset, dims[5] + dims[4] + outset
    i0 = max(walls[0] + 1, int(math.floor((x_low - origin[0]) / dx)))
    i1 = min(walls[1] - 1, int(math.ceil((x_high - origin[0]) / dx)))
    j0 = max(walls[2] + 1, int(math.floor((y_low - origin[1]) / dx)))
    j1 = min(top - 1, int(math.ceil((y_high - origin[1]) / dx)))
    k0 = max(walls[3] + 1, int(math.floor((z_low - origin[2]) / dx)))
    k1 = min(walls[4] - 1, int(math.ceil((z_high - origin[2]) / dx)))
    for j in range(j0, j1 + 1):
        ry = origin[1] + j * dx - pose[1]
        for i in range(i0, i1 + 1):
            rx = origin[0] + i * dx - pose[0]
            bx = motion[0] - motion[2] * ry
            by = motion[1] + motion[2] * rx
            for k in range(k0, k1 + 1):
                node = _index(4 * ((j * nx + i) * nz + k))
                m = grid[node + _index(3)]
                if m <= 0.0:
                    continue
                distance, n_x, n_y, n_z = signed_distance(
                    dims, rx, ry, origin[2] + k * dx
                )
                share = min(1.0, (outset - distance) / dx)
                if share <= 0.0:
                    continue
                ux, uy, uz = grid[node] - bx, grid[node + _index(1)] - by, grid[node + _index(2)]
                normal = ux * n_x + uy * n_y + uz * n_z
                allowed = -(1.0 - share) * max(0.0, bx * n_x + by * n_y)
                push = allowed - normal
                if push <= 0.0:
                    continue
                tx, ty, tz = ux - normal * n_x, uy - normal * n_y, uz - normal * n_z
                slip = math.sqrt(tx * tx + ty * ty + tz * tz)
                drag = 1.0
                if slip > friction * push:
                    drag = friction * push / slip
                cx, cy, cz = push * n_x - drag * tx, push * n_y - drag * ty, push * n_z - drag * tz
                grid[node] += cx
                grid[node + _index(1)] += cy
                grid[node + _index(2)] += cz
                impulse[0] -= m * cx
                impulse[1] -= m * cy
                impulse[2] -= m * cz


@numba.njit(**_JIT)
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
        base = _index(((bj * nx + bi) * nz + bk) * 4)
        for j in range(3):
            w_j = y0 if j == 0 else (y1 if j == 1 else y2)
            tx = ty = tz = 0.0
            for i in range(3):
                w = w_j * (x0 if i == 0 else (x1 if i == 1 else x2))
                row = base + _index((j * nx + i) * nz * 4)
                # Along z first: sum w v and sum w k v.
                mx = z1 * grid[row + _index(4)]
                my = z1 * grid[row + _index(5)]
                mz = z1 * grid[row + _index(6)]
                ax = z2 * grid[row + _index(8)]
                ay = z2 * grid[row + _index(9)]
                az = z2 * grid[row + _index(10)]
                sx = w * (z0 * grid[row] + mx + ax)
                sy = w * (z0 * grid[row + _index(1)] + my + ay)
                sz = w * (z0 * grid[row + _index(2)] + mz + az)
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


@numba.njit(inline='always', **_JIT)
def update_stress(q, dt, soil, fluidity, g_new):
    """Elastic trial stress of one particle row `q` from its velocity gradient, then relaxation."""
    trace = q[C] + q[C + 4] + q[C + 8]
    ratio = q[VOLUME_RATIO] * (1.0 + dt * trace)
    q[VOLUME_RATIO] = ratio
    p = pressure_of(ratio, soil.bulk_modulus)
    if p <= 0.0:
        for a in range(6):
            q[S + a] = 0.0
        q[FLUIDITY] = 0.0
        return
    # Spin W = (L - Lt) / 2; the stress turns with it: W s - s W.
    h = 0.5 * dt
    wxy, wyz, wzx = h * (q[C + 1] - q[C + 3]), h * (q[C + 5] - q[C + 7]), h * (q[C + 6] - q[C + 2])
    sxx, syy, szz = q[S], q[S + 1], q[S + 2]
    sxy, syz, szx = q[S + 3], q[S + 4], q[S + 5]
    g2 = 2.0 * soil.shear_modulus * dt
    third = trace / 3.0
    txx = sxx + 2.0 * (wxy * sxy - wzx * szx) + g2 * (q[C] - third)
    tyy = syy + 2.0 * (wyz * syz - wxy * sxy) + g2 * (q[C + 4] - third)
    tzz = szz + 2.0 * (wzx * szx - wyz * syz) + g2 * (q[C + 8] - third)
    g1 = soil.shear_modulus * dt
    txy = sxy + wxy * (syy - sxx) - wzx * syz + wyz * szx + g1 * (q[C + 1] + q[C + 3])
    tyz = syz + wyz * (szz - syy) - wxy * szx + wzx * sxy + g1 * (q[C + 5] + q[C + 7])
    tzx = szx + wzx * (sxx - szz) - wyz * sxy + wxy * syz + g1 * (q[C + 6] + q[C + 2])
    tau = math.sqrt(
        0.5 * (txx * txx + tyy * tyy + tzz * tzz) + txy * txy + tyz * tyz + tzx * tzx
    )
    if fluidity is not None:
        g_new = max(g_new, FLUIDITY_SEED)
        relaxed = relax_nonlocal(tau, p, g_new, dt, soil)
        q[FLUIDITY] = g_new + dt * fluidity_source(g_new, relaxed, p, soil)
    else:
        relaxed = relax_local(tau, p, dt, soil)
    factor = 1.0
    if tau > 0.0:
        factor = relaxed / tau
    q[S], q[S + 1], q[S + 2] = factor * txx, factor * tyy, factor * tzz
    q[S + 3], q[S + 4], q[S + 5] = factor * txy, factor * tyz, factor * tzx


@numba.njit(**_JIT)
def diffuse_fluidity(particles, grid, work, shape, top, origin, dx, dt, soil):
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


@numba.njit(cache=True)
def advance(
    particles,
    grid,
    fluidity,
    shape,
    origin,
    dx,
    dt,
    walls,
    soil,
    particle_volume,
    gravity,
    keep,
    dims,
    friction,
    outset,
    path,
    spin,
    rider,
    impulse,
    status,
):
    """Advances the soil (and the wheel's height) by len(path) - 1 steps. Works in place.

    Args:
        particles: float64 [N, COLUMNS].
        grid: float64 [4 nodes], work space: momentum or velocity, and mass, of each node.
        fluidity: float64 [nodes, 3], work space of the nonlocal law; None: local mu(I).
        shape, origin, dx: the grid: nodes per axis, position of node 0 (m), cell size (m).
        dt: time step, s. The caller has checked it (`stability`).
        walls: int [5], see `update_grid`.
        soil: `Soil`.
        particle_volume: m3 of packed soil per particle.
        gravity: m/s2, along -y.
        keep: factor on all grid velocities per step: 1, or less to settle a packing.
        kind, dims, friction: the body, see `bodies`.
        path: float64 [steps + 1, 2], position of the body's reference point at each step's ends;
            its y is not used if the body rides freely.
        spin: rad/s about z, prescribed.
        rider: float64 [4]: height y (m), vertical speed (m/s), mass (kg), load (N). A positive
            mass makes the vertical motion free under the load.
        impulse: float64 [3], N s given to the body by the soil (added to).
        status: int64 [3]: error code, particle, steps done.
    """
    mass = particle_volume * soil.bulk_density
    before = np.empty(3)
    for step in range(path.shape[0] - 1):
        top = particles_to_grid(
            particles, grid, shape, origin, dx, dt, mass, particle_volume,
            soil.bulk_modulus, status,
        )
        if status[0] != OK:
            return
        update_grid(grid, shape, top, dt, gravity, walls, keep)
        if dims is not None:
            free = rider[2] > 0.0
            vx = (path[step + 1, 0] - path[step, 0]) / dt
            y, vy = path[step, 1], (path[step + 1, 1] - path[step, 1]) / dt
            if free:
                y, vy = rider[0], rider[1]
            before[:] = impulse
            contact(
                grid, shape, top, origin, dx, walls, dims, friction, outset,
                (path[step, 0], y), (vx, vy, spin), impulse,
            )
            if free:
                rider[1] += (impulse[1] - before[1] - rider[3] * dt) / rider[2]
                rider[0] += dt * rider[1]
        if fluidity is not None:
            diffuse_fluidity(particles, grid, fluidity, shape, top, origin, dx, dt, soil)
        grid_to_particles(
            particles, grid, shape, origin, dx, dt, soil, fluidity
        )
        status[2] += 1
