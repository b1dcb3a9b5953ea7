"""VTK files of a rollout, read back by hand."""

import os
from xml.etree import ElementTree

import numpy as np
import pytest

from learning_to_simulate import render_rollout
from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH
from pca_tools.formats import vtp_files
from tests.learning_to_simulate import synthetic_rollout
from tests.learning_to_simulate.synthetic_rollout import DT, N_RIGID
from tests.pca_tools.test_formats import vtk_array


def test_files_hold_the_rollout(tmp_path):
    """Every tenth frame, with its time; arrays of one of them."""
    made = synthetic_rollout.write(str(tmp_path))
    out = str(tmp_path / 'vtk')
    frames, written = render_rollout.render(*made, out, formats=['vtp'], step_stride=10)
    folder = os.path.join(out, 'rollout_test_0_vtk')
    assert written == [os.path.join(folder, f'{which}.pvd') for which in (TRUTH, PREDICTION)]
    sets = ElementTree.parse(os.path.join(folder, 'truth.pvd')).getroot().iter('DataSet')
    listed = [(float(entry.get('timestep')), entry.get('file')) for entry in sets]
    assert [name for _, name in listed] == [f'truth/{t:05d}.vtp' for t in range(6, 40, 10)]
    np.testing.assert_allclose([time for time, _ in listed], DT * np.arange(6, 40, 10))
    assert all(os.path.exists(os.path.join(folder, name)) for _, name in listed)

    root = ElementTree.parse(os.path.join(folder, 'prediction', '00026.vtp')).getroot()
    assert root.get('type') == 'PolyData'
    piece = root.find('PolyData/Piece')
    count = N_RIGID + len(frames.start)
    assert piece.get('NumberOfPoints') == piece.get('NumberOfVerts') == str(count)
    points, soil = vtk_array(piece.find('Points/DataArray')), frames.soil[PREDICTION][20]
    np.testing.assert_allclose(points[N_RIGID:], soil, rtol=1e-6)  # float32 in the file
    np.testing.assert_allclose(points[:N_RIGID], frames.rigid[PREDICTION][26], rtol=1e-6)
    data = {e.get('Name'): vtk_array(e) for e in piece.find('PointData')}
    assert data['particle_type'].tolist() == [3] * N_RIGID + [6] * len(frames.start)
    expected = {
        'displacement': soil - frames.start,
        'velocity': (soil - frames.soil[PREDICTION][19]) / DT,
        'error': soil - frames.soil[TRUTH][20],
    }
    assert data.keys() == expected.keys() | {'particle_type'}
    for name, values in expected.items():
        np.testing.assert_allclose(data[name][N_RIGID:], values, atol=1e-6)
    verts = {e.get('Name'): vtk_array(e) for e in piece.find('Verts')}
    np.testing.assert_array_equal(verts['connectivity'], np.arange(count))
    np.testing.assert_array_equal(verts['offsets'], np.arange(1, count + 1))
    field = {e.get('Name'): vtk_array(e) for e in root.find('PolyData/FieldData')}
    np.testing.assert_allclose(field['time'], 26 * DT)
    np.testing.assert_allclose(field['force'][0], frames.force[PREDICTION][26])


@pytest.mark.parametrize(
    'points, data, message',
    [
        (np.zeros((4, 2)), {}, r'points have shape \(4, 2\)'),
        (np.zeros((4, 3)), {'speed': np.zeros(3)}, "'speed' has 3 values for 4 points"),
        (np.zeros((4, 3), complex), {}, 'has type complex128'),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, points, data, message):
    with pytest.raises(ValueError, match=message):
        vtp_files.write_points(str(tmp_path / 'a.vtp'), points, data, {})
    assert not os.listdir(tmp_path)
