"""Whether a training had come to its end: valid against the steps of the training, then the runs.

Trains each preset for as many steps as are asked for, reads what the training logged of valid at
each checkpoint (`--save_every`), rolls the weights out and puts the trivial predictors beside them.
How flat the curve is, the table says: the mean error over the last quarter of the checkpoints, over
that of the quarter before. A method that is fitted at once has a row and no curve.

Examples:
    # the published presets, looked at ten times
    python -m reports training_curve --data_path=datasets/excavation \\
        --train='fcg_original --num_steps=300000 --save_every=30000' \\
        --work_path=build/curves --output_path=docs/published_presets

    # the authors' records have no test split
    python -m reports training_curve --data_path=../original/Wheel_PCA --judge=valid \\
        --train='pcg_thesis --num_steps=100000 --save_every=10000' \\
        --work_path=build/curves --output_path=docs/published_presets

A second call goes on, and keeps the rows of other data and presets.
"""

import glob
import os
import re

import numpy as np
from absl import flags

from learning_to_simulate import command as tensorflow_command
from pca_tools import files
from reports import command, markdown, record
from reports.protocol import rollouts

SCHEMA_VERSION = 1
# What metrics.json says of a run and a curve or table takes over.
KEYS = ('soil_mse', 'force_relative_l2', 'force_mpe')
# Flags of a method that say how it was trained and watched, not what it is.
OF_THE_TRAINING = re.compile(r' --(num_steps|save_every|num_threads)=\S+')


def measure(data_path: str, method: str, judge: str, work_path: str) -> dict:
    """Trains, or finds that done, and rolls out; returns a row of the JSON.

    Args:
      data_path: dataset folder.
      method: `PRESET --FLAG=VALUE ...`, as of `reports.protocol`.
      judge: the split that is rolled out.
      work_path: folder for models and rollouts.

    Raises:
      ValueError: a training that failed, or too few checkpoints to say that a curve is flat.
    """
    name = os.path.basename(os.path.normpath(data_path))
    model = os.path.join(work_path, name, rollouts.name_of_folder(method))
    rollouts.train(data_path, model, rollouts.training_flags(method), shown=True)
    curve = curve_of(model)
    if 0 < len(curve) < 4:
        raise ValueError(
            f'{model}: valid was looked at {len(curve)} times; its last quarter can be compared '
            f'from 4 on (--save_every)'
        )
    output = rollouts.roll_out(data_path, model, judge, os.path.join(work_path, name, 'rollouts'))
    found = files.read_json(os.path.join(output, 'metrics.json'))
    return {
        'data': name,
        'method': method,
        'judge': judge,
        'curve': curve,
        'runs': {
            predictor: [{key: run.get(key) for key in KEYS} for run in runs]
            for predictor, runs in found['runs'].items()
        },
    }


def curve_of(model_path: str) -> list[dict]:
    """What the training logged of valid: [{step, soil_mse, force_mse}], by step.

    Steps that were trained twice, after a training was killed, count as they were last.
    """
    tensorflow_command.import_tensorflow()
    import tensorflow as tf

    names = {'rollout_error_mse': 'soil_mse', 'force_error_mse': 'force_mse'}
    found: dict[int, dict] = {}
    for path in sorted(glob.glob(os.path.join(model_path, 'events.*'))):
        for event in tf.compat.v1.train.summary_iterator(path):
            for value in event.summary.value:
                if value.tag in names:
                    number = float(tf.make_ndarray(value.tensor))
                    row = found.setdefault(event.step + 1, {'step': event.step + 1})
                    row[names[value.tag]] = number if np.isfinite(number) else None
    return [found[step] for step in sorted(found)]


def change(curve: list[dict], key: str) -> float | None:
    """Mean over the last quarter of the checkpoints, over that of the quarter before; None where
    one of them has no number."""
    n = len(curve) // 4
    known = [row[key] for row in curve[-2 * n :] if row.get(key) is not None]
    return float(np.mean(known[n:]) / np.mean(known[:n])) if len(known) == 2 * n else None


def mean_of(runs: list[dict], key: str) -> float | None:
    """Mean over runs, of the size of percentages; None where a run has none."""
    values = [run[key] for run in runs]
    return None if None in values else float(np.mean(np.abs(values)))


def table(*paths: str) -> str:
    """Errors of the judged runs beside the trivial predictors, and how flat the curves are."""
    header = ('data, runs', 'method', 'steps', 'last quarter over the one before: soil, force²',
              'soil MSE 1e-4 m²', 'median', 'against the better trivial', 'force rel. L2',
              'mean size of MPE %')  # fmt: skip
    lines: list[tuple] = []
    rows = [row for path in paths for row in files.read_json(path)['rows'].values()]
    order = list(dict.fromkeys(row['data'] for row in rows))
    for row in sorted(rows, key=lambda row: order.index(row['data'])):
        n_run = len(row['runs']['model'])
        where = f'{row["data"]}, {row["judge"]}, {n_run}'
        if where not in {line[0] for line in lines}:
            lines += [
                (where, f'*{text}*', '', '', *_errors(row['runs'][name], None))
                for name, text in markdown.TRIVIAL.items()
            ]
        curve = row['curve']  # empty for a method that is fitted at once
        flat = [markdown.cell(change(curve, key)) for key in ('soil_mse', 'force_mse') if curve]
        lines.append(
            (where, OF_THE_TRAINING.sub('', row['method']), curve[-1]['step'] if curve else '',
             ', '.join(flat), *_errors(row['runs']['model'], row['runs']))
        )  # fmt: skip
    return markdown.table(header, lines)


def _errors(runs, all_runs):
    soil = mean_of(runs, 'soil_mse')
    known = [run['soil_mse'] for run in runs if run['soil_mse'] is not None]
    beside = ''
    if all_runs:
        trivial = np.min(
            [[run['soil_mse'] for run in all_runs[name]] for name in markdown.TRIVIAL], axis=0
        )
        own = [np.inf if run['soil_mse'] is None else run['soil_mse'] for run in runs]
        beside = f'wins {int((np.array(own) < trivial).sum())} of {len(runs)}'
    return (
        'not finite' if soil is None else 1e4 * soil,
        1e4 * float(np.median(known)) if known else None,
        beside,
        mean_of(runs, 'force_relative_l2'),
        mean_of(runs, 'force_mpe'),
    )


def draw(path: str, picture: str) -> None:
    """Draws soil and force on valid against the steps, a line for each row that has a curve."""
    from matplotlib import figure

    rows = [row for row in files.read_json(path)['rows'].values() if row['curve']]
    drawn = figure.Figure(figsize=(9, 4.2), layout='constrained')
    panels = drawn.subplots(1, 2)
    for axes, key, title in zip(
        panels, ('soil_mse', 'force_mse'), ('soil, MSE 1e-4 m²', 'force, RMS N'), strict=True
    ):
        for number, row in enumerate(rows):
            points = [(p['step'], p[key]) for p in row['curve'] if p.get(key) is not None]
            if not points:
                continue
            steps, values = np.array(points).T
            values = np.sqrt(values) if key == 'force_mse' else 1e4 * values
            label = f'{row["method"].split(" --")[0]}, {row["data"]}'
            axes.plot(steps / 1000, values, 'o-', markersize=3, color=f'C{number}', label=label)
        axes.set(xlabel='thousand training steps', ylabel=f'{title} (valid)')
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    handles, labels = panels[0].get_legend_handles_labels()
    drawn.legend(
        handles, labels, loc='outside lower center', ncols=3, frameon=False, fontsize='small'
    )
    files.write_atomically(picture, lambda name: drawn.savefig(name, format='png', dpi=130))


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_list('train', None, 'Presets, "PRESET --FLAG=VALUE".', required=True)
    flags.DEFINE_enum('judge', 'test', ['test', 'valid'], 'Split that is rolled out at the end.')
    flags.DEFINE_string('work_path', None, 'Folder for trainings; calls resume.', required=True)
    flags.DEFINE_string('output_path', None, 'Path of .json and .png, without it.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    path = f'{values.output_path}.json'
    held = files.read_json(path)['rows'] if os.path.exists(path) else {}
    for method in values.train:
        row = measure(values.data_path, method, values.judge, values.work_path)
        row |= {'record': record.provenance()}
        held[f'{row["data"]} {method}'] = row
        files.write_json(path, {'schema_version': SCHEMA_VERSION, 'rows': held})
    draw(path, f'{values.output_path}.png')
    print(table(path))
    print(f'wrote {path} and .png')


if __name__ == '__main__':
    command.start(define_flags, main)
