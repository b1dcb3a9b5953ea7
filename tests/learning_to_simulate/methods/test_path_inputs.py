"""What the regressions on the path see: what moves with the tool and what stands on the bed."""

import dataclasses

import numpy as np
import pytest

from learning_to_simulate import reading_utils
from learning_to_simulate.methods.path_inputs import SETS, PathInputs
from pca_tools import dataset
from tests.learning_to_simulate import synthetic


@pytest.fixture(scope='module')
def read(tmp_path_factory):
    """(reader, a group of runs) of a blade."""
    path = synthetic.write_dataset(tmp_path_factory.mktemp('data'), motion='prescribed')
    metadata = dataset.read_metadata(path)
    groups = reading_utils.read_groups(path, 'train', metadata)
    scene = reading_utils.read_scene(path, metadata, groups, None)
    return PathInputs.of(groups, scene), groups[0]


@pytest.mark.parametrize('name', SETS)
def test_only_inputs_of_the_bed_know_where_a_run_began(read, name):
    reader, group = read
    way = np.eye(3)[reader.frame.axis] * 0.03
    shifted = dataclasses.replace(group, position=group.position + way)
    here, there = reader.read(group, name), reader.read(shifted, name)
    assert here.shape == there.shape
    if name == 'bed':
        begun = there[..., -1] - here[..., -1]
        np.testing.assert_allclose(begun, reader.frame.sign * 0.03, rtol=1e-5)
        assert np.abs(there[..., :-1] - here[..., :-1]).max() > 1e-3
    else:
        np.testing.assert_allclose(there, here, atol=1e-6)


def test_a_reader_is_restored_from_its_description(read):
    reader, group = read
    again = PathInputs.from_json(reader.to_json(), reader.scene)
    for name in SETS:
        np.testing.assert_array_equal(again.read(group, name), reader.read(group, name))
