"""Force on a blade by the fundamental equation of earthmoving, a closed formula.

Reece (1965), Proc. Inst. Mech. Eng. 179, 16, with the side crescents of McKyes & Ali (1977),
J. Terramechanics 14, 43, as in McKyes (1985), Soil Cutting and Tillage, ch. 3:

    P = (gamma d^2 N_gamma + q d N_q) w   along the blade's normal turned by the wall friction,
    N_gamma, N_q at the failure plane beta that makes P least.

Cohesionless soil, no inertia. The surcharge q is a heap that leans on the blade at the angle of
repose. `soil_field.evaluation` follows a path with it.
"""

import dataclasses

import numpy as np

# Failure planes that are compared, rad.
_BETA = np.radians(np.linspace(5.0, 60.0, 111))
BLADE_FRICTION = 0.3  # between the solver's blade and soil


@dataclasses.dataclass(frozen=True)
class BladeSoil:
    """What the equation needs to know of soil and blade."""

    unit_weight: float  # density x gravity, N/m3
    friction_angle: float  # phi of the soil, rad
    wall_angle: float  # delta between soil and blade, rad
    repose_angle: float  # of the heap, rad
    width: float  # of the blade, m
    height: float  # of its face, m; a heap is no higher

    @classmethod
    def of(cls, soil, tool) -> 'BladeSoil':
        """Of a `Soil` and a blade of a soil field: phi is the arc sine of the soil's friction (at
        most 0.999), and the friction is the slope of a heap."""
        return cls(
            unit_weight=soil.density * soil.gravity,
            friction_angle=float(np.arcsin(min(soil.friction, 0.999))),
            wall_angle=float(np.arctan(BLADE_FRICTION)),
            repose_angle=float(np.arctan(soil.friction)),
            width=tool.width,
            height=tool.length,
        )


def factors(rake, friction_angle, wall_angle, beta, depth_over_width):
    """N_gamma and N_q (dimensionless) of a wedge with side crescents at the failure plane beta;
    both infinite where no plane forms. Angles in rad: rake of the face and beta to the horizontal,
    phi, delta.

    P cos(rake + delta) + R cos(beta + phi) = W and the horizontal balance give
    P = W / (cos(rake + delta) + sin(rake + delta) cot(beta + phi)). The wedge reaches
    d (cot rake + cot beta) along the surface and the crescents s = d sqrt(cot2 beta + 2 cot rake
    cot beta) to the sides. So P = gamma d2 w N_gamma, and the force per weight of surcharge is N_q.
    """
    cot_beta, cot_rake = 1.0 / np.tan(beta), 1.0 / np.tan(rake)
    lever = np.cos(rake + wall_angle) + np.sin(rake + wall_angle) / np.tan(beta + friction_angle)
    per_weight = np.where(lever > 0, 1.0 / np.where(lever > 0, lever, 1.0), np.inf)
    side = np.sqrt(np.maximum(cot_beta**2 + 2.0 * cot_rake * cot_beta, 0.0))
    wedge = 0.5 * (cot_beta + cot_rake) * (1.0 + 2.0 / 3.0 * depth_over_width * side)
    return wedge * per_weight, per_weight


def cutting_force(depth, rake, heap_area, soil: BladeSoil):
    """Force that the soil puts on a blade which moves forward.

    Args:
      depth: [...] of the edge below the surface ahead of it, m; no force where it is not positive.
      rake: [...] angle of the face to the horizontal, rad.
      heap_area: [...] cross-section of the heap ahead of the blade, m2.

    Returns:
      [..., 2, 2]: the wedge's part and the heap's part of the force, each backward (against the
      motion) and upward, N.
    """
    depth, rake, heap_area = np.broadcast_arrays(depth, rake, heap_area)
    cut = np.maximum(depth, 1e-9)[..., None]
    n_gamma, per_weight = factors(
        rake[..., None], soil.friction_angle, soil.wall_angle, _BETA, cut / soil.width
    )
    wedge = soil.unit_weight * cut**2 * soil.width * n_gamma
    heap_weight = soil.unit_weight * soil.width * _heap_within(cut / np.tan(_BETA), heap_area, soil)
    finite = np.isfinite(per_weight)
    heap = np.where(finite, heap_weight * np.where(finite, per_weight, 0.0), np.inf)
    # The soil fails along the plane of least resistance.
    least = np.argmin(wedge + heap, axis=-1)[..., None]
    parts = [np.take_along_axis(x, least, axis=-1)[..., 0] for x in (wedge, heap)]
    parts = np.where(depth > 0, np.stack(parts), 0.0)
    angle = rake + soil.wall_angle
    direction = np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    return np.moveaxis(parts, 0, -1)[..., None] * direction[..., None, :]  # type: ignore[type-var]


def _heap_within(reach, area, soil):
    """Area (m2) of the part of a heap within a reach (m) ahead of the blade: a triangle at the
    angle of repose against it, no higher than it."""
    slope = np.tan(soil.repose_angle)
    area = np.minimum(area, 0.5 * soil.height**2 / slope)[..., None]
    length = np.sqrt(2.0 * area / slope)
    return area - 0.5 * slope * np.maximum(length - reach, 0.0) ** 2
