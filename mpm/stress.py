"""The constitutive law (`constitutive`) as kernels: stress of particles from step to step.

Notation and sources as there.
"""

import math

import numba
import numpy as np

from mpm.columns import ELASTIC, JIT, index, row

# With an array of float32 these keep a kernel in float32; with one of float64 they are exact.
NONE, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
TINY = 1e-30  # keeps 0 / 0 away, in float32 too
# Most strain of volume of soil that has come apart: a grain that flies alone keeps its velocity
# gradient, so without a limit V / V0 would grow e-fold again and again, to infinity.
LOOSEST = 99.0


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
    bulk, tiny, loosest = real(soil.bulk_modulus), real(TINY), real(LOOSEST)
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
        strain = min(strain + step * trace * strain + step * trace, loosest)
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
