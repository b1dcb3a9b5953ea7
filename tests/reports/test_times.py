"""Error against time: which times are taken, and the table and picture from known errors."""

from types import SimpleNamespace

import numpy as np
import pytest

from pca_tools import dataset, files
from reports import times, timing
from tests.reports.protocol.known import document


@pytest.fixture
def recorded(monkeypatch):
    """Cases of three runs of six frames."""
    cases = [{'kind': kind} for kind in ('grid', 'disturbed', 'lift')]
    cases[0]['solver_cpu_s'], cases[1]['solver_cpu_s'] = 5.0, 6.0
    learned = {'train': [{'solver_cpu_s': 1000.0}, {}], 'valid': [{'solver_cpu_s': 90.0}]}
    metadata = {'cases': {'test': cases} | learned, 'dt': 0.02}
    monkeypatch.setattr(dataset, 'read_metadata', lambda path: metadata)
    runs = [SimpleNamespace(n_frames=6)] * 3
    monkeypatch.setattr(dataset, 'read_split', lambda path, split: runs)
    return cases


def test_the_path_is_a_driven_one_on_a_flat_bed(recorded):
    assert times.driven('data') == 2
    assert times.solver_ms('data') == pytest.approx(1100.0)  # 5 and 6 s of five frames
    recorded.pop()
    with pytest.raises(ValueError, match='no test run that is driven'):
        times.driven('data')


def test_table_and_picture_join_errors_and_times(recorded, tmp_path, monkeypatch):
    protocol = str(tmp_path / 'protocol.json')
    files.write_json(protocol, document())
    names = [f'soil field, {count} of 2 members, C' for count in (1, 2)]
    names += ['mlp_driven, TensorFlow']
    jobs = {(name, what): name for name in names for what in ('load', 'particles')}
    monkeypatch.setattr(
        times, 'field_jobs', lambda *_: (jobs, {names[0]: dict.fromkeys(times.QUANTITIES, 7.0)})
    )
    monkeypatch.setattr(times, 'subspace_jobs', lambda *_: {})
    clock, processor = np.array([2.0, 2.0, 9.0]), np.array([4.0])
    monkeypatch.setattr(
        timing, 'in_turns',
        lambda jobs, _: {j: timing.Timing(clock, processor[: 'mlp' in j[0]]) for j in jobs},
    )  # fmt: skip
    values = SimpleNamespace(
        data_path='data,wide', protocol=protocol, soil_field='folder',
        model=['mlp_driven=folder'], training_s=['soil field=98', 'mlp_driven=6'], budget_ms=[],
        solver_ms=None, output_path=str(tmp_path / 'times'),
    )  # fmt: skip
    times.main(values)
    lines = times.table(f'{values.output_path}.json').splitlines()[2:]
    assert lines[0] == '| solver |  |  | 1100 | 1100 | 1 |'
    assert lines[1] == '| soil field, 1 of 2 members, C | 7 | 7 | 2 | 2 | 550 |'
    # Its own errors: of the training that refused no run; medians of steps, CPU time of rollouts.
    assert lines[2] == '| soil field, 2 of 2 members, C | 1.5 | 0.2 | 2 | 2 | 550 |'
    assert lines[3] == '| mlp_driven, TensorFlow | 2.5 | 1 | 4 | 4 | 275 |'
    assert (tmp_path / 'times.png').read_bytes().startswith(b'\x89PNG')
    # A soil field has learned from both datasets: 2180 + 98 s, at 1098 ms a frame.
    lines = times.break_even(f'{values.output_path}.json').splitlines()[2:]
    assert lines[0] == '| soil field | 0.606 | 0.0272 | 0.692 |'
    frames = 1e3 * (1090 + 6) / (1100 - 4)
    assert float(lines[1].split('|')[-2]) == pytest.approx(frames * 0.02 / 60, rel=1e-2)
    lines = times.picked(f'{values.output_path}.json', '1', '2', '5').splitlines()[2:]
    assert lines[0] == '| 1 |  |  |  |  |'
    second = 'soil field, 2 of 2 members, C'
    assert lines[1] == f'| 2 | {second} | 0.2 | {second} | 1.5 |' and lines[2][3:] == lines[1][3:]
    values.solver_ms = 440.0  # of this processor
    times.main(values)
    lines = times.table(f'{values.output_path}.json').splitlines()[2:]
    assert lines[0] == '| solver |  |  | 440 | 440 | 1 |' and lines[1].endswith('| 2 | 220 |')
    values.model = ['other=folder']
    with pytest.raises(ValueError, match=r"no \['other'\]"):
        times.main(values)
    values.protocol = None
    with pytest.raises(ValueError, match='--protocol is needed'):
        times.main(values)


def test_a_soil_field_is_timed_with_each_number_of_members(trained_field, monkeypatch):
    model, (data, _) = trained_field
    monkeypatch.setattr(times, 'FRAMES', 12)
    jobs, errors = times.field_jobs(model, data)
    engines = [f'soil field, {m} of 2 members, {e}' for m in (1, 2) for e in ('C', 'TensorFlow')]
    assert list(dict.fromkeys(name for name, _ in jobs)) == engines
    assert set(errors) == set(engines[:2]) and errors[engines[0]] == errors[engines[1]]
    for job in jobs.values():
        assert len(job.call()) == 11
