"""Where a number comes from."""

import subprocess
import sys

from reports import record


def test_provenance_names_command_commit_and_machine(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, 'argv', ['/somewhere/report.py', '--rounds=3'])
    found = record.provenance(2)
    assert found['command'].startswith('python -m ') and found['command'].endswith(' --rounds=3')
    assert found['machine']['threads'] == 2 and found['machine']['cores'] >= 1
    head = ['git', '-C', record.ROOT, 'rev-parse', 'HEAD']
    done = subprocess.run(head, capture_output=True, text=True)
    if done.returncode == 0:
        assert done.stdout.startswith(found['commit'].rstrip('+'))
    monkeypatch.setattr(record, 'ROOT', str(tmp_path))
    monkeypatch.setenv('GIT_CEILING_DIRECTORIES', str(tmp_path))
    assert record.provenance()['commit'] is None  # outside a checkout
