"""Says what is in a dataset folder and checks it.

An ERROR means that training or evaluating on the folder would be wrong, and makes the exit code 1;
a WARN names a defect that readers live with, as all known ones of Subspace-Graph-Physics.

Examples:
    lts inspect datasets/excavation
    lts inspect /data/Subspace-Graph-Physics/Excavation_PCA
"""

import collections
import dataclasses
import itertools
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from pca_tools import command, dataset, encode, files, legacy_pickles, rigid_fit
from pca_tools.compression import PackedRuns
from pca_tools.dataset import Trajectory
from pca_tools.heights import Heights
from pca_tools.metadata import AXES, SPLITS
from pca_tools.particles import ParticleSample
from pca_tools.storage import markdown
from pca_tools.subspace import CLUSTER_GAP, Subspace

# A body that bends by more than this (m) between frames is not rigid; float32 positions near 1 m
# resolve 6e-8 m.
RIGID_TOLERANCE = 1e-4
# Scenes move at centimetres per second; half a second a frame or 10 m/s is a mistaken dt.
PLAUSIBLE_DT = (1e-4, 0.5)
PLAUSIBLE_SPEED = 10.0
# A run is far from the training runs if the modes leave this many times their error of it.
FAR_FACTOR = 3.0
# Statistics of a part of the runs differ from those of all runs, but not by this factor.
STATISTICS_FACTOR = 10.0
STATISTICS_TOLERANCE = 1e-4
OK, WARN, ERROR = 'OK', 'WARN', 'ERROR'
_MAX_NAMED = 5


@dataclasses.dataclass
class Inspection:
    """What is in a dataset folder."""

    folder: str
    metadata: dict[str, Any] | None = None  # None if unreadable
    splits: dict[str, list[Trajectory]] = dataclasses.field(default_factory=dict)  # readable runs
    # Results of all checks: OK, WARN or ERROR, and a sentence: what is and what to do
    findings: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    n_soil: int | None = None  # N, or None if nothing says it

    @property
    def runs(self) -> list[Trajectory]:
        return [run for part in self.splits.values() for run in part]

    def add(self, level: str, text: str) -> None:
        self.findings.append((level, text))

    @property
    def failed(self) -> bool:
        return any(level == ERROR for level, _ in self.findings)

    def of_split(self, key: str, split: str) -> list:
        """What the metadata hold under a key for each run of a split, [] for nothing."""
        return self.metadata.get(key, {}).get(split, [])


def inspect_folder(folder: str) -> Inspection:
    """Runs all checks on a dataset folder, ours or the authors'; a bad one raises nothing."""
    found = Inspection(folder)
    _run(found, _check_metadata)
    if found.metadata is None:
        return found
    for split in SPLITS:
        _run(found, _read_split, split)
    if not found.splits:
        found.add(ERROR, f'{folder}: holds no readable split')
    checks = (
        _check_nodes, _check_frames, _check_case_ids, _check_duplicates, _check_statistics,
        _check_motion, _check_truncation,
    )  # fmt: skip
    for check in checks if found.splits else ():
        _run(found, check)
    for kind in (ParticleSample, Heights):
        _run(found, _check_kept, kind)
    _run(found, _check_subspace)
    _run(found, _check_pickles)
    return found


def _run(found: Inspection, check, *arguments) -> None:
    """A file that cannot be read is an error."""
    try:
        check(found, *arguments)
    except (ValueError, OSError) as error:
        found.add(ERROR, str(error))


def _check_metadata(found: Inspection) -> None:
    found.metadata = dataset.read_metadata(found.folder)
    found.add(OK, 'metadata.json has all keys, with possible values')
    entries = files.check_manifest(found.folder)
    if entries is None:
        found.add(WARN, 'no manifest.json: a cut file may go unnoticed; compare the record counts')
    else:
        found.add(OK, f'manifest: {len(entries)} files have the bytes and sha256 that it lists')


def _read_split(found: Inspection, split: str) -> None:
    path = dataset.split_path(found.folder, split)
    if not os.path.exists(path):
        found.add(WARN, f'there is no {split}.tfrecord')
        return
    runs = dataset.read_records_as_trajectories(path)
    problems = [
        f'{path}: record {index}: {problem}'
        for index, run in enumerate(runs)
        for problem in dataset.trajectory_problems(run, found.metadata)
    ]
    for problem in problems:
        found.add(ERROR, problem)
    if not problems:
        found.splits[split] = runs
        found.add(OK, f'{split}: {len(runs)} records, complete, finite, as the metadata says')


def _check_nodes(found: Inspection) -> None:
    """Rigid counts and node types against the metadata."""
    promised = found.metadata.get('particles_rigid')
    counts = collections.Counter(run.n_rigid for run in found.runs)
    if promised is not None and set(counts) != {promised}:
        every = len(found.runs)
        held = ', '.join(f'{runs} of {every} runs have {n}' for n, runs in sorted(counts.items()))
        found.add(WARN, f'particles_rigid says {promised} but {held}; that of each record is used')
    scene = found.metadata.get('scene')
    if scene is None:
        found.add(WARN, 'no scene in the metadata: what is prescribed follows from the node types')
    elif 'bodies' not in scene:  # of several each has its own motion, and its types with it
        expected = dataset.rigid_type(scene['rigid_motion'])
        if wrong := sum(np.any(run.particle_type[: run.n_rigid] != expected) for run in found.runs):
            text = f'rigid nodes that are not of type {expected} ({scene["rigid_motion"]})'
            found.add(ERROR, f'{wrong} runs have {text}; convert the raw runs again')


def _check_frames(found: Inspection) -> None:
    if repeated := sum(np.array_equal(run.position[0], run.position[1]) for run in found.runs):
        text = 'runs begin with the same frame twice: frame 0 is not a state of its own'
        found.add(WARN, f'{repeated} of {len(found.runs)} {text}')
    still = [
        f'{split} {index}'
        for split, part in found.splits.items()
        for index, run in enumerate(part)
        if np.array_equal(run.position[0], run.position[-1])
    ]
    if still:
        found.add(WARN, f'nothing moves from first to last frame in {still[:_MAX_NAMED]}')
    for split, part in found.splits.items():
        if [run.key for run in part] != list(range(len(part))):
            keys = sorted({run.key for run in part})
            found.add(WARN, f'{split}: keys are {keys}, not the index of each record')


def _check_case_ids(found: Inspection) -> None:
    """Case ids: repeated, shared by splits, or not as many as records."""
    cases = found.metadata.get('dataset_split')
    if cases is None:
        found.add(WARN, 'no dataset_split: which case a record is remains unknown')
        return
    for split, part in found.splits.items():
        ids = cases.get(split, [])
        if len(ids) != len(set(ids)):
            text = f'{len(ids)} ids but {len(set(ids))} different ones: drawn with replacement'
            found.add(WARN, f'dataset_split.{split} has {text}')
        if len(ids) != len(part):
            text = f'records but {len(ids)} ids in dataset_split: which case is which is unknown'
            found.add(WARN, f'{split} has {len(part)} {text}')
    for first, second in itertools.combinations(SPLITS, 2):
        shared = sorted(set(cases.get(first, [])) & set(cases.get(second, [])), key=str)
        if shared:
            text = f'are in {first} and {second}: errors on {second} would flatter; split again'
            found.add(ERROR, f'the cases {shared[:_MAX_NAMED]} {text}')


def _check_duplicates(found: Inspection) -> None:
    places = collections.defaultdict(list)
    for split, part in found.splits.items():
        for index, run in enumerate(part):
            places[run.position.tobytes()].append((split, index))
    repeats = [same for same in places.values() if len(same) > 1]
    for same in repeats:
        text = ' = '.join(f'{split} {index}' for split, index in same)
        if len({split for split, _ in same}) > 1:
            found.add(ERROR, f'the same run lies in different splits: {text}; remove it from one')
        else:
            found.add(WARN, f'the same run lies in the file more than once: {text}')
    if not repeats:
        found.add(OK, f'all {len(found.runs)} runs differ')


def _check_statistics(found: Inspection) -> None:
    """Normalisation statistics: zero deviations, and agreement with the records."""
    held = found.metadata
    for key in ('vel_std', 'acc_std', 'rigid_body_force_std', 'context_std'):
        if zero := [axis for axis, value in enumerate(held.get(key, [])) if value == 0]:
            found.add(WARN, f'{key} is 0 at {zero}: constant there; what divides by it floors it')
    if 'train' not in found.splits:
        return
    # Statistics are of the runs that the subspace was fitted on: only a dataset that trains on just
    # these (none appended or left out, no folder of the authors') must have their very values.
    fitted, cases = held.get('pca', {}).get('fitted_on'), held.get('cases', {}).get('train')
    whole = cases is not None and (
        fitted is None or sorted(fitted) == sorted(str(case.get('case')) for case in cases)
    )
    errors = []
    for key, values in encode.motion_statistics(found.splits['train']).items():
        if key not in held:  # of the torque, which datasets without its statistics may have
            found.add(WARN, f'the training records have {key} {values}, the metadata lacks it')
            continue
        mean, promised = np.array(values), np.array(held[key])
        scale = np.linalg.norm(held[f'{key.rsplit("_", 1)[0]}_std'])
        ratio = scale / max(np.linalg.norm(mean), 1e-30)
        if whole and np.max(np.abs(mean - promised)) > STATISTICS_TOLERANCE * max(scale, 1e-12):
            errors.append(f'is {held[key]}, the training records give {values}; convert again')
        elif key.endswith('_std') and not 1 / STATISTICS_FACTOR < ratio < STATISTICS_FACTOR:
            per_second = f'(1 / dt is {1 / held["dt"]:.3g}): they are per frame, not per second'
            errors.append(f'is {ratio:.3g} times that of the training records {per_second}')
        else:
            continue
        found.add(ERROR, f'{key} {errors[-1]}')
    if not errors:
        text = 'statistics agree with the training records' + ('' if whole else ' in size')
        if fitted is not None and not whole:
            text += f': they are of the {len(fitted)} runs that the subspace was fitted on'
        found.add(OK, text)


def _check_motion(found: Inspection) -> None:
    dt = found.metadata['dt']
    if not PLAUSIBLE_DT[0] <= dt <= PLAUSIBLE_DT[1]:
        found.add(ERROR, f'dt is {dt} s, outside {PLAUSIBLE_DT}; is it in frames per second?')
    moved = [run for run in found.runs if run.n_rigid]
    if not moved:
        return
    bodies = [run.position[:, : run.n_rigid] for run in moved]
    fastest = max(float(np.linalg.norm(np.diff(b, axis=0), axis=-1).max()) for b in bodies) / dt
    if fastest > PLAUSIBLE_SPEED:
        text = f'reaches {fastest:.3g} m/s with dt = {dt} s: dt or the unit of length is wrong'
        found.add(ERROR, f'the rigid body {text}')
    bounds = found.metadata['bounds']
    low, high = np.array(bounds).T
    if outside := sum(bool(np.any((body < low) | (body > high))) for body in bodies):
        found.add(WARN, f'in {outside} of {len(moved)} runs rigid points leave the bounds {bounds}')
    points = [body['points'] for body in found.metadata.get('scene', {}).get('bodies', [])]
    worst = max(rigid_misfit(run, points) for run in moved)
    if worst > RIGID_TOLERANCE:
        found.add(ERROR, f'the rigid body changes its shape by up to {1e3 * worst:.3g} mm (RMS)')
    else:
        found.add(OK, f'the rigid body keeps its shape within {1e3 * worst:.2g} mm (RMS)')
    if forceless := sum(run.force is not None and not np.any(run.force) for run in found.runs):
        found.add(WARN, f'{forceless} runs have no force at any frame')


def rigid_misfit(run: Trajectory, points: Sequence[int] = ()) -> float:
    """Returns the largest RMS misfit (m) of a rigid motion from frame 0 to some others; of several
    bodies `points` says how many points each has."""
    later = np.unique(np.linspace(0, run.n_frames - 1, 9).astype(int))
    bodies = np.split(run.position[:, : run.n_rigid], np.cumsum(points, dtype=int)[:-1], axis=1)
    misfits = (
        rigid_fit.fit_rigid_motion(body[0], body[frame]).residual
        for body in bodies
        if body.shape[1] >= rigid_fit.MIN_POINTS
        for frame in later
    )
    return max(misfits, default=0.0)


def _check_truncation(found: Inspection) -> None:
    """Runs of valid and test that the modes do not hold: they differ from all training runs."""
    train = found.of_split('projection_mse', 'train')
    if not train:
        return
    usual, worst = np.mean(train) ** 0.5, max(train) ** 0.5
    far = [
        f'case {case} of {split} ({1e3 * mse**0.5:.3g} mm)'
        for split in SPLITS[1:]
        for case, mse in zip(
            found.of_split('dataset_split', split), found.of_split('projection_mse', split)
        )
        if mse**0.5 > max(FAR_FACTOR * usual, worst)
    ]
    if far:
        more = f' and {len(far) - _MAX_NAMED} more' if len(far) > _MAX_NAMED else ''
        found.add(
            WARN, f'the modes leave {1e3 * usual:.3g} mm (RMS) of the training runs, '
            f'{1e3 * worst:.3g} mm of the worst, but far more of {", ".join(far[:_MAX_NAMED])}'
            f'{more}: these runs do something that no training run does; add such runs to train'
        )  # fmt: skip


def _check_kept(found: Inspection, kind: type[PackedRuns]) -> None:
    good, low, high = [], math.inf, -math.inf
    for split, runs in found.splits.items():
        path = kind.path_of(found.folder, split)
        if not os.path.exists(path):
            continue
        kept, lengths = kind(path), []
        for values in kept:
            lengths.append(len(values))
            low, high = min(low, float(values.min())), max(high, float(values.max()))
        if lengths != [-(-run.n_frames // kept.frame_stride) for run in runs]:
            found.add(ERROR, f'{path}: holds other runs than {split}.tfrecord; convert again')
        else:
            good.append(f'{split} {os.path.getsize(path) / len(runs) / 1e3:.1f} kB')
    if good:
        span = f', {low:.3f} to {high:.3f} m high' * (kind is Heights)
        steps = f'every {kept.frame_stride} frames, to {5e2 * kept.resolution:.2g} mm'
        found.add(OK, f'{kind.TITLE}s ({kept}{span}, {steps}), a run: {", ".join(good)}')


def _check_subspace(found: Inspection) -> None:
    held = found.metadata
    name = held.get('pca', {}).get('file')
    if name is None:
        return
    space = Subspace.load(os.path.join(found.folder, os.path.basename(name)))
    found.n_soil = space.n_soil
    for what, promised, is_there in (
        ('digest', held['pca'].get('digest'), space.digest),
        ('mode_number', held['mode_number'], space.n_modes),
        ('n_soil', held.get('n_soil'), space.n_soil),
    ):
        if promised != is_there:
            text = f'is {is_there}, the metadata says {promised}: the scores are of another one'
            found.add(ERROR, f'{name}: {what} {text}')
    others = [*found.of_split('cases', 'valid'), *found.of_split('cases', 'test')]
    if seen := {str(case.get('case')) for case in others} & set(space.runs):
        found.add(ERROR, f'{name}: was fitted on {sorted(seen)}, which are not training runs')
    else:
        found.add(
            OK, f'{name}: {space.n_modes} modes of N = {space.n_soil}, fitted on training runs only'
        )
    gap = space.gaps[space.n_modes - 1] if len(space.gaps) >= space.n_modes else math.inf
    if gap < CLUSTER_GAP:
        text = f'differ by only {100 * gap:.1f} %: the last mode may turn from fit to fit'
        found.add(WARN, f'{name}: singular values {space.n_modes} and {space.n_modes + 1} {text}')


def _check_pickles(found: Inspection) -> None:
    for name, lost in (
        (legacy_pickles.EIGENVECTORS_NAME, '; scores cannot be decoded'),
        (legacy_pickles.EIGENVALUES_NAME, ''),
    ):
        path = os.path.join(found.folder, name)
        if not os.path.exists(path):
            continue
        try:
            files.refuse_git_lfs_pointer(path)
            if name == legacy_pickles.EIGENVALUES_NAME:
                found.n_soil = legacy_pickles.soil_particles(found.folder)
        except (ValueError, OSError) as error:
            found.add(WARN, f'{error}{lost}')


def report(found: Inspection) -> str:
    blocks = [found.folder]
    if found.metadata is not None:
        blocks.append(_contents(found))
    if found.splits:
        blocks += [_kinds(found), _ranges(found)]
    findings = [f'  {level:<6}{text}' for level, text in found.findings]
    counts = collections.Counter(level for level, _ in found.findings)
    total = '  ' + ', '.join(f'{counts[level]} {level}' for level in (OK, WARN, ERROR))
    blocks.append('\n'.join(['Findings', *findings, total]))
    return '\n\n'.join(filter(None, blocks))


def _contents(found: Inspection) -> str:
    held = found.metadata
    scene = held.get('scene')
    about = 'no scene given'
    if scene:
        name, up = scene.get('name', 'unnamed'), AXES[scene.get('up_axis', 1)]
        about = f'scene {name}, rigid motion {scene["rigid_motion"]}, {up} up'
    size = (
        f'dt {held["dt"]:.6g} s, {held["sequence_length"]} + 1 frames '
        f'({held["sequence_length"] * held["dt"]:.3g} s), r = {held["mode_number"]} modes, '
        f'N = {found.n_soil or "unknown"}'
    )
    rows = []
    for split, part in found.splits.items():
        series = []
        for name in dataset.FRAME_SERIES:
            count = sum(getattr(run, name) is not None for run in part)
            if count and name != 'step_context':
                series.append(name + f' ({count} runs)' * (count < len(part)))
        rigid = ', '.join(map(str, sorted({run.n_rigid for run in part})))
        context = 'no' if part[0].step_context is None else part[0].step_context.shape[1]
        rows.append((split, len(part), rigid, context, ', '.join(series)))
    header = ('split', 'runs', 'R', 'context', 'series')
    return f'{about}\n{size}\n\n' + markdown.table(header, rows, aligned=True)


def _kinds(found: Inspection) -> str:
    """Runs by kind (`kind` in their parameters) and split, and the share of their motion that the
    modes keep."""
    places = collections.defaultdict(list)  # (kind, split) -> records
    for split, part in found.splits.items():
        cases = found.of_split('cases', split) + [{}] * len(part)
        for index in range(len(part)):
            places[str(cases[index].get('kind', 'not stated')), split].append(index)
            places['all', split].append(index)

    def cell(kind: str, split: str) -> str:
        chosen = places[kind, split]
        kept, moved = (found.of_split(key, split) for key in ('motion_kept', 'motion_mse'))
        if not chosen or max(chosen) >= min(len(kept), len(moved)):
            return str(len(chosen) or '-')
        share = encode.mean_share([kept[i] for i in chosen], [moved[i] for i in chosen])
        return f'{len(chosen)} ({100 * share:.2f} %)'

    kinds = sorted({kind for kind, _ in places} - {'all'})
    kinds += ['all'] * (len(kinds) > 1)
    rows = [(kind, *(cell(kind, split) for split in found.splits)) for kind in kinds]
    return markdown.table(('runs (motion energy kept)', *found.splits), rows, aligned=True)


def _ranges(found: Inspection) -> str:
    runs = found.runs
    series = {
        'rigid position [m]': [run.position[:, : run.n_rigid] for run in runs],
        'rigid step [m/frame]': [np.diff(run.position[:, : run.n_rigid], axis=0) for run in runs],
        'mode score [m]': [run.position[:, run.n_rigid :] for run in runs],
        'mode step [m/frame]': [np.diff(run.position[:, run.n_rigid :], axis=0) for run in runs],
        'force [N]': [run.force for run in runs if run.force is not None],
        'torque [N m]': [run.torque for run in runs if run.torque is not None],
    }
    rows = []
    for name, samples in series.items():
        values = np.concatenate([np.empty((0, 3)), *(part.reshape(-1, 3) for part in samples)])
        if len(values):
            ends = zip(values.min(axis=0), values.max(axis=0))
            rows.append((name, *(f'{low:.3g} .. {high:.3g}' for low, high in ends)))
    if runs[0].step_context is not None:
        values = np.concatenate([run.step_context for run in runs])
        names = found.metadata.get('scene', {}).get('context_names') or range(values.shape[1])
        for name, low, high in zip(names, values.min(axis=0), values.max(axis=0)):
            rows.append((f'context {name}', f'{low:.4g} .. {high:.4g}'))
    return markdown.table(('range', 'x', 'y', 'z'), rows, aligned=True)


def main(_, arguments: Sequence[str]) -> int:
    found = inspect_folder(arguments[0])
    for line in report(found).splitlines():
        print(command.printable(line))
    return int(found.failed)


if __name__ == '__main__':
    command.start_quietly(main, 1, 'lts inspect DATASET')
