"""Raw runs on disk: content, determinism, resuming, and what is refused."""

import json
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from mpm import batch, packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.simulation import Settings

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Runs a coarse, short version of a scene in its own process.
SHORT = """
import sys
from mpm import batch, scenes
from mpm.simulation import Settings
from mpm.experiments import coarse
scenes.FRAMES = int(sys.argv[1])
cases = tuple(int(case) for case in sys.argv[3].split(','))
batch.generate(coarse(scenes.EXCAVATION), cases, sys.argv[2], Settings(), show_progress=False)
"""


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(scenes, 'FRAMES', 5)


def make(scene, folder, cases=(186, 22), **settings):
    return batch.generate(scene, cases, str(folder), Settings(**settings), show_progress=False)


def digests(folder):
    manifest = raw_run.read_manifest(str(folder))
    return {entry['case']: entry['sha256'] for entry in manifest['runs']}


def test_files_are_as_agreed(coarse_excavation, tmp_path, short):
    make(coarse_excavation, tmp_path)
    manifest = json.loads((tmp_path / 'manifest.json').read_text())
    assert manifest['scene']['name'] == 'excavation'
    assert manifest['scene']['rigid_motion'] == 'prescribed'
    assert manifest['dt'] == pytest.approx(1 / 60)
    assert [entry['case'] for entry in manifest['runs']] == [22, 186]
    kept = len(range(0, int(np.prod(coarse_excavation.bin.lattice)), 5))
    for entry in manifest['runs']:
        path = tmp_path / entry['file']
        assert path.stat().st_size == entry['bytes']
        assert raw_run.digest(str(path)) == entry['sha256']
        with np.load(path, allow_pickle=False) as file:
            assert file['positions'].shape == (5, kept, 3)
            assert file['rigid_positions'].shape == (5, 20, 3)
            assert file['force'].shape == (5, 3)
            for name in ('positions', 'rigid_positions', 'force'):
                assert file[name].dtype == np.float32 and np.isfinite(file[name]).all()
            np.testing.assert_array_equal(file['force'][0], file['force'][1])
            parameters = json.loads(str(file['parameters']))
        assert parameters == entry['parameters']
        assert parameters['context'] == {} and parameters['seed'] == 0
        low, high = np.array(manifest['bounds']).T
        run = raw_run.read_run(str(path))
        assert (run.positions > low).all() and (run.positions < high).all()
    # Both start from the same soil, particle by particle.
    first, second = (raw_run.read_run(str(tmp_path / f'run_{c:03d}.npz')) for c in (22, 186))
    np.testing.assert_array_equal(first.positions[0], second.positions[0])


def test_wheel_runs_carry_context_and_edges(coarse_wheel, tmp_path, short, monkeypatch):
    monkeypatch.setattr('mpm.simulation.REST_FRAMES', 4)
    make(coarse_wheel, tmp_path, cases=(154,))
    manifest = raw_run.read_manifest(str(tmp_path))
    assert manifest['scene']['rigid_motion'] == 'driven'
    assert len(manifest['scene']['rigid_edges']) == 32
    context = manifest['runs'][0]['parameters']['context']
    assert context == {'gravity': 3.72, 'friction_angle_deg': 30.0, 'load': 25.0}
    run = raw_run.read_run(str(tmp_path / 'run_154.npz'))
    # Prescribed: the axle's x and the turn of the points about it.
    axle = run.rigid_positions.astype(np.float64).mean(axis=1)
    np.testing.assert_allclose(np.diff(axle[:, 0]), -0.00585 / 60, atol=1e-7)
    radius = run.rigid_positions[:, 0] - axle
    angle = np.unwrap(np.arctan2(radius[:, 1], radius[:, 0]))
    np.testing.assert_allclose(np.diff(angle), 0.78 / 60, atol=1e-5)


def test_same_seed_same_bits_other_seed_other_soil(coarse_excavation, tmp_path, short):
    for name in ('a', 'b'):
        make(coarse_excavation, tmp_path / name, cases=(22,))
    make(coarse_excavation, tmp_path / 'c', cases=(22,), seed=1)
    runs = [raw_run.read_run(str(tmp_path / name / 'run_022.npz')) for name in 'abc']
    np.testing.assert_array_equal(runs[0].positions, runs[1].positions)
    np.testing.assert_array_equal(runs[0].force, runs[1].force)
    assert (runs[0].positions != runs[2].positions).any()


def test_finished_runs_are_not_made_again(coarse_excavation, tmp_path, short):
    make(coarse_excavation, tmp_path, cases=(22,))
    stamp = (tmp_path / 'run_022.npz').stat().st_mtime_ns
    new = make(coarse_excavation, tmp_path, cases=(22, 186))
    assert [entry['case'] for entry in new] == [186]
    assert (tmp_path / 'run_022.npz').stat().st_mtime_ns == stamp
    # A truncated file does not count as finished.
    path = tmp_path / 'run_022.npz'
    path.write_bytes(path.read_bytes()[:-100])
    assert [e['case'] for e in make(coarse_excavation, tmp_path, cases=(22, 186))] == [22]
    assert len(digests(tmp_path)) == 2


def test_pool_gives_the_same_runs(coarse_excavation, tmp_path):
    """A pool of processes makes the same arrays as one process (full length: `spawn` reimports)."""
    scene = coarse_excavation
    cases = (22, 46)
    batch.generate(scene, cases, str(tmp_path / 'pool'), Settings(), 2, show_progress=False)
    batch.generate(scene, cases[:1], str(tmp_path / 'one'), Settings(), 1, show_progress=False)
    pool, one = (raw_run.read_run(str(tmp_path / name / 'run_022.npz')) for name in ('pool', 'one'))
    np.testing.assert_array_equal(pool.positions, one.positions)
    assert set(digests(tmp_path / 'pool')) == set(cases)


def test_killed_generation_resumes(tmp_path):
    """SIGKILL in the middle of a run; the same command then completes the set, bit for bit."""
    cases = '22,186,146,123'

    def command(folder):
        return [sys.executable, '-c', SHORT, '12', str(tmp_path / folder), cases]

    process = subprocess.Popen(command('killed'), cwd=ROOT)
    manifest = tmp_path / 'killed' / 'manifest.json'
    deadline = time.monotonic() + 300
    while not manifest.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = digests(tmp_path / 'killed')
    assert before
    subprocess.run(command('killed'), check=True, cwd=ROOT)
    subprocess.run(command('whole'), check=True, cwd=ROOT)
    assert set(digests(tmp_path / 'killed')) == {22, 123, 146, 186}
    for case in (22, 123, 146, 186):
        resumed, whole = (
            raw_run.read_run(str(tmp_path / folder / f'run_{case:03d}.npz'))
            for folder in ('killed', 'whole')
        )
        np.testing.assert_array_equal(resumed.positions, whole.positions)
    for case, digest in before.items():
        assert digests(tmp_path / 'killed')[case] == digest


def test_folder_of_another_scene_or_settings_is_refused(
    coarse_excavation, coarse_wheel, tmp_path, short
):
    make(coarse_excavation, tmp_path, cases=(22,))
    with pytest.raises(ValueError, match="'excavation', not 'wheel'"):
        make(coarse_wheel, tmp_path, cases=(122,))
    with pytest.raises(ValueError, match='youngs_modulus_Pa'):
        make(coarse_excavation, tmp_path, cases=(186,), youngs_modulus=3e6)
    with pytest.raises(ValueError, match='rheology'):
        make(coarse_excavation, tmp_path, cases=(186,), rheology='nonlocal')
    with pytest.raises(ValueError, match='packing'):
        packing.settled(coarse_excavation.bin, make_soil(1.5e6, 0.76), 7, str(tmp_path))


def test_what_is_no_run_or_manifest_is_refused(tmp_path):
    (tmp_path / 'manifest.json').write_text('{"runs": []}')
    with pytest.raises(ValueError, match='not a manifest'):
        raw_run.read_manifest(str(tmp_path))
    (tmp_path / 'run_001.npz').write_bytes(b'version https://git-lfs')
    with pytest.raises(ValueError, match='not a raw run'):
        raw_run.read_run(str(tmp_path / 'run_001.npz'))
    assert raw_run.read_manifest(str(tmp_path / 'nothing')) is None


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--scene=excavation', '--cases=999'], 'cases 1 to 250, got 999'),
        (['--scene=wheel', '--cases=some'], "numbers separated by commas, got 'some'"),
        (['--scene=wheel', '--cases=1', '--youngs_modulus=-1'], "Young's modulus"),
    ],
)
def test_command_refuses_bad_input(tmp_path, arguments, words):
    done = subprocess.run(
        [sys.executable, '-m', 'mpm.generate', *arguments, f'--output_path={tmp_path / "out"}'],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert done.returncode == 1
    assert words in done.stderr and 'Traceback' not in done.stderr
    assert not list(tmp_path.rglob('run_*'))
