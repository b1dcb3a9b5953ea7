"""A bounded part of `python -m reports kills`, in a process of its own: it forks before TensorFlow
computes anything. One task more than there are must lose something: results written file by file,
of which a kill leaves a mixture."""

import json
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
CODE = """
import os, sys, types
from reports.attacks import kill_tasks, kills
def broken(folder):
    os.makedirs(f'{folder}/results', exist_ok=True)
    for name in 'ab':
        path = f'{folder}/results/{name}'
        if not os.path.exists(path):  # a half one is taken for whole
            with open(path, 'w') as file:
                file.write('x')
                file.flush()
                open(f'{folder}/results/c', 'w').close()
                file.write('y' * 100)
kill_tasks.TASKS['broken'] = kill_tasks.Task(broken, 'results')
tasks = ['training', 'conversion over an older dataset', 'results over older ones', 'solver runs']
sys.exit(kills.main(types.SimpleNamespace(
    tasks=[*tasks, 'broken'], count=5, points=4, seed=0, output_path=sys.argv[1]), []))
"""


@pytest.mark.slow
def test_kills_lose_nothing_but_what_is_not_written_whole(tmp_path):
    done = subprocess.run(
        [sys.executable, '-c', CODE, str(tmp_path)], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stdout + done.stderr  # something was lost, of one task
    found = json.loads((tmp_path / 'kills.json').read_text())
    tasks = found['tasks']
    assert {loss['task'] for loss in found['losses']} == {'broken'}
    assert tasks['broken']['lost'] == len(found['losses']) > 0
    assert [(row['named'], row['random']) for row in tasks.values()] == [(4, 1)] * 5
    assert all(row['points'] > 5 for name, row in tasks.items() if name != 'broken')
