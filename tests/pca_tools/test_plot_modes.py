"""Pictures and the measured rows of the reductions."""

import json

import numpy as np
import pytest

pytest.importorskip('matplotlib')

from pca_tools import plot_modes
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import Subspace
from tests.pca_tools.commands import run_command


@pytest.fixture(scope='module')
def space(excavation):
    return Subspace.load(f'{excavation}/subspace.npz')


def test_reductions_are_measured_on_held_out_runs(space, raw_excavation):
    runs = RawRuns(raw_excavation)
    rows = plot_modes.compare_reductions(space, runs, 0.04, [1.0], max_rows=10**6)
    stored, same, kernel = rows
    training = [run.positions for run in runs if str(run.case) in space.runs]
    held_out = [run.positions for run in runs if str(run.case) not in space.runs]
    for parts, found in ((training, stored['train_mse']), (held_out, stored['test_mse'])):
        x = np.concatenate(parts)
        expected = np.mean((space.decode(space.encode(x)) - x) ** 2)
        assert found == pytest.approx(expected, rel=1e-6)
    # all frames were kept, so the PCA of them is the stored one
    assert same['train_mse'] == pytest.approx(stored['train_mse'], rel=1e-6)
    assert same['test_mse'] == pytest.approx(stored['test_mse'], rel=1e-3)
    # thesis 2.4.2: kernel PCA with a ridge pre-image reconstructs worse
    assert kernel['test_mse'] > 10 * stored['test_mse']


def test_both_kinds_of_runs_are_needed(space, raw_excavation, tmp_path):
    runs = RawRuns(raw_excavation)
    runs.cases = [int(case) for case in space.runs]
    runs._entries = runs._entries[: len(runs.cases)]
    with pytest.raises(ValueError, match='10 training and 0 held-out runs'):
        plot_modes.compare_reductions(space, runs, 0.04, [1.0], 100)


def test_command_line(excavation, raw_excavation, tmp_path):
    output = tmp_path / 'plots'
    arguments = ['pca_tools.plot_modes', excavation, f'--output_path={output}']
    done = run_command(*arguments, f'--raw_path={raw_excavation}', '--kernel_rows=200')
    assert done.returncode == 0, done.stderr
    assert 'kernel PCA of the same (RBF 0.04, ridge 1)' in done.stdout
    for name in ('energy_and_error.png', 'modes.png'):
        assert (output / name).read_bytes().startswith(b'\x89PNG')
    numbers = json.loads((output / 'modes.json').read_text())
    assert len(numbers['reductions']) == 4
    missing = run_command('pca_tools.plot_modes', str(tmp_path), f'--output_path={output}')
    assert missing.returncode == 1 and 'error: ' in missing.stderr
