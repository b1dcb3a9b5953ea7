"""The torque's report: the matrix, the judged rows, and the table beside the protocol's."""

import numpy as np
import pytest

from pca_tools import dataset, files
from reports import torque
from reports.protocol import baselines
from reports.protocol.truth import TruthReader
from tests.learning_to_simulate import synthetic


@pytest.fixture(scope='module')
def data(tmp_path_factory):
    folder = synthetic.write_dataset(tmp_path_factory.mktemp('data'), torque=True)
    synthetic.write_subspace(folder)
    return folder


def test_the_matrix_of_a_fixed_lever_is_that_of_its_cross_product(data):
    """The third axis of the force is noise of 0.1 N, enough to tell its column."""
    x, y, z = synthetic.LEVER
    found = torque.matrix_of(dataset.read_split(data, 'train'))
    np.testing.assert_allclose(found, [[0, -z, y], [z, 0, -x], [-y, x, 0]], atol=1e-5)


def test_trivial_predictors_hold_the_torque_or_take_its_mean(data):
    reader = TruthReader(data)
    train, test = (dataset.read_split(data, name) for name in ('train', 'test'))
    mean = np.concatenate([run.torque for run in train]).mean(axis=0)
    expected = {
        'persistence': [run.torque[5] for run in test],
        'mean force': [mean for _ in test],
    }
    seen = set()
    for baseline in baselines.trivial(reader):
        rows = torque.judge(baselines.predictions(baseline, reader, 'test'), reader)
        for run, row, said in zip(test, rows, expected.get(baseline.name, [None] * 2), strict=True):
            if said is None:
                assert 'torque_l2' not in row
                continue
            true = run.torque[6:].astype(float)
            error = np.linalg.norm(said - true) / np.linalg.norm(true)
            assert row['torque_l2'] == pytest.approx(error, rel=1e-5)
            seen.add(baseline.name)
    assert seen == set(expected)


def test_the_table_has_seeds_and_rows_of_the_protocol(tmp_path):
    digest = {'sha256': {'test.tfrecord': 'a'}}
    run = {'soil_mm': 2.0, 'force_l2': 0.5}
    seeds = [[run | {'torque_l2': x, 'pitch_l2': 0.25}] for x in (0.2, 0.4)]
    here, protocol = str(tmp_path / 'here.json'), str(tmp_path / 'protocol.json')
    files.write_json(here, {'data': digest, 'methods': {'mine': seeds}})
    names = 'other', 'mine', 'unasked'
    other = [{'name': name, 'seeds': [{'runs': {'test': [run]}}]} for name in names]
    files.write_json(protocol, {'data': digest, 'methods': other})
    lines = torque.table(here, protocol, 'other').splitlines()
    assert lines[2] == '| mine (2 seeds) | 2 | 0.5 | 0.3 (0.2 to 0.4) | 0.25 |'
    assert lines[3] == '| mine, trained without torque | 2 | 0.5 |  |  |'
    assert lines[4] == '| other | 2 | 0.5 |  |  |' and len(lines) == 5
    files.write_json(protocol, {'data': {'sha256': {'test.tfrecord': 'b'}}, 'methods': other})
    with pytest.raises(ValueError, match='other test runs'):
        torque.table(here, protocol, 'other')
