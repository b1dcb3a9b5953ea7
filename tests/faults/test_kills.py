"""Kills in a process of their own: it forks before TensorFlow computes anything. One task more than
there are must lose something: results written file by file, of which a kill leaves a mixture.

KILLS in the environment is the number of kills at random moments and at named points of each task,
for a long run.
"""

import collections
import json
import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
CODE = """
import json, os, sys
from tests.faults import kills
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
tasks = ['training', 'conversion over an older dataset', 'results over older ones', 'solver runs']
moments, points = map(int, sys.argv[2:])
if moments > 1:
    tasks = list(kills.TASKS)
kills.TASKS['broken'] = kills.Task(broken, 'results')
with open(sys.argv[1], 'w') as file:
    json.dump(list(kills.run(dict.fromkeys([*tasks, 'broken'], moments), 0, points)), file)
"""


@pytest.mark.slow
def test_kills_lose_nothing_but_what_is_not_written_whole(tmp_path):
    many = int(os.environ.get('KILLS', '0'))
    moments, points = (many, many) if many else (1, 3)
    done = subprocess.run(
        [sys.executable, '-c', CODE, str(tmp_path / 'kills.json'), str(moments), str(points)],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / 'kills.json').read_text())
    losses = collections.Counter(task for task, *_, lost in found if lost)
    assert losses.keys() == {'broken'}, [row for row in found if row[-1]]
    counts = collections.Counter((task, bool(point)) for task, _, point, _ in found)
    for task, n_points, _, _ in found:
        assert counts[task, False] == moments and counts[task, True] == min(points, n_points)
        assert n_points > 5 or task == 'broken'
