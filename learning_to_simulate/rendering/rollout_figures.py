"""The pictures of a rollout: a figure that is animated, and a strip of moments for print.

Both hold truth and prediction in the same colours, and below them force and error over time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from learning_to_simulate.rendering import rollout_captions, rollout_curves
from learning_to_simulate.rendering.particle_views import COLOR_MAPS, ParticleView, ViewSetup
from learning_to_simulate.rendering.rollout_curves import FAINT, INK
from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH, RolloutFrames

STYLE = {
    'font.family': 'DejaVu Sans',
    'font.size': 9,
    'axes.edgecolor': '#52606d',
    'axes.labelcolor': INK,
    'axes.linewidth': 0.8,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.titlesize': 10,
    'axes.titlelocation': 'left',
    'axes.axisbelow': True,
    'legend.fontsize': 7,
    'legend.frameon': False,
    'text.color': INK,
    'xtick.color': '#52606d',
    'ytick.color': '#52606d',
    'xtick.labelsize': 8,
    'ytick.labelsize': 8,
    'grid.color': '#e4e7eb',
    'grid.linewidth': 0.7,
}
COLOR_LABELS = {'speed': 'soil speed (mm/s)', 'error': 'soil error (mm)'}
WIDTH = 9.6  # inches
# Margins and distances in inches.
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.98, 0.92, 0.92, 0.72
_GAP, _ROW_GAP, _CURVE_HEIGHT, _CURVE_GAP = 0.3, 0.16, 1.45, 0.78
_LABEL_SIZE, _CHARACTER = 9, 0.073  # points and inches, of a label and of a letter in it
# Points; a title of more characters is set smaller, so that it stays on one line.
_TITLE_SIZE, _TITLE_LENGTH = 11.5, 88
# Share of the predicted frames that have passed at each moment of the strip.
_STRIP_MOMENTS = (1 / 3, 2 / 3, 1.0)


class AnimatedFigure:
    """Truth, where there is one, and one or several predictions side by side over time.

    What stands still is drawn once and restored as an image; only what moves is drawn in every
    frame.

    Args:
        frames: the rollout.
        view: shared setup of both views.
        color_by: `speed` or `error`.
        dpi: pixels per inch; the figure is `WIDTH` inches wide.
        beside: other predictions of the same run; curves and captions are those of the first.

    Attributes:
        views: the `ParticleView` of the truth and those of the predictions.
    """

    def __init__(
        self,
        frames: RolloutFrames,
        view: ViewSetup,
        color_by: str,
        dpi: int,
        beside: Sequence[RolloutFrames] = (),
    ):
        self._frames = frames
        shown = _shown(frames, beside)
        with rc_context(STYLE):
            page = _Page(n_columns=len(shown), n_rows=1, aspect=view.aspect, dpi=dpi)
            page.write_header(frames)
            page.write_footer(frames, view)
            self.views = []
            for column, (one, which, name) in enumerate(shown):
                axes = page.view_axes(0, column, view, title=name[0].upper() + name[1:])
                self.views.append(
                    ParticleView(axes, one, which, view, color_by, show_key=column == 0)
                )
            if frames.subspace is not None:
                page.add_color_bar(0, 0, color_by, view)
            curves = page.curve_axes(rollout_curves.count(frames))
            rollout_curves.draw(curves, frames, view.plane)
            self._markers = [axes.axvline(0.0, color=INK, linewidth=1.0) for axes in curves]
            self._status = page.write_status()
        self._canvas, self._figure = page.canvas, page.figure
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)

    @property
    def _moving(self) -> list:
        views = [artist for view in self.views for artist in view.artists]
        return [*views, *self._markers, self._status]

    def draw(self, frame: int) -> np.ndarray:
        """Draws one frame; returns its pixels, uint8 [height, width, 3], both sizes even."""
        for view in self.views:
            view.update(frame)
        for marker in self._markers:
            marker.set_xdata([self._frames.time[frame]] * 2)
        self._status.set_text(rollout_captions.status_line(self._frames, frame))
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            (artist.axes or self._figure).draw_artist(artist)
        pixels = np.asarray(self._canvas.buffer_rgba())
        height, width = (2 * (size // 2) for size in pixels.shape[:2])
        return pixels[:height, :width, :3].copy()


def strip_figure(
    frames: RolloutFrames,
    view: ViewSetup,
    drawn: Sequence[int],
    dpi: int,
    beside: Sequence[RolloutFrames] = (),
) -> Figure:
    """Draws three moments (columns) of truth, predictions and error (rows) above the curves.

    Args:
        frames: the rollout.
        view: shared setup of all views.
        drawn: the frames to choose the moments from.
        dpi: pixels per inch.
        beside: other predictions of the same run, a row each; the error is that of the first.

    Returns:
        The figure, ready to be saved.
    """
    later = [frame for frame in drawn if frame >= frames.first_predicted] or list(drawn)
    moments = [later[round(share * (len(later) - 1))] for share in _STRIP_MOMENTS]
    rows = [(one, which, 'speed', name) for one, which, name in _shown(frames, beside)]
    n_speed = len(rows)
    if frames.subspace is not None and frames.has_truth:
        # Longer names would run into the row above.
        name = f'error ({frames.label})' if frames.label else 'error of prediction'
        rows.append((frames, PREDICTION, 'error', name))
    with rc_context(STYLE):
        page = _Page(n_columns=len(moments), n_rows=len(rows), aspect=view.aspect, dpi=dpi)
        page.write_header(frames)
        page.write_footer(frames, view)
        page.write_status().set_text(rollout_captions.summary_line(frames))
        for row, (one, which, color_by, label) in enumerate(rows):
            for column, frame in enumerate(moments):
                title = f't = {frames.time[frame]:.2f} s' if row == 0 else ''
                axes = page.view_axes(row, column, view, title=title, row_label=label)
                first = row == column == 0
                ParticleView(axes, one, which, view, color_by, show_key=first).update(frame)
        if frames.subspace is not None:
            page.add_color_bar(0, n_speed - 1, 'speed', view)
            if frames.has_truth:
                page.add_color_bar(n_speed, n_speed, 'error', view)
        curves = page.curve_axes(rollout_curves.count(frames))
        rollout_curves.draw(curves, frames, view.plane)
        for axes in curves:
            for frame in moments:
                axes.axvline(frames.time[frame], color=FAINT, linewidth=0.8, zorder=1)
    return page.figure


def _shown(frames: RolloutFrames, beside: Sequence[RolloutFrames]) -> list[tuple]:
    """(rollout, truth or prediction, name) of each view."""
    shown = [(frames, which, _name(frames, which)) for which in frames.shown]
    return shown + [(other, PREDICTION, _name(other, PREDICTION)) for other in beside]


def _name(frames: RolloutFrames, which: str) -> str:
    if which == TRUTH:
        return 'ground truth'
    return f'prediction ({frames.label})' if frames.label else 'prediction'


class _Page:
    """A figure with a header, a grid of views, a row of curves and a footer; places in inches.

    The height follows from the aspect of the views, so that they fill their place.
    """

    def __init__(self, n_columns: int, n_rows: int, aspect: float, dpi: int):
        self._n_columns, self._n_rows = n_columns, n_rows
        width = WIDTH - _LEFT - _RIGHT - _GAP * (n_columns - 1)
        self._view_width = width / n_columns
        self._view_height = self._view_width * aspect
        views = n_rows * self._view_height + (n_rows - 1) * _ROW_GAP
        self._height = _TOP + views + _CURVE_GAP + _CURVE_HEIGHT + _BOTTOM
        self.figure = Figure(figsize=(WIDTH, self._height), dpi=dpi, facecolor='white')
        self.canvas = FigureCanvasAgg(self.figure)

    def view_axes(
        self, row: int, column: int, view: ViewSetup, title: str, row_label: str = ''
    ) -> Axes:
        """Axes of one view; only the outer ones carry labels."""
        axes = self._add_axes(
            _LEFT + column * (self._view_width + _GAP),
            self._row_bottom(row),
            self._view_width,
            self._view_height,
        )
        names = ['xyz'[axis] for axis in view.plane]
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

    def add_color_bar(self, first_row: int, last_row: int, color_by: str, view: ViewSetup) -> None:
        """Colour bar at the right end of some rows."""
        bottom = self._row_bottom(last_row)
        height = self._row_bottom(first_row) + self._view_height - bottom
        axes = self._add_axes(WIDTH - _RIGHT + 0.12, bottom, 0.13, height)
        scale = ScalarMappable(Normalize(0.0, view.vmax[color_by]), COLOR_MAPS[color_by])
        bar = self.figure.colorbar(scale, cax=axes, extend='max')
        bar.set_label(COLOR_LABELS[color_by])
        bar.outline.set_linewidth(0.5)

    def curve_axes(self, count: int) -> list[Axes]:
        """Axes below the views, side by side."""
        gap = 0.75
        width = (WIDTH - _LEFT - 0.25 - gap * (count - 1)) / count
        return [
            self._add_axes(_LEFT + i * (width + gap), _BOTTOM, width, _CURVE_HEIGHT)
            for i in range(count)
        ]

    def write_header(self, frames: RolloutFrames) -> None:
        """Scene and case."""
        size = _TITLE_SIZE * min(1.0, _TITLE_LENGTH / len(frames.title))
        self._text(0.2, self._height - 0.26, frames.title, fontsize=size, fontweight='bold')

    def write_status(self):
        """Returns the text below the header."""
        return self._text(0.2, self._height - 0.52, '', fontsize=9.5)

    def write_footer(self, frames: RolloutFrames, view: ViewSetup) -> None:
        """How the picture was made, and what its reader should know."""
        parts = list(frames.notes)
        if frames.subspace is not None:
            shown = f'{frames.n_soil} soil particles'
            if len(view.particles) < frames.n_soil:
                shown = f'{len(view.particles)} of {shown}, nearest to the middle plane'
            modes = frames.subspace.n_modes
            parts.insert(0, f'{shown}; {" and ".join(frames.shown)} decoded from {modes} modes.')
        self._text(0.2, 0.14, ' '.join(parts), fontsize=7, color=FAINT)

    def _row_bottom(self, row: int) -> float:
        return self._height - _TOP - (row + 1) * self._view_height - row * _ROW_GAP

    def _text(self, x: float, y: float, text: str, **style):
        place = (x / WIDTH, y / self._height)
        return self.figure.text(*place, text, verticalalignment='center', **style)

    def _add_axes(self, left: float, bottom: float, width: float, height: float) -> Axes:
        return self.figure.add_axes(
            (left / WIDTH, bottom / self._height, width / WIDTH, height / self._height)
        )
