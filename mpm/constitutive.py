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
