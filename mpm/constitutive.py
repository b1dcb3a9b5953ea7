"""Constitutive law of dry granular soil: elastic, frictional, free of tension.

Notation: p = mean pressure (positive in compression), tau = |dev sigma| / sqrt(2), the
equivalent shear stress, gamma_dot = sqrt(2) |dev D| the equivalent shear rate, and
I = gamma_dot d sqrt(rho_s / p) the inertial number. All in SI units.

Sources:
  mu(I) rheology: Jop, Forterre, Pouliquen (2006), Nature 441, 727.
  closed-form implicit update: Dunatunga, Kamrin (2015), J. Fluid Mech. 779, 483.
  nonlocal granular fluidity: Henann, Kamrin (2013), PNAS 110, 6730; explicit form for material
  points: Haeri, Skonieczny (2022), Comput. Methods Appl. Mech. Eng. 394, 114904.
"""

import math
from typing import NamedTuple

import numba

from mpm.columns import FLUIDITY, JIT, VOLUME_RATIO, S


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
    nonlocal_amplitude: float  # A of the granular fluidity
    nonlocal_time: float  # t0 of the granular fluidity, s


GRAIN_DENSITY = 2583.0
PACKING_FRACTION = 0.67
GRAIN_DIAMETER = 3.0e-4
INERTIAL_NUMBER_0 = 0.278
MU_RANGE = 0.9616 - 0.76  # mu_2 - mu_s
NONLOCAL_AMPLITUDE = 0.48
NONLOCAL_TIME = 1.0e-4
# Fluidity (1/s) from which flow starts: zero would be a fixed point. Creep at it is 1e-4 a second.
FLUIDITY_SEED = 1.0e-4
POISSON_RATIO = 0.3
TINY = 1e-300  # keeps 0 / 0 away


def friction_coefficient(friction_angle_deg: float) -> float:
    """Returns mu_s = tan(phi) for a friction angle phi in degrees.

    The cone tau = mu_s p is a circle around the Mohr-Coulomb hexagon's axis: no mu_s meets the
    hexagon everywhere. It does in plane strain at constant volume with sin(phi), in triaxial
    compression with 6 sin(phi) / (sqrt(3) (3 - sin(phi))): 0.60 and 0.87 at 37 degrees. Under a
    wheel, or in front of a blade with free sides, the soil is in between; so is tan(phi), 0.75,
    which is also what the published constant 0.76 (37.2 degrees) says.

    Raises:
        ValueError: if the angle does not lie between 0 and 90 degrees.
    """
    if not 0.0 < friction_angle_deg < 90.0:
        raise ValueError(f'friction angle must lie between 0 and 90 deg, got {friction_angle_deg}')
    return math.tan(math.radians(friction_angle_deg))


def make_soil(youngs_modulus: float, mu_s: float, poisson_ratio: float = POISSON_RATIO) -> Soil:
    """Builds the soil of both scenes from its stiffness (Pa) and its static friction.

    Raises:
        ValueError: if a parameter lies outside its physical range.
    """
    if not (math.isfinite(youngs_modulus) and youngs_modulus > 0.0):
        raise ValueError(f"Young's modulus must be positive, got {youngs_modulus} Pa")
    if not 0.0 <= poisson_ratio < 0.49:
        raise ValueError(
            f"Poisson's ratio must lie in [0, 0.49), got {poisson_ratio}: near 0.5 the wave speed, "
            'and with it the cost, has no bound'
        )
    if not (math.isfinite(mu_s) and mu_s > 0.0):
        raise ValueError(f'static friction mu_s must be positive, got {mu_s}')
    return Soil(
        bulk_density=GRAIN_DENSITY * PACKING_FRACTION,
        grain_density=GRAIN_DENSITY,
        grain_diameter=GRAIN_DIAMETER,
        bulk_modulus=youngs_modulus / (3.0 * (1.0 - 2.0 * poisson_ratio)),
        shear_modulus=youngs_modulus / (2.0 * (1.0 + poisson_ratio)),
        mu_s=mu_s,
        mu_2=mu_s + MU_RANGE,
        inertial_number_0=INERTIAL_NUMBER_0,
        nonlocal_amplitude=NONLOCAL_AMPLITUDE,
        nonlocal_time=NONLOCAL_TIME,
    )


@numba.njit(inline='always', **JIT)
def relax_local(tau_trial, p, a, soil):
    """Returns the relaxed tau (Pa) of the local mu(I) law, implicit in the step dt.

    The positive root of tau = tau_trial - G dt gamma_dot(tau, p), where mu(I) = tau / p
    (Dunatunga and Kamrin 2015, eq. 4.6), with a = G I0 dt sqrt(p / rho_s) / d (Pa); written so that
    nothing cancels.
    """
    s2 = soil.mu_2 * p
    b = s2 + tau_trial + a
    h = s2 * tau_trial + soil.mu_s * p * a
    flowing = 2.0 * h / max(b + math.sqrt(max(b * b - 4.0 * h, 0.0)), TINY)
    return tau_trial if tau_trial <= soil.mu_s * p else flowing


@numba.njit(inline='always', **JIT)
def fluidity_source(g, tau, p, soil):
    """Returns the local part of dg/dt (1/s2) of the granular fluidity g (1/s).

    t0 dg/dt = A2 d2 lap g - (mu_s - mu) g - ((mu_2 - mu_s) / I0) sqrt(rho_s d2 / p) mu g2
    (Haeri and Skonieczny 2022) without the Laplacian; mu = tau / p of the relaxed stress.
    """
    if p <= 0.0:
        return 0.0
    mu = tau / p
    b = (soil.mu_2 - soil.mu_s) / soil.inertial_number_0
    inertia = soil.grain_diameter * math.sqrt(soil.grain_density / p)
    return (-(soil.mu_s - mu) * g - b * inertia * mu * g * g) / soil.nonlocal_time


@numba.njit(inline='always', **JIT)
def relax_nonlocal(tau_trial, p, g, dt, soil):
    """Returns the relaxed tau (Pa) for a granular fluidity `g`: gamma_dot = g tau / p."""
    return tau_trial * p / max(p + soil.shear_modulus * dt * g, TINY)


@numba.njit(inline='always', **JIT)
def pressure_of(ratio, bulk_modulus):
    """Pressure (Pa) of soil at `ratio` of its packed volume: linear in density, no tension."""
    return max(bulk_modulus * (1.0 / ratio - 1.0), 0.0)


@numba.njit(**JIT)
def update_stress(q, start, stop, gradient, stress, dt, soil, damping_time, fluidity):
    """Elastic trial stress of particles from their velocity gradients, then relaxation.

    Written without branches, so that several particles share a vector register.

    Args:
        q: float64 [COLUMNS, n]: deviator, volume ratio and fluidity are updated.
        start, stop: which columns.
        gradient: float64 [9, stop - start], velocity gradients (1/s), row by row.
        stress: float64 [6, stop - start], filled with the stress that acts: sigma + damping_time
            d sigma / dt (Pa; xx yy zz xy yz zx).
        dt: s.
        soil: `Soil`.
        damping_time: s, see `stability.damping_time`.
        fluidity: None: local mu(I); anything else: the granular fluidity relaxes the stress.
    """
    h, g1 = 0.5 * dt, soil.shear_modulus * dt
    rate = soil.shear_modulus * soil.inertial_number_0 * dt
    rate /= math.sqrt(soil.grain_density) * soil.grain_diameter
    lead = damping_time / dt
    for n in range(start, stop):
        c = n - start
        lxx, lxy, lxz = gradient[0, c], gradient[1, c], gradient[2, c]
        lyx, lyy, lyz = gradient[3, c], gradient[4, c], gradient[5, c]
        lzx, lzy, lzz = gradient[6, c], gradient[7, c], gradient[8, c]
        trace = lxx + lyy + lzz
        before = pressure_of(q[VOLUME_RATIO, n], soil.bulk_modulus)
        ratio = q[VOLUME_RATIO, n] * (1.0 + dt * trace)
        q[VOLUME_RATIO, n] = ratio
        p = pressure_of(ratio, soil.bulk_modulus)
        # Spin W = (L - Lt) / 2; the stress turns with it: W s - s W.
        wxy, wyz, wzx = h * (lxy - lyx), h * (lyz - lzy), h * (lzx - lxz)
        sxx, syy, szz = q[S, n], q[S + 1, n], q[S + 2, n]
        sxy, syz, szx = q[S + 3, n], q[S + 4, n], q[S + 5, n]
        third = trace / 3.0
        txx = sxx + 2.0 * (wxy * sxy - wzx * szx) + 2.0 * g1 * (lxx - third)
        tyy = syy + 2.0 * (wyz * syz - wxy * sxy) + 2.0 * g1 * (lyy - third)
        tzz = szz + 2.0 * (wzx * szx - wyz * syz) + 2.0 * g1 * (lzz - third)
        txy = sxy + wxy * (syy - sxx) - wzx * syz + wyz * szx + g1 * (lxy + lyx)
        tyz = syz + wyz * (szz - syy) - wxy * szx + wzx * sxy + g1 * (lyz + lzy)
        tzx = szx + wzx * (sxx - szz) - wyz * sxy + wxy * syz + g1 * (lzx + lxz)
        shear = txy * txy + tyz * tyz + tzx * tzx
        tau = math.sqrt(0.5 * (txx * txx + tyy * tyy + tzz * tzz) + shear)
        if fluidity is not None:
            g = max(q[FLUIDITY, n], FLUIDITY_SEED)
            relaxed = relax_nonlocal(tau, p, g, dt, soil)
            g += dt * fluidity_source(g, relaxed, p, soil)
            q[FLUIDITY, n] = g if p > 0.0 else 0.0
        else:
            relaxed = relax_local(tau, p, rate * math.sqrt(p), soil)
        # Soil without pressure carries nothing: p = 0 gives relaxed = 0.
        factor = relaxed / max(tau, TINY)
        txx, tyy, tzz = factor * txx, factor * tyy, factor * tzz
        txy, tyz, tzx = factor * txy, factor * tyz, factor * tzx
        q[S, n], q[S + 1, n], q[S + 2, n] = txx, tyy, tzz
        q[S + 3, n], q[S + 4, n], q[S + 5, n] = txy, tyz, tzx
        # The rate of the relaxed stress damps elastic waves and leaves steady flow alone.
        p += lead * (p - before) if p > 0.0 else 0.0
        stress[0, c] = txx - p + lead * (txx - sxx)
        stress[1, c] = tyy - p + lead * (tyy - syy)
        stress[2, c] = tzz - p + lead * (tzz - szz)
        stress[3, c] = txy + lead * (txy - sxy)
        stress[4, c] = tyz + lead * (tyz - syz)
        stress[5, c] = tzx + lead * (tzx - szx)
