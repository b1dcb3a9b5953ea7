"""Raw runs on disk: content, determinism, resuming, and what is refused."""

import dataclasses
import json
import os
import pathlib
import resource
import subprocess
import sys

import numpy as np
import pytest

from mpm import batch, bodies, packing, raw_run, scenes
from mpm.height_map import shape_of
from mpm.motions.recording import Recording
from mpm.simulation import Settings
from pca_tools import files
from tests.mpm import small
from tests.mpm.small import coarse

HERE = os.environ | {'PYTHONPATH': str(pathlib.Path(__file__).resolve().parents[2])}
# Short runs in two processes, each of which imports this anew.
SHORT = """
import sys
from mpm import batch, scenes
from mpm.simulation import Settings
from tests.mpm.small import BLADE
scenes.FRAMES = 5
if __name__ == '__main__':
    batch.generate(BLADE, (22, 46), sys.argv[1], Settings(), 2)
"""


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(scenes, 'FRAMES', 5)


def make(folder, *cases, scene=small.BLADE, tool=None, **settings):
    chosen = Settings(**settings)
    return batch.generate(scene, cases, str(folder), chosen, tool=tool)


def digests(folder):
    manifest = raw_run.read_manifest(str(folder))
    return {entry['case']: entry['content'] for entry in manifest['runs']}


def test_files_are_as_agreed(tmp_path, short):
    make(tmp_path, 186, 22)
    manifest = json.loads((tmp_path / 'manifest.json').read_text())
    assert manifest['scene']['name'] == 'excavation'
    assert manifest['scene']['rigid_motion'] == 'prescribed'
    assert manifest['dt'] == pytest.approx(1 / 60)
    assert [entry['case'] for entry in manifest['runs']] == [22, 186]
    count = int(np.prod(small.BLADE.bin.lattice))
    shapes = {
        'positions': (5, count, 3), 'rigid_positions': (5, 20, 3), 'force': (5, 3),
        'heights': (5, *shape_of(small.BLADE.bin)),
        'torque': (5, 3), 'pose': (5, 7),
    }  # fmt: skip
    starts = []
    for entry in manifest['runs']:
        path = tmp_path / entry['file']
        run = raw_run.read_run(str(path))
        assert path.stat().st_size == entry['bytes']
        assert files.sha256_of_file(str(path)) == entry['sha256']
        assert raw_run.content_digest(run) == entry['content']
        with np.load(path, allow_pickle=False) as file:
            assert {name: file[name].shape for name in file.files} == shapes | {'parameters': ()}
            assert all(file[name].dtype == np.float32 for name in shapes)
            assert all(np.isfinite(file[name]).all() for name in shapes)
            assert json.loads(str(file['parameters'])) == entry['parameters']
        np.testing.assert_array_equal(run.force[0], run.force[1])
        assert run.parameters['context'] == {} and run.parameters['seed'] == 0
        low, high = np.array(manifest['bounds']).T
        assert (run.positions > low).all() and (run.positions < high).all()
        starts.append(run.positions[0])
    np.testing.assert_array_equal(*starts)  # the same soil, particle by particle


def test_finished_runs_are_not_made_again(tmp_path, short):
    make(tmp_path, 22)
    path = tmp_path / 'run_022.npz'
    stamp = path.stat().st_mtime_ns
    assert [entry['case'] for entry in make(tmp_path, 22, 186)] == [186]
    assert path.stat().st_mtime_ns == stamp
    # A truncated file does not count as finished.
    path.write_bytes(path.read_bytes()[:-100])
    assert [entry['case'] for entry in make(tmp_path, 22, 186)] == [22]
    assert len(digests(tmp_path)) == 2


def test_kinds_of_another_bin_have_a_folder_and_a_packing_of_their_own(tmp_path, short):
    own = scenes.EXCAVATION.other_bins['wide']
    wide = coarse(dataclasses.replace(scenes.EXCAVATION, bin=own)).bin
    scene = dataclasses.replace(small.BLADE, other_bins={'wide': wide})
    new = make(tmp_path, 22, 'beside_0001', scene=scene)
    assert [entry['case'] for entry in new] == [22, 'beside_0001']
    assert set(digests(tmp_path)) == {22} and set(digests(tmp_path / 'wide')) == {'beside_0001'}
    made = raw_run.read_run(str(tmp_path / 'wide' / 'run_beside_0001.npz'))
    assert made.parameters['bin_m'] == [0.8, 0.15, 1.2]
    assert made.positions.shape[1] == np.prod(wide.lattice)
    assert np.ptp(made.positions[0, :, 2]) > 1.1
    assert make(tmp_path, 22, 'beside_0001', scene=scene) == []


def test_a_run_of_another_tool_or_path_is_not_taken_for_the_finished_one(tmp_path, short):
    def plate(width):
        tool = {'outline': [[0, 0], [0, 0.2]], 'edge_radius': 0.015, 'width': width}
        return bodies.check_tool(tool)

    path = tmp_path / 'mine.csv'
    path.write_text('time_s,x_m,y_m,angle_deg\n0,0.8,0.3,0\n0.05,0.8,0.29,-5\n')
    runs, out = (22, Recording(str(path), 1)), tmp_path / 'out'
    here, mine = make(out, *runs, tool=plate(0.3))
    parameters = here['parameters']
    assert parameters['tool'] == plate(0.3) and parameters['body_width_m'] == 0.3
    assert (mine['case'], mine['file']) == ('path_mine', 'run_path_mine.npz')
    assert make(out, *runs, tool=plate(0.3)) == []
    with pytest.raises(ValueError, match='run_022.npz was made with another tool'):
        make(out, *runs, tool=plate(0.4))
    with pytest.raises(ValueError, match=r'excavation case 22: .*0.7 m wide.*does not fit'):
        make(out, 22, tool=plate(0.7))
    path.write_text(path.read_text().replace('0.29', '0.28'))
    with pytest.raises(ValueError, match='another path_sha256'):
        make(out, *runs, tool=plate(0.3))


def test_processes_make_the_same_runs_and_another_seed_others(tmp_path, short):
    script = tmp_path / 'script.py'
    script.write_text(SHORT)
    subprocess.run([sys.executable, script, tmp_path / 'out'], env=HERE, check=True)
    for name, seed in (('one', 0), ('other', 1)):
        make(tmp_path / name, 22, seed=seed)
    found = digests(tmp_path / 'out')
    assert set(found) == {22, 46} and digests(tmp_path / 'one')[22] == found[22]
    # The digest also covers the number of the seed, so the soil itself is compared.
    runs = [raw_run.read_run(str(tmp_path / n / 'run_022.npz')) for n in ('one', 'other')]
    assert (runs[0].positions[0] != runs[1].positions[0]).mean() > 0.9


def test_disk_that_fills_up_stops_with_the_name_and_loses_nothing(tmp_path, short):
    """A limit on the size of files in place of a full disk: the packing is there, no run fits."""
    packing.settled(small.BLADE.bin, 1.5e6, 0, str(tmp_path))
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, usual[1]))
    try:
        with pytest.raises(OSError, match='cannot write .*run_022.npz: File too large'):
            make(tmp_path, 22)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert not list(tmp_path.glob('*run_022*'))


def test_run_that_fails_does_not_stop_the_others(tmp_path, short, monkeypatch):
    with monkeypatch.context() as patch:
        small.fails_at(patch, 186)
        words = '1 of 3 runs failed, 2 were made.*\n.*case 186: particle 7'
        with pytest.raises(ValueError, match=words):
            make(tmp_path, 22, 186, 'stops_0001')
    assert set(digests(tmp_path)) == {22, 'stops_0001'}
    assert [entry['case'] for entry in make(tmp_path, 22, 186)] == [186]


def test_all_motions_are_checked_before_the_first_run(tmp_path, short):
    path = tmp_path / 'deep.csv'
    path.write_text('time_s,x_m,y_m,angle_deg\n0,0.8,0.3,0\n2,0.7,0.1,0\n')
    with pytest.raises(ValueError, match=r'deep\.csv: at .* s the body reaches down'):
        make(tmp_path / 'out', 22, Recording(str(path), 1))
    assert not (tmp_path / 'out').exists()
    with pytest.raises(ValueError, match='22.*twice'):
        make(tmp_path / 'out', 22, 22)


def test_folder_of_another_scene_or_settings_is_refused(tmp_path, short):
    make(tmp_path, 22)
    with pytest.raises(ValueError, match="'excavation', not 'wheel'"):
        make(tmp_path, 122, scene=small.WHEEL)
    with pytest.raises(ValueError, match='youngs_modulus_Pa'):
        make(tmp_path, 186, youngs_modulus=3e6)
    with pytest.raises(ValueError, match='packing'):
        packing.settled(small.BLADE.bin, 1.5e6, 7, str(tmp_path))
