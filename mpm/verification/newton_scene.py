"""An excavation run of this project as a scene of Newton's implicit MPM, and its run there.

What is mapped, each by its definition:

    particles of the settled packing, V = h3 of packed soil each -> the same places, radius h / 2
        (Newton takes V = 8 r3), mass from the bulk density
    E and nu of the soil's K and G -> the same; `rigid` leaves E at Newton's default, 1e15 Pa
    tau <= mu_s p, tau = |dev sigma| / sqrt(2) -> `friction` = mu_s: Newton's `YieldParamVec` holds
        p sqrt(3/2) and mu sqrt(2/3), stress vectors have the norm |sigma| / sqrt(2): the same cone
    mu(I) -> left out: at 500 Pa and 11 / s (the blade's speed over a cell) it adds 0.005 to mu_s
    no tension, cohesion, dilatancy, hardening -> Newton's defaults
    sticky walls and floor -> an open box with a friction of 1000, as no collider is sticky there
    blade, a stadium drawn out along z, friction 0.3 -> its outline as a mesh on a kinematic body
    motion -> the pose when a step begins, and the speed that leads to the pose when it ends

What is not, as each solver has its own: basis functions (quadratic B-splines here; there Newton's
defaults, trilinear velocity and stress constant in a cell), contact (here at particles, half a
spacing from the surface; there on nodes, from a quarter of a voxel), the elastic stress of the
settled bed (Newton's soil begins without and rests for `REST_FRAMES`), drag of the air (there 1 / s
on the nodes, a default of Newton), and volume: soil that was torn apart presses here when it has
closed again, there at once.

Newton is imported when a bed is built: nothing else of the project needs it.
"""

import time
from dataclasses import dataclass

import numpy as np

from mpm.bodies import Body
from mpm.motions.drive import Drive
from mpm.motions.picture import outline
from mpm.scenes import CORNER, EARTH_GRAVITY, FRAME_RATE, Bin

STICKY = 1000.0  # friction of walls and floor
OUTLINE_POINTS = 24  # of each half circle of the blade; the chord lies 0.03 mm inside
REST_FRAMES = 4  # after which no particle is faster than 1 mm/s
GRAVITY = (0.0, -EARTH_GRAVITY, 0.0)


@dataclass(frozen=True)
class Numerics:
    """How Newton resolves the scene.

    Attributes:
        voxel: edge of a cell, m.
        steps_per_frame: of 1/60 s.
        rigid: whether the soil has no elasticity, as Newton's own examples; otherwise E is ours.
    """

    voxel: float
    steps_per_frame: int
    rigid: bool = False


@dataclass(frozen=True)
class NewtonRun:
    """What Newton made of a run.

    Attributes:
        force: float64 [T, 3], N, of the soil on the blade, mean over each driven frame.
        positions: float64 [N, 3], m, at the end.
        floor_over_weight: vertical force on walls and floor over m g, before the blade moves.
        unbalanced: largest difference between the change of the soil's momentum and the impulses of
            gravity, walls and blade, of all frames, over m g (drag and rounding).
        cpu_s: CPU seconds of the steps.
    """

    force: np.ndarray
    positions: np.ndarray
    floor_over_weight: float
    unbalanced: float
    cpu_s: float


def material_of(soil: dict) -> dict[str, float]:
    """Returns Newton's parameters of a recorded soil (`Soil._asdict`): density and `mpm:*`."""
    k, g = soil['bulk_modulus'], soil['shear_modulus']
    return {
        'density': soil['bulk_density'],
        'young_modulus': 9 * k * g / (3 * k + g),
        'poisson_ratio': (3 * k - 2 * g) / (2 * (3 * k + g)),
        'friction': soil['mu_s'],
    }


def blade_mesh(body: Body) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [V, 3] (m, about the reference point) and triangles [F, 3], outward."""
    ring = outline(body, (0.0, 0.0, 0.0), OUTLINE_POINTS + 1)[:-1]
    count = len(ring)
    sides = [np.column_stack([ring, np.full(count, z * body.half_width)]) for z in (-1, 1)]
    near = np.arange(count)
    on = np.roll(near, -1)
    fan = np.arange(1, count - 1)
    first = np.zeros_like(fan)
    triangles = [
        np.stack([near, on, on + count], axis=1),
        np.stack([near, on + count, near + count], axis=1),
        np.stack([first, fan + 1, fan], axis=1),
        np.stack([first, fan, fan + 1], axis=1) + count,
    ]
    return np.concatenate(sides), np.concatenate(triangles)


def bin_mesh(box: Bin) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [8, 3] (m from the corner) and triangles of floor and walls, inward."""
    size = (box.size[0], box.height, box.size[2])
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size
    faces = [(0, 1, 5, 4), (0, 2, 3, 1), (4, 5, 7, 6), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])
    p = corners[triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    outward = (normal * (corners.mean(axis=0) - p[:, 0])).sum(axis=1) < 0
    triangles[outward] = triangles[outward][:, ::-1]
    return corners, triangles


def transform_of(pose: np.ndarray, z_middle: float) -> np.ndarray:
    """Returns Newton's transform float32 [1, 7] (place in m, quaternion x y z w) of a pose.

    Args:
        pose: x, y (m) of the reference point and the angle about z (rad).
        z_middle: z of the reference point, m.
    """
    place = np.array([pose[0], pose[1], z_middle]) - CORNER
    turn = (0.0, 0.0, np.sin(pose[2] / 2), np.cos(pose[2] / 2))
    return np.array([[*place, *turn]], dtype=np.float32)


def imported() -> tuple:
    """Returns the modules `newton` and `warp`.

    Raises:
        ValueError: if one of them, or what they need, is not installed.
    """
    try:
        import newton
        import newton.solvers
        import pxr  # noqa: F401  (usd-core, which the solver imports late)
        import warp
    except ImportError as error:
        raise ValueError(
            f'{error.name} is not installed: the comparison runs in an environment of its own, '
            'with `pip install newton usd-core warp-lang numba scipy absl-py tqdm matplotlib`'
        ) from error
    return newton, warp


class NewtonBed:
    """The bed and the blade in Newton, advanced frame by frame; lengths from the bin's corner."""

    def __init__(
        self,
        box: Bin,
        drive: Drive,
        material: dict[str, float],
        particles: tuple[np.ndarray, float],
        numerics: Numerics,
    ):
        """Builds model and solver.

        Args:
            box: the bin.
            drive: blade and motion.
            material: see `material_of`.
            particles: positions [N, 3] (m) and the volume (m3) of packed soil of each.
            numerics: cells and steps.

        Raises:
            ValueError: see `imported`.
        """
        newton, warp = imported()
        implicit = newton.solvers.SolverImplicitMPM
        self._drive, self._dt = drive, 1.0 / (FRAME_RATE * numerics.steps_per_frame)
        self._steps = numerics.steps_per_frame
        positions, volume = particles
        count = len(positions)
        self._mass = material['density'] * volume
        builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=GRAVITY)
        implicit.register_custom_attributes(builder)
        builder.add_particles(
            pos=[warp.vec3(*place) for place in positions - CORNER],
            vel=[warp.vec3(0.0)] * count,
            mass=[self._mass] * count,
            radius=[volume ** (1 / 3) / 2] * count,
        )
        blade = builder.add_body(is_kinematic=True)
        for body, (vertices, triangles), friction in (
            (-1, bin_mesh(box), STICKY),
            (blade, blade_mesh(drive.body), drive.body.friction),
        ):
            builder.add_shape_mesh(
                body,
                mesh=newton.Mesh(vertices, triangles.ravel(), compute_inertia=False),
                cfg=newton.ModelBuilder.ShapeConfig(mu=friction, density=0.0),
            )
        model = builder.finalize(device='cpu')
        for name in ('young_modulus', 'poisson_ratio', 'friction'):
            if not (numerics.rigid and name == 'young_modulus'):
                getattr(model.mpm, name).fill_(material[name])
        config = implicit.Config(voxel_size=numerics.voxel, air_drag=1.0)
        self._solver = implicit(model, config)
        self._states = [model.state(), model.state()]
        # Index of the body of each collider: -1 is the box.
        self._is_blade = self._solver.collider_body_index.numpy() == blade

    @property
    def weight(self) -> float:
        """Weight of the soil, N."""
        return self._mass * EARTH_GRAVITY * len(self.positions())

    def positions(self) -> np.ndarray:
        """Returns the positions [N, 3] of the soil, m."""
        return self._states[0].particle_q.numpy().astype(np.float64) + CORNER

    def _momentum(self) -> np.ndarray:
        return self._mass * self._states[0].particle_qd.numpy().astype(np.float64).sum(axis=0)

    def frame(self, start: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Advances by one frame from a time (s; before 0 the blade rests).

        Returns:
            Mean forces [3] (N) of the soil on the blade and on the box, and what is missing from
            the balance of the soil's momentum, [3] N.

        Raises:
            ValueError: the soil's momentum is not finite any more.
        """
        impulse, before = np.zeros((2, 3)), self._momentum()
        poses = self._drive.pose(start + np.arange(self._steps + 1) * self._dt)
        places = [transform_of(pose, self._drive.body.z_middle) for pose in poses]
        for here, there in zip(places[:-1], places[1:]):
            speed = np.zeros((1, 6), dtype=np.float32)
            speed[0, :3] = (there - here)[0, :3] / self._dt
            for state in self._states:
                state.body_q.assign(here)
                state.body_qd.assign(speed)
            old, new = self._states
            self._solver.step(old, new, None, None, self._dt)
            impulses, _, owner = (
                array.numpy() for array in self._solver.collect_collider_impulses(new)
            )
            for collider, is_blade in enumerate(self._is_blade):
                of_it = impulses[owner == collider].astype(np.float64)
                impulse[0 if is_blade else 1] += of_it.sum(axis=0)
            # As in Newton's examples: what is left inside a collider is put on its surface.
            self._solver.project_outside(new, new, self._dt)
            self._states = [new, old]
        force = impulse * FRAME_RATE
        change = (self._momentum() - before) * FRAME_RATE
        if not np.isfinite(change).all():
            raise ValueError(f"Newton's soil has no finite speed after {start:.3f} s")
        missing = change + force.sum(axis=0) - [0.0, -self.weight, 0.0]
        return force[0], force[1], missing


def run_in_newton(bed: NewtonBed, frames: int, on_frame=None) -> NewtonRun:
    """Lets the bed rest for `REST_FRAMES` and drives it for `frames`.

    Args:
        bed: a new one.
        frames: driven frames T.
        on_frame: called after each.

    Raises:
        ValueError: see `NewtonBed.frame`.
    """
    started, force, box, missing = time.process_time(), [], [], []
    for frame in range(-REST_FRAMES, frames):
        on_blade, on_box, lost = bed.frame(frame / FRAME_RATE)
        force.append(on_blade)
        box.append(on_box)
        missing.append(np.abs(lost).max())
        if on_frame is not None:
            on_frame()
    return NewtonRun(
        np.array(force[REST_FRAMES:]),
        bed.positions(),
        float(-box[REST_FRAMES - 1][1] / bed.weight),
        float(max(missing) / bed.weight),
        time.process_time() - started,
    )
