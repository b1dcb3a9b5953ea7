"""A scene on a coarser grid: same soil, same columns, fewer cells."""

import numpy as np
import pytest

from mpm import coarse, packing, scenes
from mpm.grid import make_grid

FACTORS = (1.0, 1.33, 1.5, 2.0, 3.0)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)
@pytest.mark.parametrize('factor', FACTORS)
def test_soil_keeps_its_volume_and_stays_between_the_walls(scene, factor):
    coarser = coarse.coarsened(scene, factor)
    box, fine = coarser.bin, packing.lattice(scene.bin, 0)
    particles, _ = coarse.thinned((fine, {}), coarser)
    volume = packing.particle_volume(box) * len(particles)
    assert volume == pytest.approx(np.prod(scene.bin.size), rel=1e-12)
    grid = make_grid(box)
    assert grid.dx / scene.bin.dx == pytest.approx(factor, rel=0.05)
    low = np.array(grid.origin) + np.array([grid.walls[0], grid.walls[2], grid.walls[3]]) * grid.dx
    high = np.array(grid.origin) + np.array([grid.walls[1], np.inf, grid.walls[4]]) * grid.dx
    assert (particles[:, :3] > low).all() and (particles[:, :3] < high).all()
    # A wall stands where the soil ends, or less than half a cell outside.
    gap = scenes.CORNER - low[2]
    assert -1e-9 <= gap < grid.dx / 2 and low[0] == pytest.approx(scenes.CORNER)


@pytest.mark.parametrize('scene', scenes.SCENES.values(), ids=lambda scene: scene.name)
@pytest.mark.parametrize('factor', FACTORS)
def test_written_particles_are_those_of_the_fine_run(scene, factor):
    coarser = coarse.coarsened(scene, factor)
    fine = packing.lattice(scene.bin, 0)
    particles, _ = coarse.thinned((fine, {}), coarser)
    kept = particles[:: coarser.bin.keep_every, :3]
    np.testing.assert_array_equal(kept, fine[:: scene.bin.keep_every, :3])
    # Cells hold at least as many particles as before.
    per_cell = [s.bin.dx**3 / packing.particle_volume(s.bin) for s in (coarser, scene)]
    assert per_cell[0] >= per_cell[1] * (1 - 1e-9)


def test_particles_are_thinned_only_where_no_plane_of_them_is_far():
    """Every fifth particle of the excavation is a skewed lattice, every third of the wheel planes
    19.2 mm apart: 1.15 cells at twice the cell size, 1.5 cells at 1.5 times."""
    for scene, wanted in ((scenes.EXCAVATION, (1, 1, 5, 5)), (scenes.WHEEL, (1, 1, 3, 3))):
        found = [coarse.coarsened(scene, f).bin.simulate_every for f in (1.33, 1.5, 2.0, 3.0)]
        assert tuple(found) == wanted


def test_factor_of_one_changes_nothing():
    for scene in scenes.SCENES.values():
        same = coarse.coarsened(scene, 1.0)
        assert make_grid(same.bin) == make_grid(scene.bin)
        assert packing.particle_volume(same.bin) == packing.particle_volume(scene.bin)
        assert same.bin.keep_every == scene.bin.keep_every


@pytest.mark.parametrize('factor', [0.5, float('nan'), -2.0])
def test_finer_grids_are_refused(factor):
    with pytest.raises(ValueError, match='must be at least 1'):
        coarse.coarsened(scenes.EXCAVATION, factor)


def test_too_few_cells_are_refused():
    with pytest.raises(ValueError, match='leaves 6 cells'):
        coarse.coarsened(scenes.EXCAVATION, 10.0)
