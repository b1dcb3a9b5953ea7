"""A small bed, a path over it and a field with random weights, without any training."""

import numpy as np

from learning_to_simulate.live.starts import Starts
from learning_to_simulate.live.stepper import Stepper
from learning_to_simulate.scene import RigidMotion, Scene
from learning_to_simulate.swept_field.engine import FieldEngine
from learning_to_simulate.swept_field.field import SweptField
from learning_to_simulate.swept_field.settings import SweptFieldConfig
from learning_to_simulate.tool import Blade
from learning_to_simulate.tool.axes import Axes
from learning_to_simulate.tool.swept import Bed, Frame
from pca_tools import convert, raw_writer

BLADE = Blade()
GRID = BLADE.grid
DT = 1 / 60
SURFACE, MIDDLE = 0.25, 0.4
AXES = Axes(axis=0, sign=-1, up=1, middle=MIDDLE)
SPACING = 0.05


def bed_points() -> np.ndarray:
    """[N, 3] particles of a box that is symmetric across, world, m."""
    x = np.arange(0.1 + SPACING / 2, 0.9, SPACING)
    y = np.arange(SURFACE - SPACING / 2, 0.1, -SPACING)
    z = MIDDLE + np.arange(-0.275, 0.3, SPACING)
    return np.stack(np.meshgrid(x, y, z, indexing='ij'), axis=-1).reshape(-1, 3)


def flat_bed(origin: float) -> Bed:
    """The bed of a tool that begins at u = origin."""
    surface = np.full((1, len(GRID.offsets)), SURFACE)
    return Bed(surface, np.array([SURFACE]), np.array([origin + 0.6]))


def path(n_frame=61, depth=0.04, dt=DT, reverse=True) -> np.ndarray:
    """[T, 1, 3] down, forward, back a little, and out into the air; smooth in time."""
    t = np.arange(n_frame) * dt
    end = 60 / 60
    s = t / end
    u = -0.75 + 0.25 * np.sin(np.pi * 0.75 * s) - (0.05 * np.sin(np.pi * s) ** 2 if reverse else 0)
    y = SURFACE + BLADE.radius + 0.01 - (depth + 0.01) * np.sin(np.pi * s) ** 2
    y = y + 3.0 * np.clip(s - 0.9, 0, None) ** 2
    lean = 0.4 + 0.2 * np.sin(3 * s)
    return np.stack([u, y, lean], axis=-1)[:, None]


def world_pose(plane) -> np.ndarray:
    """[..., 7] poses of the world for u, height, lean."""
    u, y, lean = np.moveaxis(np.asarray(plane), -1, 0)
    zero = np.zeros_like(u)
    # Driving towards -x, a lean back is a turn about -z.
    return np.stack(
        [-u, y, zero + MIDDLE, np.cos(lean / 2), zero, zero, np.sin(-lean / 2)], axis=-1
    )


def field_of(scene, axes, tool, points, spacing, members, seed=0, **config) -> SweptField:
    """A field with random weights, large enough to move soil visibly."""
    settings = SweptFieldConfig(
        'swept_field', members=members, latent_size=8, hidden_layers=2, seed=seed, **config
    )
    field = SweptField(settings, scene, axes, tool.grid, tool, points, spacing, spacing)
    for part in (field.network.soil, field.network.load):
        weight, bias = part.layers[-1]
        # Not the gain of the load of a blade.
        is_grown = (np.arange(bias.shape[-1]) < 3) | tool.predicts_height
        weight.assign(np.where(is_grown, 10.0, 1.0) * weight)
        bias.assign(np.where(is_grown, 0.2 if tool.predicts_height else 0.5, 0.0) + bias)
    field.ranges = {name: [-1e3, 1e3] for name in tool.scalars}
    return field


def make_field(members=3, **config) -> SweptField:
    """`field_of` a blade."""
    scene = Scene('small', 4, RigidMotion.PRESCRIBED, (), True, (), 10, DT)
    return field_of(scene, AXES, BLADE, bed_points(), SPACING, members, **config)


def make_starts(field) -> Starts:
    """The one start of a tool of four particles."""
    body = np.array([[0.0, y, z] for y in (0.0, 0.2) for z in (-0.2, 0.2)])
    pose = world_pose(path()[0])
    modes = np.zeros((1, field.scene.n_modes, 3))
    return Starts(({},), (body,), (np.arange(4),), pose, modes, None, None)


def make_live(field, members=None, outside='flag') -> Stepper:
    """Steps the field with a tool of four particles, by TensorFlow."""
    return Stepper(FieldEngine(field, make_starts(field), members=members), outside)


def frames(plane, surface=None) -> Frame:
    """Frames of one tool, [T, ...]."""
    bed = flat_bed(plane[0, 0, 0])
    if surface is not None:
        bed = bed._replace(surface=surface)
    velocity = (plane[1] - plane[0]) / DT if len(plane) > 1 else None
    _, found = BLADE.frames(GRID, bed, np.array([[BLADE.width]]), plane, DT, velocity)
    return found.at((slice(None), 0))


def made_up_run(depth, split) -> dict:
    """Soil above the deepest cut goes along with the blade; the force is that of a depth."""
    plane = path(depth=depth)
    seen = frames(plane)
    points = bed_points()
    local = AXES.points(points)
    u = local[:, 0] - plane[0, 0, 0]
    cut = np.stack([np.interp(u, GRID.offsets, b[:, 0]) for b in seen.bins])
    went = np.clip(seen.scalars[:, :1] - u, 0.0, 0.1)
    share = np.clip((cut - (SURFACE - local[:, 1])) / 0.03, 0.0, 1.0)
    moved = np.zeros((len(plane), len(points), 3))
    moved[..., 0], moved[..., 1] = share * went, 0.2 * share * went
    below = np.clip(SURFACE - plane[:, 0, 1] + BLADE.radius, 0, None)
    load = np.stack([-3e4 * below**2, 5e3 * below**2, 10 * below], axis=1)
    force, torque = AXES.world_loads(load)
    pose = world_pose(plane[:, 0])
    body = np.array([[-0.014, y, z] for y in (0.0, 0.1, 0.2) for z in (-0.2, 0.0, 0.2)])
    return {
        'positions': points + AXES.world(moved),
        'rigid_positions': pose[:, None, :3] + body,
        'force': force, 'torque': torque, 'pose': pose, 'split': split, 'kind': 'made_up',
        'parameters': {'blade_width_m': 0.457},
    }  # fmt: skip


def write_dataset(folder, depths, made_up=made_up_run, body='prescribed'):
    """Writes `folder / 'data'` of made-up runs, a (depth, split) each."""
    raw = str(folder / 'raw')
    raw_writer.write_raw(raw, [made_up(*pair) for pair in depths], DT, up_axis=1, body=body)
    convert.convert(raw, str(folder / 'data'), modes=2)
