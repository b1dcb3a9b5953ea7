"""What commands share."""

import pathlib
import subprocess
import sys

import pytest

from learning_to_simulate import command, presets

ROOT = pathlib.Path(__file__).resolve().parents[2]


def test_paths_are_given_by_name():
    found = command.named_paths('beside', ['a=x', 'b=y=z'], 'FOLDER')
    assert found == {'a': 'x', 'b': 'y=z'}
    for bad in (['a'], ['=x'], ['a='], ['a=x', 'a=y']):
        with pytest.raises(ValueError, match='--beside=.*NAME=FOLDER was expected'):
            command.named_paths('beside', bad, 'FOLDER')


def test_settings_by_name_have_their_type():
    types = presets.setting_types()
    found = command.settings(['modes=8', 'rate_scaled=false', 'noise_std=1e-3'], types)
    assert found == {'modes': 8, 'rate_scaled': False, 'noise_std': 1e-3}
    for item, words in (
        ('depth=3', 'names are .*latent_size'),
        ('modes', 'NAME=VALUE'),
        ('modes=few', 'of type int'),
        ('rate_scaled=maybe', 'of type bool'),
    ):
        with pytest.raises(ValueError, match=words):
            command.settings([item], types)
    with pytest.raises(ValueError, match='given twice'):
        command.settings(['modes=8', 'modes=9'], types)


def test_settings_come_from_a_file_a_flag_or_by_name(tmp_path):
    """A flag beats the file; a setting given twice, or unknown, is refused. Without TensorFlow."""
    model = 'models/excavation/mlp_driven/config.json'
    code = 'import sys; from absl import flags; from learning_to_simulate.train import _overrides; '
    code += 'flags.FLAGS(sys.argv); print(_overrides())'

    def overrides(*given):
        done = subprocess.run(
            [sys.executable, '-c', code, '--data_path=x', '--model_path=y', *given],
            cwd=ROOT, capture_output=True, text=True,
        )  # fmt: skip
        return done.stdout + done.stderr

    text = overrides(f'--config={model}', '--num_steps=7', '--set=hidden_layers=5')
    for found in ("'preset': 'mlp_driven'", "'num_steps': 7", "'copies': 8", "'hidden_layers': 5"):
        assert found in text
    assert 'by --modes and by --set' in overrides('--set=modes=3', '--modes=4')
    (tmp_path / 'own.json').write_text('{"depth": 3}')
    assert 'not a JSON object of settings' in overrides(f'--config={tmp_path / "own.json"}')
