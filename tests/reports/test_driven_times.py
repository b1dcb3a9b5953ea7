"""Error against time: which times are taken, and the table and picture from known errors."""

from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from pca_tools import dataset, files
from reports import driven_times
from tests.reports.test_learning_curve import document


class Rollout:
    """Of five frames; says what was asked of it."""

    modes = np.zeros((5, 1))

    def __init__(self, asked):
        self.asked = asked

    def particles(self, frame):
        self.asked.append(frame)


@pytest.fixture
def timed(monkeypatch):
    """(paths and contexts that were rolled out, frames whose particles were asked for)."""
    paths, asked = [], []
    runs = [
        SimpleNamespace(rigid_pose=np.full((6, 7), value, np.float32), step_context=None)
        for value in range(3)
    ]
    kinds = [{'kind': kind} for kind in ('grid', 'disturbed', 'lift')]

    def rollout(poses, context):
        paths.append((poses[0, 0], context))
        return Rollout(asked)

    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {'cases': {'test': kinds}})
    monkeypatch.setattr(dataset, 'read_split', lambda path, split: runs)
    monkeypatch.setattr(lts, 'load', lambda folder: SimpleNamespace(rollout=rollout), raising=False)
    return paths, asked


def test_the_path_is_a_driven_one_on_a_flat_bed_and_all_frames_are_decoded(timed):
    paths, asked = timed
    found = driven_times.time_models('data', {'field': 'folder'}, rounds=1)
    assert set(paths) == {(2.0, None)}
    assert asked == 3 * [0, 1, 2, 3, 4]  # two calls to warm up
    assert found['field']['load_ms'] > 0 and found['field']['particles_ms'] > 0


def test_data_without_such_a_run_are_refused(timed, monkeypatch):
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {})
    with pytest.raises(ValueError, match='no test run on a flat bed'):
        driven_times.time_models('data', {'field': 'folder'})


def test_table_and_picture_join_errors_and_times(timed, tmp_path, capsys):
    protocol = str(tmp_path / 'protocol.json')
    files.write_json(protocol, document(7, 1.0) | {'scene': 'excavation'})
    values = SimpleNamespace(
        data_path='data', protocol=protocol, model=['field=folder'], num_threads=1,
        output_path=str(tmp_path / 'times'),
    )  # fmt: skip
    driven_times.main(values, None)
    path = f'{values.output_path}.json'
    files.write_json(path, {'models': {'field': {'load_ms': 0.25, 'particles_ms': 11.0}}})
    lines = driven_times.table(path, protocol).splitlines()
    assert lines[0].startswith('| 2 driven test runs | soil, mm | force, rel. L2 |')
    assert lines[2] == '| field | 8 (4 to 12) | 0.6 (0.3 to 0.9) | 0.25 | 11 |'
    assert lines[3] == '| path ridge | 4 | 0.3 |  |  |'
    assert (tmp_path / 'times.png').read_bytes().startswith(b'\x89PNG')
    assert 'driven test runs' in capsys.readouterr().out
    values.model = ['other=folder']
    with pytest.raises(ValueError, match="got \\['other'\\]"):
        driven_times.main(values, None)
