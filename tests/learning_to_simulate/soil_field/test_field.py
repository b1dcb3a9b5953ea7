"""A trained field on disk, and what it flags."""

import dataclasses
import json

import numpy as np
import pytest

from learning_to_simulate.soil_field import field as field_lib
from learning_to_simulate.soil_field import samples
from tests.learning_to_simulate.soil_field import worlds

BOUNDS = {'force': [3.0, 1.5, 0.25], 'near_mm': 2.0}


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp('field')
    field_lib.save(str(path), dataclasses.replace(worlds.trained()[0], bounds=BOUNDS))
    return path


def test_a_loaded_field_says_the_same(folder):
    field, other = worlds.trained()[0], field_lib.load(str(folder))
    frames, passage, risen, *_ = samples.episode_of(worlds.run(8))
    assert (field.loads(frames) == other.loads(frames)).all()
    places = risen[-1][1]
    assert (field.rise(passage, places) == other.rise(passage, places)).all()
    points = np.insert(places, 1, -0.01, axis=1)
    assert (field.displacement(passage, points) == other.displacement(passage, points)).all()
    assert other.ranges == field.ranges and other.config == field.config
    assert other.bounds == BOUNDS
    assert len(field.loads(frames, 1)) == 1


@pytest.mark.parametrize(
    'damage',
    [
        lambda c: c['field'].pop('tool'),
        lambda c: c['field'].update(tool='spoon'),
        lambda c: c['field']['ranges'].pop('depth'),
        lambda c: c['field']['hidden'].update(soil=[24, 25]),
        lambda c: c['field']['hidden'].update(soil=[10**12]),
        lambda c: c['field']['hidden'].update(soil=[24.5]),
        lambda c: c['field'].update(bounds={'force': [1, 2], 'near_mm': 1}),
        lambda c: c['field'].update(bounds={'force': [1, 2, 3]}),
        lambda c: c['field'].update(bounds={'force': [1, 2, -3], 'near_mm': 1}),
        lambda c: c['config'].update(members=5),
    ],
)
def test_damaged_folders_are_refused(folder, tmp_path, damage):
    for name in ('config.json', 'weights.npz'):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    config = json.loads((tmp_path / 'config.json').read_text())
    damage(config)
    (tmp_path / 'config.json').write_text(json.dumps(config))
    with pytest.raises(ValueError, match=str(tmp_path)):
        field_lib.load(str(tmp_path))


def test_weights_that_are_not_finite_are_not_saved(tmp_path):
    field = worlds.training.make_field(worlds.CONFIG, 'blade', worlds.SMALL)
    field.networks.load.layers[0][1].assign(field.networks.load.layers[0][1] * np.nan)
    with pytest.raises(ValueError, match="not finite.*'load/0/bias'"):
        field_lib.save(str(tmp_path), field)
    assert not list(tmp_path.iterdir())


def test_maps_may_be_as_coarse_as_those_of_the_tool_that_was_taught():
    # The smallest wheel of the data, of 50 mm, is 4 times smaller than that of the field, and its
    # map has cells of 13 mm.
    cells = {'blade': 0.02, 'wheel': 0.0128 / 0.25}
    for tool, cell in cells.items():
        field = worlds.training.make_field(worlds.CONFIG, tool, worlds.SMALL)
        field.ranges = {name: [0.0, 1.0] for name in field.judged_names}
        limits = field.limits
        least, most = limits.limits[:, limits.names.index('cell')]
        assert least <= 0 and cell < most < 2.1 * cell
