"""The demonstration: its table, and what it refuses."""

import pathlib

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
        (['--cases=lift_0001', '--scenes=wheel'], 'wheel has no run'),
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
