"""The data of record: its list, its order, its digests."""

import json
import types

import pytest

from mpm import record, scenes, splits
from tests.mpm import small
from tests.pca_tools.commands import call_command


@pytest.fixture
def short(monkeypatch):
    """Coarse, short runs in place of the record's own."""
    monkeypatch.setattr(scenes, 'FRAMES', 4)
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 2)
    coarse = {'excavation': small.BLADE, 'wheel': small.WHEEL}
    parts = {part: (coarse[scene.name], kinds) for part, (scene, kinds) in record.PARTS.items()}
    for name, scene in coarse.items():
        monkeypatch.setitem(scenes.SCENES, name, scene)
    monkeypatch.setattr(record, 'PARTS', parts)


def make(path, parts=('operator', 'wheel_free', 'excavation_grid'), limit=2):
    return record.make(list(parts), str(path), 1, record.Selection(limit))


def test_parts_come_in_order_and_a_second_call_makes_nothing(tmp_path, short, capsys):
    found = make(tmp_path)
    assert capsys.readouterr().out.count('2 new runs') == 3
    assert set(found) == {'excavation', 'wheel'}
    assert set(found['wheel']) == {'slip_0000', 'stops_0000'}
    grid = [str(case) for case in record.runs_of('excavation_grid', record.Selection(2))]
    assert set(found['excavation']) == {'smooth_0000', 'stops_0000', *grid}
    kept = json.loads((tmp_path / 'wheel' / record.DIGESTS).read_text())
    assert kept == {'wheel': found['wheel']}
    assert make(tmp_path) == found and capsys.readouterr().out.count('0 new runs') == 3
    # Another folder, the same digests.
    again = make(tmp_path / 'again', ['operator'])['excavation']
    assert again.items() <= found['excavation'].items()


def test_runs_that_differ_from_those_expected_are_told(tmp_path, short, capsys):
    found = make(tmp_path, ['wheel_free'])['wheel']
    (tmp_path / 'expect.json').write_text(json.dumps({'wheel': found | {'stops_0000': 'other'}}))
    values = types.SimpleNamespace(
        parts=['wheel_free'], output_path=str(tmp_path), num_processes=1, cluster='', limit=2,
        held=[], splits=splits.SPLITS, list=False, expect=str(tmp_path / 'expect.json'),
    )  # fmt: skip
    assert record.main(values) == 1
    assert 'wheel: 2 runs, 1 as expected' in capsys.readouterr().out


def test_part_that_fails_does_not_stop_the_next(tmp_path, short, monkeypatch):
    small.fails_at(monkeypatch, 'smooth_0000')
    with pytest.raises(ValueError, match='operator: 1 of 2 runs failed'):
        make(tmp_path, ['operator', 'wheel_free'])
    assert len(record.digests_of(str(tmp_path / 'wheel'))) == 2
    assert len(record.digests_of(str(tmp_path / 'excavation'))) == 1


def test_splits_share_the_runs_of_a_part():
    parts = [record.runs_of('operator', record.Selection(splits=[s])) for s in splits.SPLITS]
    assert [len(part) for part in parts] == [114, 30, 60]
    assert set().union(*parts) == set(record.runs_of('operator'))
    assert {splits.split_of(scenes.EXCAVATION, case) for case in parts[2]} == {'test'}
    first = record.Selection(limit=3, splits=['test'])
    assert record.runs_of('operator', first) == parts[2][:3]  # the limit counts these alone
    with pytest.raises(ValueError, match="unknown part 'sea'; there are operator, machine, beside"):
        record.runs_of('sea')
    with pytest.raises(ValueError, match=r"unknown splits \['exam'\]; there are train, valid, te"):
        record.runs_of('operator', record.Selection(splits=['exam']))


def test_list_says_what_would_be_made():
    rows = [line.split() for line in record.table(record.PARTS).splitlines()]
    assert ['operator', 'lift', '34', '19', '5', '10'] in rows
    assert ['wheel_grid', 'grid', '40', '19', '5', '16'] in rows


def test_command_ends_in_one_line():
    done = call_command('mpm.record')
    assert (done.returncode, done.stdout) == (1, '')
    assert done.stderr == 'error: give --output_path, or --list to see what would be made\n'


def dataset(path, content):
    path.mkdir()
    (path / 'metadata.json').write_text(content)
    return str(path)


def test_what_datasets_hold_is_left_out(tmp_path):
    first, second, *_ = record.runs_of('operator')
    blade = {'train': [{'case': 22}], 'test': [{'case': first}]}
    blade = json.dumps({'scene': {'name': 'excavation'}, 'cases': blade})
    wheel = '{"scene": {"name": "wheel"}, "cases": {"valid": [{"case": 5}]}}'
    held = record.held_by([dataset(tmp_path / 'a', blade), dataset(tmp_path / 'b', wheel)])
    assert held == {'excavation': {'22', first}, 'wheel': {'5'}}
    missing = record.Selection(held=held)
    # The limit counts what is missing.
    assert record.runs_of('operator', missing._replace(limit=1)) == (second,)
    assert 22 in record.runs_of('excavation_grid')
    assert 22 not in record.runs_of('excavation_grid', missing)
    assert 9 in record.runs_of('wheel_grid', missing)
    with pytest.raises(ValueError, match='metadata.json: names no scene and cases of runs'):
        record.held_by([dataset(tmp_path / 'c', '{"cases": []}')])
