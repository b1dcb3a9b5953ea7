"""Says what is in a dataset folder and checks it.

Exit code 0: usable (warnings name known defects); 1: at least one error.

Examples:
    python -m pca_tools.inspect datasets/Excavation
    python -m pca_tools.inspect --modes=16 /data/Subspace-Graph-Physics/Excavation_PCA
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import numpy as np
from absl import app, flags

from pca_tools import files
from pca_tools.dataset import Trajectory
from pca_tools.inspection import inspect_folder, run_kinds
from pca_tools.inspection.findings import Inspection, Level
from pca_tools.raw_checks import AXES
from pca_tools.statistics import HISTORY, mean_share, trivial_errors


def report(inspection: Inspection, modes: int = 12) -> str:
    """Returns the report as text: contents, ranges, floors, motion, findings.

    Args:
        inspection: of `inspect_folder`.
        modes: rows of the table of truncation errors.
    """
    lines = [inspection.folder]
    if inspection.metadata is not None:
        lines += _contents(inspection)
        lines += run_kinds.kind_table(inspection)
        lines += _ranges(inspection)
        lines += _trivial(inspection)
        lines += run_kinds.force_table(inspection)
        lines += run_kinds.leak_table(inspection)
        lines += _floors(inspection, modes)
        lines += run_kinds.floor_table(inspection)
        lines += _motion(inspection)
    lines += ['', 'Findings']
    lines += [f'  {finding.level.value:<6}{finding.text}' for finding in inspection.findings]
    counts = {level: sum(f.level is level for f in inspection.findings) for level in Level}
    lines.append('  ' + ', '.join(f'{count} {level.value}' for level, count in counts.items()))
    return '\n'.join(lines)


def _contents(inspection: Inspection) -> list[str]:
    held = inspection.metadata
    scene = held.get('scene')
    lines = [
        f'  scene {scene.get("name", "unnamed")}, rigid motion {scene["rigid_motion"]}, '
        f'{AXES[scene.get("up_axis", 1)]} up'
        if scene
        else '  no scene given',
        f'  dt {held["dt"]:.6g} s, {held["sequence_length"]} + 1 frames '
        f'({held["sequence_length"] * held["dt"]:.3g} s), r = {held["mode_number"]} modes, '
        f'N = {inspection.n_soil or "unknown"}',
        '',
        f'  {"split":<7}{"runs":>5}  {"R":<10}{"force":<7}{"context":<8}',
    ]
    for split, part in inspection.splits.items():
        rigid = ', '.join(str(count) for count in sorted({run.n_rigid for run in part}))
        force = 'yes' if part[0].force is not None else 'no'
        context = 'no' if part[0].step_context is None else str(part[0].step_context.shape[1])
        lines.append(f'  {split:<7}{len(part):>5}  {rigid:<10}{force:<7}{context:<8}')
    return lines


def _ranges(inspection: Inspection) -> list[str]:
    """Smallest and largest values over all runs."""
    runs = inspection.runs
    if not runs:
        return []
    rows = {
        'rigid position [m]': [run.position[:, : run.n_rigid] for run in runs],
        'rigid step [m/frame]': [np.diff(run.position[:, : run.n_rigid], axis=0) for run in runs],
        'mode score [m]': [run.position[:, run.n_rigid :] for run in runs],
        'mode step [m/frame]': [np.diff(run.position[:, run.n_rigid :], axis=0) for run in runs],
    }
    for name, label in (('force', 'force [N]'), ('torque', 'torque [N m]')):
        values = [getattr(run, name) for run in runs]
        if all(value is not None for value in values):
            rows[label] = values
    lines = ['', f'  {"range":<22}{"x":>22}{"y":>22}{"z":>22}']
    for name, samples in rows.items():
        values = np.concatenate([sample.reshape(-1, 3) for sample in samples])
        if not len(values):
            continue
        cells = ''.join(
            f'{f"{low:.3g} .. {high:.3g}":>22}'
            for low, high in zip(values.min(axis=0), values.max(axis=0))
        )
        lines.append(f'  {name:<22}{cells}')
    if runs[0].step_context is not None:
        values = np.concatenate([run.step_context for run in runs])
        names = inspection.metadata.get('scene', {}).get('context_names') or range(values.shape[1])
        for name, low, high in zip(names, values.min(axis=0), values.max(axis=0)):
            lines.append(f'  {f"context {name}":<30}{low:.4g} .. {high:.4g}')
    return lines


def _trivial(inspection: Inspection) -> list[str]:
    """Errors of the predictors that need no model; only where N is known."""
    if inspection.n_soil is None or not inspection.runs:
        return []
    lines = [
        '',
        '  soil MSE of the trivial predictors [1e-4 m^2]     persistence  constant velocity',
    ]
    for split, part in inspection.splits.items():
        long = [run for run in part if run.n_frames > HISTORY]
        if len(long) < len(part):
            lines.append(
                f'    {split}: {len(part) - len(long)} runs of {HISTORY} frames or fewer, which a '
                'model is given, are left out'
            )
        if not long:
            continue
        errors = [trivial_errors(run, inspection.n_soil) for run in long]
        still, constant = (
            1e4 * np.mean([error[key] for error in errors])
            for key in ('stay_still', 'constant_velocity')
        )
        lines.append(f'    {split:<46}{still:>12.4g}{constant:>20.4g}')
    return lines


def _floors(inspection: Inspection, modes: int) -> list[str]:
    """Projection floor against the number of modes."""
    floors = inspection.floors
    if floors is None:
        return []
    kept = inspection.metadata['mode_number']
    lines = ['', '  modes   truncation error [1e-4 m^2]   RMS [mm]']
    for count in sorted({*range(1, min(modes, len(floors) - 1) + 1), kept}):
        mark = '  <- kept' if count == kept else ''
        lines.append(
            f'  {count:>5}{1e4 * floors[count]:>30.4g}{1e3 * floors[count] ** 0.5:>11.3f}{mark}'
        )
    return lines


def _motion(inspection: Inspection) -> list[str]:
    """Motion (displacement from frame 0): what is kept of it, and by which mode."""
    runs = inspection.runs
    if not runs:
        return []
    lines = ['']
    kept = inspection.metadata.get('motion_kept', {})
    for split, shares in kept.items():
        mean = mean_share(shares, inspection.metadata['motion_mse'][split])
        lines.append(
            f'  motion energy kept, {split}: {100 * mean:.2f} % '
            f'(worst run {100 * min(shares):.2f} %)'
        )
    shares = 100 * motion_shares(runs)
    lines.append(
        '  share of the kept motion in each mode [%]: '
        + ' '.join(f'{share:.2f}' for share in shares)
    )
    lines.append(
        f'  share of the mode energy that lies between the first frames of the runs: '
        f'{100 * initial_share(runs):.1f} %'
    )
    return lines


def motion_shares(runs: Sequence[Trajectory]) -> np.ndarray:
    """Returns [r] the share of each mode in the squared displacement of the scores from frame 0."""
    energy = np.zeros(runs[0].n_modes)
    for run in runs:
        scores = run.position[:, run.n_rigid :].astype(np.float64)
        energy += np.sum((scores - scores[0]) ** 2, axis=(0, 2))
    return energy / max(energy.sum(), np.finfo(np.float64).tiny)


def initial_share(runs: Sequence[Trajectory]) -> float:
    """Returns the share of the scores' variance that is there before anything moves.

    Modes that tell how runs differ at frame 0 (a wheel that sank in before it drove) are lost for
    motion.
    """
    scores = [run.position[:, run.n_rigid :].astype(np.float64) for run in runs]
    centre = np.concatenate(scores).mean(axis=0)
    total = sum(np.sum((part - centre) ** 2) for part in scores)
    first = np.stack([part[0] for part in scores])
    between = sum(len(part) for part in scores) * np.mean(
        np.sum((first - first.mean(axis=0)) ** 2, axis=(1, 2))
    )
    return float(between / max(total, np.finfo(np.float64).tiny))


def define_flags() -> None:
    """Defines the flags; not at import, so that several commands can be imported together."""
    flags.DEFINE_integer('modes', 12, 'Rows of the table of truncation errors.')


def main(argv: Sequence[str]) -> None:
    """Runs the command."""
    # TensorFlow only reads and writes records here; without its kernels its banner stays away too.
    os.environ.setdefault('TF_ENABLE_ONEDNN_OPTS', '0')
    if len(argv) != 2:
        sys.exit('usage: python -m pca_tools.inspect [--modes=12] DATASET')
    inspection = inspect_folder(argv[1])
    for line in report(inspection, flags.FLAGS.modes).splitlines():
        print(files.printable(line))
    sys.exit(int(inspection.failed))


if __name__ == '__main__':
    define_flags()
    app.run(main)
