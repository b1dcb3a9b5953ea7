"""A soil whose law is known, runs in it, and a field that has learned them."""

import functools

import numpy as np

from learning_to_simulate.soil_field import training
from learning_to_simulate.soil_field.runs import Run
from learning_to_simulate.soil_field.settings import SoilFieldConfig
from learning_to_simulate.soil_field.tools import Blade, Soil
from tests.learning_to_simulate.soil_field.scenes import DT, poses

STRIDE, CELL = 4, np.array([0.01, 0.02])
SHAPE, CORNER = (100, 40), np.array([-0.7, -0.4])
TOOL = Blade(0.3)
DEPTH = np.array([-6000.0, 2000.0, 0.0])  # N per m of depth and 0.3 m of width, along, up, across
HEAP = 0.01  # m before the tool


def path(seed, frames=49):
    """u, height of the edge's middle and lean [T, 3]: down, along, up."""
    rng = np.random.default_rng(seed)
    depth, speed = rng.uniform(0.02, 0.06), rng.uniform(0.06, 0.12)
    t = np.arange(frames) / (frames - 1)
    dip = np.clip(np.minimum(t / 0.25, (1 - t) / 0.15), 0, 1)
    height = TOOL.radius + 0.015 - (depth + 0.015) * dip
    return np.stack([3 * speed * t, height, np.full(frames, rng.uniform(0.0, 0.3))], axis=1)


def run(seed, split='train', frames=49) -> Run:
    """The soil vanishes where the edge was; before the tool it stands 10 mm higher."""
    way = path(seed, frames)
    x, z = (CORNER[i] + CELL[i] * (np.arange(SHAPE[i]) + 0.5) for i in range(2))
    u, heights, now = -x[:, None], [], np.zeros(SHAPE)
    inside = np.abs(z)[None] < TOOL.width / 2
    last = way[0, 0]
    for tip, height, _ in way:
        bottom = height - TOOL.radius
        passed = (u >= last - 0.01) & (u <= tip + 0.01) & inside
        now = np.where(passed, np.minimum(now, bottom), now)
        heap = HEAP * (bottom < 0) * inside * (u > tip + 0.01) * (u < tip + 0.1)
        heights.append(now + heap)
        last = tip
    depth = np.maximum(TOOL.radius - way[:, 1], 0.0)
    force = depth[:, None] * DEPTH * [-1, 1, 1]  # along is -x, across is -z
    rng = np.random.default_rng(99)
    rest = np.stack(
        [rng.uniform(-0.6, 0.2, 200), rng.uniform(-0.08, 0.0, 200), rng.uniform(-0.3, 0.3, 200)],
        axis=1,
    )
    taken = [
        (rest[:, 1] > -d) & (np.abs(rest[:, 2]) < TOOL.width / 2) & (np.abs(-rest[:, 0] - t) < 0.06)
        for d, t in zip(depth, way[:, 0], strict=True)
    ]
    moved = [rest + 0.02 * (np.sum(taken[: i + 1], axis=0) > 0)[:, None] * [-1.0, 0.5, 0.0]
             for i in range(frames)]  # fmt: skip
    return Run(
        f'cut_{seed}', 'cut', split, TOOL, Soil(), poses(way), force,
        np.stack([0 * depth, 0 * depth, -30.0 * depth], axis=1), np.array(heights)[::STRIDE],
        STRIDE, CORNER, CELL, np.array(moved)[::STRIDE], DT,
    )  # fmt: skip


CONFIG = SoilFieldConfig('soil_field', members=2, num_steps=500)


@functools.cache
def trained():
    """A field that has learned six runs, its losses, and from what; not to be changed."""
    field = training.make_field(CONFIG, 'blade', SMALL)
    pools = training.parts_of(field, [run(seed) for seed in range(6)])
    return field, training.fit(field, pools, progress=False), pools


SMALL = {'load': (24, 24), 'surface': (24, 24), 'soil': (24, 24)}
