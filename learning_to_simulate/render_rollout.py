"""Draws a rollout: truth and prediction side by side, with the force and the errors over time; of
a soil field the terrain.

Examples:
    # a strip of moments, a GIF and a movie
    lts render --rollout_path=rollouts/rollout_test_0.npz \\
        --data_path=datasets/excavation --output_path=pictures

    # from above, coloured by the error of the prediction
    lts render --rollout_path=rollouts/rollout_test_0.npz \\
        --data_path=datasets/excavation --output_path=pictures --color_by=error --plane=xz

    # two models beside the truth
    lts render --rollout_path=pcg/rollout_test_0.npz \\
        --label=pcg --beside=mlp_driven=mlp/rollout_test_0.npz \\
        --data_path=datasets/excavation --output_path=pictures

    # for ParaView: open truth.pvd and prediction.pvd of pictures/rollout_test_0_vtk
    lts render --rollout_path=rollouts/rollout_test_0.npz \\
        --data_path=datasets/excavation --output_path=pictures --format=vtp

Needs the extra `viz` (pip install .[viz]), except for --format=vtp. The soil is the solver's own
particles where the dataset holds a sample of them, else it is rebuilt from the modes with its
subspace.npz; without one the body and the curves are drawn.
"""

import importlib
import os
import time
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import ModuleType

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import command
from learning_to_simulate.rendering import rollout_frames, vtk_export
from learning_to_simulate.rendering.rollout_frames import RolloutFrames
from pca_tools import files

FORMATS = ('png', 'gif', 'mp4', 'vtp')
# Pixels per inch of a page 9.6 inches wide.
_DPI = {'png': 200, 'gif': 100, 'mp4': 150}


def draw_terrain(arrays, path: str, **options) -> None:
    """Draws the arrays of a `soil_field.rollout.TerrainRollout` into a file .png, .gif or .mp4;
    options of `terrain_views.draw`. ValueError: another ending, or a package for pictures is
    missing."""
    _, kind = target_and_format(path)
    _drawing('terrain_views').draw(arrays, path, kind, **options)


def _drawing(name: str) -> ModuleType:
    """A module of `rendering`; ValueError where a package for pictures is missing."""
    try:
        return importlib.import_module(f'learning_to_simulate.rendering.{name}')
    except ModuleNotFoundError as error:
        raise ValueError(f'pictures need {error.name}: pip install .[viz]') from error


def target_and_format(path: str) -> tuple[str, str]:
    """A picture's path without its ending, and the format that the ending names; ValueError for
    another."""
    target, ending = os.path.splitext(path)
    if ending not in ('.png', '.gif', '.mp4'):
        raise ValueError(f'{path}: must end in .png, .gif or .mp4')
    return target, ending[1:]


def render(
    rollout_path: str,
    data_path: str | None,
    output_path: str,
    formats: Iterable[str] = ('png', 'gif', 'mp4'),
    label: str = '',
    beside: Mapping[str, str] | None = None,
    **options,
) -> tuple[RolloutFrames, list[str]]:
    """Draws a rollout file `rollout_{split}_{i}.npz` in one or several of `FORMATS`, into a folder,
    made if missing; the files take the rollout's name. Returns the rollout, and the files written
    (of the `vtp`, the two collections).

    The dataset folder holds `subspace.npz`, or is None. `label` is the name of the model, for the
    title of the prediction; `beside` name of a model -> rollout of the same run, drawn beside the
    first (not as `vtp`). Options are those of `render_frames`. FileNotFoundError: the rollout or
    the dataset folder is missing. ValueError: an unknown format, an input that
    `rollout_frames.load` refuses, or a package for pictures is missing.
    """
    formats = tuple(dict.fromkeys(formats))
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        raise ValueError(f'--format has {unknown or "no name"}; there are {", ".join(FORMATS)}')
    frames = rollout_frames.load(rollout_path, data_path, label)
    others = [rollout_frames.load(path, data_path, name) for name, path in (beside or {}).items()]
    for other in others:
        rollout_frames.refuse_other_run(frames, other)
    os.makedirs(output_path, exist_ok=True)
    target = os.path.join(output_path, frames.name)
    return frames, render_frames(frames, target, formats, beside=others, **options)


def render_frames(
    frames: RolloutFrames,
    target: str,
    formats: Iterable[str],
    step_stride: int = 3,
    color_by: str = 'speed',
    plane: str | None = None,
    progress: Callable = lambda frames, label: frames,
    beside: Sequence[RolloutFrames] = (),
) -> list[str]:
    """Draws a rollout that is in memory, and others `beside` it of the same run; returns the files
    written.

    `target` is their path without endings; its folder must exist. `formats` are some of `FORMATS`.
    Every step_stride-th frame is drawn, or the nearest to it that the particles have. `color_by` is
    `speed` (mm/s) or `error` (mm); `plane` horizontal and vertical axis, a key of
    `rollout_frames.PLANES`, None for the view from the side, with the scene's upward axis up.
    `progress` wraps the frames of a movie, called with them and a label. ValueError: errors are
    asked for where there is no truth, or a package for pictures is missing.
    """
    if color_by == 'error' and not frames.has_truth:
        raise ValueError('color_by=error needs a recorded run; of a path there is no truth')
    shown = frames.frames[: min(len(one.frames) for one in (frames, *beside))]
    apart = int(shown[1] - shown[0]) if len(shown) > 1 else 1
    stride = max(1, round(step_stride / apart))
    drawn, written = np.arange(0, len(shown), stride), []
    for name in formats:
        if name == 'vtp':
            folder = f'{target}_vtk'
            vtk_export.write_rollout(folder, frames, progress(drawn, name))
            written += [os.path.join(folder, f'{which}.pvd') for which in frames.shown]
            continue
        figures, movie_files = _drawing('rollout_figures'), _drawing('movie_files')
        path, view = f'{target}.{name}', _drawing('particle_views').setup(frames, plane, drawn)
        written.append(path)
        if name == 'png':
            strip = figures.strip_figure(frames, view, drawn.tolist(), _DPI[name], beside)
            movie_files.write_png(path, strip)
        else:
            figure = figures.AnimatedFigure(frames, view, color_by, _DPI[name], beside)
            pixels = (figure.draw(int(i)) for i in progress(drawn, name))
            movie_files.write(path, name, pixels, stride * apart * frames.dt)
    return written


def _is_on_terrain(path):
    """Whether a file holds a rollout of a soil field."""
    if not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return 'predicted_heights.npy' in archive.namelist()


def _render_terrain(values):
    path = values.rollout_path
    if given := [n for n in ('beside', 'plane', 'color_by', 'step_stride') if values[n].present]:
        raise ValueError(f'{path}: --{given[0]} is for particles, not for a terrain')
    arrays, name = files.read_npz(path), os.path.splitext(os.path.basename(path))[0]
    os.makedirs(values.output_path, exist_ok=True)
    for kind in values.format:
        target = os.path.join(values.output_path, f'{name}.{kind}')
        draw_terrain(arrays, target, label=values.label)
        print(target)


def run(values) -> None:
    command.writable_folder(values.output_path)
    if _is_on_terrain(values.rollout_path):
        return _render_terrain(values)
    beside = command.named_paths('beside', values.beside, 'FILE')
    started = time.perf_counter()
    frames, written = render(
        values.rollout_path, values.data_path, values.output_path, values.format, values.label,
        beside, step_stride=values.step_stride, color_by=values.color_by, plane=values.plane,
        progress=lambda drawn, label: tqdm.tqdm(drawn, desc=label, unit='frame', disable=None),
    )  # fmt: skip
    print(frames.title)
    if frames.has_truth:
        print(f'{frames.model}: soil error {frames.soil_mm:.2f} mm {frames.space}')
    for note in frames.notes:
        print(f'note: {note}')
    for path in written:
        print(f'{path}  {os.path.getsize(path) / 2**20:.2f} MB')
    print(f'{time.perf_counter() - started:.1f} s')


if __name__ == '__main__':
    flags.DEFINE_string(
        'rollout_path', None, 'rollout_{split}_{i}.npz of `lts evaluate`.', required=True
    )
    flags.DEFINE_string(
        'data_path', None, 'Dataset folder with subspace.npz; without one no soil is drawn.'
    )
    flags.DEFINE_string('output_path', None, 'Folder for the pictures.', required=True)
    flags.DEFINE_integer('step_stride', 3, 'Draw every n-th frame.', 1)
    flags.DEFINE_enum('color_by', 'speed', ('speed', 'error'), 'What colours the soil.')
    flags.DEFINE_enum(
        'plane', None, list(rollout_frames.PLANES),
        'Horizontal and vertical axis of the view; default: from the side, upward axis up. With y '
        'up xz is from above, zy along the drive.',
    )  # fmt: skip
    flags.DEFINE_string('label', '', 'Name of the model, for the title of the prediction.')
    flags.DEFINE_list(
        'beside', [], 'NAME=FILE of other rollouts of the same run, drawn beside the first.'
    )
    flags.DEFINE_list('format', 'png,gif,mp4', f'Any of {", ".join(FORMATS)}.')
    command.start(run)
