"""The memory of a path: the same however it is read, and what it is of simple paths."""

from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate.axes import Axes
from learning_to_simulate.subspace import path_memory
from learning_to_simulate.subspace.path_memory import PathMemory
from learning_to_simulate.swept import EDGE_RADIUS

DT, SURFACE = 1 / 60, 0.25
MEMORY = PathMemory(Axes(axis=0, sign=-1, up=1), SURFACE, (-0.8, -0.3), DT)
PLACES = slice(-3 * (path_memory.PLACES + len(path_memory.ABOUT)), None)


def _bodies(x, y, width=0.4):
    """Upright blades [S, T, 4, 3] whose lower edges are at x, y [S, T]."""
    corners = np.array([[0, 0, 0], [0, 0, width], [0, 0.2, 0], [0, 0.2, width]], float)
    edge = np.stack([x, y, np.full_like(x, 0.1)], axis=-1)
    return edge[:, :, None] + corners


def _paths(count=3, frames=30):
    rng = np.random.default_rng(0)
    x = 0.7 - np.cumsum(rng.uniform(-0.002, 0.006, (count, frames)), axis=1)
    y = SURFACE + 0.02 - np.cumsum(rng.uniform(-0.001, 0.003, (count, frames)), axis=1)
    return x, y


def test_frame_by_frame_and_alone_equal_the_whole():
    bodies = _bodies(*_paths())
    whole = MEMORY.read(bodies)
    assert whole.shape == (3, 30, path_memory.WIDTH) and whole.dtype == np.float32
    memory = MEMORY.start(bodies[1:2, 0])
    for t in range(30):
        memory = MEMORY.advance(memory, bodies[1:2, t]) if t else memory
        np.testing.assert_array_equal(MEMORY.values(memory)[0], whole[1, t])


def test_a_straight_cut_has_the_depth_and_the_area_of_a_slot():
    """Edge of radius 14 mm, its middle 20 mm below the surface over 300 mm of travel."""
    depth, start, end = 0.02, 0.7, 0.4
    x = np.linspace(start, end, 60)[None]
    values = MEMORY.read(_bodies(x, np.full_like(x, SURFACE - depth)))[0, -1]
    low = -0.8 - path_memory.MARGIN
    assert values[0] == pytest.approx((-end - low) / 0.15, abs=1e-5)
    assert values[1] == pytest.approx(-depth / 0.05, abs=1e-5)
    assert values[8] == pytest.approx(0.2 / 0.1, abs=1e-6)  # half the width
    radius = EDGE_RADIUS
    inside = 2 * radius * depth + np.pi * radius**2 / 2  # both round ends
    area = (start - end) * (depth + radius) + inside
    assert values[4] * 0.01 == pytest.approx(area, rel=0.02)
    places = np.linspace(low, -0.3 + path_memory.MARGIN, path_memory.PLACES)
    cut = values[PLACES][: path_memory.PLACES] * 0.03
    inner = (places > -start + radius) & (places < -end - radius)
    outer = (places < -start - 2 * radius) | (places > -end + 2 * radius)
    np.testing.assert_allclose(cut[inner], depth + radius, atol=1e-5)
    np.testing.assert_array_equal(cut[outer], 0.0)
    # How much had been swept when the edge's front first reached a place, to a frame of travel.
    before = (values[PLACES][2 * path_memory.PLACES :][: path_memory.PLACES] * 0.05) ** 2 - 1e-6
    wanted = (places + start - radius) * (depth + radius) + inside
    np.testing.assert_allclose(before[inner], wanted[inner], atol=4e-4)
    assert np.ptp(wanted[inner]) > 4e-3


def test_speed_fades_as_a_first_order_lag():
    """Constant speed v from rest: the memory of time scale s holds v (1 - exp(-t / s))."""
    speed, count = 0.06, 25
    x = 0.7 - speed * DT * np.arange(count)[None]
    values = MEMORY.read(_bodies(x, np.full_like(x, SURFACE + 0.1)))[0, -1]
    time = (count - 1) * DT
    rates = values[9 : 9 + 9 : 3] * 0.1
    lags = [speed * (1 - np.exp(-time / s)) for s in path_memory.TIME_SCALES]
    np.testing.assert_allclose(rates, [speed, *lags], rtol=1e-5)


def test_it_survives_the_model_folder_and_refuses_a_path_beyond_its_bins():
    scene = SimpleNamespace(up_axis=1, dt=DT)
    again = PathMemory.of_statistics(MEMORY.to_statistics(), scene)
    assert again == MEMORY
    x = np.array([[0.7, -0.4]])
    with pytest.raises(ValueError, match='bins'):
        MEMORY.read(_bodies(x, np.full_like(x, SURFACE)))
