"""Transfers between particles and grid: quadratic B-splines, MLS stress, APIC at the exchange.

Within an exchange interval (`solver`) the weights w_ip are frozen. With x_i - x_p the way from
particle to node and D = dx2 / 4 the inertia of a quadratic B-spline:

    momentum    (m v)_i = sum_p w_ip m_p (v_p + C_p (x_i - x_p))                       (1)
    gradient    L_p     = sum_i w_ip v_i (x_i - x_p)^T / D                             (2)
    force       f_i     = -sum_p w_ip V_p sigma_p (x_i - x_p) / D                      (3)
    back        v_p = sum_i w_ip v_i,  C_p = L_p,  x_p += sum_i w_ip u_i               (4)

u_i is the way that node i has gone since the last exchange. A node is four numbers in a row, so
every sum is over vectors of four (`vectors`).

Sources:
  APIC: Jiang, Schroeder, Selle, Teran, Stomakhin (2015), ACM Trans. Graph. 34, 51.
  MLS-MPM: Hu et al. (2018), ACM Trans. Graph. 37, 150.
"""

import numba

from mpm import vectors
from mpm.columns import (
    JIT,
    LEFT_GRID,
    TURNED_INSIDE_OUT,
    VOLUME_RATIO,
    C,
    S,
    V,
    index,
)
from mpm.constitutive import pressure_of, update_stress

CHUNK = 64  # particles whose stresses are updated together, so that the compiler uses wide vectors


@numba.njit(inline='always', **JIT)
def weights(f):
    """Quadratic B-spline weights of three nodes; the first lies f + 0.5 cells below (f < 1)."""
    return 0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2


@numba.njit(inline='always', **JIT)
def _third(i, triple):
    """triple[i] in a form that is unrolled."""
    return triple[0] if i == 0 else (triple[1] if i == 1 else triple[2])


@numba.njit(inline='always', **JIT)
def scatter(grid, base, strides, place, first, along_x, along_y, along_z):
    """Adds w (first + i along_x + j along_y + k along_z) to the 27 nodes around a particle.

    Args:
        grid: float64 [4 nodes].
        base: index of node (0, 0, 0) of the 27 in `grid`.
        strides: steps of the index along x and along y; z is 4.
        place: the particle's fractions (fx, fy, fz), see `weights`.
        first, along_x, along_y, along_z: vectors of four.
    """
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    for j in range(3):
        row_value = first
        for i in range(3):
            w = _third(j, wy) * _third(i, wx)
            node = base + index(j) * strides[1] + index(i) * strides[0]
            a, b = vectors.scale(w, row_value), vectors.scale(w, along_z)
            vectors.store(grid, node, vectors.muladd(wz[0], a, vectors.load(grid, node)))
            a, node = vectors.add(a, b), node + index(4)
            vectors.store(grid, node, vectors.muladd(wz[1], a, vectors.load(grid, node)))
            a, node = vectors.add(a, b), node + index(4)
            vectors.store(grid, node, vectors.muladd(wz[2], a, vectors.load(grid, node)))
            row_value = vectors.add(row_value, along_x)
        first = vectors.add(first, along_y)


@numba.njit(inline='always', **JIT)
def gather(grid, base, strides, place):
    """Returns sum w g, sum w i g, sum w j g, sum w k g over the 27 nodes; see `scatter`."""
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    total = vectors.make(0.0, 0.0, 0.0, 0.0)
    total_i, total_j, total_k = total, total, total
    for j in range(3):
        plane = vectors.make(0.0, 0.0, 0.0, 0.0)
        for i in range(3):
            w = _third(j, wy) * _third(i, wx)
            node = base + index(j) * strides[1] + index(i) * strides[0]
            # Along z first: sum w g and sum w k g of three nodes.
            middle = vectors.scale(wz[1], vectors.load(grid, node + index(4)))
            last = vectors.scale(wz[2], vectors.load(grid, node + index(8)))
            row = vectors.muladd(wz[0], vectors.load(grid, node), vectors.add(middle, last))
            plane = vectors.muladd(w, row, plane)
            total_i = vectors.muladd(i * w, row, total_i)
            total_k = vectors.muladd(w, vectors.muladd(2.0, last, middle), total_k)
        total = vectors.add(total, plane)
        total_j = vectors.muladd(float(j), plane, total_j)
    return total, total_i, total_j, total_k


@numba.njit(inline='always', **JIT)
def interpolate(grid, base, strides, place):
    """Returns sum w g over the 27 nodes as a tuple of four; see `scatter`."""
    wx, wy, wz = weights(place[0]), weights(place[1]), weights(place[2])
    total = vectors.make(0.0, 0.0, 0.0, 0.0)
    for j in range(3):
        for i in range(3):
            node = base + index(j) * strides[1] + index(i) * strides[0]
            row = vectors.scale(wz[0], vectors.load(grid, node))
            row = vectors.muladd(wz[1], vectors.load(grid, node + index(4)), row)
            row = vectors.muladd(wz[2], vectors.load(grid, node + index(8)), row)
            total = vectors.muladd(_third(j, wy) * _third(i, wx), row, total)
    return vectors.parts(total)


@numba.njit(inline='always', **JIT)
def strides_of(shape):
    """Steps of the index of a node along x and y; nodes are numbered ((j nx + i) nz + k) 4."""
    return index(4 * shape[2]), index(4 * shape[0] * shape[2])


@numba.njit(**JIT)
def particles_to_grid(block, velocity, grid, half_step, mass, volume, bulk_modulus, status):
    """Eq. (1), and the half kick of the soil's own forces (3) that begins an exchange interval.

    Fills `block.base` and `block.place` for the interval, adds momentum and mass to `velocity`.

    Args:
        block: `solver.Block` of the particles that are awake.
        velocity: float64 [4 nodes], zero: momentum (N s) and mass (kg) afterwards.
        grid: `grid.Grid`.
        half_step: half a time step, s.
        mass, volume: of a particle as packed, kg and m3.
        bulk_modulus: Pa.
        status: int64 [2]: code and column of the block are set on an error.

    Returns:
        First and last node (exclusive) per axis that can have been touched, six integers.
    """
    q = block.particles
    nx, ny, nz = grid.shape
    inverse = 1.0 / grid.dx
    strides = strides_of(grid.shape)
    stress_scale = -half_step * volume * 4.0 * inverse * inverse
    i0, i1, j0, j1, k0, k1 = nx, 0, ny, 0, nz, 0
    for n in range(q.shape[1]):
        gx = (q[0, n] - grid.origin[0]) * inverse - 0.5
        gy = (q[1, n] - grid.origin[1]) * inverse - 0.5
        gz = (q[2, n] - grid.origin[2]) * inverse - 0.5
        # Comparisons that are false for NaN too, before anything becomes an index.
        is_inside = gx >= 0.0 and gx < nx - 2 and gy >= 0.0 and gy < ny - 2
        if not (is_inside and gz >= 0.0 and gz < nz - 2):
            status[0], status[1] = LEFT_GRID, n
            break
        ratio = q[VOLUME_RATIO, n]
        if not ratio > 0.0:
            status[0], status[1] = TURNED_INSIDE_OUT, n
            break
        bi, bj, bk = int(gx), int(gy), int(gz)
        i0, i1 = min(i0, bi), max(i1, bi + 3)
        j0, j1 = min(j0, bj), max(j1, bj + 3)
        k0, k1 = min(k0, bk), max(k1, bk + 3)
        place = (gx - bi, gy - bj, gz - bk)
        base = index(((bj * nx + bi) * nz + bk) * 4)
        block.base[n] = base
        block.place[0, n], block.place[1, n], block.place[2, n] = place
        # The columns of m C - dt/2 V sigma / D, per cell.
        p = pressure_of(ratio, bulk_modulus)
        s = stress_scale * ratio
        dx = grid.dx
        xx, yy, zz = s * (q[S, n] - p), s * (q[S + 1, n] - p), s * (q[S + 2, n] - p)
        xy, yz, zx = s * q[S + 3, n], s * q[S + 4, n], s * q[S + 5, n]
        along_x = vectors.make(
            (xx + mass * q[C, n]) * dx,
            (xy + mass * q[C + 3, n]) * dx,
            (zx + mass * q[C + 6, n]) * dx,
            0.0,
        )
        along_y = vectors.make(
            (xy + mass * q[C + 1, n]) * dx,
            (yy + mass * q[C + 4, n]) * dx,
            (yz + mass * q[C + 7, n]) * dx,
            0.0,
        )
        along_z = vectors.make(
            (zx + mass * q[C + 2, n]) * dx,
            (yz + mass * q[C + 5, n]) * dx,
            (zz + mass * q[C + 8, n]) * dx,
            0.0,
        )
        first = vectors.make(mass * q[V, n], mass * q[V + 1, n], mass * q[V + 2, n], mass)
        first = _at_first_node(place, first, along_x, along_y, along_z)
        scatter(velocity, base, strides, place, first, along_x, along_y, along_z)
    return i0, i1, j0, j1, k0, k1


@numba.njit(inline='always', **JIT)
def _at_first_node(place, value, along_x, along_y, along_z):
    """An affine field, given at the particle, at the first of the 27 nodes."""
    value = vectors.muladd(-place[2] - 0.5, along_z, value)
    value = vectors.muladd(-place[1] - 0.5, along_y, value)
    return vectors.muladd(-place[0] - 0.5, along_x, value)


@numba.njit(**JIT)
def strain_and_force(block, nodes, grid, dt, volume, soil, damping_time, fluidity):
    """Eq. (2), the stress update over `dt` (s), and eq. (3) added to the nodes' forces.

    `damping_time` (s) and `fluidity` (None with the local law): see `constitutive.update_stress`.
    """
    q, gradient, stress = block.particles, block.gradient, block.stress
    velocity, force = nodes.velocity, nodes.force
    strides = strides_of(grid.shape)
    per_cell = 4.0 / grid.dx
    for start in range(0, q.shape[1], CHUNK):
        stop = min(q.shape[1], start + CHUNK)
        for n in range(start, stop):
            place = (block.place[0, n], block.place[1, n], block.place[2, n])
            columns = _gradient(velocity, block.base[n], strides, place, per_cell)
            for axis in range(3):
                column = _third(axis, columns)
                gradient[axis, n - start] = column[0]
                gradient[axis + 3, n - start] = column[1]
                gradient[axis + 6, n - start] = column[2]
        update_stress(q, start, stop, gradient, stress, dt, soil, damping_time, fluidity)
        for n in range(start, stop):
            place = (block.place[0, n], block.place[1, n], block.place[2, n])
            c, factor = n - start, -volume * per_cell * q[VOLUME_RATIO, n]
            xy, yz, zx = factor * stress[3, c], factor * stress[4, c], factor * stress[5, c]
            along_x = vectors.make(factor * stress[0, c], xy, zx, 0.0)
            along_y = vectors.make(xy, factor * stress[1, c], yz, 0.0)
            along_z = vectors.make(zx, yz, factor * stress[2, c], 0.0)
            first = vectors.make(0.0, 0.0, 0.0, 0.0)
            first = _at_first_node(place, first, along_x, along_y, along_z)
            scatter(force, block.base[n], strides, place, first, along_x, along_y, along_z)


@numba.njit(inline='always', **JIT)
def _gradient(velocity, base, strides, place, per_cell):
    """The three columns of L_p, each (d vx, d vy, d vz, -) along one axis."""
    total, total_i, total_j, total_k = gather(velocity, base, strides, place)
    x = vectors.scale(per_cell, vectors.muladd(-place[0] - 0.5, total, total_i))
    y = vectors.scale(per_cell, vectors.muladd(-place[1] - 0.5, total, total_j))
    z = vectors.scale(per_cell, vectors.muladd(-place[2] - 0.5, total, total_k))
    return vectors.parts(x), vectors.parts(y), vectors.parts(z)


@numba.njit(**JIT)
def grid_to_particles(block, velocity, displacement, grid):
    """Eq. (4): what the particles take back at the end of an exchange interval."""
    q = block.particles
    strides = strides_of(grid.shape)
    per_cell = 4.0 / grid.dx
    for n in range(q.shape[1]):
        base = block.base[n]
        place = (block.place[0, n], block.place[1, n], block.place[2, n])
        v = interpolate(velocity, base, strides, place)
        u = interpolate(displacement, base, strides, place)
        columns = _gradient(velocity, base, strides, place, per_cell)
        for axis in range(3):
            q[axis, n] += u[axis]
            q[V + axis, n] = v[axis]
            column = _third(axis, columns)
            q[C + axis, n] = column[0]
            q[C + 3 + axis, n] = column[1]
            q[C + 6 + axis, n] = column[2]
