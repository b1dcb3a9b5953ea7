"""The console command: help at once and without heavy packages, errors in one form."""

import pathlib
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from learning_to_simulate import cli
from learning_to_simulate.live import roll_out_path
from learning_to_simulate.live import starts as starts_lib
from pca_tools import files

ROOT = pathlib.Path(__file__).resolve().parents[2]
# What takes half a second and more to load.
HEAVY = 'tensorflow', 'keras', 'matplotlib', 'sklearn', 'scipy.interpolate', 'numba'
OTHERS = (
    'nri.simulate', 'nri.train', 'nri.export_edges', 'mpm.picture', 'mpm.record', 'mpm.verify',
    'mpm.verification.anchors',
)  # fmt: skip


def lts(*arguments, absent=('tensorflow',), module='learning_to_simulate.cli'):
    """Runs a command in which some packages look as if they were not installed."""
    code = (
        f'import runpy, sys; sys.modules.update(dict.fromkeys({absent!r}))\n'
        f'runpy.run_module({module!r}, run_name="__main__", alter_sys=True)'
    )
    return subprocess.run(
        [sys.executable, '-c', code, *arguments], cwd=ROOT, capture_output=True, text=True
    )


def test_commands_are_listed():
    done = lts()
    assert done.returncode == 0 and all(name in done.stdout for name in cli.COMMANDS)
    unknown = lts('dig')
    assert unknown.returncode == 1 and unknown.stderr.startswith("error: no command 'dig'")


@pytest.mark.parametrize('name', [*cli.COMMANDS, *OTHERS])
def test_help_waits_for_no_heavy_package_and_ends_with_0(name):
    if name in OTHERS:
        done = lts('--help', absent=HEAVY, module=name)
    else:
        done = lts(name, '--help', absent=HEAVY)
    assert done.returncode == 0 and '--' in done.stdout, done.stderr
    if name == 'train':
        for meaning in ('velocity_inputs (int)', 'plain MLP', 'Training steps in all'):
            assert meaning in ' '.join(done.stdout.split()), done.stdout


def test_errors_are_one_line_before_the_work(tmp_path):
    np.savetxt(tmp_path / 'path.csv', np.zeros((3, 7)), delimiter=',')
    (tmp_path / 'file').write_text('time_s,x_m,y_m,angle_deg\n')
    model, path = f'--model_path={tmp_path / "m"}', f'--poses={tmp_path / "path.csv"}'
    rollout, out = ('rollout', '--model=excavation'), f'--output_path={tmp_path}/dig.npz'
    for arguments, message in (
        (('train', 'datasets/excavation', '--data_path=x', model), 'unexpected arguments'),
        (('train', '--data_path=datasets/excavation', model), 'tensorflow, which is not installed'),
        ((*rollout, '--poses=none.csv', out), 'error: none.csv: no such file'),
        ((*rollout, f'--poses={tmp_path / "file"}', out), 'numbers without a header, a line a'),
        ((*rollout, path, f'--output_path={tmp_path}/file/dig.npz'), 'cannot be written to'),
        ((*rollout, path, out, '--picture=dig.jpg'), 'dig.jpg: must end in .png, .gif or .mp4'),
    ):
        done = lts(*arguments)
        assert done.returncode == 1 and message in done.stderr
        assert done.stderr.startswith('error: ') and done.stderr.count('\n') == 1
    assert {path.name for path in tmp_path.iterdir()} == {'path.csv', 'file'}


def test_rollout_of_a_file_of_poses(tmp_path, capsys):
    starts, _ = starts_lib.read('models/excavation/pcg')
    path = np.tile(starts.pose[0], (9, 1))
    path[:, 0] -= np.arange(9) * 5e-4
    named, out = str(tmp_path / 'path.csv'), tmp_path / 'new' / 'dig.npz'
    np.savetxt(named, path, delimiter=',', header='x,y,z,qw,qx,qy,qz')
    np.testing.assert_allclose(roll_out_path.read_poses(named), path)
    given = dict.fromkeys(('picture', 'terrain', 'tool', 'case'))
    given |= {'model': 'excavation/pcg', 'poses': named, 'output_path': str(out)}
    roll_out_path.run(SimpleNamespace(**given))
    said = capsys.readouterr().out
    assert '8 frames' in said and 'status ok' in said
    assert files.read_npz(str(out))['predicted_rollout'].shape == (8, 28, 3)
    with pytest.raises(ValueError, match='--terrain and --tool are for soil fields'):
        roll_out_path.run(SimpleNamespace(**given | {'terrain': 'ground.npz'}))
