"""The blade's force by the fundamental equation of earthmoving, from limit equilibrium.

Sources: Reece (1965), Proc. Inst. Mech. Eng. 179, 16; McKyes, Ali (1977), J. Terramechanics 14, 43
(side crescents). Cohesionless soil, no inertia.
"""

import math

import numpy as np


def draft_force(
    depth: float,
    width: float,
    rake: float,
    friction_angle: float,
    wall_angle: float,
    unit_weight: float,
    heap_weight=None,
) -> float:
    """Returns the horizontal force (N) that pushes a flat blade through soil, inf if none does.

    A wedge of soil between the blade's face and a failure plane at the angle beta slides up; the
    force is the least over beta. Equilibrium of blade force P (at `wall_angle` to the face's
    normal), plane reaction (at `friction_angle`), weight W of wedge and heap:
    P (cos(rake + delta) + sin(rake + delta) cot(beta + phi)) = W. Two side crescents of reach
    s = depth sqrt(cot2 beta + 2 cot rake cot beta) add 2 s / 3 to the width of the wedge.

    Args:
        depth, width: of the blade's edge below the surface, and of the blade, m.
        rake: angle between the blade's face and the horizontal, rad; pi / 2 is upright.
        friction_angle, wall_angle: phi of the soil, delta between soil and blade, rad.
        unit_weight: density x gravity, N/m3.
        heap_weight: function of the wedge's reach (m) ahead of the edge -> weight (N) of the soil
            above the original surface within it, in front of the blade; None: no heap.
    """
    best = math.inf
    for beta in np.linspace(math.radians(5.0), math.radians(60.0), 221):
        lever = math.cos(rake + wall_angle) + math.sin(rake + wall_angle) / math.tan(
            beta + friction_angle
        )
        if lever <= 0.0:
            continue
        cot_beta, cot_rake = 1.0 / math.tan(beta), 1.0 / math.tan(rake)
        side = depth * math.sqrt(cot_beta**2 + 2.0 * cot_rake * cot_beta)
        area = 0.5 * depth**2 * (cot_beta + cot_rake)
        weight = unit_weight * area * (width + 2.0 * side / 3.0)
        if heap_weight is not None:
            weight += heap_weight(depth * cot_beta)
        best = min(best, weight / lever * math.sin(rake + wall_angle))
    return best
