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

from learning_to_simulate.baselines import open_loop
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.scene import RigidMotion
from learning_to_simulate.tool import swept
from learning_to_simulate.tool.axes import blade_pose
from learning_to_simulate.tool.blade import EDGE_RADIUS

# Failure planes that are compared, rad.
_BETA = np.radians(np.linspace(5.0, 60.0, 111))


@dataclasses.dataclass(frozen=True)
class BladeSoil:
    """What the equation needs to know of soil and blade.

    Attributes:
      unit_weight: density x gravity, N/m3.
      friction_angle: phi of the soil, rad.
      wall_angle: delta between soil and blade, rad.
      repose_angle: of the heap, rad.
      width: of the blade, m.
      height: of its face, m; a heap is no higher.
    """

    unit_weight: float
    friction_angle: float
    wall_angle: float
    repose_angle: float
    width: float
    height: float


@dataclasses.dataclass(frozen=True)
class BladeGeometry:
    """Where a blade's edge lies from its lowest row of particles, in the blade's own axes.

    Attributes:
      along: from the row up the face to the middle of the round edge, m.
      behind: from the face back to it, m.
      radius: of the edge, m.
      points_width: extent of the row across, m, and `width`, m, of the blade that it stands for:
        blades of other widths have their points in proportion.
      height: of the blade, m.
      friction: between blade and soil.
    """

    along: float = 0.0115
    behind: float = EDGE_RADIUS
    radius: float = EDGE_RADIUS
    points_width: float = 0.4
    width: float = 0.457
    height: float = 0.305
    friction: float = 0.3

    def edge(self, row, lean):
        """Middle of the edge [..., 2] for rows [..., 2] (u, y) at a lean [...] (rad), m."""
        sine, cosine = np.sin(lean), np.cos(lean)
        # A blade that leans back has its top at smaller u.
        u = -self.along * sine - self.behind * cosine
        y = self.along * cosine - self.behind * sine
        return row + np.stack([u, y], axis=-1)


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


def soil_of_case(case: dict, gravity: float, blade: BladeGeometry, width: float) -> BladeSoil:
    """The soil's own parameters, of a case as the dataset's metadata describe it.

    The solver's cone tau = mu p meets Mohr-Coulomb in plane strain at sin(phi) = mu, which is what
    a wide blade makes; heaps rest at tan(phi) = mu.

    Raises:
      ValueError: as `soil_parameters`.
    """
    density, mu = soil_parameters(case)
    return BladeSoil(
        unit_weight=density * gravity,
        friction_angle=float(np.arcsin(min(mu, 0.999))),
        wall_angle=float(np.arctan(case.get('body_friction', blade.friction))),
        repose_angle=float(np.arctan(mu)),
        width=width,
        height=blade.height,
    )


class EarthmovingForce:
    """The blade's force along recorded paths.

    Args:
      scene: what exists; the body's motion must be prescribed.
      axes: of the scene.
      surface: height of the flat bed, m.
      blade: geometry.
      gravity: m/s2.
      gains: [2 (wedge, heap), 2 (backward, up)] factors on the parts of the force; ones are the
        equation itself.

    Raises:
      ValueError: a body of another motion.
    """

    def __init__(self, scene, axes, surface, blade=BladeGeometry(), gravity=9.81, gains=None):  # noqa: B008
        if scene.rigid_motion != RigidMotion.PRESCRIBED:
            raise ValueError(
                f'the equation of earthmoving is for a blade on a given path, not for a body that '
                f'is {scene.rigid_motion}'
            )
        self.scene, self.axes, self.surface = scene, axes, float(surface)
        self.blade, self.gravity = blade, gravity
        self.gains = np.ones((2, 2)) if gains is None else np.asarray(gains, np.float64)

    def parameters_to_json(self) -> dict:
        """All but scene and axes, for `from_json`."""
        blade = dataclasses.asdict(self.blade)
        values = {'surface': self.surface, 'gravity': self.gravity, 'blade': blade}
        return values | {'gains': self.gains.tolist()}

    @classmethod
    def from_json(cls, values: dict, scene, axes) -> 'EarthmovingForce':
        """Rebuilds a method; raises KeyError, TypeError or ValueError on foreign values."""
        gains = np.array(values['gains'], np.float64)
        if gains.shape != (2, 2) or not np.isfinite(gains).all():
            raise ValueError(f'gains are {values["gains"]!r}')
        blade = BladeGeometry(**values['blade'])
        return cls(scene, axes, float(values['surface']), blade, float(values['gravity']), gains)

    def fitted(self, groups, cases) -> 'EarthmovingForce':
        """The same with the gains that fit the runs of the groups best, least squares with every
        run of equal weight; `cases` as in `predict`, per group."""
        parts, truth, weights = [], [], []
        for group, of_group in zip(groups, cases, strict=True):
            parts.append(self.parts(group, of_group)[:, H:].reshape(-1, 2, 2))
            force = group.force[:, H:]
            truth.append(self._in_plane(force).reshape(-1, 2))
            scale = 1.0 / np.sqrt((force**2).sum(axis=(1, 2)))
            weights.append(np.repeat(scale, force.shape[1]))
        parts, truth, weights = (np.concatenate(x) for x in (parts, truth, weights))
        gains = np.stack(
            [
                np.linalg.lstsq(parts[:, :, i] * weights[:, None], truth[:, i] * weights)[0]
                for i in range(2)
            ],
            axis=1,
        )
        return EarthmovingForce(
            self.scene, self.axes, self.surface, self.blade, self.gravity, gains
        )

    def _in_plane(self, force):
        """Backward and upward parts [..., 2] of forces [..., D]."""
        return np.stack(
            [-self.axes.sign * force[..., self.axes.axis], force[..., self.axes.up]], axis=-1
        )

    def parts(self, group, cases) -> np.ndarray:
        """[S, T, 2 (wedge, heap), 2 (backward, up)] of the force, N, before the gains."""
        body = group.position[:, :, : group.n_rigid]
        row, lean = blade_pose(body, self.axes)
        edge = self.blade.edge(row, lean)
        widths = self.axes.width(body[:, 0]) * self.blade.width / self.blade.points_width
        travel = edge[..., 0] - edge[:, :1, 0]
        grid = swept.SweptGrid(
            radius=self.blade.radius,
            behind=float(-travel.min()) + 0.1,
            ahead=float(travel.max()) + 0.1,
        )
        state = swept.start(grid, edge[:, 0], self.surface)
        depth, heap = np.zeros(edge.shape[:2]), np.zeros(edge.shape[:2])
        forward = np.zeros(edge.shape[:2], bool)
        for t in range(1, edge.shape[1]):
            state = swept.advance(grid, state, edge[:, t], self.scene.dt)
            ahead = state.tip + self.blade.radius + grid.spacing
            # What lies ahead may have been cut before; the blade itself has not been there.
            depth[:, t] = swept.profile_at(grid, state, ahead) - (
                edge[:, t, 1] - self.blade.radius
            )
            heap[:, t] = swept.swept_area(grid, state)
            step = edge[:, t, 0] - edge[:, t - 1, 0]
            # A blade at rest stays pressed on as it was; one that backs off loses the soil.
            forward[:, t] = np.where(step == 0, forward[:, t - 1], step > 0)
        parts = np.stack(
            [
                cutting_force(
                    depth[s],
                    np.pi / 2 - lean[s],
                    heap[s],
                    soil_of_case(case, self.gravity, self.blade, float(widths[s])),
                )
                for s, case in enumerate(cases)
            ]
        )
        return parts * forward[..., None, None]

    def predict(self, group, cases) -> open_loop.Prediction:
        """Frames H .. T - 1 of the S runs of a group; the soil stays still.

        Args:
          group: `RunGroup`.
          cases: per run, its entry in the metadata's `cases`.
        """
        plane = (self.parts(group, cases)[:, H:] * self.gains).sum(axis=2)
        force = np.zeros((*plane.shape[:2], group.position.shape[-1]))
        force[..., self.axes.axis] = -self.axes.sign * plane[..., 0]
        force[..., self.axes.up] = plane[..., 1]
        position = open_loop.held_position(group, self.scene)
        return open_loop.Prediction(position, force, frozenset({open_loop.FORCE}))
