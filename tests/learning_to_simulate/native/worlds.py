"""Small worlds of the tests of C, and what they all need."""

import ctypes
import os
import shutil
from typing import NamedTuple

import numpy as np
import pytest

from learning_to_simulate.live import poses
from learning_to_simulate.live import starts as live_starts
from learning_to_simulate.native import library, model_data, project
from learning_to_simulate.soil_field import training
from learning_to_simulate.soil_field.settings import SoilFieldConfig
from pca_tools import subspace
from tests.learning_to_simulate import models, synthetic

needs_c = pytest.mark.skipif(
    not any(map(shutil.which, ('cc', 'gcc', 'clang'))), reason='no C compiler'
)


# Hidden units of the networks of a soil field.
SMALL = {'load': (20, 24), 'surface': (24, 20), 'soil': (24, 16, 20)}
TINY = {'load': (6, 5), 'surface': (6,), 'soil': (5,)}


class Graph(NamedTuple):
    """An untrained model in a subspace, runs of its data, its starts and its C values."""

    model: object
    group: object
    starts: live_starts.Starts
    values: dict


def space(n_soil=synthetic.N_SOIL, n_modes=synthetic.N_MODES) -> subspace.Subspace:
    """The subspace of all graphs here, or one of other sizes."""
    return subspace.fit([np.random.default_rng(0).normal(size=(9, n_soil, 3))], n_modes)


def graph(folder, **case) -> Graph:
    """Of the options of `models.make`, with particles."""
    model, (group, *_), _ = models.make(folder, **case)
    starts = live_starts.collect(str(folder), model.simulator.config.nodes)
    values = model_data.values(model, group.n_rigid, space(), starts)
    return Graph(model, group, starts, values)


def soil_field(tool: str, hidden=SMALL, members: int = 3):
    """A soil field with networks that nobody has trained but that all inputs move."""
    made = training.make_field(SoilFieldConfig('soil_field', members=members, seed=4), tool, hidden)
    rng = np.random.default_rng(7)
    for net in (made.networks.load, made.networks.surface, made.networks.soil):
        for _, bias in net.layers:
            bias.assign(rng.normal(0, 0.3, bias.shape))
    made.ranges.update({n: [-9.0, 99.0] for n in made.judged_names})
    return made


def written(folder, name: str, values: dict) -> str:
    """A project in a new folder."""
    os.makedirs(folder)
    project.write(str(folder), name, values)
    return str(folder)


def height_map(soil, origin, cell: float, shape) -> np.ndarray:
    """float32 `shape`, m, of a run in C; ValueError for a grid that it refuses."""
    grid = library.structures()['lts_grid'](tuple(origin), cell, tuple(shape))
    heights = np.empty(min(int(np.prod(shape, dtype=float)), 1000), np.float32)
    soil.call('height_map', ctypes.byref(grid), heights)
    return heights.reshape(shape)


def started(soil, start: int = 0, pose=None, twist=None, context=None):
    """Starts a `CSubspace` from soil at rest, as lts_start; None is null."""
    shapes = {'pose': (7,), 'twist': (6,), 'context': (soil.description.n_context,)}
    given = (
        None if x is None else poses.numbers(name, x, shapes[name])
        for name, x in (('pose', pose), ('twist', twist), ('context', context))
    )
    soil.call('start', start, *given)
    return soil


def step_at(soil, pose):
    """The next frame of a `CSubspace` that was started so, at a pose [7]."""
    return soil._newest(soil.call('frame_at', pose, ctypes.byref(soil._result)))


def saved(soil) -> bytes:
    """The state of a run of a model in a subspace."""
    state = ctypes.create_string_buffer(soil.function('state_size')(soil.loaded.model))
    soil.call('save', state, len(state))
    return state.raw


def restored(soil, state: bytes) -> None:
    soil.call('load', state, len(state))
