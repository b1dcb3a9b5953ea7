"""Trains every preset on the shipped datasets and copies what a model needs into `models/`.

The checkpoints with the optimiser's state stay in the work folder, so that training can go on
there.

Examples:
    python -m run_scripts.train_models --work_path=/tmp/training

    # one scene, two presets, side by side on two cores
    python -m run_scripts.train_models --scenes=wheel --presets=pcg,pcg_thesis --num_processes=2 \\
        --work_path=/tmp/training
"""

import concurrent.futures
import os
import shutil
import subprocess
import sys

from absl import app, flags

from learning_to_simulate import checkpoints

SHIPPED = ['fcg_original', 'pcg_thesis', 'pcg']
ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def train(scene: str, preset: str, work: str, quiet: bool) -> str:
    """Trains one model (or finishes its training) and returns its table on the test split."""
    data = os.path.join(ROOT, 'datasets', scene)
    model = os.path.join(work, scene, preset)
    base = [sys.executable, '-m', 'learning_to_simulate.train', f'--data_path={data}',
            f'--model_path={model}', '--num_threads=1']  # fmt: skip
    os.makedirs(work, exist_ok=True)
    with open(os.path.join(work, f'{scene}_{preset}.log'), 'a', encoding='utf-8') as log:
        subprocess.run(
            [*base, f'--preset={preset}'], cwd=ROOT, check=True, stderr=log if quiet else None
        )
        target = os.path.join(ROOT, 'models', scene, preset)
        os.makedirs(target, exist_ok=True)
        for name in (checkpoints.CONFIG_FILE, checkpoints.WEIGHTS_FILE):
            shutil.copyfile(os.path.join(model, name), os.path.join(target, name))
        rollouts = os.path.join(work, scene, f'{preset}_rollouts')
        done = subprocess.run(
            [*base, '--mode=eval_rollout', f'--output_path={rollouts}'],
            cwd=ROOT, check=True, capture_output=True, text=True,
        )  # fmt: skip
    shutil.copyfile(os.path.join(rollouts, 'metrics.json'), os.path.join(target, 'metrics.json'))
    return f'{scene} {preset}\n{done.stdout}'


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_list('scenes', ['excavation', 'wheel'], 'Folders of datasets/ to train on.')
    flags.DEFINE_list('presets', SHIPPED, 'Presets to train.')
    flags.DEFINE_string('work_path', None, 'Folder for training states and logs.', required=True)
    flags.DEFINE_integer('num_processes', 1, 'Models trained at a time.', 1)


def main(_) -> None:
    """Runs the command."""
    values = flags.FLAGS
    jobs = [(scene, preset) for preset in values.presets for scene in values.scenes]
    with concurrent.futures.ThreadPoolExecutor(values.num_processes) as pool:
        running = [
            pool.submit(train, *job, values.work_path, values.num_processes > 1) for job in jobs
        ]
        for future in concurrent.futures.as_completed(running):
            print(future.result(), flush=True)


if __name__ == '__main__':
    define_flags()
    app.run(main)
