"""Contact between soil and bodies, at the particles.

A particle stands for soil up to half a spacing h around it in the plane of travel, so it touches a
body when its signed distance d from the surface (`distance.signed_distance`) falls below a = h / 2:

    normal      N = k (a - d)                        not negative                      (5)
    friction    T = -k g,  |T| <= mu N               g: the grip                       (6)

The grip g is the way that the body has dragged the contact along the surface since it closed; what
exceeds Coulomb's limit slips. Both act on the soil at the particle's place through its weights
(as a body force does), and on the body at the nearest point of its surface. The stiffness is a
quarter of the soil's own, k = M A / (4 h) with the modulus M of the pressure wave and the area
A = V / h that a particle covers: the depth a - d is then some tenths of a millimetre, and the step
resolves the frequency of a contact, sqrt(M / rho) / (2 h). There is no damping: one that acts on
the velocity of a step made the draft depend on the step by 1 %, and soil dissipates by itself.

Conditions on the nodes inside the body, as most material-point codes have them, move the surface by
up to a cell as the body crosses the grid (a force that swings by 20 %), and let soil through.

Sources: contact at particles instead of nodes: Zong, Jiang, Han (2024), arXiv 2403.13783; grip:
Cundall, Strack (1979), Geotechnique 29, 47.
"""

import math
from typing import NamedTuple

import numba

from mpm import vectors
from mpm.columns import GRIP, JIT, index
from mpm.constitutive import Soil
from mpm.distance import signed_distance
from mpm.transfers import WEIGHTS, interpolate, scatter, strides_of

RADIUS = 0.5  # of the particle spacing in the plane
STIFFNESS = 0.25  # of M A / h


class ContactLaw(NamedTuple):
    """Constants of eqs. (5) and (6)."""

    radius: float  # distance of a particle from the surface at which it touches, m
    stiffness: float  # N/m


def make_contact(soil: Soil, particle_volume: float, spacing: float) -> ContactLaw:
    """Returns the contact of particles of a packed volume (m3), so far (m) apart in the plane."""
    modulus = soil.bulk_modulus + 4.0 * soil.shear_modulus / 3.0
    return ContactLaw(RADIUS * spacing, STIFFNESS * modulus * particle_volume / spacing**2)


@numba.njit(**JIT)
def contact(block, nodes, grid, near, body, law, pose, rates, dt, load):
    """Eqs. (5) and (6) at the given moment: adds forces to the nodes, writes those on the body.

    The weights are those of the last exchange, to which the nodes' displacements are added.

    Args:
        near: int64, the particles to look at.
        pose: x, y (m) of the reference point, angle (rad), z (m).
        rates: of the pose, m/s and rad/s.
        dt: s, over which contacts have been dragged since the last call.
        load: float64 [6], force (N) and torque (N m, about the reference point) of the soil on the
            body; overwritten.
    """
    load[:] = 0.0
    q = block.particles
    strides = strides_of(grid.shape)
    sine, cosine = math.sin(pose[2]), math.cos(pose[2])
    zero = vectors.make(nodes.force, 0.0, 0.0, 0.0, 0.0)
    for n in near:
        at = index(WEIGHTS * n)
        u = interpolate(nodes.displacement, block.base[n], strides, block.weights, at)
        rx, ry = q[n, 0] + u[0] - pose[0], q[n, 1] + u[1] - pose[1]
        rz = q[n, 2] + u[2] - pose[3]
        distance, nx, ny, nz = signed_distance(body, sine, cosine, rx, ry, rz)
        depth = law.radius - distance
        if not depth > 0.0:
            for axis in range(3):
                q[n, GRIP + axis] = 0.0
            continue
        # The point of the surface, about the reference point, and the soil's speed past it.
        px, py, pz = rx - distance * nx, ry - distance * ny, rz - distance * nz
        v = interpolate(nodes.velocity, block.base[n], strides, block.weights, at)
        vx = v[0] - rates[0] + rates[2] * py
        vy = v[1] - rates[1] - rates[2] * px
        vz = v[2] - rates[3]
        normal = law.stiffness * depth
        gx, gy, gz = q[n, GRIP] + dt * vx, q[n, GRIP + 1] + dt * vy, q[n, GRIP + 2] + dt * vz
        # Only its part along the surface, which turns with the body.
        across = gx * nx + gy * ny + gz * nz
        gx, gy, gz = gx - across * nx, gy - across * ny, gz - across * nz
        held = law.stiffness * math.sqrt(gx * gx + gy * gy + gz * gz)
        if held > body.friction * normal:
            share = body.friction * normal / held
            gx, gy, gz = share * gx, share * gy, share * gz
        q[n, GRIP], q[n, GRIP + 1], q[n, GRIP + 2] = gx, gy, gz
        fx = normal * nx - law.stiffness * gx
        fy = normal * ny - law.stiffness * gy
        fz = normal * nz - law.stiffness * gz
        on_soil = vectors.make(nodes.force, fx, fy, fz, 0.0)
        affine = (on_soil, zero, zero, zero)
        scatter(nodes.force, block.base[n], strides, block.weights, at, affine)
        load[0] -= fx
        load[1] -= fy
        load[2] -= fz
        load[3] -= py * fz - pz * fy
        load[4] -= pz * fx - px * fz
        load[5] -= px * fy - py * fx
