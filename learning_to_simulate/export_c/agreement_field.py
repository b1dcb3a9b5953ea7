"""Compares swept fields in C with Python over whole test runs, every frame, run by run.

Example:
  python -m learning_to_simulate.export_c.agreement_field --output=docs/c/agreement_field.json
"""

import functools

from absl import flags

from learning_to_simulate import command
from learning_to_simulate.export_c import agreement, comparing, field_data
from learning_to_simulate.export_c.c_field import CField
from learning_to_simulate.live import resting_start
from learning_to_simulate.swept_field.live import LiveField
from pca_tools import dataset, files, splits
from pca_tools.storage import markdown

PARTICLES_EVERY = 40


def measure(model_path: str, data_path: str, limit: int = 0) -> list[dict]:
    """One row for each test run, see `comparing.play_field`, with its `kind` and `case`.

    Args:
      model_path, data_path: a swept field and its dataset.
      limit: only so many runs, spread over test; 0: all.

    Raises:
      FileNotFoundError, ValueError: no model or dataset there.
      c_library.NoCompiler: there is no C compiler.
    """
    field, parts = field_data.read(model_path)
    live = LiveField(field, *resting_start.read(model_path))
    soil = CField.of(field, **parts)
    cases = dataset.read_metadata(data_path).get('cases', {}).get('test', [])
    rows = []
    runs = dataset.read_split(data_path, 'test')
    for record in splits.spread_over(len(runs), limit):
        run, case = runs[record], cases[record] if record < len(cases) else {}
        row = comparing.play_field(soil, live, run, case.get('case'), PARTICLES_EVERY)
        rows.append({'kind': case.get('kind'), 'case': case.get('case'), **row})
    return rows


def table(path: str) -> str:
    """The largest of all runs of each model, from a JSON file of this command."""
    lines = []
    keys = 'force', 'torque', 'height_m', 'particles_m', 'c_to_twin_m', 'python_to_twin_m'
    for model, rows in files.read_json(path).items():
        worst = [f'{max(row[key] for row in rows):.1e}'.replace('e-0', 'e-') for key in keys]
        frames, same = (sum(row[key] for row in rows) for key in ('frames', 'same_status'))
        lines.append((model, len(rows), frames, *worst, f'{same} of {frames}'))
    header = 'model', 'runs', 'frames', 'force', 'torque', 'height, m', 'particles, m'
    return markdown.table((*header, 'C to twin, m', 'Python to twin, m', 'status agrees'), lines)


if __name__ == '__main__':
    flags.DEFINE_list(
        'models', [f'models/{s}_v2/swept_field' for s in ('excavation', 'wheel')], 'Model folders.'
    )
    flags.DEFINE_string('data_root', 'datasets', 'Folder of the datasets, named as the scenes.')
    flags.DEFINE_string('output', None, 'JSON file for the figures; other models in it stay.')
    command.start(functools.partial(agreement.run, measure=measure))
