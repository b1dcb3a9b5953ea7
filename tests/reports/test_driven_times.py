"""Error against time: which times are taken, and the table and picture from known errors."""

from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from learning_to_simulate.export_c import c_field
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


def test_a_field_in_c_goes_along_the_same_path(timed, monkeypatch):
    class Field:
        """Counts what is asked of it."""

        starts, poses, drawn = [], [], []

        def start(self, pose):
            self.starts.append(pose[0])

        def step(self, pose):
            self.poses.append(pose[0])

        def particles(self):
            self.drawn.append(True)

    monkeypatch.setattr(c_field.CField, 'load', lambda folder: Field())
    found = driven_times.time_models('data', {'field': 'folder'}, ('field',), rounds=1)
    assert list(found) == ['field', 'field, in C']
    turns = len(Field.starts)  # half of them with particles; the run has six frames
    assert set(Field.starts) == {2.0} and len(Field.poses) == 5 * turns
    assert len(Field.drawn) == 5 * turns / 2


def test_data_without_such_a_run_are_refused(timed, monkeypatch):
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {})
    with pytest.raises(ValueError, match='no test run on a flat bed'):
        driven_times.time_models('data', {'field': 'folder'})


@pytest.fixture
def judged(timed, tmp_path):
    """Flags of the command, whose protocol and coarse solver are known."""
    protocol, solver = str(tmp_path / 'protocol.json'), str(tmp_path / 'solver.json')
    files.write_json(protocol, document(7, 1.0) | {'scene': 'excavation'})
    run = {'soil_rms_mm': 5.0, 'force_relative_l2': 0.5, 'milliseconds_per_step': 7.0}
    files.write_json(solver, {'runs': {'solver': [{}], 'solver_x2': [run, run]}})
    return SimpleNamespace(
        data_path='data', protocol=protocol, model=['field=folder'], num_threads=1, in_c=[],
        solver_json=solver, output_path=str(tmp_path / 'times'),
    )  # fmt: skip


def test_table_and_picture_join_errors_and_times(judged, tmp_path, capsys):
    driven_times.main(judged, None)
    path = f'{judged.output_path}.json'
    found = files.read_json(path)
    found['models'] = {
        'field': {'load_ms': 0.25, 'particles_ms': 11.0},
        'field, in C': {'load_ms': 0.002, 'particles_ms': 2.0},
    }
    files.write_json(path, found)
    lines = driven_times.table(path, judged.protocol).splitlines()
    assert lines[0].startswith('| 2 driven test runs | soil, mm | force, rel. L2 |')
    assert lines[2] == '| field | 8 (4 to 12) | 0.6 (0.3 to 0.9) | 0.25 | 11 |'
    assert lines[3] == '| field, in C | 8 (4 to 12) | 0.6 (0.3 to 0.9) | 0.002 | 2 |'
    assert lines[4] == '| path ridge | 4 | 0.3 |  |  |'
    assert lines[5] == '| solver, cells x 2 (2 runs) | 5 | 0.5 | 7 | 7 |'
    assert (tmp_path / 'times.png').read_bytes().startswith(b'\x89PNG')
    assert 'driven test runs' in capsys.readouterr().out


@pytest.mark.parametrize(
    'given, reason',
    [({'model': ['other=folder']}, 'got .*other'), ({'in_c': ['mlp']}, 'names of --model .*mlp')],
)
def test_names_that_are_not_there_are_refused_before_the_work(judged, given, reason):
    vars(judged).update(given)
    with pytest.raises(ValueError, match=reason):
        driven_times.main(judged, None)


def test_each_axis_joins_the_modes_of_one_method(judged, tmp_path):
    protocol = files.read_json(judged.protocol)
    seeds = protocol['methods'][0]['seeds']
    about = [{'name': f'mlp, {r} modes', 'seeds': seeds} for r in (4, 8)]
    files.write_json(judged.protocol, protocol | {'methods': protocol['methods'] + about})
    times = {f'mlp, {r} modes': {'load_ms': r / 100, 'particles_ms': r / 10} for r in (4, 8)}
    path = str(tmp_path / 'times.json')
    files.write_json(path, {'models': times})
    found, runs = driven_times.rows(files.read_json(path), files.read_json(judged.protocol))
    assert runs == 2
    assert [row[0] for row in found if row[4]] == ['mlp, 4 modes', 'mlp, 8 modes']
    driven_times.draw(path, judged.protocol, str(tmp_path / 'modes.png'))
    assert (tmp_path / 'modes.png').stat().st_size > 10_000
