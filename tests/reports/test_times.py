"""Error against time: which times are taken, and the table and picture from known errors."""

from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from pca_tools import dataset, files
from reports import times, timing
from tests.reports.protocol.known import document


@pytest.fixture
def timed(monkeypatch):
    """(paths and contexts that were rolled out or stepped, frames whose particles were asked)."""
    paths, asked = [], []
    runs = [
        SimpleNamespace(rigid_pose=np.full((6, 7), i, np.float32), step_context=None, n_frames=6)
        for i in range(3)
    ]
    kinds = [{'kind': kind} for kind in ('grid', 'disturbed', 'lift')]
    kinds[0]['solver_cpu_s'], kinds[1]['solver_cpu_s'] = 5.0, 6.0

    class Rollout:
        particles = staticmethod(asked.append)

        def __len__(self):
            return 5

    def rollout(poses, context):
        paths.append((poses[0, 0], context))
        return Rollout()

    def stepping(live, poses, contexts):
        paths.append((poses[0, 0], contexts))
        return [0.001 * n for n in range(1, 101)], []

    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {'cases': {'test': kinds}})
    monkeypatch.setattr(dataset, 'read_split', lambda path, split: runs)
    monkeypatch.setattr(timing, 'stepping', stepping)
    model = SimpleNamespace(rollout=rollout, stepper=lambda: None)
    monkeypatch.setattr(lts, 'load', lambda folder: model, raising=False)
    return paths, asked


def test_the_path_is_a_driven_one_on_a_flat_bed_and_all_frames_are_decoded(timed, monkeypatch):
    paths, asked = timed
    found = times.time_models('data', {'field': 'folder'}, rounds=1)['field']
    assert set(paths) == {(2.0, None)} and asked == 3 * [0, 1, 2, 3, 4]  # two calls to warm up
    assert set(found) == set(times.COLUMNS) and min(found.values()) > 0
    assert found['step_ms'] == pytest.approx(50.5) and found['step_p99_ms'] > 99
    assert times.solver_ms('data') == pytest.approx(1100.0)  # 5 and 6 s of five frames
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {})
    assert times.solver_ms('data') is None
    with pytest.raises(ValueError, match='no test run on a flat bed'):
        times.time_models('data', {'field': 'folder'})


@pytest.fixture
def judged(timed, tmp_path):
    """Flags of the command, whose protocol is known."""
    protocol = str(tmp_path / 'protocol.json')
    files.write_json(protocol, document(7, 1.0))
    return SimpleNamespace(
        data_path='data', protocol=protocol, model=['field=folder'], num_threads=1,
        output_path=str(tmp_path / 'times'),
    )  # fmt: skip


def test_table_and_picture_join_errors_and_times(judged, tmp_path):
    times.main(judged, None)
    path = f'{judged.output_path}.json'
    found = files.read_json(path)
    assert found['solver_ms'] > 0 and list(found['models']) == ['field']
    found['models'] = {
        'field': {'load_ms': 0.25, 'particles_ms': 11.0},
        'field, in C': {'load_ms': 0.002, 'particles_ms': 2.0},
    }
    files.write_json(path, found)
    lines = times.table(path, judged.protocol).splitlines()
    assert lines[0].startswith('| 2 driven test runs | soil, mm | force, rel. L2 | load')
    assert lines[2:] == [
        '| field | 8 (4 to 12) | 0.6 (0.3 to 0.9) | 0.25 | 11 |',
        '| field, in C | 8 (4 to 12) | 0.6 (0.3 to 0.9) | 0.002 | 2 |',
        '| path ridge | 4 | 0.3 |  |  |',
    ]
    assert (tmp_path / 'times.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize(
    'given, reason', [(['other=folder'], r"no \['other'\]"), (['field='], 'NAME=FOLDER')]
)
def test_names_that_are_not_there_are_refused_before_the_work(judged, given, reason):
    judged.model = given
    with pytest.raises(ValueError, match=reason):
        times.main(judged, None)
