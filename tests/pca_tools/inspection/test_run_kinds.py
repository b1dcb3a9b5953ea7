"""Tables of an inspection by kind of run: counts, leaks, force spectrum, particle samples."""

import json
import os
import shutil

import numpy as np
import pytest

from pca_tools import convert, dataset, files, particles
from pca_tools.inspect import report
from pca_tools.inspection import inspect_folder
from pca_tools.inspection.run_kinds import force_spectrum
from tests.pca_tools import synthetic


def of_kind(case, arrays):
    parameters = json.loads(str(arrays['parameters']))
    parameters['kind'] = 'grid' if case % 3 else 'lift'
    parameters['penetration_max_mm'] = 0.25 * case
    arrays['parameters'] = np.array(json.dumps(parameters))


def test_report_by_kind(tmp_path):
    raw = synthetic.write_raw_folder(
        str(tmp_path / 'raw'), 'excavation', range(1, 13), change=of_kind
    )
    metadata = convert.convert(raw, str(tmp_path / 'out'))
    text = report(inspect_folder(str(tmp_path / 'out')))
    rows = [line.split() for line in text.splitlines()]
    train = [case['kind'] for case in metadata['cases']['train']]
    lift = next(row for row in rows if row[:1] == ['lift'] and '%)' in row)
    assert lift[1] == str(train.count('lift'))
    leak = [row for row in rows if row[1:2] == ['penetration_max_mm']]
    assert [row[0] for row in leak] == ['grid', 'lift']
    assert leak[1][2:] == ['0.75', '1.88', '3', '(case', '12)']
    floors = next(i for i, row in enumerate(rows) if row[:3] == ['RMS', 'that', 'modes'])
    assert rows[floors][-4:] == ['8', '16', '24', '48']
    assert 'particle samples (140 particles, every 4 frames, to 0.02 mm)' in text


@pytest.mark.parametrize('frames', [240, 241])
def test_spectrum_of_known_lines(frames):
    dt, time = 1 / 60, np.arange(frames) / 60
    force = np.zeros((frames, 3))
    force[:, 0] = 7.0 + 4.0 * np.sin(2 * np.pi * 0.5 * time)
    force[:, 1] = 2.0 * np.sin(2 * np.pi * 10.0 * time)
    run = dataset.Trajectory(0, np.int64([6]), np.zeros((frames, 1, 3), np.float32), force)
    shares, peak = force_spectrum([run], dt)
    # variances 8 and 2; a whole number of periods in 240 frames, leakage in 241
    np.testing.assert_allclose(shares, [0.8, 0, 0, 0.2, 0], atol=1e-9 if frames == 240 else 0.02)
    assert peak == pytest.approx(10.0, abs=0.1)
    still = dataset.Trajectory(0, run.particle_type, run.position, np.ones((frames, 3), np.float32))
    assert force_spectrum([still], dt)[0].tolist() == [0.0] * 5


def test_sample_of_other_runs_is_an_error(excavation, tmp_path):
    folder = shutil.copytree(excavation, tmp_path / 'copy')
    shutil.copy(folder / 'particles_test.npz', folder / 'particles_train.npz')
    listed = {name: {} for name in os.listdir(folder) if name != 'manifest.json'}
    files.write_manifest(str(folder), listed)
    found = [finding.text for finding in inspect_folder(str(folder)).findings]
    assert any('particles_train.npz: holds other runs than train.tfrecord' in t for t in found)
    (folder / 'particles_train.npz').write_bytes(b'PK')
    assert inspect_folder(str(folder)).failed
    assert len(particles.read_sample(excavation, 'train')) == 10
