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
        ('solver_stiffness.png', 'stiffness', _stiffness),
        ('solver_limits.png', 'divergence', _limits),
        ('error_growth.png', 'growth', _growth),
        ('ten_horizons.png', 'horizon', _horizon),
        ('rigid_shape.png', 'rigid', _rigid),
        ('extrapolation.png', 'extrapolation', _extrapolation),
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


def _stiffness(figure, curves):
    data = curves['stiffness']
    figure.set_size_inches(9.2, 5.6)
    factor = [c['factor'] for c in data]
    step, cost, force, energy = figure.subplots(2, 2).ravel()
    for axes, key, scale, title in (
        (step, 'time_step_s', 1e3, 'Largest stable step (ms): falls as 1 / sqrt(E)'),
        (cost, 'cpu_s_per_simulated_s', 1.0, 'Cost (CPU s per simulated s): rises as sqrt(E)'),
    ):
        values = np.array([c[key] for c in data]) * scale
        axes.loglog(factor, values, 'o-', color=COLORS['pcg'], linewidth=1.4)
        slope = -0.5 if axes is step else 0.5
        ideal = values[1] * np.array(factor) ** slope
        axes.loglog(factor, ideal, ':', color=GREY, label='slope of 1/2')
        axes.set(title=title)
        axes.legend()
    colors = ('#56b4e9', '#0072b2', '#d55e00', INK)
    for curve, color in zip(data, colors):
        time = (1 + np.arange(len(curve['force_N']))) / FRAME_RATE
        label = f'E x {curve["factor"]:g}'
        force.plot(time, curve['force_N'], color=color, linewidth=1.2, label=label)
    force.set(title='Draft of the blade (N)', xlabel='time (s)')
    force.legend(ncols=2)
    share = [c['energy_gained_J'] / c['work_J'] for c in data]
    energy.semilogx(factor, share, 'o-', color=COLORS['pcg'], linewidth=1.4)
    energy.axhline(1.0, color=COLORS['pcg_thesis'], linewidth=1.0, label='energy out of nothing')
    energy.set(title='Energy the soil gained over work of the blade', ylim=(-0.1, 1.15))
    energy.legend(loc='center right')
    for axes in (step, cost, energy):
        axes.set_xlabel("factor on Young's modulus 1.5 MPa")
    for axes in (step, cost, force, energy):
        axes.grid(True)


def _limits(figure, curves):
    figure.set_size_inches(9.2, 3.2)
    rest, gravity = figure.subplots(1, 2)
    known = [c for c in curves['divergence'] if c['speed_m_s'] is not None]
    rest.semilogy(
        [c['cfl'] for c in known], [1e3 * c['speed_m_s'] for c in known], 'o-', color=COLORS['pcg']
    )
    for c in curves['divergence']:
        if c['speed_m_s'] is None:
            rest.axvline(c['cfl'], color=COLORS['pcg_thesis'], linewidth=1.2)
            rest.annotate(
                'a particle leaves the grid', (c['cfl'], 0.5), rotation=90, ha='right', va='center',
                xycoords=('data', 'axes fraction'), color=COLORS['pcg_thesis'], fontsize=8,
            )  # fmt: skip
    rest.axvspan(0.0, 0.8, color='#e6f2ee', zorder=0)
    rest.annotate('allowed', (0.42, 0.93), xycoords=('data', 'axes fraction'), ha='center')
    rest.set(title='Soil at rest: largest speed (mm/s)', xlabel='CFL number', xlim=(0.3, 2.05))
    data = [c for c in curves['gravity'] if c['crossed'] is not None and c['factor'] > 0]
    gravity.loglog(
        [c['factor'] for c in data], [c['crossed'] for c in data], 'o-', color=COLORS['pcg']
    )
    gravity.axhline(0.5, color=COLORS['pcg_thesis'], label='refused above')
    gravity.set(title='Cells that soil crosses between exchanges', xlabel='gravity (g)')
    gravity.legend()
    for axes in (rest, gravity):
        axes.grid(True)


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


def _extrapolation(figure, curves):
    data = [c for c in curves['extrapolation'] if c['model'].startswith('excavation')]
    keys = list(dict.fromkeys(c['key'] for c in data))
    titles = {
        'depth_m': 'depth (m)', 'speed_m_s': 'speed (m/s)', 'angle_deg': 'angle (degrees)',
    }  # fmt: skip
    figure.set_size_inches(9.6, 5.6)
    panels = figure.subplots(2, len(keys), squeeze=False)
    for column, key in enumerate(keys):
        of_key = [c for c in data if c['key'] == key]
        for row, (what, label) in enumerate(
            (('moved_mm', 'RMS way of the soil (mm)'), ('force_N', 'mean force (N)'))
        ):
            axes = panels[row, column]
            for model in dict.fromkeys(c['model'] for c in of_key):
                of_model = [c for c in of_key if c['model'] == model]
                x = [c['value'] for c in of_model]
                y = [c[what] for c in of_model]
                axes.plot(x, y, label=model.split()[1], **_style(of_model[0]))
                for c in of_model:
                    face = COLORS[_preset(c)] if c['status'] == 'ok' else 'white'
                    axes.plot(
                        c['value'], c[what], 'o', markersize=5, color=COLORS[_preset(c)],
                        markerfacecolor=face, clip_on=False, zorder=3,
                    )  # fmt: skip
            trained = of_key[0]['trained']
            axes.axvspan(0, trained, color='#e6f2ee', zorder=0)
            axes.set(
                xlim=(of_key[0]['value'] * 0.8, of_key[-1]['value']),
                ylim=(0, 1.05 * max(c[what] for c in of_key)),
                ylabel=label if column == 0 else None,
            )
            axes.grid(True)
        panels[1, column].set_xlabel(titles[key])
    panels[0, 0].legend()
    figure.suptitle(
        'Beyond the training range (shaded: trained; open circles: flagged by status)', fontsize=9
    )


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
