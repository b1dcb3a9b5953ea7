"""What we export, read by a client that knows the format and nothing of us: every bit is there.

DeepMind's records and LagrangeBench's files have their clients in `test_formats`.
"""

import base64
import pathlib
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
import zlib

import h5py
import numpy as np
import pytest

from pca_tools.export_data import export_data, full_space_of

# Pickles stay out of this process.
GEOELEMENTS = """
import sys
import numpy as np
held = np.load(sys.argv[1], allow_pickle=True)['gns_data']
names = 'positions', 'types'
arrays = {f'{n}_{i}': v for i, run in enumerate(held) for n, v in zip(names, run, strict=True)}
np.savez(sys.argv[2], **arrays)
"""
VTK_TYPES = {'Float32': '<f4', 'Float64': '<f8', 'Int32': '<i4'}


def vtk_array(element):
    """A DataArray of one compressed block, by the rules of VTK's XML formats: its text is base64 of
    four UInt32 (blocks, size, size of a shorter last one, packed size), then of zlib's bytes."""
    text = element.text.strip()
    blocks, size, shorter, packed = np.frombuffer(base64.b64decode(text[:24])[:16], '<u4')
    data = zlib.decompress(base64.b64decode(text[24:]))
    assert (blocks, shorter, len(data)) == (1, 0, size) and packed <= len(text)
    values = np.frombuffer(data, VTK_TYPES[element.get('type')])
    components = int(element.get('NumberOfComponents', 1))
    return values if components == 1 else values.reshape(-1, components)


def of_vtp(folder, name):
    """As ParaView: the files that the .pvd lists, by their times."""
    positions, types, forces = [], None, []
    for listed in ElementTree.parse(folder / f'{name}.pvd').iter('DataSet'):
        root = ElementTree.parse(folder / listed.get('file')).getroot()
        arrays = {e.get('Name'): vtk_array(e) for e in root.iter('DataArray')}
        positions.append(arrays['Points'])
        types = arrays['particle_type']
        forces.append(arrays['force'][0])
        assert float(listed.get('timestep')) == pytest.approx(float(arrays['time'][0]), abs=1e-6)
    return np.stack(positions), types == 3, np.stack(forces)


def of_mpm_ngf(folder, name):
    """As the authors' scripts: five columns of a csv without header, the force in the first row."""
    frames = sorted((folder / name / 'frames').iterdir())
    rows = np.stack([np.loadtxt(path, delimiter=',')[:, :5] for path in frames])
    rows = rows.astype(np.float32)
    return rows[:, 1:, 1:4], rows[0, 1:, 0] == 1, rows[:, 0, :3]


def of_npz(folder, name):
    """As anyone: plain arrays, no pickles."""
    with np.load(folder / f'{name}.npz', allow_pickle=False) as arrays:
        return arrays['positions'], arrays['particle_type'] == 3, arrays['force']


@pytest.mark.parametrize('name', ['vtp', 'mpm_ngf', 'npz'])
def test_formats_that_name_their_runs(excavation, raw_excavation, tmp_path, name):
    out = tmp_path / name
    export_data(excavation, str(out), name, raw_path=raw_excavation)
    read = {'vtp': of_vtp, 'mpm_ngf': of_mpm_ngf, 'npz': of_npz}[name]
    for run in full_space_of(excavation, raw_excavation).runs():
        positions, is_body, force = read(out, run.name)
        assert positions.dtype == np.float32
        np.testing.assert_array_equal(positions, run.positions)
        np.testing.assert_array_equal(is_body, run.particle_type == 3)
        np.testing.assert_array_equal(force.astype(np.float32), run.force)


@pytest.mark.parametrize('name', ['geoelements', 'lagrangebench'])
def test_formats_that_count_their_runs(excavation, raw_excavation, tmp_path, name):
    """geoelements: an object array of (positions, types) under `gns_data`, pickled as theirs are;
    LagrangeBench: a group per run, in the order of their names."""
    out = tmp_path / name
    export_data(excavation, str(out), name, raw_path=raw_excavation)
    truth = list(full_space_of(excavation, raw_excavation).runs())
    for split in ('train', 'valid', 'test'):
        if name == 'geoelements':
            plain = str(tmp_path / f'{split}_plain.npz')
            program = [sys.executable, '-c', GEOELEMENTS, str(out / f'{split}.npz'), plain]
            subprocess.run(program, check=True)
            with np.load(plain) as file:
                count = len(file.files) // 2
                read = [(file[f'positions_{i}'], file[f'types_{i}'] == 3) for i in range(count)]
        else:
            with h5py.File(out / f'{split}.h5') as file:
                groups = [file[key] for key in sorted(file)]
                read = [(g['position'][()], g['particle_type'][()] > 0) for g in groups]
        wanted = [run for run in truth if run.split == split]
        for (positions, is_body), run in zip(read, wanted, strict=True):
            assert positions.dtype == np.float32
            np.testing.assert_array_equal(positions, run.positions)
            np.testing.assert_array_equal(is_body, run.particle_type == 3)


def test_the_client_of_vtk_notices_a_changed_bit(excavation, raw_excavation, tmp_path):
    export_data(excavation, str(tmp_path / 'vtp'), 'vtp', raw_path=raw_excavation)
    first = next(full_space_of(excavation, raw_excavation).runs())
    path = pathlib.Path(tmp_path / 'vtp' / first.name / '00000.vtp')
    points = next(e for e in ElementTree.parse(path).iter('DataArray') if e.get('Name') == 'Points')
    text = points.text.strip()
    changed = bytearray(zlib.decompress(base64.b64decode(text[24:])))
    changed[3] ^= 1
    points.text = text[:24] + base64.b64encode(zlib.compress(bytes(changed))).decode()
    assert not np.array_equal(vtk_array(points), first.positions[0])
