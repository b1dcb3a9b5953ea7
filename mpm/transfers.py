"""Transfers between particles and grid: quadratic B-splines, MLS stress, APIC at the exchange.

Within an exchange interval (`solver`) the weights w_ip are frozen. With x_i - x_p the way from
particle to node and D = diag(dx2, dx2, dz2) / 4 the inertia of a quadratic B-spline:

    momentum    (m v)_i = sum_p w_ip m_p (v_p + C_p (x_i - x_p))                       (1)
    gradient    L_p     = sum_i w_ip v_i (x_i - x_p)^T D^-1                            (2)
    force       f_i     = -sum_p w_ip V_p sigma_p D^-1 (x_i - x_p)                     (3)
    back        v_p = sum_i w_ip v_i,  C_p = L_p,  x_p += sum_i w_ip u_i               (4)

u_i is the way that node i has gone since the last exchange. A node is four numbers and the nodes
along z lie one after another, so the 27 nodes of a particle are nine rows (`vectors`).

Sources:
  APIC: Jiang, Schroeder, Selle, Teran, Stomakhin (2015), ACM Trans. Graph. 34, 51.
  MLS-MPM: Hu et al. (2018), ACM Trans. Graph. 37, 150.
"""

import numba

from mpm import vectors
from mpm.columns import (
    CHUNK,
    COLUMNS,
    ELASTIC,
    JIT,
    LEFT_GRID,
    TURNED_INSIDE_OUT,
    VOLUME_RATIO,
    C,
    S,
    V,
    index,
    row,
)
from mpm.stress import pressure_of, update_stress


@numba.njit(inline='always', **JIT)
def weights(f):
    """Quadratic B-spline weights of three nodes; the first lies f + 0.5 cells below (f < 1)."""
    return 0.5 * (1.0 - f) ** 2, 0.75 - (f - 0.5) ** 2, 0.5 * f**2


# What the transfers of an interval need of a particle, 16 numbers in a row (`Block.weights`):
# weights along x and along y, the way from the particle to the first node in cells (x, y, z),
# twice the last weight along x and along y, one unused, weights along z and a zero. The zero
# is for a fourth node: rows of four fill a register.
WEIGHTS = 16
WX, WY, WAY, TWICE, WZ = index(0), index(3), index(6), index(9), index(12)


@numba.njit(inline='always', **JIT)
def keep_weights(kept, n, place):
    """Writes the weights of particle n at fractions of a cell (fx, fy, fz)."""
    at = WEIGHTS * n
    for axis in range(3):
        w = weights(place[axis])
        to = at + (12 if axis == 2 else 3 * axis)
        kept[to], kept[to + 1], kept[to + 2] = w
        kept[at + 6 + axis] = -place[axis] - 0.5
        if axis < 2:
            kept[at + 9 + axis] = 2.0 * w[2]


@numba.njit(inline='always', **JIT)
def scatter(grid, base, strides, kept, at, affine):
    """Adds w (first + i along_x + j along_y + k along_z) to the 27 nodes around a particle.

    Args:
        grid: [4 nodes], float32 or float64; base: index of node (0, 0, 0) of the 27 in it.
        strides: steps of the index along x and y; z is 4.
        kept, at: `Block.weights` and where the particle's begin.
        affine: four registers of four: at the particle, and the change per cell along x, y, z.
    """
    first, along_x, along_y, along_z = affine
    first = vectors.muladd(kept[at + WAY + index(2)], along_z, first)
    first = vectors.muladd(kept[at + WAY + index(1)], along_y, first)
    first = vectors.muladd(kept[at + WAY], along_x, first)
    w = vectors.stretch(vectors.load(kept, at + WZ))
    k = vectors.stretch(vectors.make(grid, 0.0, 1.0, 2.0, 0.0))
    plane = vectors.add(vectors.repeat(first), vectors.multiply(k, vectors.repeat(along_z)))
    plane = vectors.multiply(w, plane)
    along_x = vectors.multiply(w, vectors.repeat(along_x))
    along_y = vectors.multiply(w, vectors.repeat(along_y))
    for j in range(3):
        row = vectors.scale(kept[at + WY + index(j)], plane)
        step = vectors.scale(kept[at + WY + index(j)], along_x)
        node = base + index(j) * strides[1]
        for i in range(3):
            old = vectors.load_row(grid, node)
            vectors.store_row(grid, node, vectors.muladd(kept[at + WX + index(i)], row, old))
            row = vectors.add(row, step)
            node = node + strides[0]
        plane = vectors.add(plane, along_y)


@numba.njit(inline='always', **JIT)
def gather(grid, base, strides, kept, at):
    """Returns sums over the 27 nodes: w g (x_i - x_p) in cells along x, y and z, and w g.

    See `scatter`. All are registers of four; three times 4 / dx (4 / dz) are the columns of L_p,
    eq. (2).
    """
    nothing = vectors.repeat(vectors.make(grid, 0.0, 0.0, 0.0, 0.0))
    total, total_i, total_j = nothing, nothing, nothing
    for j in range(3):
        node = base + index(j) * strides[1]
        first = vectors.load_row(grid, node)
        middle = vectors.load_row(grid, node + strides[0])
        last = vectors.load_row(grid, node + index(2) * strides[0])
        # sum w g and sum w i g along x; then along y, and along z for all of them at once.
        middle = vectors.scale(kept[at + WX + index(1)], middle)
        plane = vectors.muladd(kept[at + WX], first, middle)
        plane = vectors.muladd(kept[at + WX + index(2)], last, plane)
        slope = vectors.muladd(kept[at + TWICE], last, middle)
        total = vectors.muladd(kept[at + WY + index(j)], plane, total)
        total_i = vectors.muladd(kept[at + WY + index(j)], slope, total_i)
        if j > 0:
            factor = at + (WY if j == 1 else TWICE) + index(1)
            total_j = vectors.muladd(kept[factor], plane, total_j)
    w = vectors.stretch(vectors.load(kept, at + WZ))
    k = vectors.stretch(vectors.make(grid, 0.0, 1.0, 2.0, 0.0))
    total = vectors.multiply(w, total)
    x = vectors.fold(vectors.multiply(w, total_i))
    y = vectors.fold(vectors.multiply(w, total_j))
    z = vectors.fold(vectors.multiply(k, total))
    mean = vectors.fold(total)
    x = vectors.muladd(kept[at + WAY], mean, x)
    y = vectors.muladd(kept[at + WAY + index(1)], mean, y)
    z = vectors.muladd(kept[at + WAY + index(2)], mean, z)
    return (x, y, z), mean


@numba.njit(inline='always', **JIT)
def interpolate(grid, base, strides, kept, at):
    """Returns sum w g over the 27 nodes as a tuple of four float64; see `scatter`."""
    total = vectors.repeat(vectors.make(grid, 0.0, 0.0, 0.0, 0.0))
    for j in range(3):
        node = base + index(j) * strides[1]
        plane = vectors.scale(kept[at + WX], vectors.load_row(grid, node))
        for i in range(1, 3):
            node = node + strides[0]
            row = vectors.load_row(grid, node)
            plane = vectors.muladd(kept[at + WX + index(i)], row, plane)
        total = vectors.muladd(kept[at + WY + index(j)], plane, total)
    w = vectors.stretch(vectors.load(kept, at + WZ))
    return vectors.parts(vectors.fold(vectors.multiply(w, total)))


@numba.njit(inline='always', **JIT)
def strides_of(shape):
    """Steps of the index of a node along x and y; nodes are numbered ((j nx + i) nz + k) 4."""
    return index(4 * shape[2]), index(4 * shape[0] * shape[2])


@numba.njit(**JIT)
def particles_to_grid(block, velocity, grid, half_step, volume, soil, status):
    """Eq. (1), and the half kick of the soil's own forces (3) that begins an exchange interval.

    Fills `block.base`, `weights` and `elastic` for the interval; adds to `velocity`.

    Args:
        velocity: float64 [4 nodes], zero: momentum (N s) and mass (kg) afterwards.
        half_step: half a time step, s.
        volume: of a particle as packed, m3.
        status: int64 [2]: code and row of the block are set on an error.

    Returns first and last node (exclusive) per axis that can have been touched, six integers.
    """
    q = block.particles
    nx, ny, nz = grid.shape
    inverse, inverse_z = 1.0 / grid.dx, 1.0 / grid.dz
    strides = strides_of(grid.shape)
    # -dt/2 V / D per cell, and the columns of C per cell: what a node one cell on gets more.
    plane, across = -half_step * volume * 4.0 * inverse, -half_step * volume * 4.0 * inverse_z
    mass = volume * soil.bulk_density
    mass_x, mass_z = mass * grid.dx, mass * grid.dz
    i0, i1, j0, j1, k0, k1 = nx, 0, ny, 0, nz, 0
    for n in range(len(q)):
        gx = (q[n, 0] - grid.origin[0]) * inverse - 0.5
        gy = (q[n, 1] - grid.origin[1]) * inverse - 0.5
        gz = (q[n, 2] - grid.origin[2]) * inverse_z - 0.5
        # Comparisons that are false for NaN too, before anything becomes an index.
        is_inside = gx >= 0.0 and gx < nx - 2 and gy >= 0.0 and gy < ny - 2
        if not (is_inside and gz >= 0.0 and gz < nz - 3):
            status[0], status[1] = LEFT_GRID, n
            break
        ratio = q[n, VOLUME_RATIO]
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
        keep_weights(block.weights, n, place)
        keep_elastic(block, n)
        p = pressure_of(ratio - 1.0, soil.bulk_modulus)
        sp, sz = plane * ratio, across * ratio
        xx, yy, zz = q[n, S] - p, q[n, S + 1] - p, q[n, S + 2] - p
        xy, yz, zx = q[n, S + 3], q[n, S + 4], q[n, S + 5]
        affine = (
            vectors.make(velocity, mass * q[n, V], mass * q[n, V + 1], mass * q[n, V + 2], mass),
            _column(velocity, q, n, C, mass_x, sp * xx, sp * xy, sp * zx),
            _column(velocity, q, n, C + 1, mass_x, sp * xy, sp * yy, sp * yz),
            _column(velocity, q, n, C + 2, mass_z, sz * zx, sz * yz, sz * zz),
        )
        scatter(velocity, base, strides, block.weights, index(WEIGHTS * n), affine)
    return i0, i1, j0, j1, k0, k1


@numba.njit(inline='always', **JIT)
def _column(velocity, q, n, at, mass, x, y, z):
    """A column of m C - dt/2 V sigma D^-1, per cell."""
    rate = q[n, at], q[n, at + 3], q[n, at + 6]
    return vectors.make(velocity, x + mass * rate[0], y + mass * rate[1], z + mass * rate[2], 0.0)


@numba.njit(inline='always', **JIT)
def elastic_place(n):
    """Where the rows of particle n are in `Block.elastic`: this and every CHUNK numbers on."""
    return index(n // CHUNK * (ELASTIC * CHUNK) + n % CHUNK)


@numba.njit(inline='always', **JIT)
def keep_elastic(block, n):
    """Stress and strain of particle n as the steps of an interval need them."""
    at = elastic_place(n)
    for number in range(6):
        block.elastic[row(at, number)] = block.particles[n, S + number]
    block.elastic[row(at, 6)] = block.particles[n, VOLUME_RATIO] - 1.0


@numba.njit(inline='always', **JIT)
def return_elastic(block, n):
    at = elastic_place(n)
    for number in range(6):
        block.particles[n, S + number] = block.elastic[row(at, number)]
    block.particles[n, VOLUME_RATIO] = 1.0 + block.elastic[row(at, 6)]


@numba.njit(**JIT)
def strain_and_force(block, nodes, grid, dt, volume, soil, damping_time):
    """Eq. (2), the stress update over `dt` (s), and eq. (3) added to the nodes' forces.

    `damping_time` (s): see `stress.update_stress`.
    """
    gradient, stress, kept = block.gradient, block.stress, block.weights
    velocity, force = nodes.velocity, nodes.force
    strides = strides_of(grid.shape)
    per_cell, per_cell_z = 4.0 / grid.dx, 4.0 / grid.dz
    for start in range(0, len(block.particles), CHUNK):
        count = index(min(len(block.particles) - start, CHUNK))
        for c in range(count):
            n = index(start) + c
            at = index(WEIGHTS) * n
            columns, _ = gather(velocity, block.base[n], strides, kept, at)
            _put_gradient(gradient, c, index(CHUNK), columns, per_cell, per_cell_z)
        update_stress(block, start, count, dt, soil, damping_time)
        strain = row(index(ELASTIC * start), 6)
        for c in range(count):
            n = index(start) + c
            ratio = -volume * (1.0 + block.elastic[strain + c])
            plane, across = ratio * per_cell, ratio * per_cell_z
            xx, yy, zz = stress[c], stress[row(c, 1)], stress[row(c, 2)]
            xy, yz, zx = stress[row(c, 3)], stress[row(c, 4)], stress[row(c, 5)]
            affine = (
                vectors.make(force, 0.0, 0.0, 0.0, 0.0),
                vectors.scale(plane, vectors.make(force, xx, xy, zx, 0.0)),
                vectors.scale(plane, vectors.make(force, xy, yy, yz, 0.0)),
                vectors.scale(across, vectors.make(force, zx, yz, zz, 0.0)),
            )
            scatter(force, block.base[n], strides, kept, index(WEIGHTS) * n, affine)


@numba.njit(inline='always', **JIT)
def _put_gradient(out, first, step, columns, per_cell, per_cell_z):
    """Writes the nine entries of L_p, row by row, `step` apart in the vector `out`."""
    x = vectors.parts(vectors.scale(per_cell, columns[0]))
    y = vectors.parts(vectors.scale(per_cell, columns[1]))
    z = vectors.parts(vectors.scale(per_cell_z, columns[2]))
    for axis in range(3):
        at = first + index(3 * axis) * step
        out[at], out[at + step], out[at + index(2) * step] = x[axis], y[axis], z[axis]


@numba.njit(**JIT)
def grid_to_particles(block, velocity, displacement, grid):
    """Eq. (4): what particles take back at the end of an interval."""
    q, kept = block.particles, block.weights
    flat = q.ravel()
    strides = strides_of(grid.shape)
    per_cell, per_cell_z = 4.0 / grid.dx, 4.0 / grid.dz
    for n in range(len(q)):
        base, at = block.base[n], index(WEIGHTS * n)
        u = interpolate(displacement, base, strides, kept, at)
        columns, mean = gather(velocity, base, strides, kept, at)
        v = vectors.parts(mean)
        for axis in range(3):
            q[n, axis] += u[axis]
            q[n, V + axis] = v[axis]
        _put_gradient(flat, index(COLUMNS * n + C), index(1), columns, per_cell, per_cell_z)
        return_elastic(block, n)
