"""A small bed, a driven wheel on it and a field with random weights, without any training."""

import numpy as np
from scipy.spatial.transform import Rotation

from learning_to_simulate.live.starts import Starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.swept_field.field import SweptField
from learning_to_simulate.tool import Wheel, wheel
from learning_to_simulate.tool.axes import Axes
from learning_to_simulate.tool.swept import Bed, Frame
from tests.learning_to_simulate.swept_field import small_world
from tests.learning_to_simulate.swept_field.small_world import DT, field_of

WHEEL = Wheel()
GRID = WHEEL.grid
SURFACE, MIDDLE, SPACING = 0.16, 0.2, 0.012
RADIUS, WIDTH = 0.075, 0.08
AXES = Axes(axis=0, sign=-1, up=1, middle=MIDDLE)
NAMES = ('gravity', 'friction_angle_deg', 'load')
CONTEXT = np.array([3.72, 37.0, 120.0])
SIZE = np.array([RADIUS, WIDTH, 3.72, np.tan(np.radians(37.0))])


def bed_points() -> np.ndarray:
    """[N, 3] particles of a box, world, m."""
    x = np.arange(0.1 + SPACING / 2, 0.5, SPACING)
    y = np.arange(SURFACE - SPACING / 2, 0.1, -SPACING)
    z = MIDDLE + SPACING * np.arange(-7.5, 8)
    return np.stack(np.meshgrid(x, y, z, indexing='ij'), axis=-1).reshape(-1, 3)


def flat_bed(origin: float) -> Bed:
    """The bed of a wheel that begins at u = origin."""
    surface = np.full((1, len(GRID.offsets)), SURFACE)
    return Bed(surface, np.array([SURFACE]), np.array([origin + 0.28]))


def path(n_frame=61, dt=DT, sunk=0.006) -> np.ndarray:
    """[T, 1, 4] at rest, forward, back, slip both ways, and a load that changes; smooth in time."""
    s = np.arange(n_frame) * dt
    way = np.where(s < 0.1, 0.0, 1.0) * np.sin(np.pi * 0.75 * np.maximum(s - 0.1, 0)) ** 2
    u = -0.38 + 0.06 * way
    slip = 0.012 * (1 - np.cos(2.2 * np.pi * np.maximum(s - 0.1, 0)))  # it spins, then brakes
    turned = (0.06 * way + slip) / RADIUS
    height = SURFACE + RADIUS - sunk - 0.008 * np.maximum(s - 0.1, 0) ** 2
    load = 120.0 + 40.0 * np.sin(np.pi * np.maximum(s - 0.1, 0)) ** 2
    return np.stack([u, height, turned, load], axis=-1)[:, None]


def world_pose(plane) -> np.ndarray:
    """[..., 7] poses of the world for u, height, angle turned."""
    u, y, turned = np.moveaxis(np.asarray(plane)[..., :3], -1, 0)
    zero = np.zeros_like(u)
    # Driving towards -x, rolling on is a turn about +z.
    half = turned / 2
    return np.stack([-u, y, zero + MIDDLE, np.cos(half), zero, zero, np.sin(half)], axis=-1)


def body() -> np.ndarray:
    """[16, 3] points of the rim about the axle, upright, m."""
    angles = 2 * np.pi * np.arange(8) / 8
    sides = (-WIDTH / 2, WIDTH / 2)
    return np.array(
        [(RADIUS * np.cos(a), RADIUS * np.sin(a), side) for side in sides for a in angles]
    )


def contexts(plane) -> np.ndarray:
    """[T, 3] contexts of poses [T, K]."""
    rows = np.repeat(CONTEXT[None], len(plane), axis=0)
    rows[:, 2] = plane[:, wheel.LOAD]
    return rows


def make_field(members=2, **config) -> SweptField:
    """`small_world.field_of` a wheel."""
    scene = Scene('small', 4, RigidMotion.DRIVEN, (), True, NAMES, 10, DT)
    return field_of(scene, AXES, WHEEL, bed_points(), SPACING, members, **config)


class FlatBed:
    """A subspace that knows one bed."""

    n_modes = 4

    def decode(self, _):
        """The bed, whatever the modes."""
        return bed_points()


class BentBeds:
    """A subspace of beds: the flat one, and two modes that bend it."""

    n_modes = 4

    def __init__(self, points):
        x = points[:, :1]
        self.mean = points
        self.components = np.concatenate([x - 0.3, np.sin(20 * x), 0 * x, 0 * x], axis=1)

    def decode(self, modes):
        """[N, 3] m."""
        return self.components @ np.asarray(modes, np.float64) + self.mean


def two_starts(field) -> dict:
    """`starts` and `subspace` of two wheels of different size on two beds and soils."""
    modes = np.zeros((2, 4, 3))
    modes[1, :2, 1] = 0.02, 0.003
    pose = np.stack([world_pose(path()[0, 0])] * 2)
    starts = Starts(
        ({'case': 7}, {'case': 8}), (body(), 0.8 * body()), (np.arange(16),) * 2, pose, modes,
        np.array([CONTEXT, [9.81, 30.0, 200.0]]), None,
    )  # fmt: skip
    return {'starts': starts, 'subspace': BentBeds(field.rest)}


def make_live(field, **options) -> Stepper:
    """Steps the field with a wheel on the bed of its one start, by TensorFlow."""
    modes = np.zeros((1, field.scene.n_modes, 3))
    pose = world_pose(path()[0])
    starts = Starts(({},), (body(),), (np.arange(16),), pose, modes, CONTEXT[None], None)
    return Stepper(FieldEngine(field, starts, FlatBed()), **options)


def frames(plane, heights=None) -> Frame:
    """Frames of one wheel, [T, ...]."""
    _, found = WHEEL.frames(GRID, flat_bed(plane[0, 0, 0]), SIZE[None], plane, DT, None, heights)
    return found.at((slice(None), 0))


def made_up_drive(sunk, split) -> dict:
    """Soil goes down with the rut and along with the slip; the wheel sinks as it slips."""
    plane = path(sunk=sunk)
    seen = frames(plane)
    slipped = seen.scalars[:, wheel.SCALARS.index('slipped')]
    plane[:, 0, 1] = plane[0, 0, 1] - 0.4 * slipped
    seen = frames(plane)
    points = bed_points()
    local = AXES.points(points)
    u, depth = local[:, 0] - plane[0, 0, 0], SURFACE - local[:, 1]
    share = np.clip(1 - depth / 0.03, 0, 1) * (np.abs(local[:, 2]) < WIDTH / 2)
    moved = np.zeros((len(plane), len(points), 3))
    for t, bins in enumerate(seen.bins):
        new = bins[:, wheel.CUT] - bins[:, wheel.FIRST_CUT]
        moved[t, :, 0] = -0.3 * share * np.interp(u, GRID.offsets, bins[:, 5])
        moved[t, :, 1] = -share * np.interp(u, GRID.offsets, new)
    load = seen.scalars[:, wheel.SCALARS.index('frame_load')]
    stirred = seen.scalars[:, wheel.SCALARS.index('stirred')]
    loads = np.stack([-0.3 * stirred * load, load, 0.02 * stirred * load], axis=1)
    force, torque = AXES.world_loads(loads)
    pose = world_pose(plane[:, 0])
    rows = contexts(plane[:, 0])
    turns = Rotation.from_rotvec(plane[:, 0, 2:3] * [0.0, 0.0, 1.0])
    placed = np.stack([turn.apply(body()) for turn in turns])
    return {
        'positions': points + AXES.world(moved),
        'rigid_positions': pose[:, None, :3] + placed,
        'force': force, 'torque': torque, 'pose': pose, 'split': split, 'kind': 'made_up',
        'context': dict(zip(NAMES, rows[0])), 'step_context': rows,
    }  # fmt: skip


def write_dataset(folder, sinkages):
    """Writes `folder / 'data'` of made-up runs, a (sinkage, split) each."""
    small_world.write_dataset(folder, sinkages, made_up_drive, 'driven')
