"""Error against time: which times are taken, and the table and picture from known errors."""

from types import SimpleNamespace

import numpy as np
import pytest

import learning_to_simulate as lts
from pca_tools import dataset, files
from reports import times
from tests.reports.protocol.known import document


class Rollout:
    """Of five frames; says what was asked of it."""

    def __init__(self, asked):
        self.asked = asked

    def __len__(self):
        return 5

    def particles(self, frame):
        self.asked.append(frame)


class Live:
    """A stepper that remembers where it was."""

    dt = 0.5

    def __init__(self, log):
        self.log = log

    def start(self, pose, velocity, **context):
        self.log.append(('start', pose[0], velocity.tolist(), context))

    def step(self, pose, **context):
        self.log.append(('step', pose[0], context))


@pytest.fixture
def timed(monkeypatch):
    """(paths and contexts that were rolled out, frames whose particles were asked for, steps)."""
    paths, asked, steps = [], [], []
    poses = np.zeros((6, 7), np.float32)
    poses[:, 1] = np.arange(6)
    runs = [
        SimpleNamespace(rigid_pose=poses + np.eye(7)[0] * value, step_context=None, n_frames=6)
        for value in range(3)
    ]
    kinds = [{'kind': kind} for kind in ('grid', 'disturbed', 'lift')]
    kinds[0]['solver_cpu_s'], kinds[1]['solver_cpu_s'] = 5.0, 6.0

    def rollout(poses, context):
        paths.append((poses[0, 0], context))
        return Rollout(asked)

    def load(folder):
        return SimpleNamespace(rollout=rollout, stepper=lambda: Live(steps))

    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {'cases': {'test': kinds}})
    monkeypatch.setattr(dataset, 'read_split', lambda path, split: runs)
    monkeypatch.setattr(lts, 'load', load, raising=False)
    return paths, asked, steps, runs


def test_the_path_is_a_driven_one_on_a_flat_bed_and_all_frames_are_decoded(timed):
    paths, asked, steps, _ = timed
    found = times.time_models('data', {'field': 'folder'}, rounds=1)
    assert set(paths) == {(2.0, None)}
    assert asked == 3 * [0, 1, 2, 3, 4]  # two calls to warm up
    assert set(found['field']) == set(times.COLUMNS) and min(found['field'].values()) > 0
    # Every pose after the first is a step; it starts with the speed of the path, 1 m in 0.5 s.
    turn = [('start', 2.0, [0.0, 2.0, 0.0], {})] + 5 * [('step', 2.0, {})]
    assert steps == 3 * turn


def test_steps_are_given_their_contexts(timed):
    _, _, steps, runs = timed
    runs[2].step_context = np.arange(6.0)[:, None]
    times.time_models('data', {'field': 'folder'}, rounds=1)
    given = [float(entry[-1]['context'][0]) for entry in steps[:6]]
    assert given == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


def test_the_solver_s_time_stands_in_the_data(timed, monkeypatch):
    assert times.solver_ms('data') == pytest.approx(1100.0)  # 5 and 6 s of five frames
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {})
    assert times.solver_ms('data') is None


def test_data_without_such_a_run_are_refused(timed, monkeypatch):
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: {})
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


def test_table_and_picture_join_errors_and_times(judged, tmp_path, capsys):
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
    assert 'driven test runs' in capsys.readouterr().out


@pytest.mark.parametrize(
    'given, reason', [(['other=folder'], r"no \['other'\]"), (['field='], 'NAME=FOLDER')]
)
def test_names_that_are_not_there_are_refused_before_the_work(judged, given, reason):
    judged.model = given
    with pytest.raises(ValueError, match=reason):
        times.main(judged, None)
