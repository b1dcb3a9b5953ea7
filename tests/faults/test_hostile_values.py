"""Values that a user gives or a scene has: terminal control, forces that never change."""

import dataclasses
import sys

import numpy as np
import pytest
from absl import flags, logging

from learning_to_simulate import command, metrics, normalization, presets, reading_utils
from pca_tools import dataset
from tests.learning_to_simulate import synthetic


def test_a_command_cannot_be_made_to_control_the_terminal(monkeypatch):
    def fail(_):
        raise ValueError('no scene named \x1b[2J\x07' + 'x' * 30_000)

    monkeypatch.setattr(sys, 'argv', ['command'])
    with pytest.raises(SystemExit) as ended:
        command.start(fail)
    text = ended.value.code
    assert text.startswith('error: no scene named \\x1b[2J\\x07xxx') and len(text) < 5000


@pytest.mark.parametrize(('argument', 'level'), [('', logging.WARNING), ('-v=0', logging.INFO)])
def test_a_command_leaves_out_the_remarks_of_libraries_unless_asked(monkeypatch, argument, level):
    found = []
    monkeypatch.setattr(sys, 'argv', ['command', argument][: 1 + bool(argument)])
    before = logging.get_verbosity()
    try:
        with pytest.raises(SystemExit):
            command.start(lambda _: found.append(logging.get_verbosity()))
    finally:
        flags.FLAGS['verbosity'].unparse()
        logging.set_verbosity(before)
    assert found == [level]


@pytest.mark.parametrize('value', [0.0, 7.25, 1e-12])
@pytest.mark.parametrize('preset', ['pcg', 'fcg_original'])
def test_constant_and_zero_forces_have_finite_statistics(tmp_path, value, preset):
    folder = synthetic.write_dataset(tmp_path)
    metadata = dataset.read_metadata(folder)
    metadata['rigid_body_force_mean'] = [value] * 3
    metadata['rigid_body_force_std'] = [value * 1e-16] * 3  # as sums of equal numbers leave it
    config = presets.make_config(preset, mode_edges=5)
    groups = reading_utils.read_groups(folder, 'train', metadata, **config.nodes)
    groups = [dataclasses.replace(g, force=np.full_like(g.force, value)) for g in groups]
    scene = reading_utils.read_scene(folder, metadata, groups, None)
    found = normalization.compute_statistics(groups, metadata, scene, config)
    np.testing.assert_allclose(found.force_std, 1.0)
    np.testing.assert_allclose(found.force_mean, value, rtol=1e-6)
    first = groups[0]
    force = first.force[:, 6:]
    errors = metrics.load_errors(force, force, (0, 1, 2))
    assert (errors['force_rmse'] == 0.0).all()
