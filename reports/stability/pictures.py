"""Pictures of the stability report, drawn from its curves: a panel a scene, a line a model."""

import os

import numpy as np
from matplotlib import rc_context, ticker
from matplotlib.figure import Figure

from learning_to_simulate.rendering.rollout_figures import STYLE

# Okabe and Ito (2008); models also differ by the style of their lines.
_LINES = {
    'pcg': {'color': '#0072b2', 'linestyle': '-'},
    'pcg_thesis': {'color': '#d55e00', 'linestyle': '--'},
    'fcg_original': {'color': '#009e73', 'linestyle': '-.'},
    'persistence': {'color': '#1f2933', 'linestyle': ':'},
    'constant velocity': {'color': '#1f2933', 'linestyle': (0, (1, 3))},
}
FRAME_RATE = 60.0
# Name of the picture -> its curves, what is drawn of each (name of its line, None for that of its
# model -> key), the title, and the label of the axis.
_PICTURES = {
    'error_growth': (
        'growth',
        {None: 'mm', 'persistence': 'persistence_mm', 'constant velocity': 'constant_velocity_mm'},
        'Error over the horizon of the data, test runs, within the subspace',
        'soil RMS error (mm)',
    ),
    'ten_horizons': (
        'horizon',
        {None: 'distance_mm', 'constant velocity': 'constant_velocity_mm'},
        'Given motion to and fro, median of the test runs; X: first run out of bounds',
        'soil RMS distance from the start (mm)',
    ),
    'perturbed_starts': (
        'perturbation',
        {None: 'mm'},
        'Starts that are off by a share of the RMS motion per frame',
        'RMS distance from the rollout (mm)',
    ),
}


def draw_all(curves: dict, folder: str) -> list[str]:
    """Draws every picture whose curves are there; returns the names of the files."""
    names = []
    for name, (key, lines, title, label) in _PICTURES.items():
        if not curves.get(key):
            continue
        with rc_context(STYLE | {'legend.fontsize': 8}):  # type: ignore[arg-type]
            figure = Figure(layout='constrained')
            _draw(figure, curves[key], lines, label)
            figure.suptitle(title, fontsize=10)
            names.append(f'{name}.png')
            figure.savefig(os.path.join(folder, names[-1]), dpi=130)
    return names


def _draw(figure, curves, lines, label):
    scenes = list(dict.fromkeys(curve['model'].split()[0] for curve in curves))
    panels = figure.subplots(1, len(scenes), squeeze=False)[0]
    figure.set_size_inches(4.6 * len(scenes) + 0.4, 3.4)
    for axes, scene in zip(panels, scenes, strict=True):
        largest, named = 0.0, set()
        for curve in (c for c in curves if c['model'].split()[0] == scene):
            seconds, model = np.array(curve['frames']) / FRAME_RATE, curve['model'].split()[1]
            for name, key in lines.items():
                held = curve.get('continuation') == 'held at its end'
                if held or (name and name in named):
                    continue  # the trivial predictors are the same beside every model
                values = np.array(curve[key], float)
                style = _LINES[name or model] | {'linewidth': 1.4}
                shown = None if (name or model) in named else name or model
                axes.semilogy(seconds, values, label=shown, **style)
                named.add(name or model)
                if np.isfinite(values).any():
                    largest = max(largest, float(np.nanmax(values[np.isfinite(values)])))
                if name is None and curve.get('time_to_failure_s') is not None:
                    at = np.interp(curve['time_to_failure_s'], seconds, values)
                    axes.plot(curve['time_to_failure_s'], at, 'X', markersize=8, **style)
        axes.set(title=scene, xlabel='time (s)', ylim=(1e-4 * largest, 2 * largest))
        axes.yaxis.set_major_formatter('{x:g}')
        axes.yaxis.set_minor_formatter(ticker.NullFormatter())
        axes.grid(True)
    panels[0].set_ylabel(label)
    panels[0].legend(ncols=2)
