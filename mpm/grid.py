"""The background grid of a bin: its nodes, walls, kicks and drifts between two exchanges.

A cell is dx long in the plane of travel (x, y) and dz across: a tool is many times wider than it
cuts deep, so the soil in front of it changes in the plane and hardly across. A node carries
(vx, vy, vz, 1 / m). Nodes on and beyond a wall, and nodes that sleeping soil touches, do not move:
they stay out of the list of free nodes, with no velocity.
"""

from typing import NamedTuple

import numba
import numpy as np

from mpm import vectors
from mpm.columns import JIT, index
from mpm.scenes import CORNER, Bin

PAD = 3  # nodes outside the bin on the low side


class Grid(NamedTuple):
    """The background grid of a bin. A NamedTuple, so that kernels can take it."""

    shape: tuple  # nodes per axis
    origin: tuple  # position of node (0, 0, 0), m
    dx: float  # length of a cell along x and y, m
    dz: float  # along z, m
    # Node indices (x low, x high, floor, z low, z high) of the sticky walls, and 1 if the walls
    # across z are smooth instead
    walls: tuple

    @property
    def nodes(self) -> int:
        return self.shape[0] * self.shape[1] * self.shape[2]

    @property
    def cell(self) -> np.ndarray:
        """Sides [3] of a cell, m."""
        return np.array([self.dx, self.dx, self.dz])


def make_grid(box: Bin) -> Grid:
    """Returns the grid of a bin; its walls and floor lie on planes of nodes. ValueError: length or
    width are not a whole number of cells."""
    cells = [box.size[0] / box.dx, box.height / box.dx, box.size[2] / box.dz]
    for name, count in (('length', cells[0]), ('width', cells[2])):
        if abs(count - round(count)) > 1e-6:
            raise ValueError(f'the {name} of the bin must be whole cells, got {count:.6g}')
    nx, ny, nz = round(cells[0]), int(np.ceil(cells[1])), round(cells[2])
    return Grid(
        shape=(nx + 2 * PAD + 1, ny + 2 * PAD + 1, nz + 2 * PAD + 1),
        origin=(CORNER - PAD * box.dx, CORNER - PAD * box.dx, CORNER - PAD * box.dz),
        dx=box.dx,
        dz=box.dz,
        walls=(PAD, PAD + nx, PAD, PAD, PAD + nz, 0),
    )


@numba.njit(**JIT)
def start_nodes(nodes, grid, box, push, fall):
    """Turns the scattered momentum into velocity; lists the nodes that soil touches, and returns
    how many of them are free and how many there are.

    Args:
        box: first and last node (exclusive) per axis that can have been touched.
        push, fall: m/s, along x and downwards, that gravity adds.
    """
    velocity, walls = nodes.velocity, grid.walls
    zero = vectors.make(velocity, 0.0, 0.0, 0.0, 0.0)
    free = touched = 0
    for j in range(box[2], box[3]):
        for i in range(box[0], box[1]):
            is_wall = j <= walls[2] or i <= walls[0] or i >= walls[1]
            for k in range(box[4], box[5]):
                number = (j * grid.shape[0] + i) * grid.shape[2] + k
                node = index(4 * number)
                mass = velocity[node + index(3)]
                if mass > 0.0:
                    nodes.touched[touched] = node
                    touched += 1
                    is_side = k <= walls[3] or k >= walls[4]
                    r = 1.0 / mass
                    if is_wall or nodes.asleep[number] or (is_side and walls[5] == 0):
                        vectors.store(velocity, node, zero)
                        velocity[node + index(3)] = r
                        continue
                    velocity[node] = velocity[node] * r + push
                    velocity[node + index(1)] = velocity[node + index(1)] * r - fall
                    velocity[node + index(2)] *= 0.0 if is_side else r
                    velocity[node + index(3)] = r
                    nodes.free[free] = node
                    free += 1
    return free, touched


@numba.njit(**JIT)
def kick(nodes, grid, free, dt, along, down, settling, drift):
    """v_i += dt (f_i / m_i + g), then u_i += drift v_i; forces are zero again afterwards.

    Args:
        free: number of free nodes.
        dt: s, of the kick.
        along, down: m/s2, gravity along x and -y; 0 where `start_nodes` has added it.
        settling: factor on the velocities, 1 or less.
        drift: s, that the nodes then move.
    """
    velocity, force = nodes.velocity, nodes.force
    zero = vectors.make(velocity, 0.0, 0.0, 0.0, 0.0)
    fall = vectors.make(velocity, along * dt, -down * dt, 0.0, 0.0)
    nz, walls = grid.shape[2], grid.walls
    for n in range(free):
        node = nodes.free[n]
        r = velocity[node + index(3)]
        v = vectors.muladd(dt * r, vectors.load(force, node), vectors.load(velocity, node))
        # Gravity too: soil at rest would else carry 1 / settling of its weight.
        v = vectors.scale(settling, vectors.add(v, fall))
        vectors.store(velocity, node, v)
        velocity[node + index(3)] = r
        if walls[5] == 1:
            k = (node // index(4)) % index(nz)
            if k <= walls[3] or k >= walls[4]:
                velocity[node + index(2)] = 0.0
                v = vectors.load(velocity, node)
        vectors.store(force, node, zero)
        u = vectors.load(nodes.displacement, node)
        vectors.store(nodes.displacement, node, vectors.muladd(drift, v, u))


@numba.njit(**JIT)
def clear(nodes, touched):
    """Sets all arrays of the first `touched` nodes of the list to zero."""
    zero = vectors.make(nodes.velocity, 0.0, 0.0, 0.0, 0.0)
    for n in range(touched):
        node = nodes.touched[n]
        vectors.store(nodes.velocity, node, zero)
        vectors.store(nodes.force, node, zero)
        vectors.store(nodes.displacement, node, zero)
