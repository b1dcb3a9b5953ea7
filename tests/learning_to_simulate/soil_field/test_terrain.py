"""The map of heights against scipy's interpolation and walks in small steps."""

import gc

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from learning_to_simulate.soil_field.place import place_of
from learning_to_simulate.soil_field.terrain import Terrain
from learning_to_simulate.soil_field.tools import Soil
from tests.learning_to_simulate.soil_field import scenes

RNG = np.random.default_rng(0)


def rough(shape=(7, 5), **more):
    return Terrain(RNG.normal(size=shape), (0.1, 0.2), (-0.3, 1.0), **more)


@pytest.mark.parametrize('shape', [(7, 5), (1, 1), (1, 4), (4, 1)])
def test_heights_between_cells_are_those_of_scipy_and_beyond_the_map_its_border_goes_on(shape):
    terrain = rough(shape)
    x, z = terrain.middles
    np.testing.assert_allclose([x[0], z[0]], [-0.25, 1.1])
    np.testing.assert_allclose(
        [x[-1], z[-1]], terrain.corner + [0.1, 0.2] * (np.array(shape) - 0.5)
    )
    points = RNG.uniform(-3, 3, (60, 2))
    inside = np.clip(points, (x[0], z[0]), (x[-1], z[-1]))
    # One more cell that nothing asks for, where scipy needs two.
    wide = np.pad(terrain.heights, ((0, 1), (0, 1)), mode='edge')
    grid = np.append(x, x[-1] + 1), np.append(z, z[-1] + 1)
    wanted = RegularGridInterpolator(grid, wide)(inside)
    np.testing.assert_allclose(terrain.at(*points.T), wanted, atol=1e-13)


def test_a_copy_and_a_file_hold_everything(tmp_path):
    terrain = rough(soil=Soil(31.0, 1500.0, 1.6), floor=-9.0, walled=True)
    path = str(tmp_path / 'terrain.npz')
    terrain.save(path)
    copy, read = terrain.clone(), Terrain.load(path)
    for other in (copy, read):
        np.testing.assert_array_equal(other.heights, terrain.heights)
        np.testing.assert_array_equal(other.cell, terrain.cell)
        np.testing.assert_array_equal(other.corner, terrain.corner)
        assert (other.soil, other.floor, other.walled) == (terrain.soil, -9.0, True)
        other.heights[0, 0] = 5.0
    assert terrain.heights[0, 0] != 5.0


def test_a_file_that_is_no_terrain_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        Terrain.load(str(tmp_path / 'none.npz'))
    path = str(tmp_path / 'other.npz')
    np.savez(path, heights=np.zeros((2, 2)), soil=np.ones(2))
    with pytest.raises(ValueError, match='no terrain'):
        Terrain.load(path)


@pytest.mark.parametrize('order', ['C', 'F'])
def test_written_cells_change_and_soil_ends_at_the_floor(order):
    heights = np.asarray(RNG.uniform(0, 1, (4, 3)), order=order)
    terrain = Terrain(heights, floor=-0.5)
    wanted = heights.copy()
    wanted[1, 2], wanted[3, 0] = 7.0, -0.5
    terrain.write(np.array([1 * 3 + 2, 3 * 3]), np.array([7.0, -2.0]))
    np.testing.assert_array_equal(terrain.heights, wanted)
    assert heights.max() <= 1  # the caller's array is his own
    np.testing.assert_array_equal(terrain.clone().heights, wanted)


def test_work_is_done_before_heights_are_read_as_long_as_its_owner_lives():
    class Worker:
        def __init__(self, terrain):
            self.terrain = terrain

        def update(self):
            self.terrain.write(np.array([0]), -0.25)

    terrain = Terrain.flat((0.1, 0.1))
    worker = Worker(terrain)
    terrain.add_work(worker)
    assert terrain.heights[0, 0] == -0.25
    terrain.heights[0, 0] = 0.5
    assert terrain.at(0.01, 0.01) == -0.25
    del worker
    gc.collect()
    terrain.heights[0, 0] = 0.5
    assert terrain.heights[0, 0] == 0.5


def test_works_are_near_where_their_circles_meet():
    class Worker:
        def __init__(self, footprint):
            self.footprint = footprint

    terrain = Terrain.flat((0.1, 0.1))
    works = [Worker((np.array(c), r)) for c, r in (((0, 0), 1.0), ((0, 1.4), 0.5), ((3, 0), 1.9))]
    works.append(Worker(None))
    for work in works:
        terrain.add_work(work)
    assert [terrain.is_crowded(w) for w in works] == [True, True, False, False]
    del works[1], work
    gc.collect()
    assert not terrain.is_crowded(works[0])


def steepest(terrain):
    """Largest rise over run between neighbours, corners too."""
    h, (a, b) = terrain.heights, terrain.cell
    pairs = [
        (h[1:] - h[:-1]) / a, (h[:, 1:] - h[:, :-1]) / b,
        (h[1:, 1:] - h[:-1, :-1]) / np.hypot(a, b), (h[1:, :-1] - h[:-1, 1:]) / np.hypot(a, b),
    ]  # fmt: skip
    return max(np.abs(p).max() for p in pairs)


@pytest.mark.parametrize('angle, cell', [(25.0, (0.02, 0.02)), (37.0, (0.01, 0.02))])
def test_steep_soil_slides_to_its_angle_of_repose_and_none_is_lost(angle, cell):
    terrain = Terrain.flat((0.5, 0.6), cell=cell, soil=Soil(angle))
    terrain.heights[10:20, 8:14] = 0.05
    terrain.heights[22:25, 8:14] = -0.05
    first = terrain.heights.copy()
    terrain.settle(np.flatnonzero(terrain.heights))
    slope = np.tan(np.radians(angle))
    assert steepest(Terrain(first, cell)) > slope + 1e-4 / min(cell) > steepest(terrain)
    assert steepest(terrain) > 0.9 * slope
    assert terrain.heights.sum() == pytest.approx(first.sum(), abs=1e-12)
    settled = terrain.heights.copy()
    terrain.settle(np.flatnonzero(terrain.heights))
    np.testing.assert_allclose(terrain.heights, settled, atol=1e-4)


def test_what_is_not_steep_or_is_kept_does_not_slide():
    terrain = Terrain.flat((0.6, 0.6))
    x, _ = terrain.middles
    terrain.heights[:] = 0.7 * x[:, None]  # below tan 37 degrees
    first = terrain.heights.copy()
    terrain.settle(np.arange(first.size))
    np.testing.assert_array_equal(terrain.heights, first)
    terrain.heights[15, 15] += 0.1
    keep = np.arange(first.size).reshape(first.shape)[16:].ravel()
    before = terrain.heights.copy()
    terrain.settle([15 * first.shape[1] + 15], keep)
    np.testing.assert_array_equal(terrain.heights[16:], before[16:])
    assert terrain.heights[15, 15] < before[15, 15] and terrain.heights[14, 15] > before[14, 15]
    assert terrain.heights.sum() == pytest.approx(before.sum(), abs=1e-12)
    terrain.settle([])


@pytest.mark.parametrize('yaw', [0.0, 0.5, np.pi / 2, 2.2])
def test_a_wall_is_where_a_walk_leaves_the_map(yaw, u=0.15):
    terrain = Terrain.flat((1.0, 0.6), corner=(-0.4, -0.2), walled=True)
    place = place_of(scenes.poses([[0.0, 0.0, 0.0]], yaw, (0.05, 0.3, 0.06))[0])
    for way in (1, -1):
        steps = np.arange(0, 2, 1e-4)
        x, _, z = (place.origin + (u + way * steps)[:, None] * place.along).T
        inside = (x >= -0.4) & (x <= 0.6) & (z >= -0.2) & (z <= 0.4)
        here = place.origin + u * place.along
        assert terrain.wall(here, way * place.along) == pytest.approx(steps[inside].max(), abs=2e-4)
        assert Terrain.flat((1.0, 0.6), corner=(-0.4, -0.2)).wall(here, place.along) == np.inf


def test_only_heights_of_a_terrain_change():
    """Tools on it have taken in the rest."""
    terrain = Terrain.flat((1.0, 0.6))
    for name in ('soil', 'cell', 'corner', 'floor', 'walled'):
        with pytest.raises(AttributeError, match=f'{name} of a terrain stays as it is'):
            setattr(terrain, name, getattr(terrain, name))
    with pytest.raises(ValueError, match='read-only'):
        terrain.cell[0] = 0.03
    other = terrain.clone(Soil(30.0))
    assert other.soil.friction_angle_deg == 30.0 and terrain.soil == Soil()


@pytest.mark.parametrize(
    'arguments, message',
    [
        ((np.zeros(3),), 'heights has shape'),
        ((np.zeros((0, 3)),), r'\(0, 3\) cells'),
        (([[0.0, np.nan]],), r'heights holds nan at \(0, 1\)'),
        ((np.zeros((2, 2)), 0.0), 'cells of 0.0 m'),
        ((np.zeros((2, 2)), (0.1, np.inf)), 'cell'),
        ((np.zeros((2, 2)), 0.1, (0.0, 0.0, 0.0)), 'corner'),
        ((np.zeros((2, 2)), 0.1, (0.0, 0.0), None, 0.1), 'floor at 0.1 m'),
        ((np.zeros((2, 2)), 0.1, (0.0, 0.0), None, np.nan), 'floor'),
        ((np.zeros((2, 2)), 0.1, (0.0, 0.0), 'sand'), r"soil is 'sand': lts.Soil"),
        ((np.full((2, 2), 1 + 1j),), 'complex'),
    ],
)
def test_what_is_no_terrain_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Terrain(*arguments)


@pytest.mark.parametrize('size', [(1.0, 0.0), (np.inf, 1.0), 2.0])
def test_sizes_that_no_terrain_has_are_refused(size):
    with pytest.raises(ValueError, match='size'):
        Terrain.flat(size)
