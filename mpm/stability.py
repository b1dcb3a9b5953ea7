"""Limits of the explicit time step, as code.

`max_time_step` is the one to use; `check_time_step` refuses a step above it.
"""

import math

import numpy as np

from mpm.constitutive import Soil

CFL = 0.8  # of the elastic wave; divergence was measured at 1.14 to 1.34
DAMPING = 0.06  # of the time in which the wave crosses a cell
VELOCITY_CFL = 0.5  # cells that soil may cross between exchanges, and a body in a step
SPRAY_CFL = 2.0  # cells that a single grain may fly between exchanges


def wave_speed(soil: Soil) -> float:
    """Returns the speed of the pressure wave sqrt((K + 4 G / 3) / rho) in m/s."""
    return math.sqrt((soil.bulk_modulus + 4.0 * soil.shear_modulus / 3.0) / soil.bulk_density)


def damping_time(soil: Soil, dx: float) -> float:
    """Returns T (s) of the stress sigma + T d sigma / dt that damps elastic waves: `DAMPING` dx
    / c.

    Explicit codes call this linear bulk viscosity and use the same 0.06 by default (its origin:
    Landshoff 1955, LA-1930). Here it acts on the rate of the relaxed stress, shear included: waves
    of two cells lose a tenth of their amplitude per radian, steady flow feels nothing. Without it,
    waves that the body sets off keep ringing and shake the soil, the more the larger the step, and
    its resistance falls: the drawbar of a wheel by a sixth. That is why it depended on the step.
    """
    return DAMPING * dx / wave_speed(soil)


def max_time_step(soil: Soil, dx: float) -> float:
    """Returns the largest stable step (s): the elastic wave crosses at most `CFL` of the shortest
    side dx (m) of a cell."""
    return CFL * dx / wave_speed(soil)


def check_time_step(dt: float, soil: Soil, dx: float) -> None:
    """Refuses a step that the explicit scheme cannot take (ValueError)."""
    limit = max_time_step(soil, dx)
    if not 0.0 < dt <= limit * (1.0 + 1e-12):
        raise ValueError(
            f'time step {dt:.4g} s is not in (0, {limit:.4g}] s: CFL number '
            f'{dt * wave_speed(soil) / dx:.3g}, limit {CFL:.3g} '
            f'(dx {dx:.4g} m, wave speed {wave_speed(soil):.4g} m/s)'
        )


def check_body_motion(path: np.ndarray, reach: float, dt: float, dx: float, start: float) -> None:
    """Refuses a body that jumps over cells (ValueError): soil could pass through it between two
    steps.

    `path` [steps + 1, 3 or 4] are its poses at the steps' ends, x, y and z in m (constant where
    they are not prescribed), angle in rad, which comes before z; `reach` is the largest distance of
    its outline from the reference point, m; dt and dx are in s and m; `start` is the time of the
    first pose, s.
    """
    change = np.diff(path, axis=0)
    way = np.linalg.norm(np.delete(change, 2, axis=1), axis=1)
    travel = way + reach * np.abs(change[:, 2])
    worst = int(np.argmax(travel))
    if not travel[worst] <= VELOCITY_CFL * dx:
        raise ValueError(
            f'at {start + worst * dt:.3f} s the body moves at {travel[worst] / dt:.4g} m/s (tip or '
            f'rim included), {travel[worst] / dx:.3g} cells a step of {dt:.4g} s; at most '
            f'{VELOCITY_CFL} ({VELOCITY_CFL * dx / dt:.4g} m/s) is resolved'
        )


def steps_in(seconds: float, soil: Soil, dx: float) -> int:
    """Returns the smallest number of equal steps in `seconds` that are stable."""
    return max(1, math.ceil(seconds / max_time_step(soil, dx) - 1e-9))
