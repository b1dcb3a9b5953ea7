"""Raw runs on disk: content, determinism, resuming, and what is refused."""

import dataclasses
import json
import os
import pathlib
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from mpm import batch, bodies, packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.experiments import coarse
from mpm.motions.recording import Recording
from mpm.simulation import Settings

ROOT = pathlib.Path(__file__).resolve().parents[2]

# Runs a coarse, short version of a scene in its own process.
SHORT = """
import sys
from mpm import batch, scenes
from mpm.simulation import Settings
from mpm.experiments import coarse
scenes.FRAMES = int(sys.argv[1])
cases = tuple(int(case) if case.isdecimal() else case for case in sys.argv[3].split(','))
batch.generate(coarse(scenes.EXCAVATION), cases, sys.argv[2], Settings(), show_progress=False)
"""


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(scenes, 'FRAMES', 5)


def make(scene, folder, cases=(186, 22), **settings):
    return batch.generate(scene, cases, str(folder), Settings(**settings), show_progress=False)


def digests(folder):
    manifest = raw_run.read_manifest(str(folder))
    return {entry['case']: entry['content'] for entry in manifest['runs']}


def test_files_are_as_agreed(coarse_excavation, tmp_path, short):
    make(coarse_excavation, tmp_path)
    manifest = json.loads((tmp_path / 'manifest.json').read_text())
    assert manifest['scene']['name'] == 'excavation'
    assert manifest['scene']['rigid_motion'] == 'prescribed'
    assert manifest['dt'] == pytest.approx(1 / 60)
    assert [entry['case'] for entry in manifest['runs']] == [22, 186]
    kept = int(np.prod(coarse_excavation.bin.lattice))
    for entry in manifest['runs']:
        path = tmp_path / entry['file']
        assert path.stat().st_size == entry['bytes']
        assert raw_run.digest(str(path)) == entry['sha256']
        assert raw_run.content_digest(raw_run.read_run(str(path))) == entry['content']
        with np.load(path, allow_pickle=False) as file:
            assert file['positions'].shape == (5, kept, 3)
            assert file['rigid_positions'].shape == (5, 20, 3)
            assert file['force'].shape == (5, 3)
            assert file['torque'].shape == (5, 3) and file['pose'].shape == (5, 7)
            assert 'step_context' not in file.files
            for name in ('positions', 'rigid_positions', 'force', 'torque', 'pose'):
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
    monkeypatch.setattr('mpm.motions.grid.REST_FRAMES', 4)
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


def test_kinds_of_another_bin_have_a_folder_and_a_packing_of_their_own(
    coarse_excavation, tmp_path, short
):
    own = scenes.EXCAVATION.other_bins['wide']
    wide = coarse(dataclasses.replace(scenes.EXCAVATION, bin=own)).bin
    scene = dataclasses.replace(coarse_excavation, other_bins={'wide': wide})
    new = make(scene, tmp_path, cases=(22, 'beside_0001'))
    assert [entry['case'] for entry in new] == [22, 'beside_0001']
    assert set(digests(tmp_path)) == {22} and set(digests(tmp_path / 'wide')) == {'beside_0001'}
    made = raw_run.read_run(str(tmp_path / 'wide' / 'run_beside_0001.npz'))
    assert made.parameters['bin_m'] == [0.8, 0.15, 1.2]
    assert (
        made.positions.shape[1] == np.prod(wide.lattice) and np.ptp(made.positions[0, :, 2]) > 1.1
    )
    assert make(scene, tmp_path, cases=(22, 'beside_0001')) == []


def test_a_run_with_another_tool_is_not_taken_for_the_finished_one(
    coarse_excavation, tmp_path, short
):
    plate = {'outline': [[0, 0], [0, 0.2]], 'edge_radius': 0.015, 'width': 0.3}
    tool = bodies.check_tool(plate)

    def with_tool(tool):
        return batch.generate(
            coarse_excavation, (22,), str(tmp_path), Settings(), tool=tool, show_progress=False
        )

    (entry,) = with_tool(tool)
    assert entry['parameters']['tool'] == tool and entry['parameters']['body_width_m'] == 0.3
    assert with_tool(tool) == []
    with pytest.raises(ValueError, match='made with another tool'):
        with_tool(bodies.check_tool(plate | {'width': 0.4}))
    wide = bodies.check_tool(plate | {'width': 0.7})
    with pytest.raises(ValueError, match=r'excavation case 22: .*0.7 m wide.*does not fit'):
        with_tool(wide)


@pytest.mark.slow
@pytest.mark.parametrize('where', ['', 'local:2'])
def test_pool_gives_the_same_runs(coarse_excavation, tmp_path, where):
    """Processes, here or by Dask, make the same arrays as this one (full length: they reimport)."""
    if where:
        pytest.importorskip('distributed')
    scene, cases, pool = coarse_excavation, (22, 46), tmp_path / 'pool'
    batch.generate(scene, cases, str(pool), Settings(), 2, where=where, show_progress=False)
    batch.generate(scene, cases[:1], str(tmp_path / 'one'), Settings(), 1, show_progress=False)
    assert digests(tmp_path / 'one').items() <= digests(pool).items()
    assert set(digests(pool)) == set(cases)


@pytest.mark.slow
def test_generation_killed_anywhere_resumes(tmp_path):
    """SIGKILL at random times, also while files are written; then the same content, bit for bit."""
    cases = '22,186,lift_0003,stops_0001'

    def command(folder):
        return [sys.executable, '-c', SHORT, '12', str(tmp_path / folder), cases]

    started = time.monotonic()
    subprocess.run(command('whole'), check=True, cwd=ROOT)
    duration = time.monotonic() - started
    rng = np.random.default_rng(0)
    kept = {}
    for _ in range(4):
        process = subprocess.Popen(command('killed'), cwd=ROOT)
        try:
            process.wait(rng.uniform(0.2, 0.9) * duration)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
        if (tmp_path / 'killed' / 'manifest.json').exists():
            now = digests(tmp_path / 'killed')
            assert kept.items() <= now.items()  # nothing that was finished is lost
            kept = now
    subprocess.run(command('killed'), check=True, cwd=ROOT)
    expected = digests(tmp_path / 'whole')
    assert set(expected) == {22, 186, 'lift_0003', 'stops_0001'}
    assert digests(tmp_path / 'killed') == expected
    names = sorted(os.listdir(tmp_path / 'whole'))
    assert sorted(os.listdir(tmp_path / 'killed')) == names  # and no temporary file is left


def test_disk_that_fills_up_stops_with_the_name_and_loses_nothing(tmp_path):
    """A limit on the size of files in place of a full disk: the packing is there, no run fits."""
    command = [sys.executable, '-c', SHORT, '40', str(tmp_path / 'out'), '22']

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    (tmp_path / 'out').mkdir()
    packing.settled(coarse(scenes.EXCAVATION).bin, make_soil(1.5e6, 0.76), 0, str(tmp_path / 'out'))
    full = subprocess.run(command, preexec_fn=limit, capture_output=True, text=True, cwd=ROOT)
    assert full.returncode != 0
    assert 'cannot write' in full.stderr and 'run_022.npz: File too large' in full.stderr
    assert not list((tmp_path / 'out').glob('*run_022*'))
    subprocess.run(command, check=True, cwd=ROOT)
    assert set(digests(tmp_path / 'out')) == {22}


def test_run_that_fails_does_not_stop_the_others(coarse_excavation, tmp_path, short, monkeypatch):
    whole = batch.run.run_case

    def fails_at_186(scene, case, *arguments):
        if case == 186:
            raise ValueError('particle 7 left the grid at 0.1 s')
        return whole(scene, case, *arguments)

    monkeypatch.setattr(batch.run, 'run_case', fails_at_186)
    with pytest.raises(
        ValueError, match='1 of 3 runs failed, 2 were made.*\n.*case 186: particle 7'
    ):
        make(coarse_excavation, tmp_path, cases=(22, 186, 'stops_0001'))
    assert set(digests(tmp_path)) == {22, 'stops_0001'}
    monkeypatch.undo()
    monkeypatch.setattr(scenes, 'FRAMES', 5)
    assert [e['case'] for e in make(coarse_excavation, tmp_path, (22, 186))] == [186]


def test_all_motions_are_checked_before_the_first_run(coarse_excavation, tmp_path, short):
    path = tmp_path / 'deep.csv'
    path.write_text('time_s,x_m,y_m,angle_deg\n0,0.8,0.3,0\n2,0.7,0.1,0\n')
    deep = Recording(str(path), 1)
    with pytest.raises(ValueError, match=r'deep\.csv: at .* s the body reaches down'):
        make(coarse_excavation, tmp_path / 'out', cases=(22, deep))
    assert not (tmp_path / 'out').exists()
    with pytest.raises(ValueError, match='22.*twice'):
        make(coarse_excavation, tmp_path / 'out', cases=(22, 22))


def test_changed_file_is_not_taken_for_the_finished_run(coarse_excavation, tmp_path, short):
    path = tmp_path / 'mine.csv'
    path.write_text('time_s,x_m,y_m,angle_deg\n0,0.8,0.3,0\n0.05,0.8,0.29,-5\n')
    mine = Recording(str(path), 1)
    (entry,) = make(coarse_excavation, tmp_path / 'out', cases=(mine,))
    assert (entry['case'], entry['file']) == ('path_mine', 'run_path_mine.npz')
    assert make(coarse_excavation, tmp_path / 'out', cases=(mine,)) == []
    path.write_text(path.read_text().replace('0.29', '0.28'))
    with pytest.raises(ValueError, match='another path_sha256'):
        make(coarse_excavation, tmp_path / 'out', cases=(mine,))


def test_killed_worker_is_an_error_and_not_a_wait(tmp_path):
    """A process of the pool that the system kills (memory) ends the command with a message."""
    script = (
        SHORT.replace('batch.generate(', 'if __name__ == "__main__": batch.generate(')
        .replace('show_progress=False)', 'num_processes=2, show_progress=False)')
        .replace('scenes.FRAMES =', 'if int(sys.argv[1]): scenes.FRAMES =')
    )
    (tmp_path / 'script.py').write_text(script)
    process = subprocess.Popen(
        [sys.executable, tmp_path / 'script.py', '0', tmp_path / 'out', '22,186'],
        stderr=subprocess.PIPE, text=True, env=os.environ | {'PYTHONPATH': str(ROOT)},
    )  # fmt: skip
    deadline = time.monotonic() + 60
    workers = []
    while len(workers) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
        children = pathlib.Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text()
        workers = [
            pid
            for pid in children.split()
            if b'spawn_main' in pathlib.Path(f'/proc/{pid}/cmdline').read_bytes()
        ]
    os.kill(int(workers[0]), signal.SIGKILL)
    _, text = process.communicate(timeout=120)
    assert process.returncode != 0 and 'a process was killed from outside' in text


def test_folder_of_another_scene_or_settings_is_refused(
    coarse_excavation, coarse_wheel, tmp_path, short
):
    make(coarse_excavation, tmp_path, cases=(22,))
    with pytest.raises(ValueError, match="'excavation', not 'wheel'"):
        make(coarse_wheel, tmp_path, cases=(122,))
    with pytest.raises(ValueError, match='youngs_modulus_Pa'):
        make(coarse_excavation, tmp_path, cases=(186,), youngs_modulus=3e6)
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
        (['--scene=wheel', '--cases=1', '--friction_angle_deg=70'], 'must lie in [15, 50]'),
        (['--scene=wheel', '--tool=nothing.json'], "No such file or directory: 'nothing.json'"),
        (
            ['--scene=wheel', '--operator_seeds=1', '--kinds=lift'],
            "unknown kinds ['lift'] of wheel",
        ),
        (['--scene=excavation', '--kinds=lift'], 'give --operator_seeds'),
        (['--scene=excavation', '--path=nothing.csv'], "No such file or directory: 'nothing.csv'"),
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
