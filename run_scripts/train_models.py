"""Trains the shipped models on the shipped datasets and copies what a model needs into `models/`.

The checkpoints with the optimiser's state stay in the work folder, so that training can go on
there; TensorBoard shows how far it is.

Examples:
    python -m run_scripts.train_models --work_path=/tmp/training

    # two of them, side by side on two cores
    python -m run_scripts.train_models --models=excavation/pcg,wheel/pcg --num_processes=2 \\
        --work_path=/tmp/training
"""

import os
import shutil
from typing import NamedTuple

from absl import flags

from learning_to_simulate import command
from pca_tools import workers
from reports.record import ROOT


class Recipe(NamedTuple):
    """How a model is trained."""

    data: tuple[str, ...]  # names of its datasets
    preset: str
    settings: dict = {}  # that differ from those of the preset
    kinds: tuple[str, ...] = ()  # of runs that it knows; () for all


_PUBLISHED = {'modes': 8, 'num_steps': 10_000}
SHIPPED = {
    'excavation/soil_field': Recipe(
        ('excavation', 'excavation_wide', 'excavation_more', 'excavation_long'),
        'soil_field',
        {'seed': 2},
    ),
    'wheel/soil_field': Recipe(('wheel', 'wheel_more'), 'soil_field', {'seed': 0}),
    'excavation/mlp_driven': Recipe(('excavation',), 'mlp_driven', {'num_steps': 4000}),
    'excavation/pcg': Recipe(('excavation',), 'pcg', {'modes': 8}),
    'wheel/pcg': Recipe(('wheel',), 'pcg', {'modes': 8}),
    'excavation/fcg_original': Recipe(('excavation',), 'fcg_original', _PUBLISHED, ('grid',)),
    'excavation/pcg_thesis': Recipe(('excavation',), 'pcg_thesis', _PUBLISHED, ('grid',)),
}
FILES = 'config.json', 'weights.npz', 'start.npz', 'subspace.npz', 'metrics.json'


def train(job: tuple[str, str]) -> str:
    """Trains a model, or finishes its training, and says where it is; `job`: its name, folder for
    the work."""
    import learning_to_simulate as lts  # TensorFlow, which help does not wait for
    from pca_tools import subset

    name, work = job
    recipe, path = SHIPPED[name], os.path.join(work, name)
    folders = [os.path.join(ROOT, 'datasets', data) for data in recipe.data]
    if recipe.kinds:
        (whole,), folders = folders, [os.path.join(work, f'data_of_{name.replace("/", "_")}')]
        subset.subset(whole, folders[0], kinds=recipe.kinds, overwrite=True, every_split=True)
    data = [lts.Dataset(folder) for folder in folders]
    model = lts.train(lts.preset(recipe.preset, **recipe.settings), data, path)
    if recipe.preset != 'soil_field':  # its training writes the errors
        model.evaluate(data[0].valid).save(os.path.join(path, 'metrics.json'))
    target = os.path.join(ROOT, 'models', name)
    os.makedirs(target, exist_ok=True)
    for file in FILES:
        if os.path.exists(os.path.join(path, file)):
            shutil.copy(os.path.join(path, file), target)
    return f'{name} is in {target}'


def define_flags() -> None:
    flags.DEFINE_list('models', list(SHIPPED), 'Models to train.')
    flags.DEFINE_string('work_path', None, 'Folder for training states.', required=True)
    flags.DEFINE_integer('num_processes', 1, 'Models trained at a time, without a cluster.', 1)
    flags.DEFINE_string('cluster', '', 'Where that is done: local:4, slurm:64, tcp://host:port.')


def main(values) -> None:
    """ValueError: a model that does not ship, or a training that failed; the others are done."""
    if unknown := set(values.models) - SHIPPED.keys():
        raise ValueError(f'no models {sorted(unknown)}; there are {", ".join(SHIPPED)}')
    jobs = [(name, os.path.abspath(values.work_path)) for name in values.models]
    with workers.start(values.cluster, values.num_processes) as crew:
        failed = 0
        for outcome in crew.run(train, jobs):
            print(outcome.error or outcome.value, flush=True)
            failed += outcome.error is not None
    if failed:
        raise ValueError(f'{failed} of {len(jobs)} trainings failed')


if __name__ == '__main__':
    define_flags()
    command.start(main)
