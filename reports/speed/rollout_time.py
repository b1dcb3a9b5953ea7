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

import numpy as np
from absl import flags

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files
from reports import command, markdown, record, timing

ORIGINAL_STEPS = 100  # of the slow way

METHODS: dict[str, dict] = {
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


def _originals():
    """The original way, fully connected, L = 128, by how its py_function lists the pairs."""
    from reports.speed.original_style import appended_pairs, numpy_pairs

    return {
        'original way: pairs appended, as published': appended_pairs,
        'original way, pairs made by numpy': numpy_pairs,
    }


def prepare(data_path: str, metadata: dict, overrides: dict, batch: int = 1) -> dict:
    """A warmed-up rollout of test runs, as a row with 'call', 'steps' and what the model is.

    Args:
      data_path: dataset folder.
      metadata: its metadata.
      overrides: preset, config fields, and 'plain'.
      batch: B; test runs are repeated to fill it.
    """
    from learning_to_simulate.compiled.folded_step import rollout_function
    from learning_to_simulate.methods import subspace_method
    from learning_to_simulate.rollout import RolloutFunction, rollout_inputs

    plain = overrides.get('plain', False)
    config = presets.make_config(**{k: v for k, v in overrides.items() if k != 'plain'})
    groups, runs = (
        reading_utils.read_groups(data_path, split, metadata, **config.nodes)
        for split in ('train', 'test')
    )
    model = subspace_method.make_model(data_path, metadata, groups, config)
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
    from reports.speed.original_style import OriginalNetwork, original_rollout

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
        prepared |= {n: prepare_original(data_path, pairs) for n, pairs in _originals().items()}
    jobs = {
        name: timing.Job(row.pop('call'), row.pop('steps') * row['batch'])
        for name, row in prepared.items()
    }
    times = timing.in_turns(jobs, rounds)
    return [_row(name, row, times[name], metadata['dt']) for name, row in prepared.items()]


def _row(name, row, times, dt):
    return row | {'method': name} | times.summary('ms_') | {
        'processor_ms_median': float(np.median(times.processor_ms)),
        's_per_simulated_s': 1e-3 * times.percentile(50) / dt,
    }  # fmt: skip


def table(rows: list[dict]) -> str:
    """The rows of `measure` as text."""
    columns = {
        'method': 'method', 'edges': 'edges', 'weights': 'weights', 'ms_min': 'ms per step, min',
        'ms_median': 'median', 'ms_p95': 'p95', 'processor_ms_median': 'processor',
        's_per_simulated_s': 's per simulated s',
    }  # fmt: skip
    return markdown.table(
        tuple(columns.values()), [[row[key] for key in columns] for row in rows], aligned=True
    )


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_integer('rounds', 20, 'Rollouts of each method.', 1)
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', 1)
    flags.DEFINE_list('batch_sizes', [], 'Batch sizes of the throughput mode.')
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def main(values, _) -> None:
    """Runs the command."""
    batch_sizes = [int(b) for b in values.batch_sizes]
    rows = measure(values.data_path, values.rounds, batch_sizes)
    print(table(rows))
    if values.output_path:
        head = record.provenance(values.num_threads)
        files.write_json(values.output_path, head | {'rows': rows})


if __name__ == '__main__':
    command.start(define_flags, main)
