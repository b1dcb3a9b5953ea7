"""A soil whose law is known, runs and datasets in it, and a field that has learned them."""

import functools

import numpy as np
from scipy.spatial.transform import Rotation

from learning_to_simulate.soil_field import training
from learning_to_simulate.soil_field.runs import Run
from learning_to_simulate.soil_field.settings import SoilFieldConfig
from learning_to_simulate.soil_field.tools import Blade, Soil
from pca_tools import convert, write_raw
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


def arrays(way) -> dict[str, np.ndarray]:
    """What a run along a `path` [T, 3] records. The soil vanishes where the edge was; before the
    tool it stands 10 mm higher."""
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
             for i in range(len(way))]  # fmt: skip
    return {
        'pose': poses(way), 'force': force, 'heights': np.array(heights),
        'torque': np.stack([0 * depth, 0 * depth, -30.0 * depth], axis=1),
        'positions': np.array(moved),
    }  # fmt: skip


def run(seed, split='train', frames=49, way=None, **more) -> Run:
    """A run along a `path`, by default that of the seed."""
    found = arrays(path(seed, frames) if way is None else way)
    return Run(
        f'cut_{seed}', 'cut', split, TOOL, Soil(), found['pose'], found['force'], found['torque'],
        found['heights'][::STRIDE], STRIDE, CORNER, CELL, found['positions'][::STRIDE], DT,
    )._replace(**more)  # fmt: skip


def write_dataset(folder, seeds, changed=lambda values: values) -> str:
    """A dataset of runs of seeds; one of three is of `valid`, one of `test`. `changed` may alter
    what is written of a run."""

    def values(number, seed):
        found = arrays(path(seed))
        corners = np.array([[0, -TOOL.radius, z] for z in (-0.15, 0, 0.15)] + [[0, 0.2, 0]])
        turn = Rotation.from_quat(np.roll(found['pose'][:, 3:], -1, axis=1)).as_matrix()
        found['rigid_positions'] = corners @ turn.transpose(0, 2, 1) + found['pose'][:, None, :3]
        found |= {'case': seed, 'split': ('train', 'valid', 'test')[number % 3], 'kind': 'cut'}
        found['parameters'] = {
            'body_width_m': TOOL.width, 'heights_corner_m': CORNER.tolist(),
            'heights_cell_m': CELL.tolist(),
        }  # fmt: skip
        return changed(found)

    raw, data = f'{folder}_raw', str(folder)
    write_raw(raw, (values(*item) for item in enumerate(seeds)), DT, up_axis='y', body='prescribed')
    convert.convert(raw, data, modes=4)
    return data


CONFIG = SoilFieldConfig('soil_field', members=2, num_steps=150)


@functools.cache
def trained():
    """A field that has learned six runs, its losses, and from what; not to be changed."""
    field = training.make_field(CONFIG, 'blade', SMALL)
    pools = training.parts_of(field, [run(seed) for seed in range(6)])
    return field, training.fit(field, pools, progress=False), pools


SMALL = {'load': (24, 24), 'surface': (24, 24), 'soil': (24, 24)}
