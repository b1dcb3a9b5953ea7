"""Raw runs of any origin: written, checked, read back; the script of the page about it."""

import json
import os
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest

from learning_to_simulate.scene import Scene
from pca_tools import convert, dataset, files, raw_runs, write_raw
from pca_tools.inspect import inspect_folder
from pca_tools.raw_runs import RawRuns
from tests.pca_tools import synthetic
from tests.pca_tools.commands import REPOSITORY, call_command

DT = 1 / 60


def own_runs(count=5, **extra):
    """Runs of the synthetic scene as mappings."""
    for case in range(1, count + 1):
        arrays = synthetic.make_run('excavation', case, frames=20)
        kept = {name: arrays[name] for name in ('positions', 'rigid_positions', 'force')}
        yield {**kept, 'case': case, **extra}


def test_script_of_the_page_becomes_a_dataset(tmp_path):
    page = (REPOSITORY / 'docs' / 'data.md').read_text(encoding='utf-8')
    (script,) = re.findall(r'```python\n(.*?)```', page, flags=re.DOTALL)
    assert len(script.strip().splitlines()) <= 21
    environment = os.environ | {'PYTHONPATH': str(REPOSITORY)}
    subprocess.run([sys.executable, '-c', script], cwd=tmp_path, env=environment, check=True)
    raw, out = str(tmp_path / 'raw/own'), str(tmp_path / 'own_data')
    done = call_command('pca_tools.convert', f'--raw_path={raw}', f'--output_path={out}')
    assert done.returncode == 0, done.stderr
    metadata = dataset.read_metadata(out)
    assert (metadata['n_soil'], metadata['particles_rigid']) == (400, 9)
    assert metadata['scene']['up_axis'] == 1
    assert f'{out}: scene own_data, N = 400, R = 9, r = 8, T = 60' in done.stdout
    assert not inspect_folder(out).failed


def test_written_runs_are_read_back_bit_for_bit(tmp_path):
    given = list(own_runs(3, context={'load': 4.5}, kind='push', split='train'))
    write_raw(str(tmp_path / 'raw'), given, 0.02, up_axis=1, name='mine', gravity=[0, -9.8, 0])
    runs = RawRuns(str(tmp_path / 'raw'))
    assert runs.cases == [1, 2, 3] and runs.dt == 0.02 and runs.scene['name'] == 'mine'
    assert runs.scene['rigid_motion'] == 'prescribed' and runs.scene['context_names'] == ['load']
    for run, wanted in zip(runs, given, strict=True):
        for name in ('positions', 'rigid_positions', 'force'):
            np.testing.assert_array_equal(getattr(run, name), wanted[name])
        assert run.context.tolist() == [4.5]
        assert (run.parameters['kind'], run.parameters['split']) == ('push', 'train')
    low, high = np.array(runs.bounds).T
    for run in given:
        for name in ('positions', 'rigid_positions'):
            assert np.all(run[name] > low) and np.all(run[name] < high)


def test_all_faults_are_told_at_once_and_nothing_is_written(tmp_path):
    runs = list(own_runs(5))
    runs[1]['positions'][3, 7, 1] = np.nan
    runs[2]['postions'] = runs[2].pop('positions')
    runs[3]['positions'] = runs[3]['positions'][:, :9]
    runs[3]['case'] = 1
    del runs[4]['force']
    with pytest.raises(ValueError) as error:
        write_raw(str(tmp_path / 'raw'), runs, DT, up_axis='y')
    for text in (
        '4 faults', 'run 1: positions holds 1 NaN', "run 2: has the unknown keys ['postions']",
        'run 3: has (particles, torque, pose, height map) (9, False, False, None), the runs',
        'run 4: lacks force',
    ):  # fmt: skip
        assert text in str(error.value), text
    for bad in ({'dt': 0.0}, {'up_axis': 'up'}, {'body': 'moving'}, {'bounds': [[0, 1]]}):
        arguments = {'dt': DT, 'up_axis': 'y', **bad}
        with pytest.raises(ValueError, match=r'dt is|up_axis is|rigid_motion|bounds is'):
            write_raw(str(tmp_path / 'raw'), own_runs(2), **arguments)
    for case in (0.1, True, None):  # the converter would refuse the whole folder
        with pytest.raises(ValueError, match=f'run 0: case is {case}, a whole number or a text'):
            write_raw(str(tmp_path / 'raw'), [{**runs[0], 'case': case}], DT, up_axis='y')
    with pytest.raises(ValueError, match=r"run 0: parameters, with the context .*'heavy'"):
        heavy = {**runs[0], 'context': {'load': 'heavy'}}
        write_raw(str(tmp_path / 'raw'), [heavy], DT, up_axis='y')
    with pytest.raises(ValueError, match='no runs'):
        write_raw(str(tmp_path / 'raw'), [], DT, up_axis='y')
    assert not os.listdir(tmp_path)
    write_raw(str(tmp_path / 'raw'), runs[:1], DT, up_axis='y')
    with pytest.raises(ValueError, match='is not empty'):
        write_raw(str(tmp_path / 'raw'), runs[:1], DT, up_axis='y')


def test_all_faults_of_files_and_of_the_manifest_are_told_before_anything_is_encoded(tmp_path):
    def spoil(case, arrays):
        if case == 2:
            arrays['positions'][0, 0, 0] = np.inf
        if case == 4:
            del arrays['force']

    with pytest.raises(FileNotFoundError, match='manifest.json'):
        RawRuns(str(tmp_path))
    raw = synthetic.write_raw_folder(tmp_path / 'raw', 'excavation', range(1, 6), change=spoil)
    os.remove(f'{raw}/run_005.npz')
    os.truncate(f'{raw}/run_003.npz', os.path.getsize(f'{raw}/run_003.npz') - 100)
    with pytest.raises(ValueError) as error:
        convert.convert(raw, str(tmp_path / 'out'))
    for text in (
        '4 faults', '002.npz: positions', '003.npz: differs from the manifest', '004.npz: lacks',
        '005.npz: no such',
    ):  # fmt: skip
        assert text in str(error.value)
    manifest = files.read_json(f'{raw}/manifest.json')
    bad = {'dt': -1, 'bounds': 'wide', 'runs': [{'file': 'run_001.npz', 'case': 1}]}
    all_bad = '(?s)3 faults.*dt is -1.*bounds is .wide.*a run is listed as .*sha256.*--rehash'
    for change, text in (
        ({'runs': []}, 'lists no runs'),
        ({'runs': manifest['runs'][:1] * 2}, r'lists the cases \[1\] more than once'),
        ({'scene': {'name': 'x'}}, 'lacks .*rigid_motion.*up_axis'),
        (bad, all_bad),
    ):
        files.write_json(f'{raw}/manifest.json', {**manifest, **change})
        with pytest.raises(ValueError, match=text):
            RawRuns(raw)


def test_rehash_follows_files_that_were_changed_on_purpose(tmp_path):
    raw = synthetic.write_raw_folder(tmp_path / 'raw', 'excavation', range(1, 6))
    arrays = synthetic.make_run('excavation', 9)
    np.savez(f'{raw}/run_003.npz', **arrays)
    with pytest.raises(ValueError, match=r'run_003.npz: differs.*--rehash'):
        convert.convert(raw, str(tmp_path / 'out'))
    before = {name: os.stat(f'{raw}/{name}').st_mtime_ns for name in os.listdir(raw)}
    done = call_command('pca_tools.convert', '--rehash', f'--raw_path={raw}')
    assert done.returncode == 0 and 'new entries for 1 files' in done.stdout, done.stderr
    changed = {n for n in os.listdir(raw) if os.stat(f'{raw}/{n}').st_mtime_ns != before[n]}
    assert changed == {'manifest.json'}
    np.testing.assert_array_equal(RawRuns(raw)[2].positions, arrays['positions'])
    kept = convert.convert(raw, str(tmp_path / 'out'), modes=2)['cases']  # by the manifest's names
    assert sorted(run['case'] for runs in kept.values() for run in runs) == [1, 2, 3, 4, 5]
    manifest = files.read_json(f'{raw}/manifest.json')
    manifest['runs'] = [{'file': entry['file']} for entry in manifest['runs']]
    files.write_json(f'{raw}/manifest.json', manifest)
    assert len(raw_runs.rehash(raw)) == 5
    assert RawRuns(raw).cases == [1, 2, 9, 4, 5]  # the case is what the file says
    assert len(list(RawRuns(raw))) == 5
    with open(f'{raw}/run_004.npz', 'wb') as file:
        file.write(b'not a zip')
    kept = files.read_json(f'{raw}/manifest.json')
    with pytest.raises(ValueError, match='run_004.npz: is not a complete .npz'):
        raw_runs.rehash(raw)
    assert files.read_json(f'{raw}/manifest.json') == kept


@pytest.mark.parametrize(
    'change, text',
    [
        (lambda a: np.put(a['positions'], 3 * 140 * 9 + 51, np.nan),
         'positions holds 1 NaN .* frame 9, point 17, axis 0'),
        (lambda a: a.pop('force'), r"lacks the arrays \['force'\]"),
        (lambda a: a.update(force=a['force'][1:]), r'force has shape \(23, 3\), .* for 24 frames'),
        (lambda a: a.update(parameters=np.array('{"case": 1}')), 'JSON object with context'),
        (lambda a: a.update(step_context=np.zeros((24, 2), np.float32)),
         r'step_context has shape \(24, 2\).* of 3 values'),
        (lambda a: a.update(subframe_force=np.zeros((24, 5, 3), np.float32)),
         r'subframe_force has shape \(24, 5, 3\), .* of 4 x 3'),
        (lambda a: a.update(rigid_positions=a['rigid_positions'][:, :9]), 'edges name point 15'),
        (lambda a: a.update(body_pose=np.zeros((24, 2, 7))), 'body_pose is of 2 bodies, .* has 0'),
    ],
)  # fmt: skip
def test_bad_arrays_of_a_run_are_named(change, text):
    arrays = synthetic.make_run('wheel', 3)
    change(arrays)
    with pytest.raises(ValueError, match=text):
        raw_runs.run_of(arrays, synthetic.scene('wheel'), 3)


@pytest.mark.parametrize(
    ('scale', 'dt', 'bounds', 'text'),
    [
        ((1000, 1000), DT, synthetic.BOUNDS, 'lies outside the bounds: .* look like millimetres'),
        ((1000, 1000), DT, None, r'apart \(median\); these look like millimetres'),
        ((100, 100), DT, synthetic.BOUNDS, 'look like centimetres'),
        ((1, 1), 1e-5, None, 'the (soil|body) moves at .* dt is wrong'),
        ((1, 1000), DT, None, 'the body moves at .* unit of length'),
        ((1, 1), DT, [[2, 3]] * 3, 'the soil lies outside the bounds: it spans x 0.19'),
    ],
)
def test_other_units_are_found(tmp_path, scale, dt, bounds, text):
    raw = str(tmp_path / 'raw')
    soil, body = np.float32(scale)
    runs = [
        run
        | {'positions': soil * run['positions'], 'rigid_positions': body * run['rigid_positions']}
        for run in own_runs(2)
    ]
    with pytest.raises(ValueError, match=f'(?s){text}.*--nocheck_units'):
        write_raw(raw, runs, dt, up_axis='y', bounds=bounds)
    write_raw(raw, runs, dt, up_axis='y', bounds=bounds, check_units=False)
    with pytest.raises(ValueError, match='--nocheck_units'):
        RawRuns(raw).check()
    RawRuns(raw).check(check_units=False)


@pytest.mark.parametrize(
    ('up', 'gravity', 'doubt'),
    [
        ('z', None, r'up_axis is 2 \(z\) but y looks like the upward axis: free space'),
        ('y', [0, 0, -1.62], r'up_axis is 1 \(y\) but z .* gravity is \[0.0, 0.0, -1.62\]'),
        ('y', None, '^$'),
    ],
)
def test_a_wrong_up_axis_is_doubted(tmp_path, up, gravity, doubt):
    raw = str(tmp_path / 'raw')
    write_raw(raw, own_runs(2), DT, up_axis=up, bounds=synthetic.BOUNDS, gravity=gravity)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter('always')
        RawRuns(raw).check()
    assert re.search(doubt, ''.join(str(warning.message) for warning in told))


def test_other_orders_of_particles_are_matched(tmp_path):
    def shuffle(case, arrays):
        order = np.random.default_rng(case).permutation(140)
        arrays['positions'] = arrays['positions'][:, order] if case > 1 else arrays['positions']

    raw = synthetic.write_raw_folder(tmp_path / 'raw', 'excavation', range(1, 7), change=shuffle)
    with pytest.raises(ValueError, match=r'(?s)5 faults.*case 2: .*--match_particles.*full_space'):
        convert.convert(raw, str(tmp_path / 'out'))
    convert.convert(raw, str(tmp_path / 'out'), modes=3, match_particles=True)
    runs = RawRuns(raw)
    runs.check(match_particles=True)
    for run in runs:
        plain = synthetic.make_run('excavation', run.case)['positions']
        np.testing.assert_array_equal(run.positions, plain)


def test_scenes_without_a_body_in_two_dimensions_with_runs_of_different_lengths(tmp_path):
    def runs():
        for case, frames in enumerate((20, 24, 17, 30, 20, 22)):
            positions = synthetic.make_run('excavation', case + 1, frames)['positions']
            yield {'positions': positions[..., :2]}

    write_raw(str(tmp_path / 'raw'), runs(), 1 / 30, up_axis='y', name='collapse')
    manifest = json.loads((tmp_path / 'raw' / 'manifest.json').read_text())
    assert manifest['scene']['rigid_motion'] == 'none' and manifest['scene']['dim'] == 2
    metadata = convert.convert(str(tmp_path / 'raw'), str(tmp_path / 'out'), modes=3)
    assert metadata['sequence_length'] == 29 and metadata['particles_rigid'] == 0
    assert 'rigid_body_force_mean' not in metadata and metadata['acc_std'][2] == 0
    stored = {}
    for split, lengths in metadata['frames_of_runs'].items():
        read = dataset.read_split(str(tmp_path / 'out'), split)
        assert [run.n_frames for run in read] == lengths
        assert all(run.n_rigid == 0 and not run.position[..., 2].any() for run in read)
        stored |= dict(zip(metadata['dataset_split'][split], lengths))
    assert stored == dict(enumerate((20, 24, 17, 30, 20, 22)))


def test_several_bodies_keep_their_own_motion_force_and_pose(tmp_path):
    """A blade of 20 points and a wheel of 16 in one bin."""

    def runs():
        for case in range(6):
            blade, wheel = (synthetic.make_run(name, case) for name in ('excavation', 'wheel'))
            forces = np.stack([blade['force'], wheel['force']], axis=1)
            pose = np.tile(np.float32([0, 0, 0, 1, 0, 0, 0]), (24, 2, 1))
            points = [blade['rigid_positions'], wheel['rigid_positions'] + np.float32([0, 0, 2])]
            yield {
                'positions': blade['positions'],
                'rigid_positions': np.concatenate(points, axis=1),
                'force': forces.sum(axis=1),
                'body_force': forces,
                'body_pose': pose,
            }

    bodies = [
        {'name': 'blade', 'rigid_motion': 'prescribed', 'points': 20},
        {'name': 'wheel', 'rigid_motion': 'driven', 'points': 16},
    ]
    raw, out = str(tmp_path / 'raw'), str(tmp_path / 'out')
    write_raw(raw, runs(), DT, up_axis='y', body='driven', bodies=bodies)
    metadata = convert.convert(raw, out, modes=3)
    assert metadata['scene']['bodies'] == bodies
    run, wanted = dataset.read_split(out, 'test')[0], list(runs())
    case = metadata['dataset_split']['test'][0]
    assert run.particle_type.tolist() == [3] * 20 + [0] * 16 + [6] * 3
    np.testing.assert_array_equal(run.body_force, wanted[case]['body_force'])
    assert run.body_pose.shape == (24, 2, 7)
    inspection = inspect_folder(out)
    assert not inspection.failed, inspection.findings
    with pytest.raises(ValueError, match=r"several bodies \['blade', 'wheel'\]"):
        Scene.from_metadata(metadata)
    bodies[1]['points'] = 15
    with pytest.raises(ValueError, match="has 36 rigid points, its bodies {'blade': 20, 'wheel'"):
        write_raw(f'{raw}2', runs(), DT, up_axis='y', body='driven', bodies=bodies)
