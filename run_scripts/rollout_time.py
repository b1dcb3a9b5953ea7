"""Times compiled rollouts of the graphs side by side: one run, batch 1, methods interleaved.

Weights do not change the time, so the models are fresh ones of the given sizes. Each method is
compiled and warmed up first, then the methods take turns, so that a drift of the machine's speed
meets them all.

Examples:
    python -m run_scripts.rollout_time --data_path=datasets/excavation

    python -m run_scripts.rollout_time --data_path=datasets/wheel --rounds=50 --num_threads=1
"""

import json
import sys
import time

import numpy as np
import tensorflow as tf
import tqdm
from absl import app, flags

from learning_to_simulate import experiment, presets, reading_utils
from learning_to_simulate.rollout import RolloutFunction, rollout_inputs
from pca_tools import dataset, files

METHODS = {
    'fully connected, L = 128': {'preset': 'fcg_original'},
    'partial graph of the thesis, L = 128': {'preset': 'pcg_thesis'},
    'pcg, all rigid particles, L = 128': {
        'preset': 'pcg', 'rigid_particles': 0, 'latent_size': 128,
    },
    'pcg, all rigid particles': {'preset': 'pcg', 'rigid_particles': 0},
    'pcg': {'preset': 'pcg'},
}  # fmt: skip


def prepare(data_path: str, metadata: dict, overrides: dict):
    """A warmed-up rollout of the first test run; returns (call, steps, edges, weights)."""
    config = presets.make_config(**overrides)
    groups, runs = (
        reading_utils.read_groups(data_path, split, metadata, config.rigid_particles)
        for split in ('train', 'test')
    )
    model = experiment.make_model(data_path, metadata, groups, config)
    group = runs[0].select(0)
    layout = model.layout(group.n_rigid)
    function = RolloutFunction(model.simulator, layout)
    inputs = rollout_inputs(group, layout, model.simulator.scene)

    def call():
        function(*inputs)[0].numpy()

    for _ in range(5):
        call()
    weights = sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables)
    return call, inputs[-1], layout.n_edge, weights


def measure(data_path: str, rounds: int) -> list[dict]:
    """Times all methods in turns; milliseconds per step as min, median and 95th percentile."""
    metadata = dataset.read_metadata(data_path)
    prepared = {name: prepare(data_path, metadata, o) for name, o in METHODS.items()}
    seconds = {name: [] for name in prepared}
    for _ in tqdm.tqdm(range(rounds), unit='round', disable=None):
        for name, (call, *_) in prepared.items():
            start = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - start)
    rows = []
    for name, (_, steps, edges, weights) in prepared.items():
        per_step = 1e3 * np.array(seconds[name]) / steps
        low, middle, high = np.percentile(per_step, [0, 50, 95])
        rows.append(
            {
                'method': name, 'edges': edges, 'weights': weights, 'ms_min': low,
                'ms_median': middle, 'ms_p95': high, 's_per_simulated_s': middle * 60 / 1e3,
            }
        )  # fmt: skip
    return rows


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_integer('rounds', 20, 'Rollouts of each method.', 1)
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', 1)
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def main(_) -> None:
    """Runs the command."""
    values = flags.FLAGS
    tf.config.threading.set_intra_op_parallelism_threads(values.num_threads)
    try:
        rows = measure(values.data_path, values.rounds)
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(f'{"method":38s} {"edges":>6s} {"weights":>8s} {"ms/step min":>12s} {"median":>8s} '
          f'{"p95":>8s} {"s per simulated s":>18s}')  # fmt: skip
    for row in rows:
        print('{method:38s} {edges:6d} {weights:8d} {ms_min:12.4f} {ms_median:8.4f} {ms_p95:8.4f} '
              '{s_per_simulated_s:18.5f}'.format(**row))  # fmt: skip
    if values.output_path:
        files.write_json(values.output_path, json.loads(json.dumps(rows)))


if __name__ == '__main__':
    define_flags()
    app.run(main)
