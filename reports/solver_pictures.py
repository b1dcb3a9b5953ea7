"""Draws what the contact of an older and a newer solver does: soil in the blade, force spectrum.

Example:
    python -m reports solver_pictures --before_path=old/run_123.npz --after_path=raw/run_123.npz \
        --output_path=docs/solver
"""

import os

import matplotlib

matplotlib.use('Agg')

import numpy as np
from absl import flags
from matplotlib import pyplot as plt

from mpm import raw_run, scenes
from mpm.bodies import BLADE_THICKNESS
from mpm.contact import signed_distances
from mpm.motions import grid
from mpm.verification.run_rows import cutting_force, saw_tooth
from reports import command

SLICE = 0.03  # m either side of the middle that the picture shows
NAMES = ('before', 'after')


def depths(run: raw_run.RawRun) -> np.ndarray:
    """Returns how deep each written particle lies in the blade [T, N], m; negative outside."""
    drive = grid.make_drive(scenes.EXCAVATION, run.parameters)
    poses = drive.pose(np.arange(len(run.positions)) / scenes.FRAME_RATE)
    return np.array(
        [
            -signed_distances(drive.body, pose, x.astype(np.float64))
            for pose, x in zip(poses, run.positions)
        ]
    )


def draw_leak(runs, path: str) -> list[str]:
    """Draws the last frame of two runs from the side; returns a line of figures for each."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), sharex=True, sharey=True)
    lines = []
    for name, run, axis in zip(NAMES, runs, axes):
        deep, x, cell = depths(run), run.positions[-1], run.parameters['cell_size_m']
        middle = np.abs(x[:, 2] - scenes.EXCAVATION.bin.z_middle) < SLICE
        inside = deep[-1] > 0.0
        axis.plot(*x[middle & ~inside][:, :2].T, '.', color='0.6', markersize=4)
        axis.plot(*x[inside][:, :2].T, '.', color='tab:red', markersize=5)
        drive = grid.make_drive(scenes.EXCAVATION, run.parameters)
        px, py, theta = drive.pose(np.array([(len(run.positions) - 1) / scenes.FRAME_RATE]))[0]
        turn = np.linspace(0.0, np.pi, 30)
        arc = BLADE_THICKNESS / 2 * np.stack([np.cos(turn), np.sin(turn)])
        outline = np.concatenate([arc + [[0.0], [drive.body.length]], -arc], axis=1)
        outline = np.concatenate([outline, outline[:, :1]], axis=1)
        cosine, sine = np.cos(theta), np.sin(theta)
        across = cosine * outline[0] - sine * outline[1]
        axis.plot(px + across, py + sine * outline[0] + cosine * outline[1], 'k-', linewidth=1)
        quarter = int((deep[-1] > 0.25 * cell).sum())
        line = (
            f'{name}: deepest {max(0.0, deep.max() / cell):.2f} cells in any frame; at the end '
            f'{int(inside.sum())} of {len(x)} written particles inside, {quarter} deeper than a '
            'quarter of a cell'
        )
        axis.set(title=f'{name}: {int(inside.sum())} written particles inside', aspect='equal')
        axis.set(xlabel='x, m', ylabel='y, m', xlim=(px - 0.25, px + 0.2), ylim=(0.09, 0.45))
        lines.append(line)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return lines


def draw_spectrum(runs, path: str) -> list[str]:
    """Draws force and its spectrum while cutting; returns a line of figures for each."""
    figure, (curve, spectrum) = plt.subplots(1, 2, figsize=(11, 3.8))
    lines = []
    for name, run, colour in zip(NAMES, runs, ('tab:red', 'tab:blue')):
        force = cutting_force(run)
        speed, dx = run.parameters['speed_m_s'], run.parameters['cell_size_m']
        share = saw_tooth(force, speed, dx)
        frames, t = len(force), np.linspace(-1.0, 1.0, len(force))
        rest = force - np.polyval(np.polyfit(t, force, 3), t)
        window = np.hanning(frames)
        amplitude = 2 * np.abs(np.fft.rfft(window * rest, 8 * frames)) / window.sum()
        rate = np.fft.rfftfreq(8 * frames, 1 / scenes.FRAME_RATE)
        curve.plot(np.arange(frames) / scenes.FRAME_RATE, force, color=colour, label=name)
        spectrum.plot(rate, 100 * amplitude / force.mean(), color=colour, label=name)
        lines.append(
            f'{name}: mean {force.mean():.1f} N, saw-tooth {100 * share:.2f} % of it at '
            f'{speed / dx:.2f} Hz'
        )
    spectrum.axvline(speed / dx, color='0.5', linestyle=':', label='cells crossed per second')
    curve.set(xlabel='s, while cutting', ylabel='draft, N', ylim=(0.0, None))
    spectrum.set(xlabel='Hz', ylabel='amplitude, % of the mean', xlim=(0.0, 20.0), ylim=(0.0, None))
    for axis in (curve, spectrum):
        axis.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return lines


def define_flags() -> None:
    """Defines the flags of the command."""
    for name in NAMES:
        flags.DEFINE_string(
            f'{name}_path', None, 'A raw run of a grid case of the excavation.', required=True
        )
    flags.DEFINE_string('output_path', None, 'Folder of the pictures.', required=True)


def main(values, _) -> None:
    """Runs the command.

    Raises:
        ValueError: a file that is no raw run, or two of different cases.
    """
    runs = [raw_run.read_run(path) for path in (values.before_path, values.after_path)]
    cases = [run.parameters['case'] for run in runs]
    if cases[0] != cases[1] or not isinstance(cases[0], int):
        raise ValueError(f'both runs must be of one grid case, got {cases}')
    os.makedirs(values.output_path, exist_ok=True)
    for draw, name in ((draw_leak, 'leak'), (draw_spectrum, 'force_spectrum')):
        path = os.path.join(values.output_path, f'{name}.png')
        print('\n'.join(draw(runs, path)), f'\n{path}', sep='')


if __name__ == '__main__':
    command.start(define_flags, main)
