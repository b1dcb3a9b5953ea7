"""Error against run time: trains or loads what it compares, times it in turns, writes the report.

The output folder gets `points.json` (all raw numbers), and made from it alone `table.md`,
`table.csv`, `position.png` and `force.png`. The same command again goes on where it was stopped;
finished rows are not repeated.

Examples:
    # the whole report of a scene: one to two hours on one core
    python -m reports error_vs_runtime --data_path=datasets/excavation \\
        --work_path=/tmp/work_precision --output_path=docs/error_vs_runtime/excavation

    # a few rows with little training, within 10 minutes on two cores
    python -m reports error_vs_runtime --data_path=datasets/wheel --quick \\
        --work_path=/tmp/quick --output_path=/tmp/quick_report

    # what the decisions behind `pcg` are worth: one changed at a time, trained in full
    python -m reports error_vs_runtime --data_path=datasets/wheel --families=decisions \\
        --work_path=/tmp/decisions --output_path=/tmp/decisions_report

    # table and pictures again from the stored numbers; the best model for 0.2 ms a step
    python -m reports error_vs_runtime --from_json \\
        --output_path=docs/error_vs_runtime/excavation --budget_ms=0.2
"""

import os
from typing import TYPE_CHECKING

from absl import flags

from pca_tools import files
from reports import command, isolated
from reports.record import ROOT
from reports.work_precision import families, pictures, tables
from reports.work_precision.points import choose

if TYPE_CHECKING:
    from reports.work_precision import survey

QUICK_TRAINING = {'num_steps': 400, 'unroll_steps': 60, 'unroll_length': 4}


def write_report(document: dict, output_path: str) -> list[str]:
    """Writes the table and the pictures of a stored report; returns the file names."""
    texts = {'table.md': tables.table(document), 'table.csv': tables.comma_separated(document)}
    written = []
    for name, text in texts.items():
        written.append(os.path.join(output_path, name))
        files.write_text(written[-1], text)
    for quantity in pictures.QUANTITIES:
        if any(pictures.QUANTITIES[quantity][1](p, 'test') for p in document['points']):
            written.append(os.path.join(output_path, f'{quantity}.png'))
            pictures.draw(document, quantity, written[-1])
    return written


def recommendation(document: dict, budget_ms: float) -> str:
    """The best model for a budget, in one line.

    Raises:
      ValueError: no model is that fast; says the fastest.
    """
    from reports.work_precision import measure

    point = choose(document['points'], budget_ms)
    errors = ', '.join(
        f'{split} {point.position_error(split):.3g} mm' for split in measure.SPLITS
        if point.position_error(split) is not None
    )  # fmt: skip
    forces = ', '.join(
        f'{split} {tables.force_error(point, split):.3g}' for split in measure.SPLITS
        if tables.force_error(point, split) is not None
    )  # fmt: skip
    flags_ = ' '.join(f'--{key}={value}' for key, value in point.overrides.items())
    return (
        f'best model within {budget_ms:g} ms per step: {point.label} ({point.step_ms():.3g} ms, '
        f'99th percentile); soil RMS {errors}; force relative L2 {forces or "absent"}; '
        f'train it with {flags_}'
    )


def make_settings(values) -> 'survey.Settings':
    """Flags -> settings of the survey."""
    from reports.work_precision import survey

    if values.quick:
        whole, sweeps, training = families.QUICK_WHOLE, families.QUICK_SWEEPS, QUICK_TRAINING
        seeds = sweep_seeds = 1
    else:
        whole, sweeps = families.WHOLE, families.SWEEPS
        seeds, sweep_seeds = values.seeds, values.sweep_seeds
        training = {
            'num_steps': values.sweep_steps,
            'unroll_steps': values.sweep_unroll_steps,
            'unroll_length': values.sweep_unroll_length,
        }
    if values.families:
        whole = whole | families.ON_DEMAND
        if unknown := set(values.families) - {*whole, *sweeps}:
            raise ValueError(
                f'unknown families {sorted(unknown)}; there are {", ".join([*whole, *sweeps])}'
            )
        whole, sweeps = (
            {name: rows for name, rows in members.items() if name in values.families}
            for members in (whole, sweeps)
        )
    return survey.Settings(
        whole, sweeps, training, values.models_path, seeds, sweep_seeds, values.rounds,
        threads=values.num_threads, num_processes=values.num_processes, cluster=values.cluster,
        row_limit_s=60.0 * values.row_minutes, time_again=values.time_again,
        solver_json=values.solver_json,
    )  # fmt: skip


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.')
    flags.DEFINE_string('work_path', None, 'Folder for the models that are trained.')
    flags.DEFINE_string('output_path', None, 'Folder of the report.', required=True)
    flags.DEFINE_string('models_path', None, 'Trained models to load instead of training them; '
                        'default: models/<name of the dataset folder> of the project.')  # fmt: skip
    flags.DEFINE_string('solver_json', None, 'Rows of reports coarse_solver; default: '
                        'docs/coarse_solver_<scene>.json where it exists.')  # fmt: skip
    flags.DEFINE_list('families', None, 'Only these, as a report of its own (another '
                      f'--output_path). Default: all but {families.DECISIONS!r}.')  # fmt: skip
    flags.DEFINE_bool('from_json', False, 'Measure nothing: report from the stored numbers.')
    flags.DEFINE_bool('time_again', False, 'Time all rows again, after a call on a busy machine.')
    flags.DEFINE_bool('quick', False, 'Few rows, little training: within 10 minutes.')
    flags.DEFINE_integer('seeds', 3, 'Trainings of each row at full length.', 1)
    flags.DEFINE_integer('sweep_seeds', 1, 'Trainings of each swept row.', 1)
    flags.DEFINE_integer('sweep_steps', 2000, 'Single-step training of the swept rows.', 1)
    flags.DEFINE_integer('sweep_unroll_steps', 800, 'Unrolled training of the swept rows.', 0)
    flags.DEFINE_integer('sweep_unroll_length', 8, 'Frames per unrolled step there.', 2)
    flags.DEFINE_integer('rounds', 30, 'Timed rollouts of each model.', 1)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads of TensorFlow.', 1)
    command.define_workers('Rows trained at a time.')
    flags.DEFINE_float('row_minutes', 30.0, 'A row that trains longer has failed.', 0.0)
    flags.DEFINE_float('budget_ms', None, 'Name the best model for so many ms per step.')


def main(values, _) -> None:
    """Runs the command."""
    from reports.work_precision import survey

    if values.from_json:
        document = survey.read_document(os.path.join(values.output_path, survey.DOCUMENT))
    else:
        missing = [n for n in ('data_path', 'work_path') if not values[n].value]
        if missing:
            raise ValueError(f'give --{" and --".join(missing)}, or --from_json')
        scene = os.path.basename(os.path.abspath(values.data_path))
        if values.models_path is None:
            values.models_path = os.path.join(ROOT, 'models', scene)
        solver_json = os.path.join(ROOT, 'docs', f'coarse_solver_{scene}.json')
        if values.solver_json is None and os.path.exists(solver_json):
            values.solver_json = solver_json
        isolated.use_threads(values.num_threads)
        document = survey.Survey(
            values.data_path, values.work_path, values.output_path, make_settings(values)
        ).run()
    written = write_report(document, values.output_path)
    print(tables.table(document))
    print('wrote ' + ', '.join(written))
    if values.budget_ms is not None:
        print(recommendation(document, values.budget_ms))


if __name__ == '__main__':
    command.start(define_flags, main)
