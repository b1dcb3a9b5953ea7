"""Where a number comes from, and sweeps that go on."""

import subprocess
import sys

import pytest

from pca_tools import files
from reports import record


def test_provenance_names_command_commit_and_machine(monkeypatch):
    monkeypatch.setattr(sys, 'argv', ['/somewhere/report.py', '--rounds=3'])
    found = record.provenance(2)
    assert found['command'].startswith('python -m ') and found['command'].endswith(' --rounds=3')
    assert found['machine']['threads'] == 2 and found['machine']['cores'] >= 1
    done = subprocess.run(
        ['git', '-C', record.ROOT, 'rev-parse', 'HEAD'], capture_output=True, text=True
    )
    if done.returncode == 0:
        assert done.stdout.startswith(found['commit'].rstrip('+'))


def test_outside_a_checkout_there_is_no_commit(monkeypatch, tmp_path):
    monkeypatch.setattr(record, 'ROOT', str(tmp_path))
    monkeypatch.setenv('GIT_CEILING_DIRECTORIES', str(tmp_path))
    assert record.provenance()['commit'] is None


def test_a_sweep_goes_on_with_its_own_rows_alone(tmp_path):
    path, empty = str(tmp_path / 'rows.json'), {'rows': []}
    fresh = record.resume(path, {'budget': 3}, empty)
    assert fresh == {'budget': 3, 'rows': []}
    files.write_json(path, fresh | {'rows': [1], 'command': 'old'})
    assert record.resume(path, {'budget': 3}, empty)['rows'] == [1]
    with pytest.raises(ValueError, match=r'another budget \(3 there, 4 now\)'):
        record.resume(path, {'budget': 4}, empty)
    files.write_json(path, [1])
    with pytest.raises(ValueError, match='holds something else'):
        record.resume(path, {'budget': 3}, empty)


def test_the_version_of_data_stands_with_their_cases():
    old = {'cases': {'train': [{'case': 1}]}}
    assert record.data_version(old) == record.data_version({}) == 1
    old['cases']['test'] = [{'case': 2, 'data_version': '2'}]
    assert record.data_version(old) == 2
    shipped = files.read_json(f'{record.ROOT}/datasets/wheel_v2/metadata.json')
    stored = files.read_json(f'{record.ROOT}/docs/protocol/wheel_v2.json')
    assert stored['data']['version'] == record.data_version(shipped) == 2
