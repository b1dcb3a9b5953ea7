"""Trains the default preset with one decision changed at a time, and tabulates what each is worth.

Every row is trained and rolled out by the same commands as the shipped models; rows that are
finished are not repeated. The validation split decides about defaults, the test split reports.

Examples:
    python -m reports alternatives --data_path=datasets/wheel --work_path=/tmp/alternatives \\
        --output_path=docs/alternatives_wheel.json
"""

import os
import sys

import tensorflow as tf
from absl import app, flags

from learning_to_simulate import evaluation, experiment, presets
from pca_tools import files

ALTERNATIVES = {
    'default': {},
    'single-step training only': {'unroll_steps': 0},
    'accelerations instead of displacements': {
        'mode_order': 2, 'rigid_order': 2, 'rate_scaled': False, 'velocity_inputs': 5,
    },
    'displacements per frame, not per body displacement': {'rate_scaled': False},
    'five last velocities as inputs': {'velocity_inputs': 5},
    'all rigid particles': {'rigid_particles': 0},
    'five lowest rigid particles': {'rigid_particles': 5},
    'published inputs (no conditioning)': {
        'conditioned': False, 'rate_scaled': False, 'velocity_inputs': 5, 'rigid_particles': 0,
    },
}  # fmt: skip


def measure(data_path: str, name: str, overrides: dict, work: str) -> dict:
    """Trains one alternative, or finishes it, and returns its errors on valid and test."""
    model_path = os.path.join(work, name.replace(' ', '_').replace('>', ''))
    experiment.train(data_path, model_path, presets.make_config('pcg', **overrides))
    row = {'name': name, 'overrides': overrides}
    for split in ('valid', 'test'):
        model, metadata, groups = experiment.load_for_evaluation(model_path, data_path, split, {})
        _, summary = evaluation.Evaluator(model, metadata).run(groups, split)
        mean = summary['mean']['model']
        row[split] = {
            'soil_mse': mean['soil_mse'],
            'of_best_trivial': summary['soil_mse_over_best_trivial'],
            'force_relative_l2': mean.get('force_relative_l2'),
            'milliseconds_per_step': mean['milliseconds_per_step'],
        }
    return row


def markdown(rows: list[dict]) -> str:
    """The rows as a Markdown table."""
    lines = [
        '| alternative | soil MSE of best trivial, valid | test | force rel. L2, valid | test |',
        '|---|---|---|---|---|',
    ]
    for row in rows:
        cells = [
            f'{row[split][key]:.3g}'
            for key in ('of_best_trivial', 'force_relative_l2')
            for split in ('valid', 'test')
        ]
        lines.append(f'| {row["name"]} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_string('work_path', None, 'Folder for the models.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.', required=True)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads of TensorFlow.', 1)


def main(_) -> None:
    """Runs the command."""
    values = flags.FLAGS
    tf.config.threading.set_intra_op_parallelism_threads(values.num_threads)
    rows = []
    try:
        for name, overrides in ALTERNATIVES.items():
            print(f'{len(rows) + 1} of {len(ALTERNATIVES)}: {name}')
            rows.append(measure(values.data_path, name, overrides, values.work_path))
            files.write_json(values.output_path, rows)
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(markdown(rows))


if __name__ == '__main__':
    define_flags()
    app.run(main)
