"""Judges methods on test runs: run by run, against baselines, beside the truth's own error.

Train fits, valid chooses, test is only judged. Models are rolled out as by `lts evaluate`, in
processes of one thread; the ridge on the path is fitted here. Several folders of one method are
trainings of it: its figures are mean and range.

Examples:
    python -m reports protocol --data_path=datasets/excavation,datasets/excavation_wide \\
        --model='soil field=models/excavation/soil_field' --model=pcg=/tmp/pcg_0,/tmp/pcg_1 \\
        --work_path=/tmp/protocol --output_path=docs/protocol/excavation.json

    python -m reports protocol --data_path=datasets/wheel \\
        --model='soil field=models/wheel/soil_field' \\
        --work_path=/tmp/protocol --output_path=docs/protocol/wheel.json

    python -m reports documents  # the tables of the documents, from the JSON
"""

import json

from absl import flags

from pca_tools import files
from reports.protocol import judge, tables


def define_flags() -> None:
    flags.DEFINE_string(
        'data_path', None, 'Dataset folders, separated by commas; all but the first are for soil '
        'fields alone.', required=True,
    )  # fmt: skip
    flags.DEFINE_multi_string('model', [], 'NAME=FOLDER[,FOLDER...] of trained models of a method.')
    flags.DEFINE_string('work_path', None, 'Folder for rollouts; calls resume.', required=True)
    flags.DEFINE_string('output_path', None, 'JSON file to write.', required=True)
    flags.DEFINE_integer('num_processes', 1, 'Models rolled out at a time.', 1)


def main(values) -> None:
    path = values.output_path
    methods = judge.folders_of(values.model)
    document = judge.judge(values.data_path, methods, values.work_path, values.num_processes)
    # On one line: every run of every training is in it.
    files.write_text(path, json.dumps(document, separators=(',', ':')) + '\n')
    print(tables.methods(path))
    for method in document['methods']:
        if 'bounds' in method['seeds'][0]:
            print(f'\n{method["name"]}, by kind\n{tables.kinds(path, method["name"])}')
    print(f'\n{tables.bounds(path)}\nwrote {path}')
