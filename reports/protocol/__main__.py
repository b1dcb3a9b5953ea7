"""Judges methods by the protocol: per run, in full space, over seeds, against all baselines.

Train fits the baselines, valid chooses (the median seed, the ridge), test is only judged. Models
are rolled out by `learning_to_simulate.train --mode=eval_rollout`, each in a process of its own.

Examples:
    # the shipped models of both scenes and all baselines: docs/protocol/<dataset>.json and tables
    python -m reports.protocol --work_path=/tmp/protocol --output_path=docs/protocol

    # and five seeds of an MLP, trained here; a second call goes on
    python -m reports.protocol --train=mlp --num_seeds=5 --work_path=/tmp/protocol \\
        --output_path=docs/protocol

    # presets with other flags of the training are methods of their own
    python -m reports.protocol --data_path=datasets/excavation_v2 --work_path=/tmp/protocol \\
        --train='swept_field,mlp --modes=8,pcg --modes=8' --output_path=docs/protocol

    # the same on 8 processes, or on a cluster (docs/guide.md)
    python -m reports.protocol --train=mlp --num_seeds=5 --work_path=/shared/protocol \\
        --output_path=docs/protocol --cluster=local:8

    # what more training runs bring: the same methods trained on 14, 28 and 56 of them
    python -m reports.protocol --data_path=datasets/excavation_v2 --train=swept_field,pcg \\
        --sizes=14,28,56 --work_path=/tmp/protocol --output_path=/tmp/judged

    # a dozen runs: every run judged by models that did not see it
    python -m reports.protocol --data_path=my_data --train=path_ridge_few_runs,pcg --folds=4 \\
        --work_path=/tmp/protocol --output_path=/tmp/judged

    # other models: folders under one name are seeds of one method
    python -m reports.protocol --data_path=datasets/wheel --model=mine=/tmp/a --model=mine=/tmp/b \\
        --work_path=/tmp/protocol --output_path=/tmp/judged

What valid said at the checkpoints of a training stands in the JSON as `curve`; the table of
trainings says whether it had become flat.
"""

import os

from absl import flags

from pca_tools import files
from reports import command
from reports.protocol import document, parts, tables


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_multi_string(
        'data_path', ['datasets/excavation', 'datasets/wheel'], 'Dataset folder; may be repeated.'
    )
    flags.DEFINE_multi_string(
        'model', [], 'NAME=FOLDER of a trained model; a name may be repeated with its seeds. '
        'Default: models/<dataset>/*.'
    )  # fmt: skip
    flags.DEFINE_list(
        'train', [], 'Presets that are trained here, with several seeds; "PRESET --FLAG=VALUE" '
        'with other flags of the training, in which {seed} is the seed.',
    )  # fmt: skip
    flags.DEFINE_integer('num_seeds', 5, 'Seeds of --train; one for what draws nothing.', 1)
    flags.DEFINE_list('sizes', [], 'Numbers of training runs that --train is trained on.')
    flags.DEFINE_integer('folds', 0, 'Folds of all runs; each is judged by models without it.', 0)
    flags.DEFINE_integer('num_valid', 2, 'Runs of the training of a fold that choose.', 1)
    command.define_workers('Models trained and rolled out at a time.')
    flags.DEFINE_string(
        'work_path', None, 'Folder for trainings and rollouts; calls resume.', required=True
    )
    flags.DEFINE_string('output_path', None, 'Folder for <dataset>.json.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    if bad := [size for size in values.sizes if not size.isdecimal() or not int(size)]:
        raise ValueError(f'--sizes are numbers of training runs, got {bad}')
    if (values.sizes or values.folds) and (values.model or not values.train):
        raise ValueError('--sizes and --folds train on parts of the data: --train is needed alone')
    if values.sizes and values.folds:
        raise ValueError('--sizes and --folds: one of them')
    os.makedirs(values.output_path, exist_ok=True)
    for data_path in values.data_path:
        name, work = document.name_of(data_path), os.path.join(values.work_path, 'parts')
        if values.folds:
            folds = parts.folds(data_path, values.folds, values.num_valid, work)
            judged = parts.joined([document.protocol(fold, values) for fold in folds])
            _finish(judged, f'{name}_{values.folds}_folds', values)
            continue
        if not values.sizes:
            _finish(document.protocol(data_path, values), name, values)
            continue
        paths = []
        for size in values.sizes:
            part = parts.of_size(data_path, int(size), work)
            paths.append(_finish(document.protocol(part, values), document.name_of(part), values))
        print(f'\n{name}, test, by number of training runs\n{tables.sizes(*paths)}')


def _finish(judged, name, values) -> str:
    """Writes a document and prints its tables; returns its path."""
    judged = tables.complete(judged)
    path = os.path.join(values.output_path, f'{name}.json')
    files.write_json(path, judged, indent=0)  # every run of every seed: half the size
    for quantity in judged['summary']['test']['all']:
        print(f'\n{name}, test, {quantity}')
        print(tables.quantity_table(judged, 'test', quantity))
    if trained := tables.training_table(judged):
        print(f'\n{name}, trainings\n{trained}')
    print(f'wrote {path}', flush=True)
    return path


if __name__ == '__main__':
    command.start(define_flags, main)
