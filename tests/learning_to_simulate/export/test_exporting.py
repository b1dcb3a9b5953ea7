"""Exported models: without the project's code they say what the source model says."""

import json
import subprocess
import sys
import types

import numpy as np
import pytest

from learning_to_simulate import registry, rollout
from learning_to_simulate.export import __main__ as command_of_export
from learning_to_simulate.export import exporting, step_functions
from pca_tools import subspace
from tests.learning_to_simulate import models, synthetic

N_STEP = 10
# Follows a recorded start by its own predictions, as a user without this project would.
PROGRAM = """
import json, sys
sys.modules.update(dict.fromkeys(
    ['learning_to_simulate', 'pca_tools', 'sonnet', 'graph_nets', 'tests']))
import numpy as np
import tensorflow as tf
model = tf.saved_model.load(sys.argv[1])
given, origin, forces = np.load(sys.argv[2]), np.array(json.load(open(sys.argv[3]))['origin']), []
history, coming, n = given['history'], given['coming'], given['coming'].shape[1]
offset, velocity = history[-1] - origin, np.diff(history, axis=0).swapaxes(0, 1)
before = history[-1, :n]
for body, context in zip(coming, given['context']):
    inputs = {'offset': offset, 'velocity': velocity, 'context': context,
              'rigid_offset': body - origin[:n], 'rigid_velocity': body - before}
    out = model.signatures['step'](**{k: tf.constant(v, tf.float32) for k, v in inputs.items()})
    offset, velocity, before = out['next_offset'], out['next_velocity'], body
    forces.append(out['force'])
position = offset.numpy() + origin
modes = tf.constant(position[n:], tf.float32)
particles = model.signatures['reconstruct'](modes=modes)['particles']
np.savez(sys.argv[4], position=position, forces=forces, particles=particles)
"""


@pytest.mark.xla
def test_saved_model_rolls_out_without_the_project(tmp_path):
    model_path, data = models.saved(tmp_path, motion='driven', context='changing')
    out = str(tmp_path / 'exported')
    description = exporting.export(model_path, data, out, 'savedmodel')
    assert set(description['signatures']) == {'step', 'reconstruct'}
    written = json.loads((tmp_path / 'exported' / 'export.json').read_text())
    assert written == json.loads(json.dumps(description))
    opened = registry.open_model(model_path, data, 'test')
    model, groups = opened.model, opened.groups
    group = groups[0].select(0)
    np.savez(
        tmp_path / 'given.npz',
        history=group.position[0, :6],
        coming=group.position[0, 6 : 6 + N_STEP, :4],
        context=group.context[0, 6 : 6 + N_STEP].astype(np.float32),
    )
    arguments = [out, 'given.npz', f'{out}/export.json', 'result.npz']
    subprocess.run([sys.executable, '-c', PROGRAM, *arguments], cwd=tmp_path, check=True)
    result = np.load(tmp_path / 'result.npz')
    expected = rollout.roll_out(rollout.RolloutFunction(model.simulator, model.layout(4)), group)
    # Float32 round-off over ten steps: 2e-8 of the modes' range measured, and 1e-6 of the force.
    scale = np.ptp(group.position[:, :, 4:])
    last = expected.position[0, N_STEP - 1]
    np.testing.assert_allclose(result['position'], last, atol=1e-6 * scale)
    force = expected.force[0, :N_STEP]
    np.testing.assert_allclose(result['forces'], force, atol=1e-4 * np.abs(force).max())
    space = subspace.Subspace.load(f'{data}/subspace.npz')
    np.testing.assert_allclose(result['particles'], space.decode(last[4:]), atol=3e-6)


def test_predicted_body_is_kept_rigid_in_a_saved_model_and_refused_elsewhere(tmp_path):
    model_path, data = models.saved(
        tmp_path, 'pcg_thesis', with_subspace=False, motion='predicted', rigid_counts=(6,)
    )
    description = exporting.export(model_path, data, str(tmp_path / 'exported'), 'savedmodel')
    assert set(description['signatures']) == {'step'}
    assert set(description['signatures']['step']['inputs']) == {'offset', 'velocity'}
    for kind in ('tflite', 'onnx'):
        with pytest.raises(ValueError, match='no eigenvalue solver'):
            exporting.export(model_path, data, str(tmp_path / kind), kind)
        assert not (tmp_path / kind).exists()


@pytest.mark.parametrize('kind, motion', [('tflite', 'driven'), ('onnx', 'prescribed')])
def test_litert_and_onnx_say_the_same(tmp_path, kind, motion):
    for package in ['ai_edge_litert'] if kind == 'tflite' else ['tf2onnx', 'onnxruntime']:
        pytest.importorskip(package, reason='extra deploy')
    model_path, data = models.saved(tmp_path, motion=motion)
    out = tmp_path / 'exported'
    description = exporting.export(model_path, data, str(out), kind)
    assert {f'step.{kind}', f'reconstruct.{kind}', 'sample.npz'} < {p.name for p in out.iterdir()}
    compared = description['compared']
    assert set(compared['relative_difference']) == {'modes', 'rigid', 'force'}
    assert max(compared['relative_difference'].values()) <= step_functions.TOLERANCE
    assert compared['calls'] == 8 and 0 < compared['particles_difference_m'] <= 2e-6
    assert len(description['origin']) == 4 + synthetic.N_MODES


def test_bad_input_leaves_nothing_behind(tmp_path, monkeypatch):
    model_path, data = models.saved(tmp_path)
    out = tmp_path / 'exported'
    for kind, package in (('onnx', 'tf2onnx'), ('tflite', 'ai_edge_litert.interpreter')):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ValueError, match='comes with the extra'):
            exporting.export(model_path, data, str(out), kind)
    monkeypatch.setattr(step_functions, 'TOLERANCE', 0.0)
    with pytest.raises(ValueError, match='differs from its source.*nothing was written'):
        exporting.export(model_path, data, str(out), 'savedmodel')
    assert not [p for p in tmp_path.iterdir() if 'exported' in p.name]
    out.mkdir()
    (out / 'mine').write_text('keep')
    with pytest.raises(ValueError, match='not empty'):
        exporting.export(model_path, data, str(out), 'tflite')


def test_the_command_takes_shipped_names(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(command_of_export, 'export', lambda *given: asked.extend(given))
    monkeypatch.setattr(command_of_export, 'summary', lambda *given: '')
    monkeypatch.chdir(tmp_path)
    names = dict(model_path='wheel', data_path='excavation_wide', output_path='c', n_tools=None)
    command_of_export.run(types.SimpleNamespace(format='c', **names))
    places = 'models/wheel/soil_field', 'datasets/excavation_wide'
    assert [path.endswith(place) for path, place in zip(asked, places, strict=False)] == [True] * 2
