"""The report's pictures, from the stored points alone: error against run time, both logarithmic."""

import math

from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from pca_tools import files
from reports import markdown, record
from reports.work_precision import families, labels, solver_rows, tables
from reports.work_precision.points import OK, WorkPrecisionPoint, over_seeds

# Okabe & Ito 2008: told apart with every common colour blindness; the markers tell it twice.
STYLES = (
    ('#0072B2', 'o'), ('#E69F00', 's'), ('#009E73', '^'), ('#CC79A7', 'D'), ('#D55E00', 'v'),
    ('#56B4E9', 'P'), ('#000000', 'X'), ('#8C6D1F', '<'),
    ('#7F7F7F', 'h'),
)  # fmt: skip
REFERENCE_LINES = {
    markdown.FLOOR: (0, (1, 1)), markdown.TRIVIAL['stay_still']: (0, (6, 2)),
    'constant velocity': (0, (6, 2, 1, 2)),
}  # fmt: skip
QUANTITIES = {
    'position': ('soil error on {split} runs, mm RMS', WorkPrecisionPoint.position_error),
    'force': ('force error on {split} runs, relative L2', tables.force_error),
}


def draw(document: dict, quantity: str, path: str, split: str = 'test') -> None:
    """Draws one picture: a curve per family, the spread over seeds, the front, the references.

    Args:
      document: as `survey.read_document` returns it.
      quantity: a key of `QUANTITIES`.
      path: PNG file.
      split: the runs that the errors are of.

    Raises:
      ValueError: no row has both a time and this error.
    """
    title, error = QUANTITIES[quantity]
    dt = document['dt']
    first = {p.label: p for p in over_seeds(document['points'])}
    places = {
        label: (time, size)
        for label, p in first.items()
        if families.REFERENCE not in p.families and p.status == OK
        if (time := p.seconds_per_second(dt)) is not None and (size := error(p, split)) is not None
    }
    if not places:
        raise ValueError(f'no model has both a time and a {quantity} error on {split}')
    figure = Figure(
        figsize=(10.5, 6.5), dpi=130, layout='constrained'
    )  # no pyplot: no display is needed
    axes = figure.subplots()
    axes.set(xscale='log', yscale='log', xlabel='seconds of computing per simulated second',
             ylabel=title.format(split=split))  # fmt: skip
    axes.set_title(f'{document["scene"]}: {quantity} error against run time', loc='left')
    _draw_families(axes, first, places)
    for label in places:
        seeds = [p for p in document['points'] if p.label == label]
        _draw_spread(axes, places[label], [error(p, split) for p in seeds])
    front = sorted(
        places[x] for x in tables.front_labels(document['points'], error, dt, split) if x in places
    )
    axes.plot(*zip(*front, strict=True), color='0.82', linewidth=6, zorder=1, marker='o',
              markersize=15, label='front: no model is better in both')  # fmt: skip
    references = {
        label: error(p, split) for label, p in first.items() if families.REFERENCE in p.families
    }
    slowest = [p.seconds_per_second(dt) or 0.0 for p in first.values()]
    _set_limits(axes, places.values(), references.values(), max(1.0, *slowest))
    failures = [p for p in document['points'] if p.status != OK]
    _draw_failures(axes, failures, dt)
    _draw_references(axes, {k: v for k, v in references.items() if v})
    fine = next((p for p in first.values() if p.label == solver_rows.FINE), None)
    _draw_times(axes, dt, fine)
    axes.grid(True, which='major', alpha=0.35)
    axes.grid(True, which='minor', alpha=0.12)
    axes.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), fontsize=9, frameon=False)
    figure.supxlabel(_caption(document, failures), fontsize=7.5, x=0.01, ha='left')
    labels.place(axes, places)
    files.write_atomically(path, lambda name: figure.savefig(name, format='png'))


def _draw_families(axes, first, places):
    """One curve per sweep, joined in the order of time; what is no sweep is not joined."""
    known = (*families.WHOLE, *families.SWEEPS, solver_rows.FAMILY)  # One colour in all pictures.
    present = dict.fromkeys(f for label in places for f in first[label].families)
    for name in (*(n for n in known if n in present), *(n for n in present if n not in known)):
        index = known.index(name) if name in known else len(known)
        colour, marker = STYLES[index % len(STYLES)]
        curve = sorted(places[label] for label in places if name in first[label].families)
        loose = name in (families.SHIPPED, families.OTHER_METHODS)
        axes.plot(*zip(*curve, strict=True), color=colour, marker=marker,
                  linestyle='None' if loose else '-', linewidth=1.3,
                  markersize=9 if loose else 6, label=name, zorder=3)  # fmt: skip


def _draw_spread(axes, place, errors):
    """The range over seeds as a bar, every seed a dash."""
    errors = [e for e in errors if e is not None]
    if len(errors) > 1:
        axes.vlines(place[0], min(errors), max(errors), color='0.2', linewidth=1.2, zorder=2)
        axes.plot([place[0]] * len(errors), errors, '_', color='0.2', markersize=9, zorder=2)


def _set_limits(axes, places, references, slowest):
    times, errors = zip(*places, strict=True)
    errors = [*errors, *(v for v in references if v)]
    axes.set_xlim(min(times) / 1.6, slowest * 1.6)
    low, high = math.log(min(errors)), math.log(max(errors))
    margin = 0.08 * (high - low) + 0.05
    axes.set_ylim(math.exp(low - margin), math.exp(high + 2.2 * margin))
    plain = FuncFormatter(lambda value, _: f'{value:g}')
    axes.xaxis.set_major_formatter(plain)
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5)))
    axes.yaxis.set_major_formatter(plain)
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_failures(axes, failures, dt):
    """Timed failures as crosses on the upper edge; the others are named in the caption."""
    for p in failures:
        seconds = p.seconds_per_second(dt)
        if seconds is not None:
            axes.plot(seconds, 0.985, 'x', color='#D55E00', markersize=9, markeredgewidth=2,
                      transform=axes.get_xaxis_transform(), clip_on=False)  # fmt: skip


def _draw_references(axes, references):
    for label, value in references.items():
        style = REFERENCE_LINES.get(label, '--')
        axes.axhline(value, color='0.35', linewidth=1.1, linestyle=style, label=label, zorder=1)


def _draw_times(axes, dt, fine):
    """Vertical lines: a frame per frame time, a step per millisecond, the fine solver."""
    times = [
        (1.0, f'real time: a frame every 1/{1 / dt:.0f} s', '-'),
        (1e-3 / dt, '1 kHz: a step every ms', '-'),
    ]
    if fine is not None:
        times.append((fine.seconds_per_second(dt), 'the solver that made the data', ':'))
    for seconds, text, style in times:
        axes.axvline(seconds, color='#555555', linewidth=1.4, linestyle=style, zorder=1)
        axes.text(0.985 * seconds, 0.02, text, rotation=90, ha='right', va='bottom', fontsize=8.5,
                  color='#333333', transform=axes.get_xaxis_transform(),
                  bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 1})  # fmt: skip


def _caption(document, failures):
    lines = [
        'Batch 1, whole compiled rollouts, median of '
        f'{_rounds(document["points"])} calls in turns. {record.sentence(document["machine"])}.'
    ]
    names = dict.fromkeys(f'{p.label}, seed {p.seed} ({p.status})' for p in failures)
    if names:
        lines.append('Failed (crosses where timed): ' + '; '.join(names) + '.')
    return '\n'.join(lines)


def _rounds(points):
    return max((len(p.rollout.samples_ms) for p in points if p.rollout and p.overrides), default=0)
