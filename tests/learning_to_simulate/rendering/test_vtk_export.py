"""VTK files of a rollout, read back by hand."""

import base64
import os
import zlib
from xml.etree import ElementTree

import numpy as np
import pytest

from learning_to_simulate import render_rollout
from learning_to_simulate.rendering import rollout_frames, vtk_export
from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH
from tests.learning_to_simulate import synthetic_rollout
from tests.learning_to_simulate.synthetic_rollout import DT, N_RIGID


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """(rollout path, dataset folder, particles before any projection)."""
    return synthetic_rollout.write(str(tmp_path_factory.mktemp('rollout')), n_frames=60)


@pytest.fixture(scope='module')
def frames(made):
    return rollout_frames.load(*made[:2])


@pytest.fixture(scope='module')
def folder(made, tmp_path_factory):
    """VTK files of the rollout, every tenth frame."""
    output = str(tmp_path_factory.mktemp('vtk'))
    _, written = render_rollout.render(*made[:2], output, formats=['vtp'], step_stride=10)
    folder = os.path.join(output, 'rollout_test_0_vtk')
    assert written == [os.path.join(folder, f'{which}.pvd') for which in (TRUTH, PREDICTION)]
    return folder


def decoded(element):
    """An inline binary array of a `.vtp`, read by hand: header and zlib block, both base64."""
    text = element.text.strip()
    header = np.frombuffer(base64.b64decode(text[:24]), '<u4')  # 16 bytes are 24 characters
    blocks, size, last, packed = header
    assert (blocks, last) == (1, 0)
    data = zlib.decompress(base64.b64decode(text[24:]))
    assert len(data) == size and len(base64.b64decode(text[24:])) == packed
    kinds = {'Float32': '<f4', 'Float64': '<f8', 'Int32': '<i4'}
    values = np.frombuffer(data, kinds[element.get('type')])
    columns = int(element.get('NumberOfComponents'))
    return values.reshape(-1, columns) if columns > 1 else values


def test_collection_has_the_times(folder):
    sets = ElementTree.parse(os.path.join(folder, 'truth.pvd')).getroot().iter('DataSet')
    listed = [(float(entry.get('timestep')), entry.get('file')) for entry in sets]
    assert [name for _, name in listed] == [f'truth/{t:05d}.vtp' for t in range(6, 60, 10)]
    np.testing.assert_allclose([time for time, _ in listed], DT * np.arange(6, 60, 10))
    assert all(os.path.exists(os.path.join(folder, name)) for _, name in listed)


def test_arrays_read_by_hand(folder, frames):
    root = ElementTree.parse(os.path.join(folder, 'prediction', '00046.vtp')).getroot()
    assert root.get('type') == 'PolyData'
    piece = root.find('PolyData/Piece')
    count = N_RIGID + len(frames.start)
    assert piece.get('NumberOfPoints') == piece.get('NumberOfVerts') == str(count)
    points = decoded(piece.find('Points/DataArray'))
    soil = frames.soil[PREDICTION][40]
    # float32 in the file.
    np.testing.assert_allclose(points[N_RIGID:], soil, rtol=1e-6)
    np.testing.assert_allclose(points[:N_RIGID], frames.rigid[PREDICTION][46], rtol=1e-6)
    data = {e.get('Name'): decoded(e) for e in piece.find('PointData')}
    assert data.keys() == {'displacement', 'velocity', 'error', 'particle_type'}
    assert data['particle_type'].tolist() == [3] * N_RIGID + [6] * len(frames.start)
    way = soil - frames.start
    np.testing.assert_allclose(data['displacement'][N_RIGID:], way, atol=1e-7)
    velocity = (soil - frames.soil[PREDICTION][39]) / DT
    np.testing.assert_allclose(data['velocity'][N_RIGID:], velocity, atol=1e-6)
    error = soil - frames.soil[TRUTH][40]
    np.testing.assert_allclose(data['error'][N_RIGID:], error, atol=1e-7)
    verts = {e.get('Name'): decoded(e) for e in piece.find('Verts')}
    np.testing.assert_array_equal(verts['connectivity'], np.arange(count))
    np.testing.assert_array_equal(verts['offsets'], np.arange(1, count + 1))
    field = {e.get('Name'): decoded(e) for e in root.find('PolyData/FieldData')}
    np.testing.assert_allclose(field['time'], 46 * DT)
    np.testing.assert_allclose(field['force'][0], frames.force[PREDICTION][46])


def test_a_vtk_reader_agrees(folder, frames):
    pyvista = pytest.importorskip('pyvista')
    reader = pyvista.get_reader(os.path.join(folder, 'truth.pvd'))
    reader.set_active_time_value(reader.time_values[3])
    cloud = reader.read()[0]
    np.testing.assert_allclose(cloud.points[N_RIGID:], frames.soil[TRUTH][30], rtol=1e-6)
    np.testing.assert_allclose(cloud.field_data['force'][0], frames.force[TRUTH][36])


def test_refuses_arrays_that_do_not_fit(tmp_path):
    path = str(tmp_path / 'a.vtp')
    with pytest.raises(ValueError, match=r'points have shape \(4, 2\)'):
        vtk_export.write_points(path, np.zeros((4, 2)), {}, {})
    with pytest.raises(ValueError, match="'speed' has 3 values for 4 points"):
        vtk_export.write_points(path, np.zeros((4, 3)), {'speed': np.zeros(3)}, {})
    with pytest.raises(ValueError, match='has type complex128'):
        vtk_export.write_points(path, np.zeros((4, 3), complex), {}, {})
    assert not os.listdir(tmp_path)
