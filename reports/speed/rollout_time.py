"""Times compiled rollouts of the graphs side by side: methods interleaved, batch 1 or more.

Weights do not change the time, so the models are fresh ones of the given sizes. Each method is
compiled and warmed up first, then the methods take turns, so that a drift of the machine's speed
meets them all. 'plain' is `rollout.RolloutFunction`, the others are specialised for their scene;
the original way makes its edges in a `py_function` in every step. Processor time is that of all
threads: on a busy machine it says more than the clock.

Examples:
    python -m reports rollout_time --data_path=datasets/excavation

    python -m reports rollout_time --data_path=datasets/wheel --rounds=50 --num_threads=1

    # throughput: B runs as one batch, of the default preset
    python -m reports rollout_time --data_path=datasets/wheel --batch_sizes=1,4,16,64
"""

import sys
import time

import numpy as np
import tensorflow as tf
import tqdm
from absl import app, flags

from learning_to_simulate import experiment, presets, reading_utils
from learning_to_simulate.presets import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.rollout import RolloutFunction, rollout_inputs
from learning_to_simulate.specialised_rollout import rollout_function
from pca_tools import dataset, files
from reports.speed.original_style import (
    OriginalNetwork,
    appended_pairs,
    numpy_pairs,
    original_rollout,
)

ORIGINAL_STEPS = 100  # of the slow way

# The original way, fully connected, L = 128, by how its py_function lists the pairs.
ORIGINALS = {
    'original way: pairs appended, as published': appended_pairs,
    'original way, pairs made by numpy': numpy_pairs,
}
METHODS = {
    'fully connected, L = 128, plain': {'preset': 'fcg_original', 'plain': True},
    'fully connected, L = 128': {'preset': 'fcg_original'},
    'partial graph, all rigid, L = 128, plain': {
        'preset': 'pcg', 'rigid_particles': 0, 'latent_size': 128, 'plain': True,
    },
    'partial graph, all rigid, L = 128': {
        'preset': 'pcg', 'rigid_particles': 0, 'latent_size': 128,
    },
    'pcg, plain': {'preset': 'pcg', 'plain': True},
    'pcg': {'preset': 'pcg'},
}  # fmt: skip


def prepare(data_path: str, metadata: dict, overrides: dict, batch: int = 1) -> dict:
    """A warmed-up rollout of test runs, as a row with 'call', 'steps' and what the model is.

    Args:
      data_path: dataset folder.
      metadata: its metadata.
      overrides: preset, config fields, and 'plain'.
      batch: B; test runs are repeated to fill it.
    """
    plain = overrides.get('plain', False)
    config = presets.make_config(**{k: v for k, v in overrides.items() if k != 'plain'})
    groups, runs = (
        reading_utils.read_groups(data_path, split, metadata, **config.nodes)
        for split in ('train', 'test')
    )
    model = experiment.make_model(data_path, metadata, groups, config)
    group = runs[0].take(np.arange(batch) % len(runs[0].position))
    layout = model.layout(group.n_rigid)
    function = (RolloutFunction if plain else rollout_function)(model.simulator, layout)
    inputs = rollout_inputs(group, layout, model.simulator.scene)
    weights = sum(int(np.prod(v.shape)) for v in model.simulator.trainable_variables)
    return {
        'call': lambda: function(*inputs)[0].numpy(), 'steps': inputs[-1], 'batch': batch,
        'edges': layout.n_edge, 'weights': weights,
    }  # fmt: skip


def prepare_original(data_path: str, pairs) -> dict:
    """The rollout of the original way on the first test run, as a row of `prepare`; `pairs` lists
    the pairs of nodes."""
    group = reading_utils.read_groups(data_path, 'test', dataset.read_metadata(data_path))[0]
    position, n = group.position[:1], group.n_rigid
    steps = min(ORIGINAL_STEPS, position.shape[1] - H)
    network = OriginalNetwork(pairs=pairs)
    body = np.moveaxis(position[:, H : H + steps, :n], 1, 0)
    run = original_rollout(network, position[:, :H], group.particle_type, body, steps)
    run()
    weights = sum(int(np.prod(v.shape)) for v in network.trainable_variables)
    return {
        'call': lambda: run().numpy(), 'steps': steps, 'batch': 1,
        'edges': position.shape[2] ** 2, 'weights': weights,
    }  # fmt: skip


def measure(data_path: str, rounds: int, batch_sizes=()) -> list[dict]:
    """Times all methods in turns; milliseconds per step and run as min, median, 95th percentile.

    With batch sizes: the default preset at each of them instead of the methods.

    Raises:
      ValueError: a batch size below 1.
    """
    if any(b < 1 for b in batch_sizes):
        raise ValueError(f'batch sizes are {list(batch_sizes)}, must be at least 1')
    metadata = dataset.read_metadata(data_path)
    if batch_sizes:
        prepared = {
            f'pcg, B = {b}': prepare(data_path, metadata, METHODS['pcg'], b) for b in batch_sizes
        }
    else:
        prepared = {name: prepare(data_path, metadata, o) for name, o in METHODS.items()}
        prepared |= {n: prepare_original(data_path, pairs) for n, pairs in ORIGINALS.items()}
    seconds = {name: [] for name in prepared}
    for name in prepared:
        for _ in range(2):
            prepared[name]['call']()
    for _ in tqdm.tqdm(range(rounds), unit='round', disable=None):
        for name, row in prepared.items():
            start = time.perf_counter(), time.process_time()
            row['call']()
            end = time.perf_counter(), time.process_time()
            seconds[name].append(np.subtract(end, start))
    return [_row(name, prepared[name], np.array(seconds[name])) for name in prepared]


def _row(name, row, seconds):
    per_step = 1e3 * seconds / (row['steps'] * row['batch'])
    low, middle, high = np.percentile(per_step[:, 0], [0, 50, 95]).tolist()
    return {k: v for k, v in row.items() if k not in ('call', 'steps')} | {
        'method': name, 'ms_min': low, 'ms_median': middle, 'ms_p95': high,
        'processor_ms_median': float(np.median(per_step[:, 1])),
        's_per_simulated_s': middle * 60 / 1e3,
    }  # fmt: skip


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_integer('rounds', 20, 'Rollouts of each method.', 1)
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', 1)
    flags.DEFINE_list('batch_sizes', [], 'Batch sizes of the throughput mode.')
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def main(_) -> None:
    """Runs the command."""
    values = flags.FLAGS
    tf.config.threading.set_intra_op_parallelism_threads(values.num_threads)
    try:
        batch_sizes = [int(b) for b in values.batch_sizes]
        rows = measure(values.data_path, values.rounds, batch_sizes)
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(f'{"method":54s} {"edges":>6s} {"weights":>8s} {"ms/step min":>12s} {"median":>8s} '
          f'{"p95":>8s} {"processor":>10s} {"s per simulated s":>18s}')  # fmt: skip
    for row in rows:
        print('{method:54s} {edges:6d} {weights:8d} {ms_min:12.4f} {ms_median:8.4f} {ms_p95:8.4f} '
              '{processor_ms_median:10.4f} {s_per_simulated_s:18.5f}'.format(**row))  # fmt: skip
    if values.output_path:
        files.write_json(values.output_path, rows)


if __name__ == '__main__':
    define_flags()
    app.run(main)
