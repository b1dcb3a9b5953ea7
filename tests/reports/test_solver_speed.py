"""Two checkouts in turns: the figures are those that the runs state."""

import json

import pytest

from reports import solver_speed

FAKE = """
import os, sys
import numpy as np
from true_mpm import raw_run, scenes
folder = sys.argv[-1].split('=')[1]
case = int(sys.argv[2].split('=')[1])
os.makedirs(folder, exist_ok=True)
ones = np.ones((2, 3), np.float32)
run = raw_run.RawRun(ones[:, None], ones[:, None], ones, {{'case': case, 'solver_cpu_s': {cpu}}})
raw_run.write_manifest(folder, scenes.EXCAVATION, [raw_run.write_run(folder, run)])
"""


@pytest.fixture
def checkout(tmp_path):
    """Makes a folder whose solver says that a run takes so many seconds."""

    def make(cpu):
        folder = tmp_path / f'checkout_{cpu}'
        (folder / 'mpm').mkdir(parents=True)
        (folder / 'mpm' / 'generate.py').write_text(FAKE.format(cpu=cpu))
        # The true package under another name, so that the fake one can write a run.
        (folder / 'true_mpm.py').write_text(
            'import sys, importlib\n'
            f'sys.path.insert(0, {solver_speed.record.ROOT!r})\n'
            'for name in [n for n in sys.modules if n == "mpm" or n.startswith("mpm.")]:\n'
            '    del sys.modules[name]\n'
            'raw_run = importlib.import_module("mpm.raw_run")\n'
            'scenes = importlib.import_module("mpm.scenes")\n'
        )
        return str(folder)

    return make


def test_ratio_is_that_of_the_seconds_both_state(checkout, tmp_path, monkeypatch):
    old, new = checkout(60.0), checkout(20.0)
    monkeypatch.setattr(solver_speed.record, 'ROOT', new)
    rows = solver_speed.measure(old, ['excavation:186'], repeats=2)
    assert rows == [
        {'scene': 'excavation', 'case': '186', 'other': [60.0, 60.0], 'this': [20.0, 20.0]}
    ]
    path = tmp_path / 'speed.json'
    path.write_text(json.dumps({'rows': rows}))
    assert solver_speed.table(str(path)).splitlines()[-1] == '| excavation 186 | 60 | 20 | 0.333 |'


def test_what_is_no_solver_is_named(checkout, tmp_path):
    with pytest.raises(ValueError, match='holds no solver'):
        solver_speed.measure(str(tmp_path), ['excavation:186'], 1)
    with pytest.raises(ValueError, match=r"cases \['186'\]: scene:case"):
        solver_speed.measure(checkout(1.0), ['186'], 1)
    broken = checkout(2.0)
    with open(f'{broken}/mpm/generate.py', 'w') as file:
        file.write('raise SystemExit("no soil today")')
    with pytest.raises(ValueError, match='ends with 1: no soil today'):
        solver_speed.measure(broken, ['excavation:186'], 1)
