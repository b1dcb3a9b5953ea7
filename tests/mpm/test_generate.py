"""What the flags of the command name, and what it refuses."""

import types

import pytest

from mpm import generate, scenes
from mpm.motions.recording import Recording
from tests.pca_tools.commands import call_command


def chosen(scene, **values):
    usual = {'cases': [], 'operator_seeds': None, 'kinds': None, 'path': [], 'tool': None}
    usual |= {'blade_width': 0.3, 'like_case': 122}
    return generate.chosen_runs(types.SimpleNamespace(scene=scene, **usual | values))


def test_flags_choose_cases_then_seeds_then_paths():
    seeds = {'operator_seeds': '9000-9001', 'kinds': 'press'}
    scene, runs, tool = chosen('excavation', cases=['lift_3', '22'], path=['a.csv'], **seeds)
    mine = Recording('a.csv', 122, 0.3)
    assert runs == (22, 'lift_0003', 'press_9000', 'press_9001', mine)
    assert scene is scenes.EXCAVATION and tool is None
    assert chosen('wheel')[1] == ()


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'scene': 'wheel', 'cases': ['some']}, "wheel has no run 'some'"),
        ({'scene': 'excavation', 'kinds': 'lift'}, 'give --operator_seeds'),
        ({'scene': 'wheel', 'tool': 'nothing.json'}, "No such file or directory: 'nothing.json'"),
    ],
)
def test_bad_choices_are_refused(values, words):
    with pytest.raises((ValueError, OSError), match=words):
        chosen(**values)


def test_command_ends_in_one_line(tmp_path):
    out = f'--output_path={tmp_path / "out"}'
    done = call_command('mpm.generate', '--scene=excavation', '--gravity=0', out)
    assert done.returncode == 1 and not list(tmp_path.iterdir())
    assert done.stderr.startswith('error: gravity is 0.0, must lie in')
