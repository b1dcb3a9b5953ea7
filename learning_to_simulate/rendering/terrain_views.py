"""Pictures of a tool on a terrain: the section through it, the map from above, the force.

Draws the arrays of `soil_field.rollout.TerrainRollout`, which its files hold as well.
"""

import json
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy import ndimage
from scipy.spatial.transform import Rotation

from learning_to_simulate import metrics
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH
from learning_to_simulate.rendering import movie_files
from learning_to_simulate.rendering.particle_views import BODY_EDGE, BODY_FACE, PLAIN_SOIL
from learning_to_simulate.rendering.rollout_figures import FAINT, INK, STYLE, WIDTH, draw_force
from learning_to_simulate.rendering.rollout_frames import TRUE_NAME

_MOMENTS = (0.2, 0.6, 1.0)  # shares of the run that a picture shows
_CHANGE = 'BrBG'  # brown where soil is missing, green where it lies on top
_DPI = {'png': 160, 'gif': 90, 'mp4': 130}
_UP = np.array([0.0, 1.0, 0.0])
_BESIDE, _ASIDE = 0.4, 0.7  # m beyond the path that a section and a map reach
# Out of a run's heights and forces that axes show; a few cells or frames stand out.
_QUANTILE = 0.998


def draw(
    arrays: Mapping[str, np.ndarray], path: str, kind: str, label: str = '', step_stride: int = 8,
    progress: Callable = lambda frames, label: frames,
) -> None:  # fmt: skip
    """Draws a rollout, the arrays of `TerrainRollout.arrays`, into a file: png (three moments), gif
    or mp4, which has step_stride frames between those it shows, or one where there is a map.
    `label` is the name of the model. `progress` wraps these frames, called with them and a label.
    """
    frames = arrays['height_frames']
    last = len(frames) - 1
    if kind == 'png':
        page = figure(arrays, [round(share * last) for share in _MOMENTS], _DPI[kind], label)
        movie_files.write_png(path, page)
        return
    apart = int(frames[1] - frames[0]) if last else 1
    shown = range(0, last + 1, max(1, round(step_stride / apart)))
    pages = (figure(arrays, [i], _DPI[kind], label) for i in progress(shown, kind))
    pixels = map(_pixels, pages)
    movie_files.write(path, kind, pixels, shown.step * apart * float(arrays['dt']))


def _pixels(page):
    canvas = FigureCanvasAgg(page)
    page.draw_without_rendering()  # the first layout knows no ticks: the scale's name is cut
    canvas.draw()
    return movie_files.pixels_of(canvas)


def figure(
    arrays: Mapping[str, np.ndarray], moments: Sequence[int], dpi: int, label: str = ''
) -> Figure:
    """The figure of some moments, indices of maps, side by side; of one, maps are side by side."""
    arrays = _about_path(arrays)
    maps = {'model': arrays['predicted_heights']}
    if 'ground_truth_heights' in arrays:
        maps[TRUE_NAME] = arrays['ground_truth_heights']
    before, frames = arrays['heights_before'], arrays['height_frames']
    changes = np.nan_to_num([m[-1] - before for m in maps.values()])
    largest = max(1e3 * float(np.quantile(np.abs(changes), _QUANTILE)), 1.0)
    sides = arrays['cell'] * before.shape
    # Of the map its longer side first.
    across, up = axes = (0, 1) if sides[0] >= sides[1] else (1, 0)
    aspect = sides[up] / sides[across]
    is_one = len(moments) == 1
    columns, map_rows = (len(maps), 1) if is_one else (len(moments), len(maps))
    wide = WIDTH / max(columns, 1 if aspect < 0.5 else 2)
    high = 0.3 * WIDTH if is_one else 0.42 * wide
    rows = [high, *[wide * min(max(aspect, 0.25), 1.0)] * map_rows, 1.7]
    with rc_context(STYLE):
        page = Figure(
            figsize=(WIDTH, sum(rows) + 0.9), dpi=dpi, facecolor='white', layout='constrained'
        )
        page.suptitle(_title(arrays, label), fontsize=11, fontweight='bold', x=0.02, ha='left')
        grid = page.add_gridspec(len(rows), columns, height_ratios=rows)
        views: list = []
        for column, i in enumerate(moments):
            time = float(arrays['dt']) * int(frames[i])
            side = page.add_subplot(grid[0, :] if is_one else grid[0, column])
            side.set_title(f't = {time:.2f} s', fontweight='bold')
            _draw_section(side, arrays, maps, i)
            side.set_ylabel('' if column else 'height (m)')
            if column == 0:  # beside the title: it would hide the soil of a wheel
                page.legend(*side.get_legend_handles_labels(), loc='upper right', ncols=3)
            for k, (label, heights) in enumerate(maps.items()):
                plan = page.add_subplot(grid[1, k] if is_one else grid[1 + k, column])
                _draw_map(plan, arrays, heights[i] - before, int(frames[i]), axes, largest)
                plan.set_ylabel(f'{label}\n{"xz"[up]} (m)' if column == 0 else '')
                plan.set_xlabel(f'{"xz"[across]} (m)' if is_one or k == len(maps) - 1 else '')
                views.append(plan)
        scale = ScalarMappable(Normalize(-largest, largest), _CHANGE)
        page.colorbar(scale, ax=views, extend='both', pad=0.01, label='change of height (mm)')
        curves = page.add_subplot(grid[-1, :])
        _draw_force(curves, arrays, [int(frames[i]) for i in moments])
    return page


def _about_path(arrays):
    """The arrays, poses in float64, with maps that end `_ASIDE` from the path."""
    arrays = {**arrays, 'pose': np.asarray(arrays['pose'], float)}
    places = arrays['pose'][:, [0, 2]]
    places = places[np.isfinite(places).all(axis=1)]
    shape = arrays['heights_before'].shape
    if not len(places):
        return arrays
    ends = (np.stack([places.min(axis=0) - _ASIDE, places.max(axis=0) + _ASIDE])
            - arrays['corner']) / arrays['cell']  # fmt: skip
    first = np.clip(np.floor(ends[0]).astype(int), 0, np.subtract(shape, 1))
    last = np.clip(np.ceil(ends[1]).astype(int), first + 1, shape)
    part = (..., slice(first[0], last[0]), slice(first[1], last[1]))
    names = [n for n in arrays if n.endswith('heights') or n == 'heights_before']
    corner = arrays['corner'] + first * arrays['cell']
    return {**arrays, 'corner': corner} | {n: arrays[n][part] for n in names}


def _title(arrays, label):
    tool = json.loads(str(arrays['tool']))
    text = f'{label}: a' if label else 'A'
    text += f' {tool["name"]} of {1e2 * tool["width"]:.3g} cm width'
    text += f' on the run {arrays["case"]}' if 'case' in arrays else ' on a given path'
    if errors := ', '.join(_errors(arrays, tool['name'] == 'wheel')):
        text += '\n' + errors
    status = str(arrays['status'])
    return text if status == 'ok' else f'{text}\n{status}: {arrays["status_reason"]}'


def _errors(arrays, is_wheel):
    """How far a rollout is off, as evaluation counts it, in words; none where that is not known."""
    if 'ground_truth_forces' not in arrays:
        return []
    names, found = ('predicted', 'ground_truth'), []
    forces = [arrays[f'{name}_forces'][None, INPUT_SEQUENCE_LENGTH:] for name in names]
    loads = {'force off': forces}
    if is_wheel:  # its load is given, so most of its force is
        along = _start(arrays)
        drawbar = [force @ along[:, None] for force in forces]
        loads = {'drawbar (force along the way) off': drawbar, 'whole force': forces}
    for name, both in loads.items():
        share = float(metrics.force_errors(*both)['force_relative_l2'][0])
        if np.isfinite(share):
            found.append(f'{name} by {100 * share:.0f} %')
    if 'predicted_particles' in arrays and 'ground_truth_particles' in arrays:
        both = [arrays[f'{name}_particles'] for name in names]
        stride = int(arrays['height_frames'][1] - arrays['height_frames'][0])
        found.append(f'soil by {metrics.soil_mm(*both, stride):.2g} mm')
    return found


def _way(pose):
    """Level unit vectors along and across the way of a pose [7], and its rotation."""
    turn = Rotation.from_quat(np.roll(pose[3:], -1))
    across = turn.apply([0.0, 0.0, -1.0]) * [1.0, 0.0, 1.0]
    across = across / max(np.linalg.norm(across), 1e-12)
    return np.cross(_UP, across), across, turn


def _start(arrays):
    """Level unit vector along the way of the first pose that is finite."""
    pose = arrays['pose']
    good = np.flatnonzero(np.isfinite(pose).all(axis=1))
    return _way(pose[good[0]])[0] if len(good) else np.array([-1.0, 0.0, 0.0])


def _draw_section(axes, arrays, maps, i):
    """Terrain and tool in the plane of the tool, against the distance along its way."""
    path = arrays['pose']
    pose = path[int(arrays['height_frames'][i])]
    if not np.isfinite(pose).all():
        axes.text(0.5, 0.5, 'no prediction', ha='center', transform=axes.transAxes)
        return
    along, _, turn = _way(pose)
    corner, cell, way = arrays['corner'], arrays['cell'], path[:, :3] @ along
    start = path[0, :3] @ along
    ends = np.nanmin(way) - _BESIDE, np.nanmax(way) + _BESIDE
    u = np.linspace(*ends, 801) - pose[:3] @ along
    places = pose[:3] + u[:, None] * along
    at = ((places[:, [0, 2]] - corner) / cell - 0.5).T
    inside = ((at >= -0.5) & (at <= np.array(arrays['heights_before'].shape)[:, None] - 0.5)).all(0)
    u, at = u[inside] + pose[:3] @ along - start, at[:, inside]

    def section(heights):
        values = np.asarray(heights, float)
        return ndimage.map_coordinates(values, at, order=1, mode='nearest')

    now, was = section(maps['model'][i]), section(arrays['heights_before'])
    shown = [was, *(section(m[-1]) for m in maps.values()), now]
    low, high = min(x.min() for x in shown), max(x.max() for x in shown)
    room = max(0.6 * (high - low), 0.03)
    axes.fill_between(u, low - room, now, color=PLAIN_SOIL, alpha=0.75, linewidth=0)
    axes.plot(u, now, color=INK, linewidth=1.3, label='model')
    if TRUE_NAME in maps:
        truth = section(maps[TRUE_NAME][i])
        axes.plot(u, truth, '--', color='#b03060', linewidth=1.2, label=TRUE_NAME)
    axes.plot(u, was, ':', color=FAINT, linewidth=1.1, label='before')
    shape = np.asarray(arrays['outline'], float)
    points = turn.apply(np.stack([-shape[:, 0], shape[:, 1], 0 * shape[:, 0]], axis=1)) + pose[:3]
    tool = np.stack([points @ along - start, points[:, 1]], axis=1)
    axes.fill(*tool.T, facecolor=BODY_FACE, edgecolor=BODY_EDGE, linewidth=1.0, zorder=3)
    # Of a large wheel the lower part, where there is soil to see.
    top = min(max(high, tool[:, 1].max()) + 0.02, high + 0.45 * np.ptp(u))
    axes.set(xlim=(u.min(), u.max()), ylim=(low - room, top))
    axes.set(xlabel='along the way (m)', aspect='equal')


def _draw_map(axes, arrays, change, frame, order, largest):
    first, side = arrays['corner'], arrays['cell'] * change.shape
    extent = [end for i in order for end in (first[i], first[i] + side[i])]
    axes.imshow(
        1e3 * np.asarray(change, float).transpose(order[::-1]), origin='lower', extent=extent,
        cmap=_CHANGE, vmin=-largest, vmax=largest, interpolation='nearest',
    )  # fmt: skip
    axes.locator_params(nbins=5)
    pose = arrays['pose'][frame]
    if np.isfinite(pose).all():
        _, across, _ = _way(pose)
        half = json.loads(str(arrays['tool']))['width'] / 2 * across
        ends = np.stack([pose[:3] - half, pose[:3] + half])[:, [0, 2]]
        axes.plot(*ends[:, order].T, color=BODY_EDGE, linewidth=2.5)


def _draw_force(axes, arrays, frames):
    time = float(arrays['dt']) * np.arange(len(arrays['pose']))
    directions = np.stack([-_start(arrays), _UP], axis=1)
    truth, force = (
        np.asarray(arrays[key], float) @ directions if key in arrays else None
        for key in ('ground_truth_forces', 'predicted_forces')
    )
    draw_force(axes, None if truth is None else (time, truth), [('model', time, force)])
    for frame in frames:
        axes.axvline(time[frame], color=FAINT, linewidth=0.8, zorder=1)
    axes.set(xlabel='time (s)', xlim=(time[0], time[-1] or 1.0))
