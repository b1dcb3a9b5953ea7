"""The pictures of a rollout: a figure that is animated, and a strip of moments for print.

Both hold truth and predictions in the same colours, and below them force and error over time.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context, ticker
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from learning_to_simulate.rendering import movie_files
from learning_to_simulate.rendering.particle_views import COLOR_MAPS, ParticleView, ViewSetup
from learning_to_simulate.rendering.rollout_frames import (
    CONSTANT,
    FORCE_NAMES,
    PREDICTION,
    STILL,
    TRUE_NAME,
    TRUTH,
    RolloutFrames,
)
from learning_to_simulate.soil_truth import WITH_CUT_OFF

INK, FAINT = '#1f2933', '#8693a0'
STYLE = {
    'font.family': 'DejaVu Sans', 'font.size': 9, 'text.color': INK,
    'axes.edgecolor': '#52606d', 'axes.labelcolor': INK, 'axes.linewidth': 0.8,
    'axes.spines.top': False, 'axes.spines.right': False, 'axes.axisbelow': True,
    'axes.titlesize': 10, 'axes.titlelocation': 'left',
    'legend.fontsize': 7.5, 'legend.frameon': False,
    'xtick.color': '#52606d', 'ytick.color': '#52606d', 'xtick.labelsize': 8, 'ytick.labelsize': 8,
    'grid.color': '#e4e7eb', 'grid.linewidth': 0.7,
}  # fmt: skip
COLOR_LABELS = {'speed': 'soil speed (mm/s)', 'error': 'soil error (mm)'}
# Okabe and Ito (2008), told apart with every kind of colour vision: axes of the force; models.
AXIS_COLORS = '#0072b2', '#d55e00'
_MODEL_COLORS = ('#7b1f6b', '#009e73', '#c8a24a', '#0072b2')
_MODEL_DASHES = ('-', '--', ':', '-.')
WIDTH = 9.6  # inches
# Margins and distances in inches.
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.98, 0.92, 1.12, 0.72
_GAP, _ROW_GAP, _CURVE_HEIGHT, _CURVE_GAP, _LEGEND_ROW = 0.3, 0.16, 1.45, 0.92, 0.13
_LABEL_SIZE, _CHARACTER = 9, 0.073  # points and inches, of a label and of a letter in it
# Points; a title of more characters is set smaller, so that it stays on one line.
_TITLE_SIZE, _TITLE_LENGTH, _CAPTION_SIZE = 13, 86, 9.5
# Share of the shown frames that have passed at each moment of the strip.
_STRIP_MOMENTS = (1 / 3, 2 / 3, 1.0)


class AnimatedFigure:
    """Truth, where there is one, and predictions of the same run side by side over time.

    What stands still is drawn once and restored as an image; only what moves is drawn in every
    frame. `views` are the `ParticleView`s, `caption` is the text of time and errors.
    """

    def __init__(
        self, frames: RolloutFrames, view: ViewSetup, color_by: str, dpi: int,
        beside: Sequence[RolloutFrames] = (),
    ):  # fmt: skip
        self._frames, self._models = frames, [frames, *beside]
        shown = _shown(self._models)
        with rc_context(STYLE):
            page = _Page(len(shown), 1, self._models, view, dpi)
            self.views = []
            for column, (one, which, name) in enumerate(shown):
                axes = page.view_axes(0, column, title=name)
                self.views.append(
                    ParticleView(axes, one, which, view, color_by, show_key=column == 0)
                )
            if frames.soil:
                page.add_color_bar(0, 0, color_by)
            curves = page.curve_axes(self._models)
            self._markers = [axes.axvline(0.0, color=INK, linewidth=1.0) for axes in curves]
            self.caption = page.caption
        self._canvas, self._figure = page.canvas, page.figure
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)

    @property
    def _moving(self) -> list:
        views = [artist for view in self.views for artist in view.artists]
        return [*views, *self._markers, self.caption]

    def draw(self, i: int) -> np.ndarray:
        """Pixels of the i-th shown frame, uint8 [height, width, 3], both sizes even."""
        for view in self.views:
            view.update(i)
        for marker in self._markers:
            marker.set_xdata([self._frames.time[self._frames.frames[i]]] * 2)
        self.caption.set_text(caption(self._models, i))
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            (artist.axes or self._figure).draw_artist(artist)
        return movie_files.pixels_of(self._canvas)


def strip_figure(
    frames: RolloutFrames, view: ViewSetup, drawn: Sequence[int], dpi: int,
    beside: Sequence[RolloutFrames] = (),
) -> Figure:  # fmt: skip
    """Three moments (columns) of truth, predictions and error (rows) above the curves.

    The moments are of the frames `drawn`; predictions `beside` the first, of the same run, have a
    row each, the error row is of the first.
    """
    moments = [drawn[round(share * (len(drawn) - 1))] for share in _STRIP_MOMENTS]
    models = [frames, *beside]
    rows = [(one, which, 'speed', name) for one, which, name in _shown(models)]
    n_speed = len(rows)
    if frames.soil and frames.has_truth:
        rows.append((frames, PREDICTION, 'error', f'error ({frames.model})'))
    with rc_context(STYLE):
        page = _Page(len(moments), len(rows), models, view, dpi)
        page.caption.set_text(caption(models))
        for row, (one, which, color_by, label) in enumerate(rows):
            for column, i in enumerate(moments):
                title = f't = {frames.time[frames.frames[i]]:.2f} s' if row == 0 else ''
                axes = page.view_axes(row, column, title, label)
                first = row == column == 0
                ParticleView(axes, one, which, view, color_by, show_key=first).update(i)
        if frames.soil:
            page.add_color_bar(0, n_speed - 1, 'speed')
            if frames.has_truth:
                page.add_color_bar(n_speed, n_speed, 'error')
        for axes in page.curve_axes(models):
            for i in moments:
                time = frames.time[frames.frames[i]]
                axes.axvline(time, color=FAINT, linewidth=0.8, zorder=1)
    return page.figure


def caption(models: Sequence[RolloutFrames], i: int | None = None) -> str:
    """The errors of each model of one run in words, a line each: of the i-th shown frame (its soil,
    and the force so far), or of all frames."""
    first = models[0]
    last = None if i is None else int(first.frames[i])
    time = '' if last is None else f't = {first.time[last]:.2f} s   '
    if not first.has_truth:
        return time or f'{first.n_frames - first.first_predicted} predicted frames'
    lines = []
    for number, one in enumerate(models):
        soil = one.soil_mm if i is None else float(one.soil_rms_mm[PREDICTION][i])
        parts = [f'{one.model}: soil error {soil:.2f} mm' + ' over all frames' * (i is None)]
        if one.body_is_predicted:
            body = one.rigid_rms_mm[one.first_predicted :]
            size = np.sqrt((body**2).mean()) if last is None else one.rigid_rms_mm[last]
            parts.append(f'body {size:.2f} mm')
        loads, so_far = one.load_errors(last), ' so far' * (i is not None)
        names = {'force': f'force error{so_far}', 'drawbar': 'along the way'}
        if one.is_driven:  # the vertical force is the given load
            names = {'drawbar': f'drawbar error{so_far}', 'force': 'whole force'}
        for key, name in names.items():
            if key + '_rmse' in loads:
                share = loads[key + '_relative_l2']
                share = f' ({100 * share:.0f} %)' if np.isfinite(share) else ''
                parts.append(f'{name} {loads[key + "_rmse"]:.3g} N{share}')
        lines.append(time * (number == 0) + ', '.join(parts))
    return '\n'.join(lines)


def _shown(models: Sequence[RolloutFrames]) -> list[tuple]:
    """(rollout, truth or prediction, name) of each view."""
    first = models[0]
    truth = [(first, TRUTH, TRUE_NAME)] if first.has_truth else []
    return truth + [(one, PREDICTION, one.model) for one in models]


def draw_force(axes: Axes, truth: tuple | None, predictions: Sequence[tuple]) -> None:
    """Force over time against the way and upwards: pale the truth, (time [T], force [T, 2]), thin
    the predictions, each (name, time, force)."""
    for axis, (color, way) in enumerate(zip(AXIS_COLORS, FORCE_NAMES, strict=True)):
        if truth is not None:
            time, force = truth
            label = f'{way}, {TRUE_NAME}'
            axes.plot(time, force[:, axis], color=color, alpha=0.35, linewidth=2.6, label=label)
        for (name, time, force), dashes in zip(predictions, _MODEL_DASHES):
            label = f'{way}, {name}'
            axes.plot(time, force[:, axis], dashes, color=color, linewidth=1.2, label=label)
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    axes.set_ylabel('force on the tool (N)')
    _legend_above(axes, columns=2)


def _draw_force(axes: Axes, models: Sequence[RolloutFrames]) -> None:
    first = models[0]

    def seen(one, which, start):
        along_and_up = one.force[which][start:, list(first.axes[:2])]
        return one.time[start:], along_and_up * (-first.heading, 1.0)

    truth = seen(first, TRUTH, 0) if first.has_truth else None
    known = [one for one in models if one.force is not None]
    draw_force(axes, truth, [(m.model, *seen(m, PREDICTION, first.first_predicted)) for m in known])


def _draw_errors(axes: Axes, models: Sequence[RolloutFrames]) -> None:
    first = models[0]
    for one, color in zip(models, _MODEL_COLORS):
        time = one.time[one.frames]
        axes.plot(time, one.soil_rms_mm[PREDICTION], color=color, linewidth=1.8, label=one.model)
    for name, dashes in ((STILL, (1, 1.2)), (CONSTANT, (4, 1.5))):
        axes.plot(
            first.time[first.frames], first.soil_rms_mm[name], color=FAINT, linewidth=1.2,
            dashes=dashes, label=name,
        )  # fmt: skip
    axes.set_ylabel('soil error (mm)')
    _legend_above(axes, columns=3)
    shown = [line.get_ydata() for line in axes.lines]
    values = np.concatenate(shown)
    if not (values > 0).any():
        return  # soil that rests, and a prediction that says so
    # Predictions may be orders of magnitude better than their neighbours.
    high = 1.3 * float(values.max())
    low = max(float(values[values > 0].min()), 1e-3 * high)
    for line in axes.lines:  # what is smaller is seen at the floor
        line.set_ydata(np.maximum(line.get_ydata(), low))
    low *= 0.8
    axes.set_yscale('log')
    axes.set_ylim(low, high)
    subs = (1.0, 2.0, 5.0) if high < 200 * low else (1.0,)
    axes.yaxis.set_major_locator(ticker.LogLocator(subs=subs))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())


def _legend_above(axes: Axes, columns: int) -> None:
    axes.legend(
        loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=columns, handlelength=1.6,
        columnspacing=0.9, handletextpad=0.4, borderaxespad=0.2, labelspacing=0.25,
    )  # fmt: skip


def _remarks(frames: RolloutFrames, view: ViewSetup) -> str:
    parts = list(frames.notes)
    if frames.soil:
        count = len(frames.start)
        shown = f'{count} soil particles'
        if len(view.particles) < count:
            shown = f'{len(view.particles)} of {shown}, nearest to the middle plane'
        parts.insert(0, f'{shown}.')
    if frames.space:
        by_frame = '; by frame: of the modes alone' * (frames.space == WITH_CUT_OFF)
        parts.append(f'Soil error: root mean square {frames.space}{by_frame}.')
    return ' '.join(parts)


class _Page:
    """A figure with a header, a grid of views, a row of curves and a footer; places in inches.

    The height follows from the aspect of the views, so that they fill their place.
    """

    def __init__(
        self, n_columns: int, n_rows: int, models: Sequence[RolloutFrames], view: ViewSetup,
        dpi: int,
    ):  # fmt: skip
        frames = models[0]
        self._n_rows, self._view = n_rows, view
        width = (WIDTH - _LEFT - _RIGHT - _GAP * (n_columns - 1)) / n_columns
        self._view_height = width * view.aspect
        views = n_rows * self._view_height + (n_rows - 1) * _ROW_GAP
        below = _CURVE_GAP + _LEGEND_ROW * max(len(models) - 2, 0) + _CURVE_HEIGHT + _BOTTOM
        self._height = _TOP + views + below
        self.figure = Figure(figsize=(WIDTH, self._height), dpi=dpi, facecolor='white')
        self.canvas = FigureCanvasAgg(self.figure)
        gaps = {'wspace': _GAP / width, 'hspace': _ROW_GAP / self._view_height}
        self._views = self._grid(n_rows, n_columns, _RIGHT, below, below + views, **gaps)
        size = _TITLE_SIZE * min(1.0, _TITLE_LENGTH / len(frames.title))
        self._text(self._height - 0.24, frames.title, fontsize=size, fontweight='bold')
        self.caption = self._text(self._height - 0.62, '', fontsize=_CAPTION_SIZE)
        self._text(0.14, _remarks(frames, view), fontsize=7.5, color=FAINT)

    def view_axes(self, row: int, column: int, title: str, row_label: str = '') -> Axes:
        """Axes of one view; only the outer ones carry labels."""
        axes = self.figure.add_subplot(self._views[row, column])
        names = ['xyz'[axis] for axis in self._view.plane]
        axes.set_facecolor('#f7f8fa')
        axes.locator_params(nbins=5)
        axes.set_title(title, fontweight='bold')
        if column == 0:
            # A name that is longer than its row would run into that of the next one.
            if len(row_label) * _CHARACTER > self._view_height:
                row_label = row_label.replace(' (', '\n(')
            lines = row_label.split('\n') * bool(row_label) + [f'{names[1]} (m)']
            room = self._view_height / (_CHARACTER * max(map(len, lines)))
            axes.set_ylabel('\n'.join(lines), fontsize=_LABEL_SIZE * min(1.0, room))
        if row == self._n_rows - 1:
            axes.set_xlabel(f'{names[0]} (m)', labelpad=1)
        axes.tick_params(labelleft=column == 0, labelbottom=row == self._n_rows - 1)
        return axes

    def add_color_bar(self, first_row: int, last_row: int, color_by: str) -> None:
        rows = self._views[first_row : last_row + 1, -1].get_position(self.figure)
        axes = self.figure.add_axes((rows.x1 + 0.12 / WIDTH, rows.y0, 0.13 / WIDTH, rows.height))
        scale = ScalarMappable(Normalize(0.0, self._view.vmax[color_by]), COLOR_MAPS[color_by])
        bar = self.figure.colorbar(scale, cax=axes, extend='max')
        bar.set_label(COLOR_LABELS[color_by])
        bar.outline.set_linewidth(0.5)

    def curve_axes(self, models: Sequence[RolloutFrames]) -> list[Axes]:
        """Axes below the views, side by side, with force and error where there are any."""
        draws = [_draw_force] * (models[0].force is not None)
        draws += [_draw_errors] * models[0].has_truth
        count, top = len(draws), _BOTTOM + _CURVE_HEIGHT
        grid = self._grid(1, max(count, 1), 0.25, _BOTTOM, top, wspace=0.2)
        found = [self.figure.add_subplot(grid[0, k]) for k in range(count)]
        for axes, draw in zip(found, draws, strict=True):
            axes.grid(True)
            axes.set(xlim=(0.0, models[0].time[-1]))
            axes.set_xlabel('time (s)', labelpad=1)
            draw(axes, models)
        return found

    def _text(self, y: float, text: str, **style):
        place = (0.2 / WIDTH, y / self._height)
        return self.figure.text(*place, text, verticalalignment='center', **style)

    def _grid(self, n_rows, n_columns, right, low, high, **gaps):
        """Places of axes between heights and beside margins, in inches."""
        return self.figure.add_gridspec(
            n_rows, n_columns, left=_LEFT / WIDTH, right=1 - right / WIDTH,
            bottom=low / self._height, top=high / self._height, **gaps,
        )  # fmt: skip
