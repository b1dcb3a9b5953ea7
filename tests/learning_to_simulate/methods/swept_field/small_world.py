"""A small bed, a path over it and a field with random weights, without any training."""

import numpy as np

from learning_to_simulate.live.resting_start import Starts
from learning_to_simulate.methods.swept_features import SweptGrid
from learning_to_simulate.methods.swept_field import tool_path
from learning_to_simulate.methods.swept_field.axes import Axes
from learning_to_simulate.methods.swept_field.field import SweptField
from learning_to_simulate.methods.swept_field.live import LiveField
from learning_to_simulate.methods.swept_field.settings import SweptFieldConfig
from learning_to_simulate.methods.swept_field.tool_path import Bed
from learning_to_simulate.methods.swept_field.tools import Blade
from learning_to_simulate.scene import RigidMotion, Scene

GRID = SweptGrid(radius=0.014, spacing=0.005, behind=0.45, ahead=0.75)
BLADE = Blade()
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


def make_field(members=3, seed=0, **config) -> SweptField:
    """A field with random weights, large enough to move soil visibly."""
    scene = Scene('small', 4, RigidMotion.PRESCRIBED, (), True, (), 10, DT)
    settings = SweptFieldConfig(
        'swept_field', members=members, latent_size=8, hidden_layers=2, force_latent_size=8,
        seed=seed, **config,
    )  # fmt: skip
    field = SweptField(settings, scene, AXES, GRID, BLADE, bed_points(), SPACING, SPACING)
    for part in (field.network.soil, field.network.load):
        weight, bias = part.layers[-1]
        # Not the gain of the load.
        scale = np.where(np.arange(bias.shape[-1]) < 3, 10.0, 1.0)
        weight.assign(scale * weight)
        bias.assign(0.5 * (scale > 1) + bias)
    field.ranges = {name: [-10.0, 10.0] for name in tool_path.SCALARS}
    return field


def make_live(field, **options) -> LiveField:
    """Steps the field with a tool of four particles."""
    body = np.array([[0.0, y, z] for y in (0.0, 0.2) for z in (-0.2, 0.2)])
    pose = world_pose(path()[0])
    modes = np.zeros((1, field.scene.n_modes, 3))
    starts = Starts(({},), (body,), (np.arange(4),), pose, modes, None, None)
    return LiveField(field, starts, **options)


def frames(plane, surface=None) -> tool_path.Frame:
    """Frames of one tool, [T, ...]."""
    bed = flat_bed(plane[0, 0, 0])
    if surface is not None:
        bed = bed._replace(surface=surface)
    found = tool_path.frames(GRID, bed, np.array([BLADE.width]), plane, DT)
    return tool_path.Frame(found.bins[:, 0], found.scalars[:, 0])
