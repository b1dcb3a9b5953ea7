"""Curves of a rollout over time: force, soil error beside its trivial neighbours, mode scores.

Without a truth: force and mode scores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps, ticker
from matplotlib.axes import Axes

from learning_to_simulate.rendering.rollout_frames import PREDICTION, TRUTH, RolloutFrames

INK, FAINT = '#1f2933', '#8693a0'
# Okabe and Ito (2008): told apart with every kind of colour vision.
_COMPONENT_COLORS = ('#0072b2', '#d55e00')
_ERROR_COLOR = '#7b1f6b'
_RIGID_COLOR = '#009e73'
_FLOOR_COLOR = '#c8a24a'
# From this ratio of its ends on, a logarithmic axis is labelled at powers of ten only.
_FEW_TICKS_FROM = 200.0


def count(frames: RolloutFrames) -> int:
    """Number of axes that `draw` needs."""
    return 1 if frames.force is None else 2


def draw(axes: Sequence[Axes], frames: RolloutFrames, plane: tuple[int, int]) -> None:
    """Draws the force (where there is one), then errors, or mode scores where there is no soil.

    Args:
        axes: `count(frames)` of them.
        frames: the rollout.
        plane: the two axes whose force components are drawn.
    """
    for one in axes:
        one.grid(True)
        one.set(xlim=(0.0, frames.time[-1]))
        one.set_xlabel('time (s)', labelpad=1)
    if frames.force is not None:
        _draw_force(axes[0], frames, plane)
    if frames.subspace is None or not frames.has_truth:
        _draw_scores(axes[-1], frames)
    else:
        _draw_errors(axes[-1], frames)


def _draw_force(axes: Axes, frames: RolloutFrames, plane: tuple[int, int]) -> None:
    start = frames.first_predicted
    for axis, color in zip(plane, _COMPONENT_COLORS):
        name = 'xyz'[axis]
        if frames.has_truth:
            axes.plot(
                frames.time, frames.force[TRUTH][:, axis], color=color, alpha=0.35, linewidth=2.6,
                label=f'{name}, truth',
            )  # fmt: skip
        axes.plot(
            frames.time[start:], frames.force[PREDICTION][start:, axis], color=color, linewidth=1.3,
            label=f'{name}, predicted',
        )  # fmt: skip
    axes.axhline(0.0, color=FAINT, linewidth=0.7)
    axes.set_ylabel('force on the body (N)')
    shown = frames.force[frames.reference][:, plane]
    low, high = min(0.0, float(shown.min())), max(0.0, float(shown.max()))
    room = 0.12 * (high - low) or 1.0
    axes.set_ylim(low - room, high + room)
    _legend_above(axes, columns=4)


def _draw_errors(axes: Axes, frames: RolloutFrames) -> None:
    start, rms = frames.first_predicted, frames.soil_rms_mm
    time = frames.time[start:]
    axes.plot(time, rms[PREDICTION][start:], color=_ERROR_COLOR, linewidth=1.8, label='predicted')
    if frames.body_is_predicted:
        axes.plot(
            time, frames.rigid_rms_mm[start:], color=_RIGID_COLOR, linewidth=1.3, label='body'
        )
    for name, dashes in (('persistence', (1, 1.2)), ('constant velocity', (4, 1.5))):
        axes.plot(time, rms[name][start:], color=FAINT, linewidth=1.2, dashes=dashes, label=name)
    if frames.projection_mse is not None:
        floor = 1e3 * frames.projection_mse**0.5
        axes.axhline(floor, color=_FLOOR_COLOR, linewidth=1.2, label='truncation error')
    axes.set_ylabel('soil error, RMS (mm)')
    _legend_above(axes, columns=5)
    shown = [line.get_ydata() for line in axes.lines]
    medians = [float(np.median(y)) for y in shown if np.median(y) > 0]
    if not medians:
        return  # soil that rests, and a prediction that says so
    # Predictions may be orders of magnitude better than their neighbours.
    axes.set_yscale('log')
    low, high = min(medians) / 5.0, 2.0 * max(float(np.max(y)) for y in shown)
    axes.set_ylim(low, high)
    steps = (1.0, 2.0, 5.0) if high < _FEW_TICKS_FROM * low else (1.0,)
    axes.yaxis.set_major_locator(ticker.LogLocator(subs=steps))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())


def _draw_scores(axes: Axes, frames: RolloutFrames) -> None:
    """Change of the modes' x scores: pale the truth, thin the prediction."""
    start = frames.first_predicted
    n_modes = frames.scores[PREDICTION].shape[1]
    colors = colormaps['viridis'](np.linspace(0.0, 0.9, n_modes))
    change = {which: x[..., 0] - x[0, :, 0] for which, x in frames.scores.items()}
    for mode, color in enumerate(colors):
        if frames.has_truth:
            axes.plot(frames.time, change[TRUTH][:, mode], color=color, alpha=0.35, linewidth=2.6)
        axes.plot(
            frames.time[start:], change[PREDICTION][start:, mode], color=color, linewidth=1.3,
            label=f'{mode + 1}',
        )  # fmt: skip
    axes.set_ylabel('x score since start (m)')
    _legend_above(axes, columns=n_modes)


def _legend_above(axes: Axes, columns: int) -> None:
    """A legend in one line that covers no curve."""
    axes.legend(
        loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=columns, handlelength=1.3,
        columnspacing=0.8, handletextpad=0.4, borderaxespad=0.2,
    )  # fmt: skip
