"""Says what is in a dataset folder and checks it.

An ERROR means that training or evaluating on the folder would be wrong, and makes the exit code 1;
a WARN names a defect that readers live with (all known defects of the authors' folders are such).

Examples:
    python -m pca_tools.inspect datasets/Excavation
    python -m pca_tools.inspect --modes=16 /data/Subspace-Graph-Physics/Excavation_PCA
"""

from __future__ import annotations

import collections
import dataclasses
import enum
import math
import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from absl import flags

from pca_tools import command, dataset, files, legacy_pickles, particles, rigid_fit, statistics
from pca_tools.dataset import Trajectory
from pca_tools.metadata import AXES, SPLITS
from pca_tools.statistics import HISTORY, mean_share
from pca_tools.subspace import CLUSTER_GAP, Subspace

# A body that bends by more than this (m) between frames is not rigid; float32 positions near 1 m
# resolve 6e-8 m.
RIGID_TOLERANCE = 1e-4
# Scenes move at centimetres per second; half a second a frame or 10 m/s is a mistaken dt.
PLAUSIBLE_DT = (1e-4, 0.5)
PLAUSIBLE_SPEED = 10.0
# A run is far from the training runs if the modes leave so many times their error of it.
FAR_FACTOR = 3.0
# Statistics of a part of the runs differ from those of all runs, but not by this factor.
STATISTICS_FACTOR = 10.0
STATISTICS_TOLERANCE = 1e-4
_MAX_NAMED = 5


class Level(enum.Enum):
    """How bad a finding is."""

    OK = 'OK'
    WARN = 'WARN'
    ERROR = 'ERROR'


@dataclasses.dataclass(frozen=True)
class Finding:
    """One result of a check: a level and a sentence that says what is and what to do."""

    level: Level
    text: str


@dataclasses.dataclass
class Inspection:
    """What is in a dataset folder.

    Attributes:
        folder: the folder.
        metadata: its metadata, or None if unreadable.
        splits: split -> readable runs.
        findings: results of all checks.
        n_soil: N, or None if nothing says it.
        floors: truncation error in m^2 against the number of modes [S + 1], or None.
    """

    folder: str
    metadata: dict[str, Any] | None = None
    splits: dict[str, list[Trajectory]] = dataclasses.field(default_factory=dict)
    findings: list[Finding] = dataclasses.field(default_factory=list)
    n_soil: int | None = None
    floors: np.ndarray | None = None

    @property
    def runs(self) -> list[Trajectory]:
        """All readable runs of all splits."""
        return [run for part in self.splits.values() for run in part]

    @property
    def failed(self) -> bool:
        """True if any finding is an error."""
        return any(finding.level is Level.ERROR for finding in self.findings)

    def of_split(self, key: str, split: str) -> list:
        """Returns what the metadata hold under a key for each run of a split, [] for nothing."""
        return self.metadata.get(key, {}).get(split, [])

    def ok(self, text: str) -> None:
        """Adds a passed check."""
        self.findings.append(Finding(Level.OK, text))

    def warn(self, text: str) -> None:
        """Adds a defect that readers live with."""
        self.findings.append(Finding(Level.WARN, text))

    def error(self, text: str) -> None:
        """Adds a defect that makes the folder unusable."""
        self.findings.append(Finding(Level.ERROR, text))


def inspect_folder(folder: str) -> Inspection:
    """Runs all checks on a dataset folder, ours or the authors'.

    Returns:
        What was found; nothing is raised for a bad dataset.
    """
    found = Inspection(folder)
    try:
        found.metadata = dataset.read_metadata(folder)
    except (ValueError, OSError) as error:
        found.error(str(error))
        return found
    found.ok('metadata.json has all keys, with possible values')
    _check_manifest(found)
    _read_splits(found)
    if found.runs:
        for check in (
            _check_nodes, _check_frames, _check_case_ids, _check_duplicates, _check_statistics,
            _check_motion, _check_truncation,
        ):  # fmt: skip
            check(found)
    _check_particles(found)
    _check_subspace(found)
    _check_pickles(found)
    return found


def _check_manifest(found: Inspection) -> None:
    try:
        entries = files.check_manifest(found.folder)
    except (ValueError, OSError) as error:
        found.error(str(error))
        return
    if entries is None:
        found.warn(
            'no manifest.json: a file cut at a record boundary would not be noticed; compare the '
            'record counts below with the source'
        )
    else:
        found.ok(f'manifest: {len(entries)} files have the bytes and sha256 that it lists')


def _read_splits(found: Inspection) -> None:
    for split in SPLITS:
        path = dataset.split_path(found.folder, split)
        if not os.path.exists(path):
            found.warn(f'there is no {split}.tfrecord')
            continue
        try:
            runs = dataset.read_records_as_trajectories(path)
        except (ValueError, OSError) as error:
            found.error(str(error))
            continue
        problems = [
            f'{path}: record {index}: {problem}'
            for index, run in enumerate(runs)
            for problem in dataset.trajectory_problems(run, found.metadata)
        ]
        for problem in problems:
            found.error(problem)
        if not problems:
            found.ok(f'{split}: {len(runs)} records, complete, finite, as the metadata says')
            found.splits[split] = runs
    if not found.splits:
        found.error(f'{found.folder}: holds no readable split')


def _check_nodes(found: Inspection) -> None:
    """Rigid counts and node types against the metadata."""
    promised = found.metadata.get('particles_rigid')
    counts = collections.Counter(run.n_rigid for run in found.runs)
    if promised is not None and set(counts) != {promised}:
        held = ', '.join(
            f'{runs} of {len(found.runs)} runs have {n}' for n, runs in sorted(counts.items())
        )
        found.warn(
            f'particles_rigid says {promised} but {held}; the count of each record is the one '
            'that is used'
        )
    scene = found.metadata.get('scene')
    if scene is None:
        found.warn('no scene in the metadata: what is prescribed follows from the node types')
        return
    if 'bodies' in scene:
        return  # each has its own motion, and its types with it
    given = scene['rigid_motion'] == 'prescribed'
    expected = dataset.KINEMATIC_PARTICLE_ID if given else dataset.RIGID_PARTICLE_ID
    wrong = sum(not np.all(run.particle_type[: run.n_rigid] == expected) for run in found.runs)
    if wrong:
        found.error(
            f'{wrong} runs have rigid nodes that are not of type {expected}, which rigid_motion '
            f'{scene["rigid_motion"]!r} asks for; convert the raw runs again'
        )


def _check_frames(found: Inspection) -> None:
    """Frames that repeat, and keys that do not count."""
    runs = found.runs
    repeated = sum(np.array_equal(run.position[0], run.position[1]) for run in runs)
    if repeated:
        found.warn(
            f'{repeated} of {len(runs)} runs begin with the same frame twice: their first '
            'velocity is 0, and frame 0 is not a state of its own'
        )
    still = [
        f'{split} {index}'
        for split, part in found.splits.items()
        for index, run in enumerate(part)
        if np.array_equal(run.position[0], run.position[-1])
    ]
    if still:
        found.warn(f'nothing moves from first to last frame in the records {still[:_MAX_NAMED]}')
    for split, part in found.splits.items():
        if [run.key for run in part] != list(range(len(part))):
            found.warn(
                f'{split}: keys are {sorted({run.key for run in part})}, not the index of each '
                'record; runs are told apart by their place in the file'
            )


def _check_case_ids(found: Inspection) -> None:
    """Case ids: repeated, shared by splits, or not as many as records."""
    cases = found.metadata.get('dataset_split')
    if cases is None:
        found.warn('no dataset_split: which case a record is remains unknown')
        return
    for split, part in found.splits.items():
        ids = cases.get(split, [])
        if len(ids) != len(set(ids)):
            found.warn(
                f'dataset_split.{split} has {len(ids)} ids but {len(set(ids))} different ones: it '
                'was drawn with replacement'
            )
        if len(ids) != len(part):
            found.warn(
                f'{split} has {len(part)} records, dataset_split.{split} names {len(ids)} cases: '
                'which record is which case cannot be told from it'
            )
    for first, second in (('train', 'valid'), ('train', 'test'), ('valid', 'test')):
        shared = sorted(set(cases.get(first, [])) & set(cases.get(second, [])), key=str)
        if shared:
            found.error(
                f'the cases {shared[:_MAX_NAMED]} are in {first} and {second}: errors on {second} '
                'would flatter; split again'
            )


def _check_duplicates(found: Inspection) -> None:
    places = collections.defaultdict(list)
    for split, part in found.splits.items():
        for index, run in enumerate(part):
            places[run.position.tobytes()].append((split, index))
    repeats = [same for same in places.values() if len(same) > 1]
    for same in repeats:
        text = ' = '.join(f'{split} {index}' for split, index in same)
        if len({split for split, _ in same}) > 1:
            found.error(f'the same run lies in different splits: {text}; remove it from one')
        else:
            found.warn(f'the same run lies in the file more than once: {text}')
    if not repeats:
        found.ok(f'all {len(found.runs)} runs differ')


def _check_statistics(found: Inspection) -> None:
    """Normalisation statistics: zero deviations, and agreement with the records."""
    held = found.metadata
    for key in ('vel_std', 'acc_std', 'rigid_body_force_std', 'context_std'):
        zero = [axis for axis, value in enumerate(held.get(key, [])) if value == 0]
        if zero:
            found.warn(
                f'{key} is 0 at {zero}: constant there; our training floors it, others must, too'
            )
    if 'train' not in found.splits:
        return
    # Statistics are of the runs that the subspace was fitted on: only a dataset that trains on just
    # these (none appended or left out, no folder of the authors') must have their very values.
    fitted, cases = held.get('pca', {}).get('fitted_on'), held.get('cases', {}).get('train')
    whole = cases is not None and (
        fitted is None or sorted(fitted) == sorted(str(case.get('case')) for case in cases)
    )
    before = len(found.findings)
    for key, values in statistics.motion_statistics(found.splits['train']).items():
        mean, promised = np.array(values), np.array(held[key])
        scale = np.linalg.norm(held[f'{key.rsplit("_", 1)[0]}_std'])
        ratio = scale / max(np.linalg.norm(mean), 1e-30)
        if whole and np.max(np.abs(mean - promised)) > STATISTICS_TOLERANCE * max(scale, 1e-12):
            found.error(f'{key} is {held[key]}, the training records give {values}; convert again')
        elif key.endswith('_std') and not 1 / STATISTICS_FACTOR < ratio < STATISTICS_FACTOR:
            found.error(
                f'{key} is {ratio:.3g} times that of the training records (1 / dt is '
                f'{1 / held["dt"]:.3g}): velocities and accelerations are per frame, not divided '
                'by dt'
            )
    if len(found.findings) == before:
        text = 'statistics agree with the training records' + ('' if whole else ' in size')
        if fitted is not None and not whole:
            text += f': they are of the {len(fitted)} runs that the subspace was fitted on'
        found.ok(text)


def _check_motion(found: Inspection) -> None:
    """Time step, speed and rigidity of the body."""
    dt = found.metadata['dt']
    if not PLAUSIBLE_DT[0] <= dt <= PLAUSIBLE_DT[1]:
        found.error(f'dt is {dt} s per frame, outside {PLAUSIBLE_DT}; is it in frames per second?')
    moved = [run for run in found.runs if run.n_rigid]
    if not moved:
        return
    bodies = [run.position[:, : run.n_rigid] for run in moved]
    fastest = max(float(np.linalg.norm(np.diff(b, axis=0), axis=-1).max()) for b in bodies) / dt
    if fastest > PLAUSIBLE_SPEED:
        found.error(
            f'the rigid body reaches {fastest:.3g} m/s with dt = {dt} s: dt or the unit of '
            'length is wrong'
        )
    bounds = found.metadata['bounds']
    low, high = np.array(bounds).T
    outside = sum(bool(np.any((body < low) | (body > high))) for body in bodies)
    if outside:
        found.warn(f'in {outside} of {len(moved)} runs rigid points leave the bounds {bounds}')
    points = [body['points'] for body in found.metadata.get('scene', {}).get('bodies', [])]
    worst = max(rigid_misfit(run, points) for run in moved)
    if worst > RIGID_TOLERANCE:
        found.error(f'the rigid body changes its shape by up to {1e3 * worst:.3g} mm (RMS)')
    else:
        found.ok(f'the rigid body keeps its shape within {1e3 * worst:.2g} mm (RMS)')
    forceless = sum(run.force is not None and not np.any(run.force) for run in found.runs)
    if forceless:
        found.warn(f'{forceless} runs have no force at any frame')


def rigid_misfit(run: Trajectory, points: Sequence[int] = (), frames: int = 9) -> float:
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
        found.warn(
            f'the modes leave {1e3 * usual:.3g} mm (RMS) of the training runs, {1e3 * worst:.3g} '
            f'mm of the worst, but far more of {", ".join(far[:_MAX_NAMED])}{more}: these runs do '
            'something that no training run does; add such runs to train'
        )


def _check_particles(found: Inspection) -> None:
    """The particle samples beside the records."""
    good = []
    for split, runs in found.splits.items():
        path = particles.sample_path(found.folder, split)
        if not os.path.exists(path):
            continue
        try:
            sample = particles.ParticleSample(path)
            whole = len(sample) == len(runs) and all(
                -(-run.n_frames // sample.frame_stride) == len(soil)
                for run, soil in zip(runs, sample)
            )
        except (ValueError, OSError) as error:
            found.error(str(error))
            continue
        if whole:
            good.append(f'{split} {os.path.getsize(path) / len(runs) / 1e3:.1f} kB')
        else:
            found.error(f'{path}: holds other runs than {split}.tfrecord; convert again')
    if good:
        found.ok(
            f'particle samples ({len(sample.indices)} particles, every {sample.frame_stride} '
            f'frames, to {5e2 * sample.resolution:.2g} mm), a run: ' + ', '.join(good)
        )


def _check_subspace(found: Inspection) -> None:
    """`subspace.npz` against metadata and splits."""
    held = found.metadata
    name = held.get('pca', {}).get('file')
    if name is None:
        return
    try:
        space = Subspace.load(os.path.join(found.folder, os.path.basename(name)))
    except (ValueError, OSError) as error:
        found.error(str(error))
        return
    found.n_soil, found.floors = space.n_soil, space.projection_floors
    for what, promised, is_there in (
        ('digest', held['pca'].get('digest'), space.digest),
        ('mode_number', held['mode_number'], space.n_modes),
        ('n_soil', held.get('n_soil'), space.n_soil),
    ):
        if promised != is_there:
            found.error(
                f'{name}: {what} is {is_there}, the metadata says {promised}; the scores belong '
                'to another subspace'
            )
    others = [*found.of_split('cases', 'valid'), *found.of_split('cases', 'test')]
    seen = {str(case.get('case')) for case in others} & set(space.runs)
    if seen:
        found.error(f'{name}: was fitted on {sorted(seen)}, which are not training runs')
    else:
        found.ok(
            f'{name}: {space.n_modes} modes of N = {space.n_soil}, fitted on training runs only'
        )
    gap = space.gaps[space.n_modes - 1] if len(space.gaps) >= space.n_modes else math.inf
    if gap < CLUSTER_GAP:
        found.warn(
            f'{name}: singular values {space.n_modes} and {space.n_modes + 1} differ by only '
            f'{100 * gap:.1f} %: the last mode may turn from fit to fit'
        )


def _check_pickles(found: Inspection) -> None:
    """The authors' pickles beside their records."""
    vectors = os.path.join(found.folder, legacy_pickles.EIGENVECTORS_NAME)
    if os.path.exists(vectors):
        try:
            files.refuse_git_lfs_pointer(vectors)
        except ValueError as error:
            found.warn(f'{error}; scores cannot be decoded, errors are given in the subspace')
    name = legacy_pickles.EIGENVALUES_NAME
    if not os.path.exists(os.path.join(found.folder, name)):
        return
    try:
        values = legacy_pickles.read_array(os.path.join(found.folder, name))
    except ValueError as error:
        found.warn(str(error))
        return
    negative = int(np.count_nonzero(values.real < 0))
    if np.iscomplexobj(values) or negative:
        found.warn(
            f'{name}: type {values.dtype}, {negative} of {len(values)} values are negative: they '
            'come from a solver for non-symmetric matrices; negative ones are taken as 0'
        )
    found.n_soil = len(values)
    if found.runs:
        found.floors, runs = floors_of_eigenvalues(values.real, found.runs)
        found.warn(
            f'the mode energies of the records fit eigenvalues of {runs:.0f} runs: the published '
            'modes were fitted on all runs, validation and test included'
        )


def floors_of_eigenvalues(
    eigenvalues: np.ndarray, runs: Sequence[Trajectory]
) -> tuple[np.ndarray, float]:
    """Turns the published eigenvalues into truncation errors.

    They are those of X^T X / (N - 1) (thesis Algorithm 1), so their sum grows with the number of
    runs, which is not written anywhere. It follows from the energy of the kept modes in the
    records.

    Args:
        eigenvalues: [N], descending; negative ones count as 0.
        runs: some runs of the same subspace.

    Returns:
        floors in m^2 for 0..N modes [N + 1], and the number of runs the eigenvalues were summed
        over.
    """
    energies = np.maximum(eigenvalues, 0.0) * (len(eigenvalues) - 1)
    n_modes, n_rows = runs[0].n_modes, 3 * runs[0].n_frames
    per_run = np.mean(
        [np.sum(run.position[:, run.n_rigid :].astype(np.float64) ** 2) for run in runs]
    )
    n_runs = float(energies[:n_modes].sum() / per_run)
    tails = np.concatenate([[energies.sum()], energies.sum() - np.cumsum(energies)])
    return np.maximum(tails, 0.0) / (n_runs * n_rows * len(eigenvalues)), n_runs


def report(found: Inspection, modes: int = 12) -> str:
    """Returns the report as text: contents, ranges, floors, findings.

    Args:
        found: of `inspect_folder`.
        modes: rows of the table of truncation errors.
    """
    lines = [found.folder]
    if found.metadata is not None:
        lines += _contents(found) + _kinds(found) + _ranges(found) + _trivial(found)
        lines += _floors(found, modes)
    lines += ['', 'Findings']
    lines += [f'  {finding.level.value:<6}{finding.text}' for finding in found.findings]
    counts = {level: sum(f.level is level for f in found.findings) for level in Level}
    lines.append('  ' + ', '.join(f'{count} {level.value}' for level, count in counts.items()))
    return '\n'.join(lines)


def _contents(found: Inspection) -> list[str]:
    held = found.metadata
    scene = held.get('scene')
    lines = [
        f'  scene {scene.get("name", "unnamed")}, rigid motion {scene["rigid_motion"]}, '
        f'{AXES[scene.get("up_axis", 1)]} up'
        if scene
        else '  no scene given',
        f'  dt {held["dt"]:.6g} s, {held["sequence_length"]} + 1 frames '
        f'({held["sequence_length"] * held["dt"]:.3g} s), r = {held["mode_number"]} modes, '
        f'N = {found.n_soil or "unknown"}',
        '',
        f'  {"split":<7}{"runs":>5}  {"R":<10}{"context":<9}{"series":<30}',
    ]
    for split, part in found.splits.items():
        rigid = ', '.join(str(count) for count in sorted({run.n_rigid for run in part}))
        context = 'no' if part[0].step_context is None else str(part[0].step_context.shape[1])
        series = [
            name + ('' if count == len(part) else f' ({count} runs)')
            for name in dataset.FRAME_SERIES
            if name != 'step_context'
            and (count := sum(getattr(run, name) is not None for run in part))
        ]
        lines.append(f'  {split:<7}{len(part):>5}  {rigid:<10}{context:<9}{", ".join(series)}')
    return lines


def _kinds(found: Inspection) -> list[str]:
    """Runs by kind (`kind` in their parameters) and split, and the share of their motion that the
    modes keep."""
    cells: dict[str, dict[str, list[int]]] = {}
    for split, part in found.splits.items():
        cases = found.of_split('cases', split)
        for index in range(len(part)):
            case = cases[index] if index < len(cases) and isinstance(cases[index], dict) else {}
            places = cells.setdefault(str(case.get('kind', 'not stated')), {})
            places.setdefault(split, []).append(index)
    lines = ['', '  runs (motion energy kept)' + ''.join(f'{name:>20}' for name in found.splits)]
    rows = dict(sorted(cells.items())) | ({} if len(cells) < 2 else {'all': {}})
    for kind, places in rows.items():
        texts = []
        for split, part in found.splits.items():
            chosen = places.get(split, []) if places else list(range(len(part)))
            kept, moved = (found.of_split(k, split) for k in ('motion_kept', 'motion_mse'))
            text = str(len(chosen) or '-')
            if chosen and max(chosen) < min(len(kept), len(moved)):
                share = mean_share([kept[i] for i in chosen], [moved[i] for i in chosen])
                text += f' ({100 * share:.2f} %)'
            texts.append(f'{text:>20}')
        lines.append(f'    {kind:<23}{"".join(texts)}')
    return lines if found.splits else []


def _ranges(found: Inspection) -> list[str]:
    """Smallest and largest values over all runs."""
    runs = found.runs
    if not runs:
        return []
    rows = {
        'rigid position [m]': [run.position[:, : run.n_rigid] for run in runs],
        'rigid step [m/frame]': [np.diff(run.position[:, : run.n_rigid], axis=0) for run in runs],
        'mode score [m]': [run.position[:, run.n_rigid :] for run in runs],
        'mode step [m/frame]': [np.diff(run.position[:, run.n_rigid :], axis=0) for run in runs],
        'force [N]': [run.force for run in runs if run.force is not None],
        'torque [N m]': [run.torque for run in runs if run.torque is not None],
    }
    lines = ['', f'  {"range":<22}{"x":>22}{"y":>22}{"z":>22}']
    for name, samples in rows.items():
        values = np.concatenate([sample.reshape(-1, 3) for sample in samples] or [np.empty((0, 3))])
        if len(values):
            ends = zip(values.min(axis=0), values.max(axis=0))
            cells = ''.join(f'{f"{low:.3g} .. {high:.3g}":>22}' for low, high in ends)
            lines.append(f'  {name:<22}{cells}')
    if runs[0].step_context is not None:
        values = np.concatenate([run.step_context for run in runs])
        names = found.metadata.get('scene', {}).get('context_names') or range(values.shape[1])
        for name, low, high in zip(names, values.min(axis=0), values.max(axis=0)):
            lines.append(f'  {f"context {name}":<30}{low:.4g} .. {high:.4g}')
    return lines


def _trivial(found: Inspection) -> list[str]:
    """Errors of the predictors that need no model; only where N is known."""
    if found.n_soil is None or not found.runs:
        return []
    lines = [
        '',
        '  soil MSE of the trivial predictors [1e-4 m^2]     persistence  constant velocity',
    ]
    for split, part in found.splits.items():
        long = [run for run in part if run.n_frames > HISTORY]
        if len(long) < len(part):
            lines.append(
                f'    {split}: {len(part) - len(long)} runs of {HISTORY} frames or fewer, which a '
                'model is given, are left out'
            )
        if long:
            errors = [statistics.trivial_errors(run, found.n_soil) for run in long]
            still, constant = (
                1e4 * np.mean([error[key] for error in errors])
                for key in ('stay_still', 'constant_velocity')
            )
            lines.append(f'    {split:<46}{still:>12.4g}{constant:>20.4g}')
    return lines


def _floors(found: Inspection, modes: int) -> list[str]:
    """Truncation error against the number of modes: of the fit by mode, and by split."""
    lines = []
    if found.floors is not None:
        kept = found.metadata['mode_number']
        lines += ['', '  modes   truncation error [1e-4 m^2]   RMS [mm]']
        for count in sorted({*range(1, min(modes, len(found.floors) - 1) + 1), kept}):
            mse, mark = found.floors[count], '  <- kept' * (count == kept)
            lines.append(f'  {count:>5}{1e4 * mse:>30.4g}{1e3 * mse**0.5:>11.3f}{mark}')
    held = found.metadata.get('projection_floors')
    if isinstance(held, dict) and isinstance(held.get('modes'), list):
        lines += ['', '  RMS that modes leave [mm]' + ''.join(f'{m:>10}' for m in held['modes'])]
        for split in [name for name in held if name != 'modes']:
            cells = ''.join(f'{1e3 * value**0.5:>10.3f}' for value in held[split])
            lines.append(f'    {split:<23}{cells}')
    return lines


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('modes', 12, 'Rows of the table of truncation errors.')


def main(values, arguments: Sequence[str]) -> int:
    """Runs the command."""
    if not arguments:
        sys.exit('usage: python -m pca_tools.inspect [--modes=12] DATASET')
    found = inspect_folder(arguments[0])
    for line in report(found, values.modes).splitlines():
        print(files.printable(line))
    return int(found.failed)


if __name__ == '__main__':
    define_flags()
    command.start_quietly(main, 1)
