"""A bounded part of `python -m reports kills`, in a process of its own: it forks before TensorFlow
computes anything."""

import json
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_kills_lose_nothing(tmp_path):
    tasks = 'training,conversion over an older dataset,results over older ones,solver runs'
    subprocess.run(
        [sys.executable, '-m', 'reports', 'kills', '--count=8', '--points=4',
         f'--tasks={tasks}', f'--output_path={tmp_path}'],
        cwd=ROOT, check=True,
    )  # fmt: skip
    found = json.loads((tmp_path / 'kills.json').read_text())
    assert found['losses'] == []
    for row in found['tasks'].values():
        assert row['points'] > 5 and (row['named'], row['random']) == (4, 2)


@pytest.mark.slow
def test_a_writer_that_is_not_whole_is_found(tmp_path):
    """The results written file by file, as before: a kill leaves a mixture."""
    code = """
import sys
from reports.attacks import kill_tasks, kills
def broken(folder):
    import os
    os.makedirs(f'{folder}/results', exist_ok=True)
    for name in 'ab':
        path = f'{folder}/results/{name}'
        if not os.path.exists(path):  # a half one is taken for whole
            with open(path, 'w') as file:
                file.write('x')
                file.flush()
                open(f'{folder}/results/c', 'w').close()
                file.write('y' * 100)
kill_tasks.TASKS = {'broken': kill_tasks.Task(broken, 'results')}
done = list(kills.run({'broken': 2}, 0))
assert len(done) > 4 and [point for *_, point, _ in done].count('') == 2
sys.exit(0 if any(lost for *_, lost in done) else 1)
"""
    subprocess.run([sys.executable, '-c', code], cwd=ROOT, check=True)
