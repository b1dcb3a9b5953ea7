"""One excavation run against Newton's implicit MPM (PyPI `newton`): draft and surface.

It runs in an environment of its own, and nothing else of the project needs it:

    python -m venv newton_venv
    newton_venv/bin/pip install newton usd-core warp-lang numba scipy absl-py tqdm matplotlib
    python -m mpm.generate --scene=excavation --cases=146 --output_path=raw/excavation
    newton_venv/bin/python -m mpm.verification.newton --raw_run=raw/excavation/run_146.npz \\
        --output=docs/solver/newton.json --picture=docs/solver/newton.png

How the scene is mapped says `newton_scene.py`; nothing is tuned. Each variant of Newton's numerics
(--list_variants) is kept in the JSON when it is made; the same command goes on with those that are
absent. A variant takes two to ten minutes of one core for 60 frames.
"""

import importlib.metadata
import json
import os
import sys

import numpy as np
from absl import app, flags, logging
from tqdm import tqdm

from mpm import packing, raw_run, scenes
from mpm.constitutive import make_soil
from mpm.files import write_json
from mpm.motions import grid
from mpm.run import RawRun
from mpm.simulation import Settings
from mpm.verification import newton_scene
from mpm.verification.convergence import drive
from mpm.verification.newton_scene import Numerics
from mpm.verification.run_rows import cutting_frames
from mpm.verification.surfaces import surface
from storage import markdown

_RAW_RUN = flags.DEFINE_string('raw_run', None, 'The recorded run, of the excavation grid.')
_OUTPUT = flags.DEFINE_string('output', None, 'JSON of the comparison; variants in it are kept.')
_FRAMES = flags.DEFINE_integer('frames', 60, 'How many frames are driven.', lower_bound=20)
_VARIANTS = flags.DEFINE_list('variants', None, 'Only these variants of Newton, by name.')
_LIST = flags.DEFINE_bool('list_variants', False, 'Only name the variants.')
_PICTURE = flags.DEFINE_string('picture', None, 'PNG of forces and surfaces.')

VARIANTS = {
    'base': Numerics(0.02, 2),
    'half_step': Numerics(0.02, 4),
    'larger_cells': Numerics(0.08 / 3, 2),
    'rigid': Numerics(0.02, 2, rigid=True),
    'our_cells': Numerics(scenes.EXCAVATION.bin.dx, 2),
}
SAME_FORCE = 0.02  # of the mean: the recorded run and this solver, over the frames compared
MOVED = 5e-3  # m, by which a square of the surface rose or sank if it counts as moved


def checked(run: RawRun, frames: int) -> RawRun:
    """Returns a run that can be compared.

    Raises:
        ValueError: no case of the excavation grid, another law, or too few frames that cut.
    """
    p = run.parameters
    if not isinstance(p.get('case'), int) or 'depth_m' not in p:
        raise ValueError(f'run {p.get("case")!r} is no case of the excavation grid')
    if p['rheology'] != 'local':
        raise ValueError(f'run {p["case"]} has the law {p["rheology"]!r}; Newton has no such one')
    if len(run.force) <= frames or not len(cutting_frames(p, frames + 1)):
        raise ValueError(f'run {p["case"]} does not cut in its first {frames} frames')
    return run


def compare_forces(ours: np.ndarray, theirs: np.ndarray, window: np.ndarray) -> dict[str, float]:
    """Compares the forces [T, 3] (N) on the blade in the frames `window` [K]."""
    x, other = ours[window, 0], theirs[window, 0]
    return {
        'draft_N': float(other.mean()),
        'draft_ratio': float(other.mean() / x.mean()),
        'draft_rms_over_mean': float(np.sqrt(((other - x) ** 2).mean()) / x.mean()),
        'vertical_N': float(theirs[window, 1].mean()),
    }


def compare_surfaces(start: np.ndarray, ours: np.ndarray, theirs: np.ndarray) -> dict[str, float]:
    """Compares heights [x, z] (m) at the end; `start` is the surface before the blade moved.

    Returns:
        In mm: RMS difference, over all squares and over those that moved in either; RMS by which
        ours moved, in the latter; the highest point of each over the start's mean.
    """
    moved = np.maximum(np.abs(ours - start), np.abs(theirs - start)) > MOVED

    def rms(difference):
        return float(1e3 * np.sqrt((difference**2).mean())) if difference.size else 0.0

    return {
        'surface_rms_mm': rms(theirs - ours),
        'surface_rms_moved_mm': rms((theirs - ours)[moved]),
        'moved_by_rms_mm': rms((ours - start)[moved]),
        'heap_mm': float(1e3 * (theirs.max() - start.mean())),
        'heap_ours_mm': float(1e3 * (ours.max() - start.mean())),
    }


def profile(height: np.ndarray) -> list[float]:
    """Returns the mean height (mm over the floor) of the middle third across, along x."""
    third = height.shape[1] // 3
    middle = height[:, third : height.shape[1] - third].mean(axis=1)
    return [round(float(1e3 * (y - scenes.CORNER)), 1) for y in middle]


def opened(path: str, run: RawRun, frames: int) -> dict:
    """Returns the comparison kept in a file, or a new one.

    Raises:
        ValueError: the file holds no comparison, or one of another run.
    """
    p = run.parameters
    identity = {
        'case': p['case'],
        'frames': frames,
        'solver_version': p['solver_version'],
        'newton': importlib.metadata.version('newton'),
        'warp': importlib.metadata.version('warp-lang'),
    }
    if not os.path.exists(path):
        return identity | {'rows': {}}
    try:
        with open(path, encoding='utf-8') as file:
            kept = json.load(file)
        found = {name: kept[name] for name in identity}
        kept['rows'].keys()
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f'{path} is not a comparison with Newton: {error!r}') from error
    if found != identity:
        raise ValueError(f'{path} compares {found}, not {identity}; name another')
    return kept


def compare(run: RawRun, folder: str, path: str, frames: int, names: list[str]) -> None:
    """Makes the variants that the file does not hold yet.

    Args:
        run: see `checked`.
        folder: that the run lies in; its packing is made if it is absent.
        path: of the JSON.
        frames: how many are driven.
        names: of `VARIANTS`.

    Raises:
        ValueError: Newton is not installed; or the run is not what this solver gives.
    """
    newton_scene.imported()
    content = opened(path, run, frames)
    missing = [name for name in names if name not in content['rows']]
    if not missing:
        return
    scene, p = scenes.EXCAVATION, run.parameters
    soil = make_soil(p['youngs_modulus_Pa'], scenes.PACKING_MU_S)
    particles = packing.settled(scene.bin, soil, p['seed'], folder)[0]
    window = cutting_frames(p, frames + 1)
    force = run.force[: frames + 1].astype(np.float64)
    again, simulation = drive(
        scene, p['case'], frames, Settings(p['youngs_modulus_Pa'], seed=p['seed'])
    )
    apart = float(np.abs(again - force[1:])[:, 0].mean() / force[window, 0].mean())
    if apart > SAME_FORCE:
        raise ValueError(f'run {p["case"]} is not what this solver gives: forces {apart:.1%} apart')
    start = surface(particles[:, :3], scene.bin)
    ours = surface(simulation.positions(), scene.bin)
    material = newton_scene.material_of(p['soil'])
    content |= {
        'window': [int(window[0]), int(window[-1])],
        'material': material,
        'ours': {
            'draft_N': float(force[window, 0].mean()),
            'vertical_N': float(force[window, 1].mean()),
            'recorded_and_again': apart,
            'force_x_N': np.round(force[1:, 0], 1).tolist(),
            'profile_mm': profile(ours),
        },
    }
    blade = grid.make_drive(scene, p)
    bed = (particles[:, :3], packing.particle_volume(scene.bin))
    for name in missing:
        numerics = VARIANTS[name]
        newton = newton_scene.NewtonBed(scene.bin, blade, material, bed, numerics)
        with tqdm(total=frames + newton_scene.REST_FRAMES, desc=name, unit='frame') as bar:
            made = newton_scene.run_in_newton(newton, frames, bar.update)
        theirs = surface(made.positions, scene.bin)
        content['rows'][name] = {
            'voxel_mm': 1e3 * numerics.voxel,
            'particles_per_cell': numerics.voxel**3 / bed[1],
            'step_s': 1 / (scenes.FRAME_RATE * numerics.steps_per_frame),
            'rigid': numerics.rigid,
            **compare_forces(force, np.concatenate([force[:1], made.force]), window),
            **compare_surfaces(start, ours, theirs),
            'floor_over_weight': made.floor_over_weight,
            'unbalanced_over_weight': made.unbalanced,
            'cpu_s': round(made.cpu_s),
            'force_x_N': np.round(made.force[:, 0], 1).tolist(),
            'profile_mm': profile(theirs),
        }
        write_json(path, content)


def shown(name: str) -> str:
    """Returns the name of a variant for readers."""
    return f'Newton, {name.replace("_", " ")}'


def table(path: str) -> str:
    """The table of a JSON of this command."""
    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    ours = content['ours']
    cells = f'{1e3 * scenes.EXCAVATION.bin.dx:.1f}'
    rows = [('this solver', cells, '', ours['draft_N'], 1.0, 0.0, ours['vertical_N'])]
    for name, row in content['rows'].items():
        heap = f'{row["heap_mm"]:.0f}, {row["heap_ours_mm"]:.0f}'
        rows.append((
            shown(name), f'{row["voxel_mm"]:.1f}', f'1/{1 / row["step_s"]:.0f}',
            row['draft_N'], row['draft_ratio'], row['draft_rms_over_mean'], row['vertical_N'],
            row['surface_rms_mm'], row['surface_rms_moved_mm'], heap, row['cpu_s'],
        ))  # fmt: skip
    title = ('', 'cells, mm', 'step, s', 'draft, N', 'over ours', 'curve, RMS over mean',
             'vertical, N', 'surface, mm RMS', 'where it moved', 'heap, theirs and ours, mm',
             'CPU s')  # fmt: skip
    return markdown.table(title, rows)


def draw(path: str, picture: str) -> None:
    """Draws force and middle of the surface of all variants of a JSON."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    with open(path, encoding='utf-8') as file:
        content = json.load(file)
    figure, (force, side) = pyplot.subplots(1, 2, figsize=(11, 3.6), layout='constrained')
    rows = {'this solver': content['ours']} | {
        shown(name): row for name, row in content['rows'].items()
    }
    length = scenes.EXCAVATION.bin.size[0]
    for name, row in rows.items():
        style = {'color': 'k', 'linewidth': 2} if name == 'this solver' else {'linewidth': 1}
        time = np.arange(1, len(row['force_x_N']) + 1) / scenes.FRAME_RATE
        force.plot(time, row['force_x_N'], label=name, **style)
        count = len(row['profile_mm'])
        side.plot((np.arange(count) + 0.5) / count * length, row['profile_mm'], **style)
    first, last = np.array(content['window']) / scenes.FRAME_RATE
    force.axvspan(first, last, color='0.93', zorder=0)
    force.set(xlabel='s', ylabel='draft, N', title=f'case {content["case"]}; grey: the mean')
    force.legend(fontsize=7, frameon=False)
    side.set(xlabel='m', ylabel='surface, mm over the floor', title='middle third, at the end')
    figure.savefig(picture, dpi=110)
    pyplot.close(figure)


def main(argv):
    if len(argv) > 1:
        raise app.UsageError(f'unknown arguments: {argv[1:]}')
    if _LIST.value:
        print('\n'.join(VARIANTS))
        return
    try:
        names = _VARIANTS.value or list(VARIANTS)
        if unknown := sorted(set(names) - set(VARIANTS)):
            raise ValueError(f'unknown variants {unknown}; there are {"; ".join(VARIANTS)}')
        if not _RAW_RUN.value or not _OUTPUT.value:
            raise ValueError('--raw_run and --output are needed')
        run = checked(raw_run.read_run(_RAW_RUN.value), _FRAMES.value)
        folder = os.path.dirname(os.path.abspath(_RAW_RUN.value))
        compare(run, folder, _OUTPUT.value, _FRAMES.value, names)
        if _PICTURE.value:
            draw(_OUTPUT.value, _PICTURE.value)
    except (ValueError, OSError) as error:
        logging.error('%s', error)
        sys.exit(1)
    print(table(_OUTPUT.value))


if __name__ == '__main__':
    app.run(main)
