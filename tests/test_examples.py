"""What the documents show runs as it is written."""

import functools
import importlib
import json
import pathlib
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import learning_to_simulate as lts
from learning_to_simulate import api, evaluation, render_rollout
from learning_to_simulate.soil_field.evaluation import SoilEvaluator

ROOT = pathlib.Path(__file__).resolve().parents[1]


def _example(name):
    return importlib.import_module(f'examples.{name}')


def run_lines(page, block=0):
    """Runs a block of Python on a page as it is written; returns its names and their values."""
    text, values = (ROOT / page).read_text(encoding='utf-8'), {}
    exec(re.findall(r'```python\n(.*?)```', text, re.S)[block], values)
    return values


def test_ten_trenches_keep_their_volume(tmp_path, capsys):
    pytest.importorskip('matplotlib')
    rollout = _example('trenches').main(str(tmp_path / 'trenches.png'))
    change = rollout.heights[-1].astype(float) - rollout.heights[0]
    cut, heap = -change[change < 0].sum(), change[change > 0].sum()
    assert rollout.status == 'ok' and heap == pytest.approx(cut, rel=0.05)
    # Nine trenches lie beside an earlier one and ask for one force.
    largest = [np.abs(part[:, 0]).max() for part in np.array_split(rollout.force, 10)]
    np.testing.assert_allclose(largest[2:], largest[1], rtol=0.02)
    assert 'ok' in capsys.readouterr().out and (tmp_path / 'trenches.png').exists()


def test_lines_of_the_python_page(tmp_path, monkeypatch):
    """As written, but for the length of the training and the numbers of judged runs and of frames
    in the film."""
    pytest.importorskip('matplotlib')
    monkeypatch.chdir(tmp_path)
    preset, soil, subspace = api.preset, SoilEvaluator.run, evaluation.Evaluator.run
    monkeypatch.setattr(SoilEvaluator, 'run', lambda self, runs, *x: soil(self, runs[:3], *x))
    monkeypatch.setattr(
        evaluation.Evaluator,
        'run',
        lambda self, groups, *x: subspace(self, [groups[0].select(0)], *x),
    )
    few = functools.partial(render_rollout.draw_terrain, step_stride=40)
    monkeypatch.setattr(render_rollout, 'draw_terrain', few)
    short = {'num_steps': 2, 'unroll_steps': 0}
    monkeypatch.setattr(api, 'preset', lambda name, **fields: preset(name, **fields | short))
    assert lts.preset('pcg').num_steps == 2
    values = run_lines('docs/python.md')
    assert values['frame'].status == values['rollout'].status == 'ok'
    assert values['recorded'].run is not None
    assert {p.name for p in tmp_path.iterdir()} == {'dig.gif', 'dig.npz', 'my_model'}
    assert lts.load('my_model').config.latent_size == 32


def test_lines_of_the_front_page():
    values = run_lines('README.md')
    assert values['frame'].status == 'ok' and values['frame'].force[0] > 0


def test_wrench_with_z_up_is_that_about_the_centre_of_mass():
    """The code of the page on axes, against the formula in the axes of this project."""
    values = run_lines('docs/axes.md')
    turn, (place, centre) = values['TO_Z_UP'], np.random.default_rng(0).normal(size=(2, 3))
    rotation = Rotation.from_euler('z', -20, degrees=True)
    w_last = rotation.as_quat()
    pose = np.array([*place, w_last[3], *w_last[:3]])
    z_up = Rotation.from_matrix(turn @ rotation.as_matrix() @ turn.T).as_quat()
    taken = values['pose_from_z_up'](turn @ place, np.array([z_up[3], *z_up[:3]]))
    np.testing.assert_allclose(taken, pose, atol=1e-15)
    frame = SimpleNamespace(force=np.array([100.0, 50.0, 0.0]), torque=np.array([0, 0, 5.0]))
    frame.pose = pose
    force, torque = values['wrench_to_z_up'](frame, turn @ centre)
    np.testing.assert_allclose(turn.T @ force, frame.force)
    moved = frame.torque + np.cross(place - centre, frame.force)
    np.testing.assert_allclose(turn.T @ torque, moved, atol=1e-12)


def test_lines_of_the_mujoco_page():
    pytest.importorskip('mujoco')
    values = run_lines('docs/mujoco.md')
    assert values['soil'].judgement.status == 'ok'
    assert values['ground'].heights.min() < 0.249 < 0.25 < values['ground'].heights.max()


@pytest.mark.slow
def test_excavator_through_its_cycle(tmp_path, monkeypatch):
    """The cut meets soil that holds it back, and leaves a trench; what the bucket lifts weighs on
    it and lies on a heap in the end; a film is drawn of it."""
    pytest.importorskip('mujoco')
    example, film = _example('excavator'), tmp_path / 'dig.mp4'
    monkeypatch.setattr(sys.modules['film'], 'FPS', 1)
    ground, _, rows = example.main(str(film), 11.5)
    time, force, flagged = rows[:, 0], rows[:, 4:7], rows[:, -1]
    cut, out = (time > 2.5) & (time < 5.5), (time < 0.5) | (time > 10.8)
    assert force[cut, 0].mean() > 50.0 and not force[out].any()
    held = (time > 8.4) & (time < 9.5)
    assert not force[held][:, [0, 2]].any() and -90.0 < force[held, 1].mean() < -25.0
    x, z = ground.middles
    heap = np.maximum(ground.heights, 0.0)[np.hypot(x[:, None] - 0.75, z + 1.45) < 0.3].sum()
    weight = heap * np.prod(ground.cell) * ground.soil.density * ground.soil.gravity
    assert weight == pytest.approx(-force[held, 1].mean(), rel=0.1)
    assert flagged.mean() < 0.05 and not flagged[time < 3.4].any()
    assert rows[cut, 2].min() < -0.035 and (ground.heights < -0.03).sum() > 100
    assert film.stat().st_size > 10_000


def test_rover():
    """The first second: it stands on its weight, then drives on."""
    pytest.importorskip('mujoco')
    example = _example('rover')
    _, _, rows = example.main(seconds=1.0)
    assert rows[-1, 1] < -0.03 and abs(rows[-1, 2]) < 0.3
    assert 0.0 < rows[-1, 5] < 0.01
    assert example.drawn_plan(4.0 + 1.5) == (1, 7.0)


@pytest.mark.slow
def test_data_of_ones_own(tmp_path, capsys):
    settings = {'num_steps': 4, 'unroll_steps': 0, 'latent_size': 8}
    errors = _example('your_own_data').main(str(tmp_path / 'own'), **settings)
    assert errors.summary['mean']['model']['soil_mse'] > 0
    assert 'soil within the subspace, mean square' in capsys.readouterr().out


@pytest.mark.slow
def test_cells_of_the_tutorial_run_in_order():
    pytest.importorskip('matplotlib').use('agg')
    path = ROOT / 'examples' / 'tutorial.ipynb'
    cells = json.loads(path.read_text(encoding='utf-8'))['cells']
    values = {}
    for number, cell in enumerate(cells):
        if cell['cell_type'] == 'code':
            exec(compile(''.join(cell['source']), f'cell {number}', 'exec'), values)
            assert not cell['outputs'], 'is committed without outputs'
    assert set(values['states']) == {'ok'} and values['outside'].status != 'ok'
    assert values['rollout'].force.shape == (150, 3)
    assert values['error'] < 0.2 < values['held']


def test_a_machine_of_ones_own_by_the_lines_of_the_front_page(tmp_path, monkeypatch):
    """A slide with a plate on it, let down to the soil and pushed along."""
    pytest.importorskip('mujoco')
    slide = """<mujoco><option timestep="0.001"/><worldbody><body pos="2 -0.5 0.27">
      <joint type="slide" axis="1 0 0" damping="200"/>
      <joint type="slide" axis="0 0 1" damping="20"/>
      <geom type="box" size=".01 .2 .14" pos="0 0 .14" mass="20" contype="0" conaffinity="0"/>
      <site name="edge"/></body></worldbody></mujoco>"""
    (tmp_path / 'machine.xml').write_text(slide, encoding='utf-8')
    monkeypatch.chdir(tmp_path)
    values = run_lines('README.md', 1)
    assert values['soil'].judgement.status == 'ok'
    lowest = values['data'].xpos[1, 2] - lts.Blade().radius
    assert 0.23 < lowest < 0.249  # it stands in the soil
    assert values['frames']['edge'].force[1] == pytest.approx(20 * 9.81, rel=0.05)
