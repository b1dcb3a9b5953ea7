"""The console command: help at once and without TensorFlow, errors in one form."""

import pathlib
import subprocess
import sys

import numpy as np
import pytest

from learning_to_simulate import cli
from learning_to_simulate.live import roll_out_path
from pca_tools import files

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Nothing in these runs may touch TensorFlow: the name leads nowhere.
_WITHOUT = (
    'import sys; sys.modules["tensorflow"] = None; sys.argv[0] = "lts"\n'
    'from learning_to_simulate import cli; cli.main()'
)


def lts(*arguments, without_tensorflow=True):
    command = ['-c', _WITHOUT] if without_tensorflow else ['-m', 'learning_to_simulate.cli']
    return subprocess.run(
        [sys.executable, *command, *arguments], cwd=ROOT, capture_output=True, text=True
    )


def test_commands_are_listed():
    done = lts()
    assert done.returncode == 0 and all(name in done.stdout for name in cli.COMMANDS)
    unknown = lts('dig')
    assert unknown.returncode == 1 and unknown.stderr.startswith("error: no command 'dig'")


@pytest.mark.parametrize('name', cli.COMMANDS)
def test_help_needs_no_tensorflow_and_ends_with_0(name):
    done = lts(name, '--help')
    assert done.returncode == 0, done.stderr
    assert '--' in done.stdout


@pytest.mark.parametrize('module', ['nri.simulate', 'nri.train', 'nri.export_edges'])
def test_help_of_nri_needs_no_tensorflow_and_ends_with_0(module):
    code = f'import sys; sys.modules["tensorflow"] = None; sys.argv[0] = {module!r}; import runpy; '
    code += f'runpy.run_module({module!r}, run_name="__main__")'
    done = subprocess.run(
        [sys.executable, '-c', code, '--help'], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert '_path' in done.stdout


def test_help_of_training_says_what_every_flag_means():
    text = lts('train', '--help').stdout
    for meaning in ('velocity_inputs (int)', 'plain MLP', 'Training steps in all'):
        assert meaning in ' '.join(text.split()), text
    module = subprocess.run(
        [sys.executable, '-m', 'learning_to_simulate.train', '--help'], cwd=ROOT,
        capture_output=True, text=True,
    )  # fmt: skip
    assert module.returncode == 0 and module.stdout


def test_stray_arguments_and_missing_things_are_one_line(tmp_path):
    done = lts('train', 'datasets/excavation', '--data_path=x', f'--model_path={tmp_path / "m"}')
    assert done.returncode == 1 and done.stderr.startswith('error: unexpected arguments')
    done = lts('train', '--data_path=datasets/excavation', f'--model_path={tmp_path / "m"}')
    assert done.returncode == 1 and 'tensorflow, which is not installed' in done.stderr
    assert 'Traceback' not in done.stderr and not (tmp_path / 'm').exists()
    done = lts('rollout', '--model=excavation', '--poses=none.csv', '--output_path=/tmp/x.npz')
    assert done.returncode == 1 and done.stderr == 'error: none.csv: no such file\n'


def test_output_is_tried_before_the_work(tmp_path):
    (tmp_path / 'file').write_text('')
    np.savetxt(tmp_path / 'path.csv', np.zeros((3, 7)), delimiter=',')
    target = tmp_path / 'file' / 'dig.npz'
    done = lts('rollout', '--model=excavation', f'--poses={tmp_path / "path.csv"}',
               f'--output_path={target}')  # fmt: skip
    assert done.returncode == 1 and 'cannot be written to' in done.stderr
    assert 'tensorflow' not in done.stderr
    done = lts('rollout', '--model=excavation', f'--poses={tmp_path / "path.csv"}',
               f'--output_path={tmp_path / "dig.npz"}', '--picture=dig.jpg')  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == 'error: dig.jpg: must end in .png, .gif or .mp4\n'


def test_rollout_of_a_file_of_poses(tmp_path):
    from learning_to_simulate.live import starts as starts_lib

    starts, _ = starts_lib.read('models/excavation/pcg')
    path = np.tile(starts.pose[0], (9, 1))
    path[:, 0] -= np.arange(9) * 5e-4
    np.savetxt(tmp_path / 'path.csv', path, delimiter=',', header='x,y,z,qw,qx,qy,qz')
    np.testing.assert_allclose(roll_out_path.read_poses(str(tmp_path / 'path.csv')), path)
    out = tmp_path / 'new' / 'dig.npz'
    done = lts('rollout', '--model=excavation', f'--poses={tmp_path / "path.csv"}',
               f'--output_path={out}', without_tensorflow=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == '' and '8 frames' in done.stdout and 'status ok' in done.stdout
    assert files.read_npz(str(out))['predicted_rollout'].shape == (8, 28, 3)
    (tmp_path / 'words.csv').write_text('left,right\n')
    with pytest.raises(ValueError, match='not a table of numbers'):
        roll_out_path.read_poses(str(tmp_path / 'words.csv'))
