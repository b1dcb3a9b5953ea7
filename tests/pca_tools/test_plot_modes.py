"""Pictures and numbers of a subspace."""

import json
import types

import numpy as np
import pytest

pytest.importorskip('matplotlib')

from pca_tools import convert, plot_modes
from pca_tools.subspace import Subspace


def test_pictures_and_numbers(raw_excavation, tmp_path, capsys):
    convert.convert(raw_excavation, f'{tmp_path}/data', modes=1)
    plot_modes.main(types.SimpleNamespace(output_path=str(tmp_path)), [f'{tmp_path}/data'])
    assert 'energy left out' in capsys.readouterr().out
    for name in ('energy_and_error.png', 'modes.png'):
        assert (tmp_path / name).read_bytes().startswith(b'\x89PNG')
    space = Subspace.load(f'{tmp_path}/data/subspace.npz')
    floors = json.loads((tmp_path / 'modes.json').read_text())['projection_floors']
    np.testing.assert_array_equal(floors, space.projection_floors)
