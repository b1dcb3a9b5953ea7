"""A model of a tool of one's own: what is refused before any work, and the whole way on a coarse
grid, with a kill in between."""

import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import types

import pytest

from learning_to_simulate.soil_field import field
from mpm import batch, bodies, new_tool, scenes
from mpm.simulation import Settings
from tests.learning_to_simulate.native import worlds
from tests.mpm import small
from tests.pca_tools.commands import call_command

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCOOP = {
    'name': 'bucket', 'edge_radius': 0.004, 'width': 0.35,
    'outline': [[0, 0], [0.16, 0.01], [0.2, 0.06], [0.2, 0.17], [0.176, 0.17], [0.176, 0.07],
                [0.148, 0.036], [0.02, 0.018]],
}  # fmt: skip


def started(tool, out, *more, **options):
    command = [sys.executable, '-m', 'learning_to_simulate.cli', 'new-tool', str(tool)]
    return subprocess.Popen(
        [*command, f'--output_path={out}', *more], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
    )  # fmt: skip


@pytest.mark.parametrize(
    'changed, more, words',
    [
        ({'outline': [[0, 0], [0.1, 0.1], [0.1, 0], [0, 0.1]]}, {}, 'crosses itself'),
        ({'width': 1.19}, {}, 'does not fit|none of 200 motions'),
        (
            {'outline': [[0, 0], [0.1, -0.14], [0.12, -0.13], [0, 0.05]]}, {},
            "the outline of 'bucket' falls by 54.5 deg behind its edge",
        ),
        ({}, {'runs': 4, 'kept': 2}, 'none is left to learn from'),
        ({}, {'initial_weights': 'none_such'}, 'none_such: no folder with a config.json'),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_refused_before_any_work(tmp_path, changed, more, words):
    tool, asked = tmp_path / 'tool.json', {'runs': 24, 'kept': None, 'initial_weights': None} | more
    tool.write_text(json.dumps(SCOOP | changed))
    values = types.SimpleNamespace(output_path=str(tmp_path / 'out'), **asked)
    with pytest.raises(ValueError, match=words):
        new_tool.main(values, [str(tool)])
    assert not (tmp_path / 'out').exists()


def test_a_folder_belongs_to_one_tool(tmp_path):
    (tmp_path / 'raw').mkdir()
    asked = {'tool': SCOOP, 'runs': 4, 'learning_rate': 1e-3}
    new_tool.Work(str(tmp_path), asked)
    new_tool.Work(str(tmp_path), asked)
    with pytest.raises(ValueError, match='with another runs; give another'):
        new_tool.Work(str(tmp_path), asked | {'runs': 5})
    (tmp_path / 'other').mkdir()
    (tmp_path / 'other' / 'letter.txt').write_text('')
    with pytest.raises(ValueError, match='holds something else'):
        new_tool.Work(str(tmp_path / 'other'), asked)


def test_the_bin_fits_the_tool():
    tool = bodies.check_tool(SCOOP)
    cases = ['scoop_9000', 'smooth_9001']
    assert new_tool.planned(tool, 2)[1:] == ('scoop,smooth,scoop,lift,scoop,reverse', cases)
    plate = bodies.check_tool(SCOOP | {'outline': [[0, 0], [0, 0.2]]})
    assert new_tool.planned(plate, 1)[1:] == ('smooth,stops,reverse,lift', ['smooth_9000'])
    wide = bodies.check_tool(SCOOP | {'width': 0.55})
    assert new_tool.planned(wide, 1)[1:] == ('tools', ['tools_9000'])
    wheel = bodies.check_tool({'name': 'wheel', 'radius': 0.1, 'width': 0.1})
    assert new_tool.planned(wheel, 1)[0].name == 'wheel'


def test_the_last_line(tmp_path):
    work = new_tool.Work(str(tmp_path), {})
    work.state['seconds'] = {'a': 3600.0 * 2, 'b': 40 * 60.0}
    for name, soil, force in (('judged', 3.1, 0.16), ('judged_as_it_is', None, 0.3)):
        (tmp_path / name).mkdir()
        mean = {'mean': {'model': {'soil_mm': soil, 'force_relative_l2': force}}}
        (tmp_path / name / 'metrics.json').write_text(json.dumps(mean))
    assert new_tool.is_taken(work)
    assert new_tool.verdict(work, 4, '2 processes') == (
        'soil 3.10 mm, force 0.160 on 4 runs kept back; shipped model as it is: refused some of '
        'them; 2 h 40 min on 2 processes; no page'
    )
    for soil, force, taken in (
        (3.2, 0.17, True),
        (3.2, 0.15, False),
        (2.6, 0.5, True),
        (3.0, 0.16, False),
    ):
        mean['mean']['model'] = {'soil_mm': soil, 'force_relative_l2': force}
        (tmp_path / 'judged_as_it_is' / 'metrics.json').write_text(json.dumps(mean))
        assert new_tool.is_taken(work) == taken
    assert new_tool.verdict(work, 4, 'here').startswith(
        'shipped model as it is, soil 3.00 mm, force 0.160 on 4 runs kept back; trained, not '
        'taken: soil 3.10 mm, force 0.160; make more --runs; 2 h 40 min on here'
    )


@pytest.mark.parametrize('count, lost, goes_on', [(6, 1, True), (6, 2, False), (3, 1, False)])
def test_a_run_that_cannot_be_made_does_not_stop_all(tmp_path, monkeypatch, count, lost, goes_on):
    tool, steps = tmp_path / 'tool.json', {}
    tool.write_text(json.dumps(SCOOP))
    cases = new_tool.planned(bodies.check_tool(SCOOP), count)[2]
    manifest = {'runs': [{'case': case} for case in cases[: count - lost]]}
    monkeypatch.setattr(new_tool.raw_run, 'read_manifest', lambda folder: manifest)

    def do(self, step, module, *arguments):
        steps[module] = arguments
        raise ValueError(f'{step} failed')

    monkeypatch.setattr(new_tool.Work, 'do', do)
    asked = {
        'runs': count, 'kept': None, 'initial_weights': None, 'num_steps': 20, 'formats': ['c'],
        'learning_rate': 1e-3, 'num_processes': 2, 'cluster': '', 'output_path': tmp_path / 'out',
    }  # fmt: skip
    failed = '2 of 5, dataset failed' if goes_on else '1 of 5, runs of the solver failed'
    with pytest.raises(ValueError, match=failed):
        new_tool.main(types.SimpleNamespace(**asked), [str(tool)])
    if goes_on:
        assert {'--hold_out=scoop_9004', '--split=0.6,0.2,0.2'} <= set(steps['pca_tools.convert'])


@pytest.mark.slow
def test_from_an_outline_to_c_with_a_kill_in_between(tmp_path, monkeypatch, capsys):
    tool, out = tmp_path / 'scoop.json', tmp_path / 'out'
    tool.write_text(json.dumps(SCOOP))
    checked, count = bodies.check_tool(SCOOP), 3
    usual = str(tmp_path / 'usual')  # of few weights, in place of the shipped one
    os.makedirs(usual)
    field.save(usual, worlds.soil_field('blade'))
    # Short runs of a coarse grid count as made.
    cases = tuple(new_tool.planned(checked, count)[2])
    with monkeypatch.context() as patch:
        patch.setattr(scenes, 'FRAMES', 61)
        batch.generate(small.BLADE, cases, str(out / 'raw'), Settings(), tool=checked)
    first = started(tool, out, f'--runs={count}', '--num_steps=20', f'--initial_weights={usual}')
    while not (out / 'model').exists():  # it trains
        assert first.poll() is None, first.communicate()
        time.sleep(0.1)
    os.kill(first.pid, signal.SIGKILL)
    told = first.communicate()[0].splitlines()
    assert [line[4] for line in told if line.startswith('---')] == ['1', '2', '3']
    steps = []

    def do(self, step, module, *arguments):
        """The command, in this process. How a training goes on is seen in `test_method.py` of the
        soil field: here it is done."""
        steps.append(step)
        if step in ('1 of 5, runs of the solver', '3 of 5, training'):
            assert f'--- {step}: python -m {module} {" ".join(arguments)}' in told
        if step == '3 of 5, training':
            field.save(str(out / 'model'), worlds.soil_field('blade'))
            return
        done = call_command(module, *arguments)
        assert done.returncode == 0, done.stderr

    monkeypatch.setattr(new_tool.Work, 'do', do)
    asked = {
        'runs': count, 'kept': None, 'initial_weights': usual, 'num_steps': 20, 'formats': ['c'],
        'learning_rate': 1e-3, 'num_processes': 2, 'cluster': '', 'output_path': str(out),
    }  # fmt: skip
    new_tool.main(types.SimpleNamespace(**asked), [str(tool)])
    judged = [f'4 of 5, runs kept back, {name}' for name in ('judged', 'judged_as_it_is')]
    assert steps == ['1 of 5, runs of the solver', '3 of 5, training', *judged, '5 of 5, c']
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert re.match('(soil|shipped model as it is, soil) .* on 1 runs kept back; ', last)
    assert (out / 'c' / 'export.json').exists() and not (out / 'fmu').exists()
