"""Force on a blade by the fundamental equation of earthmoving: no soil, no learning.

Reece (1965), Proc. Inst. Mech. Eng. 179, 16, with the side crescents of McKyes & Ali (1977),
J. Terramechanics 14, 43, as in McKyes (1985), Soil Cutting and Tillage, ch. 3:

    P = (gamma d^2 N_gamma + q d N_q) w   along the blade's normal turned by the wall friction,
    N_gamma, N_q at the failure plane beta that makes P least.

Cohesionless soil, no inertia. `blade_force` follows a path: the depth is below the surface that
earlier passes have left, and the surcharge q is the heap of all soil that the blade has cut,
leaning on it at the angle of repose.
"""

import dataclasses

import numpy as np

from learning_to_simulate import swept
from learning_to_simulate.axes import Axes, blade_pose
from learning_to_simulate.baselines import open_loop
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.swept import EDGE_RADIUS

# Failure planes that are compared, rad.
_BETA = np.radians(np.linspace(5.0, 60.0, 111))


@dataclasses.dataclass(frozen=True)
class BladeGeometry:
    """The solver's blade, in its own axes, m."""

    along: float = 0.0115  # from the lowest row of its particles up the face to the edge's middle
    behind: float = EDGE_RADIUS  # from the face back to the edge's middle
    radius: float = EDGE_RADIUS  # of the round edge
    # Extent of the row across, and width of the blade that it stands for: blades of other widths
    # have their points in proportion.
    points_width: float = 0.4
    width: float = 0.457
    height: float = 0.305  # of the face
    friction: float = 0.3  # between blade and soil

    def edge(self, row, lean):
        """Middle of the edge [..., 2] for rows [..., 2] (u, y) at a lean [...] (rad), m."""
        sine, cosine = np.sin(lean), np.cos(lean)
        # A blade that leans back has its top at smaller u.
        u = -self.along * sine - self.behind * cosine
        y = self.along * cosine - self.behind * sine
        return row + np.stack([u, y], axis=-1)


BLADE = BladeGeometry()


@dataclasses.dataclass(frozen=True)
class BladeSoil:
    """What the equation needs to know of soil and blade."""

    unit_weight: float  # density x gravity, N/m3
    friction_angle: float  # phi of the soil, rad
    wall_angle: float  # delta between soil and blade, rad
    repose_angle: float  # of the heap, rad
    width: float  # of the blade, m
    height: float = BLADE.height  # of its face, m; a heap is no higher

    @classmethod
    def of_case(cls, case: dict, gravity: float, width: float) -> 'BladeSoil':
        """The soil's own parameters, of a case of the dataset's metadata.

        The solver's cone tau = mu p meets Mohr-Coulomb in plane strain at sin(phi) = mu, which is
        what a wide blade makes; heaps rest at tan(phi) = mu.

        Raises:
          ValueError: as `soil_parameters`.
        """
        density, mu = soil_parameters(case)
        return cls(
            unit_weight=density * gravity,
            friction_angle=float(np.arcsin(min(mu, 0.999))),
            wall_angle=float(np.arctan(case.get('body_friction', BLADE.friction))),
            repose_angle=float(np.arctan(mu)),
            width=width,
        )


def soil_parameters(case: dict) -> tuple[float, float]:
    """Bulk density (kg/m3) and static friction mu_s of a case of the metadata.

    Raises:
      ValueError: the case does not state them.
    """
    try:
        return float(case['soil']['bulk_density']), float(case['soil']['mu_s'])
    except (KeyError, TypeError) as error:
        raise ValueError(
            f'case {case.get("case")!r} states no soil.bulk_density and soil.mu_s, which the '
            f'equation of earthmoving needs'
        ) from error


def factors(rake, friction_angle, wall_angle, beta, depth_over_width):
    """N_gamma and N_q (dimensionless) of a wedge with side crescents at the failure plane beta.

    P cos(rake + delta) + R cos(beta + phi) = W and the horizontal balance give
    P = W / (cos(rake + delta) + sin(rake + delta) cot(beta + phi)). The wedge reaches
    d (cot rake + cot beta) along the surface and the crescents s = d sqrt(cot2 beta + 2 cot rake
    cot beta) to the sides.

    Args:
      rake: angle of the face to the horizontal, rad.
      friction_angle, wall_angle: phi and delta, rad.
      beta: failure plane to the horizontal, rad.
      depth_over_width: d / w.

    Returns:
      N_gamma, with P = gamma d2 w N_gamma for the wedge and its crescents, and N_q = d P / d W / w:
      the force per weight of surcharge on the wedge is N_q; both infinite where no plane forms.
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
      soil: parameters.

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
    """Area (m2) of a heap's part within a reach (m) ahead of the blade.

    A triangle at the angle of repose against the blade, no higher than it.
    """
    slope = np.tan(soil.repose_angle)
    area = np.minimum(area, 0.5 * soil.height**2 / slope)[..., None]
    length = np.sqrt(2.0 * area / slope)
    return area - 0.5 * slope * np.maximum(length - reach, 0.0) ** 2


class EarthmovingForce:
    """The blade's force along recorded paths.

    Args:
      scene: what exists; the body's motion must be prescribed.
      axes: of the scene.
      surface: height of the flat bed, m.
      gravity: m/s2.
      gains: [2 (wedge, heap), 2 (backward, up)] factors on the parts of the force; ones are the
        equation itself.

    Raises:
      ValueError: a body of another motion, or gains that are no such factors.
    """

    def __init__(self, scene, axes, surface, gravity=9.81, gains=((1.0, 1.0), (1.0, 1.0))):
        if scene.rigid_motion != RigidMotion.PRESCRIBED:
            raise ValueError(
                f'the equation of earthmoving is for a blade on a given path, not for a body that '
                f'is {scene.rigid_motion}'
            )
        self.scene, self.axes, self.surface = scene, axes, float(surface)
        self.gravity, self.gains = float(gravity), np.array(gains, np.float64)
        if self.gains.shape != (2, 2) or not np.isfinite(self.gains).all():
            raise ValueError(f'gains are {gains!r}')

    def parts(self) -> tuple[dict, dict]:
        """Values for JSON, and no arrays; `of_parts` is the inverse."""
        values = {'surface': self.surface, 'gravity': self.gravity, 'gains': self.gains.tolist()}
        return values | {'axes': dataclasses.asdict(self.axes)}, {}

    @classmethod
    def of_parts(cls, values: dict, arrays: dict, scene) -> 'EarthmovingForce':
        """Rebuilds a method; raises KeyError, TypeError or ValueError on foreign values."""
        return cls(scene, **values | {'axes': Axes(**values['axes'])})

    def fitted(self, groups, cases) -> 'EarthmovingForce':
        """The same with the gains that fit the runs of the groups best, least squares with every
        run of equal weight; `cases` as in `predict`, per group."""
        parts, truth = [], []
        for group, of_group in zip(groups, cases, strict=True):
            force = group.force[:, H:]
            scale = 1.0 / np.sqrt((force**2).sum(axis=(1, 2)))
            weight = np.repeat(scale, force.shape[1])[:, None]
            backward = -self.axes.sign * force[..., self.axes.axis]
            plane = np.stack([backward, force[..., self.axes.up]], axis=-1)
            truth.append(plane.reshape(-1, 2) * weight)
            found = self.wedge_and_heap(group, of_group)[:, H:]
            parts.append(found.reshape(-1, 2, 2) * weight[:, None])
        parts, truth = np.concatenate(parts), np.concatenate(truth)
        gains = [np.linalg.lstsq(parts[:, :, i], truth[:, i])[0] for i in range(2)]
        return EarthmovingForce(
            self.scene, self.axes, self.surface, self.gravity, np.stack(gains, axis=1)
        )

    def wedge_and_heap(self, group, cases) -> np.ndarray:
        """[S, T, 2 (wedge, heap), 2 (backward, up)] of the force, N, before the gains."""
        body = group.position[:, :, : group.n_rigid]
        row, lean = blade_pose(body, self.axes)
        edge = BLADE.edge(row, lean)
        widths = self.axes.width(body[:, 0]) * BLADE.width / BLADE.points_width
        travel = edge[..., 0] - edge[:, :1, 0]
        grid = swept.SweptGrid(
            radius=BLADE.radius,
            behind=float(-travel.min()) + 0.1,
            ahead=float(travel.max()) + 0.1,
        )
        state = swept.start(grid, edge[:, 0], self.surface)
        depth, heap = np.zeros(edge.shape[:2]), np.zeros(edge.shape[:2])
        forward = np.zeros(edge.shape[:2], bool)
        for t in range(1, edge.shape[1]):
            state = swept.advance(grid, state, edge[:, t], self.scene.dt)
            ahead = state.tip + BLADE.radius + grid.spacing
            # What lies ahead may have been cut before; the blade itself has not been there.
            lowest = edge[:, t, 1] - BLADE.radius
            depth[:, t] = swept.profile_at(grid, state, ahead) - lowest
            heap[:, t] = swept.swept_area(grid, state)
            step = edge[:, t, 0] - edge[:, t - 1, 0]
            # A blade at rest stays pressed on as it was; one that backs off loses the soil.
            forward[:, t] = np.where(step == 0, forward[:, t - 1], step > 0)
        soils = [BladeSoil.of_case(c, self.gravity, float(w)) for c, w in zip(cases, widths)]
        parts = [
            cutting_force(depth[s], np.pi / 2 - lean[s], heap[s], soil)
            for s, soil in enumerate(soils)
        ]
        return np.stack(parts) * forward[..., None, None]

    def predict(self, group, cases) -> open_loop.Prediction:
        """Frames H .. T - 1 of the S runs of a group; the soil stays still.

        Args:
          group: `RunGroup`.
          cases: per run, its entry in the metadata's `cases`.
        """
        plane = (self.wedge_and_heap(group, cases)[:, H:] * self.gains).sum(axis=2)
        force = np.zeros((*plane.shape[:2], group.position.shape[-1]))
        force[..., self.axes.axis] = -self.axes.sign * plane[..., 0]
        force[..., self.axes.up] = plane[..., 1]
        position = open_loop.held_position(group, self.scene)
        return open_loop.Prediction(position, force)
