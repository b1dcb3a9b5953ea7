"""Draws one raw run of each kind as a strip of frames from the side, to be looked at.

Example:
    python -m reports film_strips --raw_path=raw/excavation --output_path=docs/data/excavation.png
"""

import os

import matplotlib

matplotlib.use('Agg')

import numpy as np
from absl import flags
from matplotlib import pyplot as plt

from mpm import raw_run, scenes
from reports import command

FRAMES = 6
WIDTH = 2.6  # inches of a frame
SLICE = 0.25  # of the bed's width, about its middle: what a strip shows


def first_of_each_kind(folder: str) -> dict[str, str]:
    """Returns kind -> file of its first finished run, sorted by kind.

    Raises:
        ValueError: no manifest, or no finished run.
    """
    manifest = raw_run.read_manifest(folder)
    if not manifest or not manifest['runs']:
        raise ValueError(f'{folder}: no finished raw runs')
    found: dict = {}
    for entry in sorted(manifest['runs'], key=lambda entry: str(entry['case'])):
        found.setdefault(entry['parameters'].get('kind', 'grid'), entry['file'])
    return {kind: os.path.join(folder, found[kind]) for kind in sorted(found)}


def draw(runs: dict[str, raw_run.RawRun], path: str) -> None:
    """Draws a row for each kind; soil is coloured by how far it has moved since frame 0."""
    bed = np.concatenate([run.positions[0] for run in runs.values()])
    low, high = bed.min(axis=0), bed.max(axis=0)
    # Somewhat more than twice the bed: a large wheel sticks out, the soil is what is looked at.
    top = low[1] + 2.2 * (high[1] - low[1])
    height = WIDTH * (top - low[1]) / (high[0] - low[0])
    figure, axes = plt.subplots(
        len(runs), FRAMES, figsize=(WIDTH * FRAMES, (height + 0.4) * len(runs)),
        sharex=True, sharey=True, squeeze=False, layout='constrained',
    )  # fmt: skip
    middle, reach = (low[2] + high[2]) / 2, SLICE * (high[2] - low[2]) / 2
    for row, (kind, run) in zip(axes, runs.items()):
        for axis, frame in zip(row, np.linspace(0, len(run.positions) - 1, FRAMES).astype(int)):
            x, body = run.positions[frame], run.rigid_positions[frame]
            moved = np.linalg.norm(x - run.positions[0], axis=1)
            shown = np.abs(run.positions[0, :, 2] - middle) < reach
            picture = axis.scatter(
                *x[shown][:, :2].T, c=1e3 * moved[shown], s=2.0, cmap='viridis', vmin=0, vmax=100
            )
            axis.plot(*body[:, :2].T, '.', color='tab:red', markersize=1.5)
            axis.set_title(
                f'{frame / scenes.FRAME_RATE:.1f} s, {run.force[frame, 0]:.0f} N', fontsize=8
            )
            axis.set(aspect='equal', xlim=(low[0], high[0]), ylim=(low[1], top))
            axis.tick_params(labelsize=6)
        row[0].set_ylabel(f'{kind}\n{run.parameters["case"]}', fontsize=8)
    figure.colorbar(picture, ax=axes, label='moved since frame 0, mm', shrink=0.6)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('raw_path', None, 'Folder of raw runs.', required=True)
    flags.DEFINE_string('output_path', None, 'The picture, a .png file.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    files = first_of_each_kind(values.raw_path)
    os.makedirs(os.path.dirname(os.path.abspath(values.output_path)), exist_ok=True)
    draw({kind: raw_run.read_run(path) for kind, path in files.items()}, values.output_path)
    print('\n'.join(f'{kind}: {path}' for kind, path in files.items()))
    print(values.output_path)


if __name__ == '__main__':
    command.start(define_flags, main)
