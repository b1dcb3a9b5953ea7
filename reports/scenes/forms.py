"""Each scene's model in its forms for other programs, C and LiteRT: timed, or refused.

A form's time does not see what the weights are, so the models here have the shape of those of
`reports scenes` and two training steps. Each form is compared with the model that it came from.
Times are CPU time of one core, median of single steps: modes and force, no particles.

Examples:
    python -m reports scene_forms --output_path=docs
    python -m reports scene_forms --scenes=column,pair --output_path=/tmp/forms
"""

import os
import tempfile
import time

import numpy as np
from absl import flags

import learning_to_simulate as lts
from pca_tools import files
from reports import command, markdown, record
from reports.scenes import report

FORMS = {'c': 'C', 'tflite': 'LiteRT'}
SHORT = report.RECIPE | {'num_steps': 2, 'unroll_steps': 0}


def judge(name: str, folder: str, calls: int) -> dict[str, dict]:
    """What becomes of each form of a scene.

    Args:
      name: of the scene.
      folder: to work in.
      calls: timed of each form.

    Returns:
      form -> `ms_per_step` and `relative_difference` to the source, or `refused`: the sentence
      that says why.
    """
    data = report.make(folder, name)
    model = os.path.join(folder, name, 'model')
    lts.train(report.preset(name, SHORT), data, model)
    rows = {}
    for kind in FORMS:
        try:
            rows[kind] = _row(kind, model, data.path, os.path.join(folder, name, kind), calls)
        except ValueError as error:
            rows[kind] = {'refused': str(error)}
    return rows


def _row(kind, model, data, path, calls):
    from learning_to_simulate.export import export_formats, exporting
    from learning_to_simulate.export_c import benchmark
    from learning_to_simulate.export_c import exporting as exporting_c

    if kind == 'c':
        compared = exporting_c.export(model, data, path, kind)['compared']
        ms = 1e-3 * benchmark.measure(model, data, calls)['C step']['median_us']
    else:
        compared = exporting.export(model, data, path, kind)['compared']
        ms = _litert_ms(os.path.join(path, export_formats.TFLITE_FILE), calls)
    difference = max(compared['relative_difference'].values())
    return {'ms_per_step': ms, 'relative_difference': difference}


def _litert_ms(path, calls):
    """Median ms a step of a LiteRT file, on one thread."""
    from learning_to_simulate.export import export_formats

    interpreter = export_formats.litert_interpreter()(model_path=path, num_threads=1)
    step = interpreter.get_signature_runner()
    inputs = {
        name: np.zeros(value['shape'], value['dtype'])
        for name, value in step.get_input_details().items()
    }
    seconds = []
    for _ in range(calls):
        start = time.process_time()
        step(**inputs)
        seconds.append(time.process_time() - start)
    return 1e3 * float(np.median(seconds))


def table(path: str) -> str:
    """Times and differences of a JSON of this report, by scene."""
    rows = files.read_json(path)['rows']
    header = (
        'scene',
        *(f'{title}, ms a step' for title in FORMS.values()),
        *(f'{title}: largest difference' for title in FORMS.values()),
    )
    keys = [('ms_per_step', 'refused'), ('relative_difference', '')]
    return markdown.table(
        header,
        (
            (f'`{name}`', *(row[kind].get(key, none) for key, none in keys for kind in FORMS))
            for name, row in rows.items()
        ),
    )


def refusals(path: str) -> str:
    """The forms that scenes do not have, and why, from the same JSON."""
    rows = files.read_json(path)['rows']
    refused = [
        (f'`{name}`', title, row[kind]['refused'])
        for name, row in rows.items()
        for kind, title in FORMS.items()
        if 'refused' in row[kind]
    ]
    return markdown.table(('scene', 'form', 'what the export says'), refused)


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('scenes', list(report.SCENES), 'Which scenes.')
    flags.DEFINE_integer('calls', 2000, 'Timed steps of each form.', 1)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads of the trainings.', 1)
    flags.DEFINE_string('output_path', None, 'Folder for scene_forms.json.', required=True)


def run(values, _) -> None:
    """Runs the report; scenes that are there are left out.

    Raises:
      ValueError: an unknown scene.
    """
    if unknown := set(values.scenes) - set(report.SCENES):
        raise ValueError(f'unknown scenes {sorted(unknown)}; there are {", ".join(report.SCENES)}')
    os.makedirs(values.output_path, exist_ok=True)
    target = os.path.join(values.output_path, 'scene_forms.json')
    document = record.resume(target, {'calls': values.calls}, {'rows': {}})
    for name in values.scenes:
        if name not in document['rows']:
            with tempfile.TemporaryDirectory() as folder:
                rows = document['rows'] | {name: judge(name, folder, values.calls)}
            document['rows'] = {known: rows[known] for known in report.SCENES if known in rows}
            files.write_json(target, document | record.provenance(values.num_threads))
            print(f'{name}: {document["rows"][name]}', flush=True)
    print(table(target))
    print(refusals(target))


if __name__ == '__main__':
    command.start(define_flags, run)
