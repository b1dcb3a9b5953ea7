"""Steady flow down a rough incline: Bagnold's profile of the mu(I) law."""

import math

import numpy as np

from mpm import columns
from mpm.constitutive import make_soil
from mpm.experiments import Experiment
from mpm.scenes import CORNER, EARTH_GRAVITY, Bin
from mpm.solver import EXCHANGE

DEPTH, LENGTH, CELLS = 0.032, 0.48, 8  # m, m, cells in the depth
GRAIN = 0.01  # m in the law: so slow a flow is steady before the ends of the layer are felt
INERTIAL_NUMBER = 0.1
MU_S = 0.5


def bagnold_incline(seconds: float = 0.4) -> dict:
    """Lets a layer flow down a rough plane on which mu(I) = tan(angle) at I = 0.1.

    Steady, shear stress and pressure grow alike with depth, so I is the same in all of the layer
    (Jop, Forterre, Pouliquen 2006), and with the height y above the plane
    v(y) = 2/3 (I / d) sqrt(rho g cos(angle) / rho_s) (h^3/2 - (h - y)^3/2).
    The layer is finite; its middle is compared, before the ends are felt there.

    Returns:
        `speed_ratio`: mean speed over the formula's; `profile_error`: RMS difference over its
        largest speed; `still_gains`: relative change of the speed in the last tenth.
    """
    soil = make_soil(1.5e6, MU_S)._replace(grain_diameter=GRAIN)
    rise = INERTIAL_NUMBER / (soil.inertial_number_0 + INERTIAL_NUMBER)
    angle = math.atan(soil.mu_s + (soil.mu_2 - soil.mu_s) * rise)
    dx = DEPTH / CELLS
    room = Bin((2 * LENGTH, 0.0, 2 * dx), dx, (0, 0, 0), 1, 2 * DEPTH, ())
    count = (2 * round(LENGTH / dx), 2 * CELLS, 4)
    block = Bin((LENGTH, DEPTH, 2 * dx), dx, count, 1, 0.0, ())
    experiment = Experiment(room, block, soil, smooth_sides=True)
    # Packed under its weight, so that it is not thrown up at first.
    q = experiment.particles
    weight = soil.bulk_density * EARTH_GRAVITY * math.cos(angle)
    q[:, columns.VOLUME_RATIO] /= 1 + weight * (CORNER + DEPTH - q[:, 1]) / soil.bulk_modulus
    push = EARTH_GRAVITY * math.sin(angle) * EXCHANGE
    speeds = []
    for _ in range(math.ceil(seconds / EXCHANGE)):
        # Gravity along the plane acts at the exchanges; the kernels know the one across it.
        experiment.particles[:, columns.V] += push
        experiment.advance(EXCHANGE, EARTH_GRAVITY * math.cos(angle))
        q = experiment.particles
        middle = np.abs(q[:, 0] - CORNER - 0.55 * LENGTH) < 0.1 * LENGTH
        speeds.append(q[middle, columns.V].mean())
    y, v = q[middle, 1] - CORNER, q[middle, columns.V]
    depth = DEPTH - weight * DEPTH**2 / (2 * soil.bulk_modulus)
    scale = soil.bulk_density * EARTH_GRAVITY * math.cos(angle) / soil.grain_density
    expected = 2 / 3 * INERTIAL_NUMBER / GRAIN * math.sqrt(scale)
    expected *= depth**1.5 - np.maximum(depth - y, 0.0) ** 1.5
    return {
        'speed_ratio': float(v.mean() / expected.mean()),
        'profile_error': float(np.sqrt(np.mean((v - expected) ** 2)) / expected.max()),
        'still_gains': float(speeds[-1] / speeds[-len(speeds) // 10] - 1.0),
        'surface_speed_m_s': float(expected.max()),
    }
