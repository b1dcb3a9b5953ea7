"""Checks of a dataset folder: every check gives findings, none stops the others.

An ERROR means that training or evaluating on the folder would be wrong; a WARN names a defect that
readers of this project live with (all known defects of the authors' folders are of this kind).
"""

from __future__ import annotations

import collections
import os

import numpy as np

from pca_tools import dataset, files, metadata, particles, rigid_fit, statistics
from pca_tools.dataset import Trajectory
from pca_tools.inspection.findings import Inspection
from pca_tools.inspection.subspace import check_legacy_files, check_subspace

# A body that bends by more than this between frames is not rigid (float32 positions near 1 m
# resolve 6e-8 m).
RIGID_TOLERANCE = 1e-4
# Scenes move at centimetres per second; a frame of half a second or a speed of 10 m/s is a mistaken
# dt.
PLAUSIBLE_DT = (1e-4, 0.5)
PLAUSIBLE_SPEED = 10.0
# Statistics of a part of the runs differ from those of all runs, but not by this factor.
# A run is far from the training runs if the modes leave so many times their error of it.
FAR_FACTOR = 3.0
MAX_NAMED = 5
STATISTICS_FACTOR = 10.0
STATISTICS_TOLERANCE = 1e-4


def inspect_folder(folder: str) -> Inspection:
    """Runs all checks on a dataset folder, ours or the authors'.

    Args:
        folder: dataset folder.

    Returns:
        What was found; nothing is raised for a bad dataset.
    """
    inspection = Inspection(folder)
    try:
        inspection.metadata = dataset.read_metadata(folder)
    except (ValueError, OSError) as error:
        inspection.error(str(error))
        return inspection
    inspection.ok('metadata.json has all keys, with possible values')
    _check_manifest(inspection)
    _read_splits(inspection)
    if inspection.runs:
        _check_nodes(inspection)
        _check_frames(inspection)
        _check_case_ids(inspection)
        _check_duplicates(inspection)
        _check_statistics(inspection)
        _check_motion(inspection)
    _check_truncation(inspection)
    _check_particles(inspection)
    check_subspace(inspection)
    check_legacy_files(inspection)
    return inspection


def _check_manifest(inspection: Inspection) -> None:
    try:
        entries = files.check_manifest(inspection.folder)
    except (ValueError, OSError) as error:
        inspection.error(str(error))
        return
    if entries is None:
        inspection.warn(
            'no manifest.json: a file cut at a record boundary would not be noticed; compare the '
            'record counts below with '
            'the source'
        )
    else:
        inspection.ok(f'manifest: {len(entries)} files have the bytes and sha256 that it lists')


def _read_splits(inspection: Inspection) -> None:
    for split in metadata.SPLITS:
        path = dataset.split_path(inspection.folder, split)
        if not os.path.exists(path):
            inspection.warn(f'there is no {split}.tfrecord')
            continue
        try:
            runs = dataset.read_records_as_trajectories(path)
        except (ValueError, OSError) as error:
            inspection.error(str(error))
            continue
        bad = 0
        for index, run in enumerate(runs):
            problems = dataset.trajectory_problems(run, inspection.metadata)
            bad += bool(problems)
            for problem in problems:
                inspection.error(f'{path}: record {index}: {problem}')
        if not bad:
            inspection.ok(f'{split}: {len(runs)} records, complete, finite, as the metadata says')
            inspection.splits[split] = runs
    if not inspection.splits:
        inspection.error(f'{inspection.folder}: holds no readable split')


def _check_nodes(inspection: Inspection) -> None:
    """Rigid counts and node types against the metadata."""
    promised = inspection.metadata.get('particles_rigid')
    counts = collections.Counter(run.n_rigid for run in inspection.runs)
    if promised is not None and set(counts) != {promised}:
        held = ', '.join(
            f'{runs} of {len(inspection.runs)} runs have {n}' for n, runs in sorted(counts.items())
        )
        inspection.warn(
            f'particles_rigid says {promised} but {held}; the count of each record is the one '
            'that is used'
        )
    motion = inspection.metadata.get('scene', {}).get('rigid_motion')
    if motion is None:
        inspection.warn('no scene in the metadata: what is prescribed follows from the node types')
        return
    if 'bodies' in inspection.metadata['scene']:
        return  # each has its own motion, and its types with it
    expected = (
        dataset.KINEMATIC_PARTICLE_ID if motion == 'prescribed' else dataset.RIGID_PARTICLE_ID
    )
    wrong = sum(not np.all(run.particle_type[: run.n_rigid] == expected) for run in inspection.runs)
    if wrong:
        inspection.error(
            f'{wrong} runs have rigid nodes that are not of type {expected}, which rigid_motion '
            f'{motion!r} asks for; '
            'convert the raw runs again'
        )


def _check_frames(inspection: Inspection) -> None:
    """Frames that repeat, and keys that do not count."""
    runs = inspection.runs
    repeated = sum(np.array_equal(run.position[0], run.position[1]) for run in runs)
    if repeated:
        inspection.warn(
            f'{repeated} of {len(runs)} runs begin with the same frame twice: their first '
            'velocity is 0, and frame 0 is not '
            'a state of its own'
        )
    still = [
        f'{split} {index}'
        for split, part in inspection.splits.items()
        for index, run in enumerate(part)
        if np.array_equal(run.position[0], run.position[-1])
    ]
    if still:
        inspection.warn(f'nothing moves from first to last frame in the records {still[:5]}')
    for split, part in inspection.splits.items():
        if [run.key for run in part] != list(range(len(part))):
            inspection.warn(
                f'{split}: keys are {sorted({run.key for run in part})}, not the index of each '
                'record; '
                'runs are told apart by their place in the file'
            )


def _check_case_ids(inspection: Inspection) -> None:
    """Case ids: repeated, shared by splits, or not as many as records."""
    cases = inspection.metadata.get('dataset_split')
    if cases is None:
        inspection.warn('no dataset_split: which case a record is remains unknown')
        return
    for split, part in inspection.splits.items():
        ids = cases.get(split, [])
        if len(ids) != len(set(ids)):
            inspection.warn(
                f'dataset_split.{split} has {len(ids)} ids but {len(set(ids))} different ones: it '
                'was drawn with replacement'
            )
        if len(ids) != len(part):
            inspection.warn(
                f'{split} has {len(part)} records, dataset_split.{split} names {len(ids)} cases: '
                'which record is which '
                'case cannot be told from it'
            )
    for first, second in (('train', 'valid'), ('train', 'test'), ('valid', 'test')):
        shared = sorted(set(cases.get(first, [])) & set(cases.get(second, [])), key=str)
        if shared:
            inspection.error(
                f'the cases {shared[:10]} are in {first} and {second}: errors on {second} would '
                'flatter; split again'
            )


def _check_duplicates(inspection: Inspection) -> None:
    places = collections.defaultdict(list)
    for split, part in inspection.splits.items():
        for index, run in enumerate(part):
            places[run.position.tobytes()].append((split, index))
    repeats = [found for found in places.values() if len(found) > 1]
    for found in repeats:
        text = ' = '.join(f'{split} {index}' for split, index in found)
        if len({split for split, _ in found}) > 1:
            inspection.error(f'the same run lies in different splits: {text}; remove it from one')
        else:
            inspection.warn(f'the same run lies in the file more than once: {text}')
    if not repeats:
        inspection.ok(f'all {len(inspection.runs)} runs differ')


def _check_statistics(inspection: Inspection) -> None:
    """Normalisation statistics: zero deviations, and agreement with the records."""
    held = inspection.metadata
    for key in ('vel_std', 'acc_std', 'rigid_body_force_std', 'context_std'):
        zero = [axis for axis, value in enumerate(held.get(key, [])) if value == 0]
        if zero:
            inspection.warn(
                f'{key} is 0 at {zero}: constant there; our training floors it, others must, too'
            )
    training = inspection.splits.get('train')
    if training is None:
        return
    found = statistics.motion_statistics(training)
    # Statistics are of the runs that the subspace was fitted on: only a dataset that trains on just
    # these (none appended or left out, no folder of the authors') must have their very values.
    fitted = held.get('pca', {}).get('fitted_on')
    trained = held.get('cases', {}).get('train')
    whole = trained is not None and (
        fitted is None or sorted(fitted) == sorted(str(case.get('case')) for case in trained)
    )
    agree = True
    for key, values in found.items():
        mean, promised = np.array(values), np.array(held[key])
        scale = np.linalg.norm(held[f'{key.rsplit("_", 1)[0]}_std'])
        if whole and np.max(np.abs(mean - promised)) > STATISTICS_TOLERANCE * max(scale, 1e-12):
            agree = False
            inspection.error(
                f'{key} is {held[key]}, the training records give {values}; convert again'
            )
        elif key.endswith('_std'):
            ratio = scale / max(np.linalg.norm(mean), 1e-30)
            if not 1 / STATISTICS_FACTOR < ratio < STATISTICS_FACTOR:
                agree = False
                inspection.error(
                    f'{key} is {ratio:.3g} times that of the training records (1 / dt is '
                    f'{1 / held["dt"]:.3g}): velocities '
                    'and accelerations are per frame, not divided by dt'
                )
    if agree:
        text = 'statistics agree with the training records' + ('' if whole else ' in size')
        if fitted is not None and not whole:
            text += f': they are of the {len(fitted)} runs that the subspace was fitted on'
        inspection.ok(text)


def _check_motion(inspection: Inspection) -> None:
    """Time step, speed and rigidity of the body."""
    dt = inspection.metadata['dt']
    if not PLAUSIBLE_DT[0] <= dt <= PLAUSIBLE_DT[1]:
        inspection.error(
            f'dt is {dt} s per frame, outside {PLAUSIBLE_DT}; is it in frames per second?'
        )
    with_body = [run for run in inspection.runs if run.n_rigid]
    if not with_body:
        return
    fastest = max(
        float(np.max(np.linalg.norm(np.diff(run.position[:, : run.n_rigid], axis=0), axis=-1)))
        for run in with_body
    )
    if fastest / dt > PLAUSIBLE_SPEED:
        inspection.error(
            f'the rigid body reaches {fastest / dt:.3g} m/s with dt = {dt} s: dt or the unit of '
            'length is wrong'
        )
    points = [body['points'] for body in inspection.metadata.get('scene', {}).get('bodies', [])]
    worst = max(rigid_misfit(run, points) for run in with_body)
    low, high = np.array(inspection.metadata['bounds']).T
    outside = sum(
        bool(
            np.any(run.position[:, : run.n_rigid] < low)
            or np.any(run.position[:, : run.n_rigid] > high)
        )
        for run in with_body
    )
    if outside:
        inspection.warn(
            f'in {outside} of {len(with_body)} runs rigid points leave the bounds '
            f'{inspection.metadata["bounds"]}'
        )
    if worst > RIGID_TOLERANCE:
        inspection.error(f'the rigid body changes its shape by up to {1e3 * worst:.3g} mm (RMS)')
    else:
        inspection.ok(f'the rigid body keeps its shape within {1e3 * worst:.2g} mm (RMS)')
    forceless = sum(run.force is not None and not np.any(run.force) for run in inspection.runs)
    if forceless:
        inspection.warn(f'{forceless} runs have no force at any frame')


def _check_truncation(inspection: Inspection) -> None:
    """Runs of valid and test that the modes do not hold: they differ from all training runs."""
    errors = inspection.metadata.get('projection_mse', {})
    train = errors.get('train')
    if not train:
        return
    usual, worst = np.mean(train) ** 0.5, max(train) ** 0.5
    cases = inspection.metadata.get('dataset_split', {})
    far = [
        f'case {case} of {split} ({1e3 * mse**0.5:.3g} mm)'
        for split in ('valid', 'test')
        for case, mse in zip(cases.get(split, []), errors.get(split, []))
        if mse**0.5 > max(FAR_FACTOR * usual, worst)
    ]
    if far:
        more = f' and {len(far) - MAX_NAMED} more' if len(far) > MAX_NAMED else ''
        inspection.warn(
            f'the modes leave {1e3 * usual:.3g} mm (RMS) of the training runs, {1e3 * worst:.3g} '
            f'mm of the worst, but far more of {", ".join(far[:MAX_NAMED])}{more}: these runs do '
            'something that no training run does; add such runs to train'
        )


def _check_particles(inspection: Inspection) -> None:
    """The particle samples beside the records."""
    good = []
    for split, runs in inspection.splits.items():
        path = particles.sample_path(inspection.folder, split)
        if not os.path.exists(path):
            continue
        try:
            sample = particles.ParticleSample(path)
            frames = [
                -(-run.n_frames // sample.frame_stride) == len(sample[index])
                for index, run in enumerate(runs[: len(sample)])
            ]
        except (ValueError, OSError) as error:
            inspection.error(str(error))
            continue
        if len(sample) != len(runs) or not all(frames):
            inspection.error(f'{path}: holds other runs than {split}.tfrecord; convert again')
        else:
            good.append(f'{split} {os.path.getsize(path) / len(runs) / 1e3:.1f} kB')
    if good:
        inspection.ok(
            f'particle samples ({len(sample.indices)} particles, every {sample.frame_stride} '
            f'frames, to {5e2 * sample.resolution:.2g} mm), a run: ' + ', '.join(good)
        )


def rigid_misfit(run: Trajectory, points: list[int] = (), frames: int = 9) -> float:
    """Returns the largest RMS misfit in metres of a rigid motion from frame 0 to some others.

    Args:
        run: the run.
        points: how many points each of several bodies has; none for one body.
        frames: how many later frames are looked at.
    """
    later = np.unique(np.linspace(0, run.n_frames - 1, frames).astype(int))
    bodies = np.split(run.position[:, : run.n_rigid], np.cumsum(points, dtype=int)[:-1], axis=1)
    return max(
        (
            rigid_fit.fit_rigid_motion(body[0], body[frame]).residual
            for body in bodies
            if body.shape[1] >= rigid_fit.MIN_POINTS
            for frame in later
        ),
        default=0.0,
    )
