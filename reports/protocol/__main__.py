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

    # the same on 8 processes, or on a cluster (docs/cluster.md)
    python -m reports.protocol --train=mlp --num_seeds=5 --work_path=/shared/protocol \\
        --output_path=docs/protocol --cluster=local:8

    # other models: folders under one name are seeds of one method
    python -m reports.protocol --data_path=datasets/wheel --model=mine=/tmp/a --model=mine=/tmp/b \\
        --work_path=/tmp/protocol --output_path=/tmp/judged

    # the tables of the page again, from the JSON
    python -m reports documents docs/protocol.md
"""

import os

from absl import flags

from pca_tools import files
from reports import command
from reports.protocol import document, tables


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
    command.define_workers('Models trained and rolled out at a time.')
    flags.DEFINE_string(
        'work_path', None, 'Folder for trainings and rollouts; calls resume.', required=True
    )
    flags.DEFINE_string('output_path', None, 'Folder for <dataset>.json.', required=True)


def main(values, _) -> None:
    """Runs the command."""
    os.makedirs(values.output_path, exist_ok=True)
    for data_path in values.data_path:
        judged = document.protocol(data_path, values)
        path = os.path.join(values.output_path, f'{document.name_of(data_path)}.json')
        files.write_json(path, judged, indent=0)  # every run of every seed: half the size
        for quantity in judged['summary']['test']['all']:
            print(f'\n{document.name_of(data_path)}, test, {quantity}')
            print(tables.quantity_table(judged, 'test', quantity))
        print(f'wrote {path}', flush=True)


if __name__ == '__main__':
    command.start(define_flags, main)
