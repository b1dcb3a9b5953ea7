"""The exported networks of a swept field say what the field says, in each format."""

import json
import os
import pathlib
import re

import numpy as np
import pytest
import tensorflow as tf

from learning_to_simulate.export import export_formats, exporting
from learning_to_simulate.live import starts
from learning_to_simulate.swept_field import field as field_lib
from tests.learning_to_simulate.swept_field import small_wheel
from tests.learning_to_simulate.swept_field import small_world as world

ROOT = pathlib.Path(__file__).resolve().parents[3]
WORLDS = {'blade': world, 'wheel': small_wheel}
DEPTHS = {
    'blade': [(0.03, 'train'), (0.045, 'train'), (0.04, 'valid'), (0.05, 'test')],
    'wheel': [(0.004, 'train'), (0.008, 'train'), (0.006, 'valid'), (0.007, 'test')],
}


@pytest.fixture(scope='module')
def models(tmp_path_factory):
    """Name of a tool -> an untrained model and its data."""
    found = {}
    for name, small in WORLDS.items():
        folder = tmp_path_factory.mktemp(name)
        small.write_dataset(folder, DEPTHS[name])
        (folder / 'model').mkdir()
        paths = str(folder / 'model'), str(folder / 'data')
        written = starts.write(*paths, {})
        field_lib.save(paths[0], small.make_field(members=2), {}, written)
        found[name] = paths
    return found


@pytest.mark.parametrize('tool', WORLDS)
@pytest.mark.parametrize('kind', ['savedmodel', 'tflite', 'onnx'])
def test_each_format_says_what_the_field_says(models, kind, tool, tmp_path, monkeypatch):
    if kind == 'onnx':
        pytest.importorskip('tf2onnx', reason='extra deploy')
        pytest.importorskip('onnxruntime', reason='extra deploy')
    out = tmp_path / 'field'
    description = exporting.export(*models[tool], str(out), kind, n_particles=300)
    written = json.loads((out / 'export.json').read_text())
    assert written == json.loads(json.dumps(description))
    compared, signatures = description['compared'], written['signatures']
    assert compared['calls'] == 8 and max(compared['relative_difference'].values()) < 2e-5
    assert ('height' in compared['relative_difference']) == (tool == 'wheel')
    sample = np.load(out / 'sample.npz')
    for function in ('load', 'soil'):
        for side in ('inputs', 'outputs'):
            for name, (shape, _, meaning) in signatures[function][side].items():
                assert list(sample[name].shape) == [8, *shape] and meaning
    assert len(written['bin_channels']) == sample['bins'].shape[-1]
    assert len(written['scalars']) == sample['scalars'].shape[-1]
    assert sample['rest'].shape == (8, 300, 3)
    assert sample['loads'].shape == (8, 2, len(written['load_columns']))
    assert np.abs(sample['displacement']).max() > 1e-3
    assert 'signatures load, soil' in exporting.summary(description, str(out))
    if kind != 'savedmodel':
        expected = {'export.json', 'sample.npz', f'load.{kind}', f'soil.{kind}'}
        assert set(os.listdir(out)) == expected
    if kind == 'onnx':  # the lines of the document run on it
        text = (ROOT / 'docs' / 'native.md').read_text(encoding='utf-8')
        monkeypatch.chdir(tmp_path)
        values: dict = {}
        (block,) = re.findall(r'```python\n(import numpy.*?)```', text, re.S)
        exec(block.replace('networks/', 'field/'), values)
        np.testing.assert_allclose(values['moved'], sample['displacement'][-1], atol=1e-6)


def test_bad_input_leaves_nothing_behind(models, tmp_path, monkeypatch):
    paths, out = models['blade'], str(tmp_path / 'field')
    with pytest.raises(ValueError, match='n_rigid is 4: a swept field has no rigid nodes'):
        exporting.export(*paths, out, 'tflite', n_rigid=4)
    with pytest.raises(ValueError, match=r'n_particles is 0, must lie in \[1, '):
        exporting.export(*paths, out, 'tflite', n_particles=0)

    def wrong(functions, *_):
        """A format whose loads are 1 % off."""

        def call(name, **inputs):
            found = functions[name](**{k: tf.constant(v) for k, v in inputs.items()})
            return {k: (1.01 if k == 'loads' else 1.0) * v for k, v in found.items()}

        return lambda: {name: lambda name=name, **x: call(name, **x) for name in functions}

    monkeypatch.setitem(export_formats.WRITERS, 'tflite', wrong)
    with pytest.raises(ValueError, match='differs from its source.*nothing was written'):
        exporting.export(*paths, out, 'tflite', n_particles=10)
    monkeypatch.setattr(exporting, 'TOLERANCE', 0.02)
    exporting.export(*paths, out, 'tflite', n_particles=10)
