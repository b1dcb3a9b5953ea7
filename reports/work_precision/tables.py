"""The report's table, from the stored points alone: Markdown to read, CSV to compute with."""

import csv
import io
from collections.abc import Sequence

from pca_tools import files
from reports import markdown, record
from reports.timing import CLOCKS
from reports.work_precision import families
from reports.work_precision.points import (
    OK,
    WorkPrecisionPoint,
    over_seeds,
    pareto_front,
    read_document,
)

SUMMARY = (
    'persistence', 'constant velocity', 'truncation error', 'fcg_original', 'pcg_thesis', 'pcg',
    'pcg, L = 32', 'MLP', 'Motion-Mixer, SE', 'GNS on particles', 'solver, cells x 2',
    'solver, cells x 1.5',
)  # fmt: skip
COLUMNS = (
    'model', 'edges', 'weights', 'soil RMS mm, valid', 'test', 'of best trivial', 'force rel. L2, '
    'valid', 'test', 'ms per step', 'p99', 'worst', 'live p99', 's per simulated s',
    'first call s', 'MB', 'trained s',
)  # fmt: skip


def front_labels(
    points: Sequence[WorkPrecisionPoint], error, dt: float, split: str = 'test'
) -> set[str]:
    """Labels of the models that no other beats in both time and error.

    Args:
      points: rows; failures and rows without a network are no candidates.
      error: function (point, split) -> error or None.
      dt: seconds per frame.
      split: the split of the error.
    """
    rows = [
        (p.label, time, size)
        for p in over_seeds(points) if p.status == OK and p.overrides
        if (time := p.seconds_per_second(dt)) is not None and (size := error(p, split)) is not None
    ]  # fmt: skip
    front = pareto_front([row[1:] for row in rows])
    return {row[0] for row, kept in zip(rows, front, strict=True) if kept}


def force_error(point: WorkPrecisionPoint, split: str) -> float | None:
    """Relative L2 error of the force, mean over runs."""
    return point.error(split, 'force_relative_l2')


def best_trivial(points: Sequence[WorkPrecisionPoint], split: str) -> float | None:
    """Soil MSE of the better trivial predictor, m²; None if the report holds none."""
    values = [p.error(split, 'soil_mse') for p in points if not p.overrides]
    return min((v for v in values if v), default=None)


def table(document: dict) -> str:
    """The table with what a reader must know about it."""
    points = document['points']
    lines = [
        f'**{document["scene"]}**: error against run time, batch 1. '
        f'{record.sentence(document["machine"])}.',
        '',
        rows_table(document),
    ]
    failures = [f'- {p.label}, seed {p.seed}: **{p.status}**. {p.note}'
                for p in points if p.status != OK]  # fmt: skip
    lines += [
        '',
        '▲ on the front of soil error and time, ● of force error and time (test). Soil errors are '
        'RMS per coordinate with the truncation error of the modes, mean over runs and seeds; of '
        'best trivial: soil MSE within the modes over that of the better of persistence and '
        'constant velocity, whose force is the mean of the training runs; in brackets the range '
        'over seeds. Times: whole compiled rollouts in '
        'turns, median; live: single steps from Python. First call: compilation included. MB: '
        'peak of a process of its own, TensorFlow included.',
    ]
    training = document.get('swept_training')
    if training:
        given = ', '.join(f'{k} {v}' for k, v in training.items())
        lines.append(f'Swept rows are trained alike and shorter than shipped ones: {given}.')
    notes = [f'- {p.label}: {p.note}' for p in points if p.status == OK and p.note]
    if failures:
        lines += ['', 'Failures:', *failures]
    if notes:
        lines += ['', 'Notes:', *notes]
    return '\n'.join(lines) + '\n'


def rows_table(document: dict) -> str:
    """The rows alone: one per label, the mean over its seeds and their range."""
    points, dt = document['points'], document['dt']
    position_front = front_labels(points, WorkPrecisionPoint.position_error, dt)
    force_front = front_labels(points, force_error, dt)
    lines = []
    for point in over_seeds(points):
        marks = ' ▲' * (point.label in position_front) + ' ●' * (point.label in force_front)
        seeds = [p for p in points if p.label == point.label]
        lines.append([point.label + marks, *_cells(point, seeds, points, dt)])
    return markdown.table(COLUMNS, lines)


def summary(*paths: str) -> str:
    """Soil and force errors on test and the time of a step, scene beside scene.

    Args:
      *paths: `points.json` of each scene.
    """
    documents = [read_document(path) for path in paths]
    header: list[str] = ['mean (range over trainings)']
    found: dict[str, dict] = {}
    few: dict[str, str] = {}
    for document in documents:
        header += [f'{document["scene"]}: soil RMS mm', 'force rel. L2', 'ms per step']
        n_run = max(point.n_run('test') for point in document['points'])
        for point in over_seeds(document['points']):
            if point.label in SUMMARY:
                seeds = [p for p in document['points'] if p.label == point.label]
                count = seeds[0].n_run('test')
                if count < n_run:  # the solver: not every case was simulated again
                    few[point.label] = f'{point.label} ({count} runs of {n_run})'
                found.setdefault(point.label, {})[document['scene']] = (
                    markdown.span([p.position_error('test') for p in seeds]),
                    markdown.span([force_error(p, 'test') for p in seeds]),
                    point.rollout and point.overrides and point.rollout.percentile(50),
                )
    empty = (None,) * 3
    return markdown.table(
        header,
        [
            [
                few.get(label, label),
                *(c or None for d in documents for c in cells.get(d['scene'], empty)),
            ]
            for label in SUMMARY
            if (cells := found.get(label))
        ],
    )


def shipped(*paths: str) -> str:
    """The shipped presets: sizes, and errors on test of all trainings of the same recipe.

    Args:
      *paths: `points.json` of each scene.
    """
    header = ('model', 'weights', 'edges', 'soil RMS mm', 'truncation error mm', 'force rel. L2',
              'ms per step')  # fmt: skip
    lines = []
    for path in paths:
        document = read_document(path)
        floor = next(p for p in document['points'] if p.label == markdown.FLOOR)
        for point in over_seeds(document['points']):
            if families.SHIPPED not in point.families:
                continue
            seeds = [p for p in document['points'] if p.label == point.label]
            lines.append(
                (f'`models/{document["scene"]}/{point.label}`', point.n_weight, point.n_edge,
                 markdown.span([p.position_error('test') for p in seeds]),
                 floor.position_error('test'),
                 markdown.span([force_error(p, 'test') for p in seeds]),
                 point.rollout and point.rollout.percentile(50))
            )  # fmt: skip
    return markdown.table(header, lines)


def sweeps(*paths: str) -> str:
    """The rows of the sweeps: soil error on valid and test and the time of a step, per scene."""
    documents = [read_document(path) for path in paths]
    header: list[str] = ['left out, or added']
    found: dict[str, dict] = {}
    for document in documents:
        header += [f'{document["scene"]}: valid, mm', 'test, mm', 'ms per step']
        for p in document['points']:
            if not set(p.families).isdisjoint(families.SWEEPS):
                found.setdefault(p.label, {})[document['scene']] = (
                    p.position_error('valid'), p.position_error('test'),
                    p.rollout and p.rollout.percentile(50),
                )  # fmt: skip
    empty = (None,) * 3
    return markdown.table(
        header,
        [
            [label, *(c for d in documents for c in cells.get(d['scene'], empty))]
            for label, cells in found.items()
        ],
    )


def decisions(path: str) -> str:
    """Rows with one decision changed each, one training a row.

    Args:
      path: JSON list of name, valid and test; since then these rows are a family of the survey.
    """
    header = ('alternative', 'soil MSE of best trivial, valid', 'test', 'force rel. L2, valid',
              'test')  # fmt: skip
    keys = [(s, k) for k in ('of_best_trivial', 'force_relative_l2') for s in ('valid', 'test')]
    rows = files.read_json(path)
    return markdown.table(header, [(row['name'], *(row[s][k] for s, k in keys)) for row in rows])


def _cells(point, seeds, points, dt):
    def spread(error):
        if error(point) is None:
            return '' if point.status == OK else f'**{point.status}**'
        return markdown.span(map(error, seeds))

    def ratio(point):
        trivial, value = best_trivial(points, 'test'), point.error('test', 'soil_mse')
        return None if not trivial or value is None else value / trivial

    rollout = point.rollout
    times = [None] * 3 if rollout is None else [rollout.percentile(q) for q in (50, 99, 100)]
    return [
        point.n_edge,
        point.n_weight,
        *(spread(lambda p, s=s: p.position_error(s)) for s in ('valid', 'test')),
        spread(ratio),
        *(spread(lambda p, s=s: force_error(p, s)) for s in ('valid', 'test')),
        *times,
        point.live and point.live.percentile(99),
        point.seconds_per_second(dt),
        point.first_call_s,
        point.peak_memory_mb,
        point.training_s,
    ]


def comma_separated(document: dict) -> str:
    """Every point and seed as CSV, one line each."""
    names = (
        'label', 'families', 'seed', 'status', 'note', 'n_node', 'n_edge', 'n_weight', 'load_s',
        'first_call_s', 'peak_memory_mb', 'base_memory_mb', 'training_s', 'digest',
    )  # fmt: skip
    errors = ('soil_mse', 'soil_rms_mm', 'soil_rms_mm_full', 'rigid_mse', 'force_relative_l2')
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator='\n')
    writer.writerow(
        [
            *names,
            *(f'{e}_{split}' for split in ('valid', 'test') for e in errors),
            *(f'{kind}_ms_{c}' for kind in ('rollout', 'live') for c in CLOCKS),
            's_per_simulated_s',
        ]
    )
    for p in document['points']:
        row = ['; '.join(v) if isinstance(v, tuple) else v for v in (getattr(p, n) for n in names)]
        row += [p.error(split, e) for split in ('valid', 'test') for e in errors]
        for timing in (p.rollout, p.live):
            row += [None] * len(CLOCKS) if timing is None else timing.summary().values()
        row.append(p.seconds_per_second(document['dt']))
        writer.writerow(['' if v is None else v for v in row])
    return buffer.getvalue()
