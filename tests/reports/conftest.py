"""A soil field that was trained for a moment, for the reports that open one."""

import pytest

import learning_to_simulate as lts
from tests.learning_to_simulate.soil_field import worlds


@pytest.fixture(scope='session')
def trained_field(tmp_path_factory):
    """Folder of a field of two members, and of the two datasets that it has learned from."""
    folder = tmp_path_factory.mktemp('field')
    data = [worlds.write_dataset(folder / str(i), range(3 * i, 3 * i + 3)) for i in (0, 1)]
    settings = lts.preset('soil_field', members=2, num_steps=6)
    path = str(folder / 'model')
    lts.train(settings, [lts.Dataset(each) for each in data], path)
    return path, data
