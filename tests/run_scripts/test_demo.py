"""The demonstration: its table, and what it refuses."""

import pathlib
import types

import numpy as np
import pytest

from pca_tools import dataset
from run_scripts import demo
from tests.pca_tools.commands import call_command

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['--scenes=moon'], 'unknown scene'),
        (['--cases=1,2', '--scenes=wheel'], '2 cases for 1'),
        (['--cases=lift_0001', '--scenes=wheel'], 'wheel has no test run'),
    ],
)
def test_demo_refuses_bad_choices_before_it_simulates(tmp_path, arguments, message):
    done = call_command('run_scripts.demo', f'--output_path={tmp_path}', *arguments)
    assert done.returncode != 0 and message in done.stderr and 'Traceback' not in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('scene', sorted(demo.CASES))
def test_no_model_has_seen_the_runs_of_the_demo(scene):
    cases = dataset.read_metadata(str(ROOT / 'datasets' / scene))['cases']
    assert demo.CASES[scene] in [case['case'] for case in cases['test']]
    for preset in demo.MODELS:
        assert (ROOT / 'models' / scene / preset / 'config.json').exists()


def test_a_soil_field_is_timed_where_forces_are_largest(monkeypatch):
    """On a clock that each step turns on by a second, and particles by as much as the force."""
    force = np.zeros((100, 3))
    force[60:90, 0] = np.arange(30) + 1.0
    clock = [0.0]

    class Stepper:
        def start(self, pose):
            assert pose == 0

        def step(self, pose):
            self.pose = pose
            clock[0] += 1.0

        def particles(self):
            clock[0] += force[self.pose, 0]
            return np.zeros((7, 3))

    terrain = types.SimpleNamespace(clone=lambda: None)
    rollout = types.SimpleNamespace(force=force, pose=np.arange(100), before=terrain, tool=None)
    model = types.SimpleNamespace(stepper=lambda terrain, tool: Stepper())
    monkeypatch.setattr(demo.time, 'perf_counter', lambda: clock[0])
    steps, wholes, count = demo.field_steps(model, rollout)
    assert steps == [1.0] * demo.EVERY and count == 7
    assert sorted(wholes) == [1.0 + f for f in range(31 - demo.EVERY, 31)]
