"""Exported swept fields on disk: each format follows a recorded run as its source does."""

import json
import os
import pathlib
import re

import numpy as np
import pytest
import tensorflow as tf
from learning_to_simulate.methods.swept_field import model_files

from learning_to_simulate.export import __main__ as command
from learning_to_simulate.export import export_formats, exporting, field_exporting
from learning_to_simulate.export.field_functions import FORMS
from learning_to_simulate.export.field_state import STATUS
from learning_to_simulate.live import resting_start
from tests.learning_to_simulate.swept_field import small_wheel
from tests.learning_to_simulate.swept_field import small_world as world

ROOT = pathlib.Path(__file__).resolve().parents[3]
WORLDS = {'blade': world, 'wheel': small_wheel}
DEPTHS = {
    'blade': [(0.03, 'train'), (0.045, 'train'), (0.04, 'valid'), (0.05, 'test')],
    'wheel': [(0.004, 'train'), (0.008, 'train'), (0.006, 'valid'), (0.007, 'test')],
}


def save(folder, field, data):
    """A model folder without any training."""
    folder.mkdir()
    written = resting_start.write(str(folder), str(data), {})
    model_files.save(str(folder), field, {}, written)
    return str(folder)


@pytest.fixture(scope='module')
def models(tmp_path_factory):
    """Name of a tool -> an untrained model and its data."""
    found = {}
    for name, small in WORLDS.items():
        folder = tmp_path_factory.mktemp(name)
        small.write_dataset(folder, DEPTHS[name])
        field = small.make_field(members=2)
        field.calibration = {'force': [1.5, 2.0, 0.1]}
        found[name] = save(folder / 'model', field, folder / 'data'), str(folder / 'data')
    return found


@pytest.fixture
def paths(models):
    return models['blade']


@pytest.fixture(
    scope='module', params=[(k, n) for k in exporting.FORMATS for n in WORLDS], ids='-'.join
)
def exported(request, models, tmp_path_factory):
    """A format, a tool, the folder that was written and its description."""
    kind, tool = request.param
    if kind == 'onnx':
        pytest.importorskip('tf2onnx', reason='extra deploy')
        pytest.importorskip('onnxruntime', reason='extra deploy')
    out = tmp_path_factory.mktemp(kind) / 'field'
    return kind, tool, out, exporting.export(*models[tool], str(out), kind, n_particles=300)


def test_each_format_follows_a_recorded_run(exported):
    kind, tool, out, description = exported
    form, grid = FORMS[tool], WORLDS[tool].GRID
    written = json.loads((out / 'export.json').read_text())
    assert written == json.loads(json.dumps(description))
    compared = written['compared']
    assert compared['steps'] == 60
    # Measured 5e-6 and 5e-7 m.
    assert max(compared['relative_difference'].values()) < 5e-5
    assert compared['particles_difference_m'] < 5e-6
    step = written['signatures']['step']
    assert step['inputs']['bins'][:2] == [[len(form.bins), len(grid.offsets)], 'float32']
    assert step['outputs']['next_tool'][0] == [len(written['state_tool'])]
    assert written['status'] == STATUS and written['members'] == 2
    assert len(written['bin_offsets']) == len(grid.offsets)
    assert ('height' in step['outputs']) == (tool == 'wheel')
    if kind != 'savedmodel':
        assert set(os.listdir(out)) == {
            'export.json', 'bed.npz', *(f'{n}.{kind}' for n in ('start', 'step', 'particles')),
        }  # fmt: skip
    bed = np.load(out / 'bed.npz')
    given = {*written['signatures']['start']['inputs'], 'rest'}
    assert set(bed.files) == given and bed['rest'].shape == (300, 3)
    summary = command.summary(description, str(out))
    assert 'signatures start, step, particles' in summary and 'particles: largest' in summary


@pytest.mark.parametrize('exported', [('onnx', name) for name in WORLDS], indirect=True)
def test_lines_of_the_document_run(exported, monkeypatch):
    _, tool, out, _ = exported
    text = (ROOT / 'docs' / 'swept_field.md').read_text(encoding='utf-8')
    monkeypatch.chdir(out.parent)
    values: dict = {}
    exec(re.findall(r'```python\n(.*?)```', text, re.S)[tool == 'wheel'], values)
    assert values['status'] == STATUS['ok'] and np.abs(values['force']).max() > 1
    moved = np.abs(values['points'] - values['rest']).max(axis=1)
    assert moved.max() > 1e-3 and (moved == 0).any()


def called(functions):
    return {
        name: lambda function=function, **inputs: function(
            **{k: tf.constant(v, tf.float32) for k, v in inputs.items()}
        )
        for name, function in functions.items()
    }


def test_bad_input_leaves_nothing_behind(paths, tmp_path, monkeypatch):
    out = tmp_path / 'field'
    with pytest.raises(ValueError, match='n_rigid is 4: a swept field has no rigid nodes'):
        exporting.export(*paths, str(out), 'tflite', n_rigid=4)
    with pytest.raises(ValueError, match=r'members is 9, must lie in \[1, 2\]'):
        exporting.export(*paths, str(out), 'tflite', members=9)
    # A format that a file of it need not be written for.
    monkeypatch.setitem(export_formats.WRITERS, 'tflite', lambda given, *_: lambda: called(given))
    monkeypatch.setattr(field_exporting, 'TOLERANCE', 0.0)
    with pytest.raises(ValueError, match='differs from its source.*nothing was written'):
        exporting.export(*paths, str(out), 'tflite', n_particles=10)
    assert not list(tmp_path.iterdir())


def test_a_frame_that_one_judges_otherwise_is_an_error(paths):
    functions, _ = field_exporting.open_field(*paths)
    live = world.make_live(functions.field)
    state = {'bins': 0, 'tool': 0}
    loaded = {
        'start': lambda **_: state,
        'step': lambda **_: {f'next_{n}': 0 for n in state} | {'status': STATUS['refused']},
    }
    poses = world.world_pose(world.path()[:, 0])
    with pytest.raises(ValueError, match="frame 1 is 'refused' in the exported model and 'ok' in"):
        field_exporting.compare(functions, loaded, live, poses, {'bed': functions.field.rest})
