"""Trains every preset on the shipped datasets and copies what a model needs into `models/`.

The checkpoints with the optimiser's state stay in the work folder, so that training can go on
there; TensorBoard shows how far it is.

Examples:
    python -m run_scripts.train_models --work_path=/tmp/training

    # one scene, two presets, side by side on two cores
    python -m run_scripts.train_models --scenes=wheel --presets=pcg,pcg_thesis --num_processes=2 \\
        --work_path=/tmp/training
"""

import os
import shutil

from absl import flags

from learning_to_simulate import checkpoints
from pca_tools import files, workers
from reports import command
from reports.protocol import rollouts
from reports.record import ROOT

SHIPPED = ['fcg_original', 'pcg_thesis', 'pcg']


def train(job: tuple[str, str, str]) -> str:
    """Trains one model (or finishes its training) and returns its table on the test split; `job`:
    scene, preset, folder for the work."""
    from learning_to_simulate import evaluation  # TensorFlow, which help does not wait for

    scene, preset, work = job
    data, folder = os.path.join(ROOT, 'datasets', scene), os.path.join(work, 'rollouts', scene)
    ((model, given),) = rollouts.trainings(preset, 1, os.path.join(work, scene))
    rollouts.make((data, model, given, ('test',), folder))
    metrics = os.path.join(rollouts.roll_out(data, model, 'test', folder), 'metrics.json')
    target = os.path.join(ROOT, 'models', scene, preset)
    os.makedirs(target, exist_ok=True)
    names = checkpoints.CONFIG_FILE, checkpoints.WEIGHTS_FILE
    for path in (metrics, *(os.path.join(model, name) for name in names)):
        shutil.copy(path, target)
    return f'{scene} {preset}\n{evaluation.table(files.read_json(metrics))}'


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('scenes', ['excavation', 'wheel'], 'Folders of datasets/ to train on.')
    flags.DEFINE_list('presets', SHIPPED, 'Presets to train.')
    flags.DEFINE_string('work_path', None, 'Folder for training states.', required=True)
    command.define_workers('Models trained at a time.')


def main(values, _) -> None:
    """Runs the command."""
    work = os.path.abspath(values.work_path)
    jobs = [(scene, preset, work) for preset in values.presets for scene in values.scenes]
    with workers.start(values.cluster, values.num_processes) as crew:
        for outcome in crew.run(train, jobs):
            print(outcome.error or outcome.value, flush=True)


if __name__ == '__main__':
    command.start(define_flags, main)
