"""Pictures and the measured rows of the reductions."""

import json
import types

import numpy as np
import pytest

pytest.importorskip('matplotlib')

from pca_tools import convert, plot_modes
from pca_tools.raw_runs import RawRuns
from pca_tools.subspace import Subspace


@pytest.fixture(scope='module')
def space(excavation):
    return Subspace.load(f'{excavation}/subspace.npz')


def test_reductions_are_measured_on_held_out_runs(space, raw_excavation):
    runs = RawRuns(raw_excavation)
    stored, same, kernel, _ = plot_modes.compare_reductions(space, runs, max_rows=10**6)
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


def test_pictures_and_numbers(raw_excavation, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(plot_modes, 'KERNEL_ROWS', 200)
    convert.convert(raw_excavation, f'{tmp_path}/data', modes=1)
    values = types.SimpleNamespace(output_path=str(tmp_path), raw_path=raw_excavation)
    plot_modes.main(values, [f'{tmp_path}/data'])
    assert 'kernel PCA of the same (RBF 0.04, ridge 1)' in capsys.readouterr().out
    for name in ('energy_and_error.png', 'modes.png'):
        assert (tmp_path / name).read_bytes().startswith(b'\x89PNG')
    assert len(json.loads((tmp_path / 'modes.json').read_text())['reductions']) == 4
