"""The grid step: gravity, walls, and Coulomb contact with the body."""

import math

import numba

from mpm.bodies import signed_distance
from mpm.columns import JIT, index


@numba.njit(**JIT)
def update_grid(grid, shape, top, dt, gravity, walls, keep):
    """Turns momentum into velocity; applies gravity and the sticky walls.

    `walls` are node indices (i low, i high, j low, k low, k high): soil at rest on and beyond
    them; the plane of a wall is the plane of its nodes. If walls[5] is 1, the two walls across z
    are smooth instead of sticky. `keep` scales velocities (settling).
    """
    nx, ny, nz = shape
    fall = -gravity * dt
    for j in range(top):
        for i in range(nx):
            row = (j * nx + i) * nz
            is_wall = j <= walls[2] or i <= walls[0] or i >= walls[1]
            for k in range(nz):
                node = index(4 * (row + k))
                m = grid[node + index(3)]
                if m > 0.0:
                    is_side = k <= walls[3] or k >= walls[4]
                    if is_wall or (is_side and walls[5] == 0):
                        grid[node] = 0.0
                        grid[node + index(1)] = 0.0
                        grid[node + index(2)] = 0.0
                    else:
                        r = keep / m
                        grid[node] *= r
                        grid[node + index(1)] = grid[node + index(1)] * r + fall
                        grid[node + index(2)] *= 0.0 if is_side else r


@numba.njit(**JIT)
def contact(grid, shape, top, origin, dx, walls, body, pose, motion, impulse):
    """Coulomb contact on the nodes inside the body; adds the momentum it removes to `impulse`.

    A node is constrained only if it lies inside (signed distance < 0), never one outside: a
    condition one node too low would let the soil sink by a cell.

    Args:
        body: `bodies.Body`.
        pose: (x, y, theta) of the body: its reference point, m, and its angle about z, rad.
        motion: (vx, vy, omega) of the body, m/s and rad/s.
        impulse: float64 [6], N s and N m s given to the body (added to); the angular part is
            r x p about the reference point, summed over the same nodes as the linear one.
    """
    nx, ny, nz = shape
    outset = body.outset * dx
    reach = body.radius + outset
    sine, cosine = math.sin(pose[2]), math.cos(pose[2])
    tip_x, tip_y = -body.length * sine, body.length * cosine
    x_low, x_high = pose[0] + min(0.0, tip_x) - reach, pose[0] + max(0.0, tip_x) + reach
    y_low, y_high = pose[1] + min(0.0, tip_y) - reach, pose[1] + max(0.0, tip_y) + reach
    half = body.half_width + outset
    z_low, z_high = body.z_middle - half, body.z_middle + half
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
            px, py = cosine * rx + sine * ry, cosine * ry - sine * rx
            bx = motion[0] - motion[2] * ry
            by = motion[1] + motion[2] * rx
            for k in range(k0, k1 + 1):
                node = index(4 * ((j * nx + i) * nz + k))
                m = grid[node + index(3)]
                if m <= 0.0:
                    continue
                rz = origin[2] + k * dx - body.z_middle
                distance, n_px, n_py, n_z = signed_distance(body, px, py, rz)
                share = min(1.0, (outset - distance) / dx)
                if share <= 0.0:
                    continue
                n_x, n_y = cosine * n_px - sine * n_py, sine * n_px + cosine * n_py
                ux, uy, uz = grid[node] - bx, grid[node + index(1)] - by, grid[node + index(2)]
                normal = ux * n_x + uy * n_y + uz * n_z
                allowed = -(1.0 - share) * max(0.0, bx * n_x + by * n_y)
                push = allowed - normal
                if push <= 0.0:
                    continue
                tx, ty, tz = ux - normal * n_x, uy - normal * n_y, uz - normal * n_z
                slip = math.sqrt(tx * tx + ty * ty + tz * tz)
                drag = 1.0
                if slip > body.friction * push:
                    drag = body.friction * push / slip
                cx, cy, cz = push * n_x - drag * tx, push * n_y - drag * ty, push * n_z - drag * tz
                grid[node] += cx
                grid[node + index(1)] += cy
                grid[node + index(2)] += cz
                dpx, dpy, dpz = -m * cx, -m * cy, -m * cz
                impulse[0] += dpx
                impulse[1] += dpy
                impulse[2] += dpz
                impulse[3] += ry * dpz - rz * dpy
                impulse[4] += rz * dpx - rx * dpz
                impulse[5] += rx * dpy - ry * dpx
