"""Pictures of the stability report, drawn from its curves."""

import os
from typing import Any

import numpy as np
from matplotlib import rc_context, ticker
from matplotlib.figure import Figure

from learning_to_simulate.rendering.rollout_figures import STYLE

# Okabe and Ito (2008); models also differ by the style of their lines.
COLORS = {'pcg': '#0072b2', 'pcg_thesis': '#d55e00', 'fcg_original': '#009e73'}
LINES = {'pcg': '-', 'pcg_thesis': '--', 'fcg_original': '-.'}
GREY, INK = '#8693a0', '#1f2933'
FRAME_RATE = 60.0


def draw_all(curves: dict, folder: str) -> list[str]:
    """Draws every picture whose curves are there; returns the names of the files."""
    names = []
    for name, key, draw in (
        ('error_growth.png', 'growth', _growth),
        ('ten_horizons.png', 'horizon', _horizon),
        ('rigid_shape.png', 'rigid', _rigid),
        ('perturbed_starts.png', 'perturbation', _perturbation),
        ('springs.png', 'springs', _springs),
    ):
        if not curves.get(key):
            continue
        style: Any = STYLE | {'legend.fontsize': 8}
        with rc_context(style):
            figure = Figure(layout='constrained')
            draw(figure, curves)
            for axes in figure.axes:
                _plain_ticks(axes)
            figure.savefig(os.path.join(folder, name), dpi=130)
        names.append(name)
    return names


def _plain_ticks(axes):
    """Labels a logarithmic axis with plain numbers, between the decades too where they are few."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() != 'log':
            continue
        low, high = axis.get_view_interval()
        subs = (1, 2, 5) if high / low < 300 else (1,)
        axis.set_major_locator(ticker.LogLocator(subs=subs, numticks=12))
        axis.set_major_formatter('{x:g}')
        axis.set_minor_formatter(ticker.NullFormatter())


def _preset(curve):
    return curve['model'].split()[1]


def _finite(value):
    return value if value is not None and np.isfinite(value) else 0.0


def _style(curve):
    return {'color': COLORS[_preset(curve)], 'linestyle': LINES[_preset(curve)], 'linewidth': 1.4}


def _panels(figure, curves):
    """One axes per scene, side by side with a shared scale; returns [(axes, its curves)]."""
    scenes = list(dict.fromkeys(curve['model'].split()[0] for curve in curves))
    axes = figure.subplots(1, len(scenes), squeeze=False)[0]
    figure.set_size_inches(4.6 * len(scenes) + 0.4, 3.4)
    panels = []
    for one, scene in zip(axes, scenes):
        one.set_title(scene)
        one.grid(True)
        panels.append((one, [c for c in curves if c['model'].startswith(scene)]))
    return panels


def _growth(figure, curves):
    for axes, of_scene in _panels(figure, curves['growth']):
        for curve in of_scene:
            seconds = np.array(curve['frames']) / FRAME_RATE
            axes.semilogy(seconds, curve['mm']['model'], label=_preset(curve), **_style(curve))
        for name, line in (('persistence', ':'), ('constant velocity', (0, (1, 3)))):
            values = of_scene[0]['mm'][name]
            axes.semilogy(seconds, values, color=INK, linestyle=line, linewidth=1.1, label=name)
        axes.set(xlabel='time (s)', ylabel='soil RMS error (mm)')
        axes.legend(ncols=2)
    figure.suptitle('Error over the horizon of the data, test runs, within the subspace')


def _horizon(figure, curves):
    data = curves['horizon']
    scenes = list(dict.fromkeys(c['model'].split()[0] for c in data))
    figure.set_size_inches(9.6, 3.1 * 2)
    panels = figure.subplots(2, len(scenes), squeeze=False, sharex=True)
    for column, scene in enumerate(scenes):
        of_scene = [c for c in data if c['model'].startswith(scene)]
        of_scene = [c for c in of_scene if c['continuation'] == 'to and fro']
        for row, (key, label) in enumerate(
            (
                ('distance_mm', 'distance from the start (mm)'),
                ('speed_mm_per_frame', 'motion per frame (mm)'),
            )
        ):
            axes = panels[row, column]
            for curve in of_scene:
                seconds = np.array(curve['frames']) / FRAME_RATE
                failed = curve['time_to_failure_s']
                values = np.array(curve[key], float)
                axes.semilogy(seconds, values, label=_preset(curve), **_style(curve))
                if failed is not None:
                    at = np.interp(failed, seconds, values)
                    axes.plot(failed, at, 'X', color=COLORS[_preset(curve)], markersize=8)
            if key == 'distance_mm':
                axes.semilogy(
                    seconds, of_scene[0]['constant_velocity_mm'], ':', color=INK, linewidth=1.1,
                    label='constant velocity',
                )  # fmt: skip
            axes.axvspan(0, 321 / FRAME_RATE, color='#e6f2ee', zorder=0)
            axes.set(ylabel=f'soil RMS {label}', xlim=(0, seconds[-1]))
            largest = max(max(map(_finite, curve[key])) for curve in of_scene)
            axes.set_ylim(bottom=1e-3 * largest, top=2 * largest)
            axes.grid(True)
        panels[0, column].set_title(scene)
        panels[1, column].set_xlabel('time (s)')
    panels[0, 0].legend(loc='lower right', bbox_to_anchor=(1.0, 0.2))
    figure.suptitle(
        'Ten horizons, given motion to and fro (median of the test runs; shaded: the data; '
        'X: first run out of bounds)',
        fontsize=9,
    )


def _rigid(figure, curves):
    for axes, of_scene in _panels(figure, curves['rigid']):
        for curve in of_scene:
            seconds = np.array(curve['frames']) / FRAME_RATE
            for way, width in (('without', 1.4), ('with', 2.4)):
                style = _style(curve) | {'linewidth': width}
                label = f'{_preset(curve)}, {way} correction'
                axes.semilogy(seconds, np.maximum(curve[way], 1e-6), label=label, **style)
        axes.set(xlabel='time (s)', ylabel='largest change of a distance in the body (mm)')
        axes.legend()
    figure.set_size_inches(6.4, 3.6)


def _perturbation(figure, curves):
    for axes, of_scene in _panels(figure, curves['perturbation']):
        for curve in of_scene:
            seconds = np.array(curve['frames']) / FRAME_RATE
            first = curve['amplitude'] == of_scene[0]['amplitude']
            label = _preset(curve) if first else None
            axes.semilogy(seconds, curve['mm'], label=label, **_style(curve))
        axes.set(xlabel='time (s)', ylabel='RMS distance from the rollout (mm)')
    figure.axes[0].legend(loc='upper center', ncols=3, bbox_to_anchor=(0.5, 1.0))
    figure.axes[0].margins(y=0.2)
    sizes = ', '.join(f'{a:g}' for a in sorted({c['amplitude'] for c in curves['perturbation']}))
    figure.suptitle(f'Starts that are off by {sizes} of the RMS motion per frame')


def _springs(figure, curves):
    figure.set_size_inches(5.4, 3.4)
    axes = figure.subplots()
    data = curves['springs']
    x = [c['stiffness'] for c in data]
    axes.loglog(x, [c['drift'] for c in data], 'o-', color=COLORS['pcg'], label='measured')
    axes.loglog(x, [c['bound'] for c in data], ':', color=GREY, label='closed form, largest')
    axes.axvline(0.8, color=COLORS['pcg_thesis'], label='refused from here')
    axes.set(xlabel='k dt²', ylabel='largest relative change of energy')
    axes.grid(True)
    axes.legend()
