"""Constitutive law of dry granular soil: elastic, frictional, free of tension.

Notation: p = mean pressure (positive in compression), tau = |dev sigma| / sqrt(2), the
equivalent shear stress, gamma_dot = sqrt(2) |dev D| the equivalent shear rate, and
I = gamma_dot d sqrt(rho_s / p) the inertial number. All in SI units.

Sources:
  mu(I) rheology: Jop, Forterre, Pouliquen (2006), Nature 441, 727.
  closed-form implicit update: Dunatunga, Kamrin (2015), J. Fluid Mech. 779, 483.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from mpm.columns import ELASTIC, JIT, index, row


class Soil(NamedTuple):
    """Parameters of the soil (SI units). A NamedTuple, so that a Numba kernel can take it."""

    bulk_density: float  # kg/m3, of the packing: grain density x packing fraction
    grain_density: float  # kg/m3
    grain_diameter: float  # m
    bulk_modulus: float  # Pa
    shear_modulus: float  # Pa
    mu_s: float  # static friction coefficient tau / p
    mu_2: float  # friction coefficient at a large inertial number
    inertial_number_0: float  # I0 of mu(I)


GRAIN_DENSITY = 2583.0
PACKING_FRACTION = 0.67
PACKED_DENSITY = GRAIN_DENSITY * PACKING_FRACTION
GRAIN_DIAMETER = 3.0e-4
INERTIAL_NUMBER_0 = 0.278
MU_RANGE = 0.9616 - 0.76  # mu_2 - mu_s
POISSON_RATIO = 0.3
# With an array of float32 these keep a kernel in float32; with one of float64 they are exact.
NONE, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
TINY = 1e-30  # keeps 0 / 0 away, in float32 too


def friction_coefficient(friction_angle_deg: float) -> float:
    """Returns mu_s = tan(phi) for a friction angle phi in degrees, of 0 to 90 (ValueError).

    The cone tau = mu_s p is a circle around the Mohr-Coulomb hexagon's axis: no mu_s meets the
    hexagon everywhere. It does in plane strain at constant volume with sin(phi), in triaxial
    compression with 6 sin(phi) / (sqrt(3) (3 - sin(phi))): 0.60 and 0.87 at 37 degrees. Under a
    wheel, or in front of a blade with free sides, the soil is in between; so is tan(phi), 0.75,
    which is also what the published constant 0.76 (37.2 degrees) says.
    """
    if not 0.0 < friction_angle_deg < 90.0:
        raise ValueError(f'friction angle must lie between 0 and 90 deg, got {friction_angle_deg}')
    return math.tan(math.radians(friction_angle_deg))


def make_soil(youngs_modulus: float, mu_s: float, bulk_density: float = PACKED_DENSITY) -> Soil:
    """Builds a soil from its stiffness (Pa), static friction mu_s and packed density (kg/m3), all
    positive (ValueError).

    Grains are as dense as the packing says: bulk density over the packing fraction 0.67.
    """
    for value, what in (
        (youngs_modulus, "Young's modulus"), (mu_s, 'static friction mu_s'),
        (bulk_density, 'bulk density'),
    ):  # fmt: skip
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f'{what} must be positive, got {value}')
    return Soil(
        bulk_density=bulk_density,
        grain_density=bulk_density / PACKING_FRACTION,
        grain_diameter=GRAIN_DIAMETER,
        bulk_modulus=youngs_modulus / (3.0 * (1.0 - 2.0 * POISSON_RATIO)),
        shear_modulus=youngs_modulus / (2.0 * (1.0 + POISSON_RATIO)),
        mu_s=mu_s,
        mu_2=mu_s + MU_RANGE,
        inertial_number_0=INERTIAL_NUMBER_0,
    )


@numba.njit(inline='always', **JIT)
def relax_local(tau_trial, p, a, mu_s, mu_2):
    """Returns the relaxed tau (Pa) of the local mu(I) law, implicit in the step dt.

    The positive root of tau = tau_trial - G dt gamma_dot(tau, p), where mu(I) = tau / p
    (Dunatunga and Kamrin 2015, eq. 4.6), with a = G I0 dt sqrt(p / rho_s) / d (Pa); written so that
    nothing cancels.
    """
    s1, s2 = mu_s * p, mu_2 * p
    beyond = s2 + tau_trial - s1 - s1
    root = math.sqrt((s2 - tau_trial) * (s2 - tau_trial) + a * (beyond + beyond + a))
    h = s2 * tau_trial + s1 * a
    flowing = (h + h) / (s2 + tau_trial + a + root)
    return tau_trial if tau_trial <= s1 else flowing


@numba.njit(inline='always', **JIT)
def pressure_of(strain, bulk_modulus):
    """Pressure (Pa) at a strain of volume V / V0 - 1: linear in density, none in tension."""
    return max(-bulk_modulus * strain / (ONE + strain), NONE)


@numba.njit(**JIT)
def update_stress(block, start, count, dt, soil, damping_time):
    """Elastic trial stress of particles from their velocity gradients, then relaxation.

    Written without branches, in numbers of one type (float32 or float64, that of the arrays), and
    on rows of CHUNK numbers a known way apart, so that particles share a vector register.

    Args:
        block: `elastic` (deviator and strain of volume) is updated, `gradient` is
            read (1/s), `stress` filled with the stress that acts: sigma + damping_time d sigma / dt
            (Pa; xx yy zz xy yz zx).
        start, count: which particles, at most CHUNK, the first of a chunk.
        dt: s.
        damping_time: s, see `stability.damping_time`.
    """
    e, gradient, stress = block.elastic, block.gradient, block.stress
    real = e.dtype.type
    h, g1, step = real(0.5 * dt), real(soil.shear_modulus * dt), real(dt)
    bulk, tiny = real(soil.bulk_modulus), real(TINY)
    rate = soil.shear_modulus * soil.inertial_number_0 * dt
    rate = real(rate / (math.sqrt(soil.grain_density) * soil.grain_diameter))
    lead, a_third = real(damping_time / dt), real(1.0 / 3.0)
    mu_s, mu_2 = real(soil.mu_s), real(soil.mu_2)
    first = index(ELASTIC * start)
    for c in range(index(count)):
        at = first + c
        lxx, lxy, lxz = gradient[c], gradient[row(c, 1)], gradient[row(c, 2)]
        lyx, lyy, lyz = gradient[row(c, 3)], gradient[row(c, 4)], gradient[row(c, 5)]
        lzx, lzy, lzz = gradient[row(c, 6)], gradient[row(c, 7)], gradient[row(c, 8)]
        trace = lxx + lyy + lzz
        strain = e[row(at, 6)]
        before = pressure_of(strain, bulk)
        # V / V0 grows by the factor 1 + dt tr L.
        strain += step * trace * strain + step * trace
        e[row(at, 6)] = strain
        p = pressure_of(strain, bulk)
        # Spin W = (L - Lt) / 2; the stress turns with it: W s - s W.
        wxy, wyz, wzx = h * (lxy - lyx), h * (lyz - lzy), h * (lzx - lxz)
        sxx, syy, szz = e[at], e[row(at, 1)], e[row(at, 2)]
        sxy, syz, szx = e[row(at, 3)], e[row(at, 4)], e[row(at, 5)]
        third = a_third * trace
        txx = sxx + TWO * (wxy * sxy - wzx * szx) + TWO * g1 * (lxx - third)
        tyy = syy + TWO * (wyz * syz - wxy * sxy) + TWO * g1 * (lyy - third)
        tzz = szz + TWO * (wzx * szx - wyz * syz) + TWO * g1 * (lzz - third)
        txy = sxy + wxy * (syy - sxx) - wzx * syz + wyz * szx + g1 * (lxy + lyx)
        tyz = syz + wyz * (szz - syy) - wxy * szx + wzx * sxy + g1 * (lyz + lzy)
        tzx = szx + wzx * (sxx - szz) - wyz * sxy + wxy * syz + g1 * (lzx + lxz)
        shear = txy * txy + tyz * tyz + tzx * tzx
        tau = math.sqrt((txx * txx + tyy * tyy + tzz * tzz) / TWO + shear)
        relaxed = relax_local(tau, p, rate * math.sqrt(p), mu_s, mu_2)
        # Soil without pressure carries nothing: p = 0 gives relaxed = 0.
        factor = relaxed / max(tau, tiny)
        txx, tyy, tzz = factor * txx, factor * tyy, factor * tzz
        txy, tyz, tzx = factor * txy, factor * tyz, factor * tzx
        e[at], e[row(at, 1)], e[row(at, 2)] = txx, tyy, tzz
        e[row(at, 3)], e[row(at, 4)], e[row(at, 5)] = txy, tyz, tzx
        # The rate of the relaxed stress damps elastic waves and leaves steady flow alone.
        p += (lead if p > NONE else NONE) * (p - before)
        stress[c] = txx - p + lead * (txx - sxx)
        stress[row(c, 1)] = tyy - p + lead * (tyy - syy)
        stress[row(c, 2)] = tzz - p + lead * (tzz - szz)
        stress[row(c, 3)] = txy + lead * (txy - sxy)
        stress[row(c, 4)] = tyz + lead * (tyz - syz)
        stress[row(c, 5)] = tzx + lead * (tzx - szx)
