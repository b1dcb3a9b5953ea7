"""Times training steps of the single-step stage against the original way, at one batch size.

Our step draws its windows from memory inside one compiled function. The original way cuts windows
in a `tf.data` pipeline, lists the pairs of nodes in a `py_function` in every step, and runs
graph_nets uncompiled (`original_style`). The methods take turns, so that a drift of the machine's
speed meets them all; one turn is some steps, after a warm-up. Processor time is that of all
threads: on a busy machine it says more than the clock.

With `--time_to_error`: seconds of training until the rollouts of the validation runs have a mean
squared error of that share of the best trivial prediction (persistence, constant velocity).
Compilation counts, the validation rollouts do not.

Examples:
    python -m reports training_speed --data_path=datasets/excavation

    python -m reports training_speed --data_path=datasets/excavation --time_to_error=0.5 \\
        --budget_seconds=600 --output_path=/tmp/training_speed.json
"""

import time
from functools import partial

import numpy as np
import tqdm
from absl import flags

from learning_to_simulate import presets, reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from pca_tools import dataset, files
from reports import command, markdown, record, timing

ORIGINAL = 'original way'
NUMPY_PAIRS = 'original way, pairs made by numpy'
PRESETS = ('fcg_original', 'pcg')
SHUFFLED = 512  # windows, as in the original code
NOISE, LEARNING_RATE = 6.7e-4, 1e-4  # of the original preset, m/frame
CHECKS = 20  # validations within the budget


def _read(data_path, split, config):
    metadata = dataset.read_metadata(data_path)
    return metadata, reading_utils.read_groups(data_path, split, metadata, **config.nodes)


def our_step(data_path: str, preset: str, batch_size: int, **overrides):
    """A function that runs the next training step of a preset and returns its loss."""
    from learning_to_simulate.methods import subspace_method
    from learning_to_simulate.training.trainer import Trainer

    config = presets.make_config(preset, batch_size=batch_size, **overrides)
    metadata, groups = _read(data_path, 'train', config)
    model = subspace_method.make_model(data_path, metadata, groups, config)
    trainer, count = Trainer(model, groups), iter(range(config.num_steps))
    return lambda: float(trainer.step(next(count))['loss'])


def original_step(data_path: str, batch_size: int, pairs=None, latent_size: int = 128):
    """A function that runs the next training step of the original way and returns its loss.

    All pairs of nodes, listed by `pairs` (None: `appended_pairs`), L = 128, one message-passing
    step: the network of `fcg_original`.
    """
    import sonnet as snt
    import tensorflow as tf

    from learning_to_simulate.training import noise_utils
    from reports.speed.original_style import OriginalNetwork, appended_pairs

    _, (group, *_) = _read(data_path, 'train', presets.make_config('fcg_original'))
    types = tf.constant(group.particle_type, tf.int32)
    n_rigid, n_frame = group.n_rigid, group.position.shape[1]
    force = np.zeros((*group.position.shape[:2], 3)) if group.force is None else group.force
    # The target takes the noise back, so its spread is that of both, as in the original code.
    std = np.float32(np.hypot(np.diff(group.position, 2, axis=1).std(), NOISE))
    force_std = np.float32(max(force.std(), 1e-12))

    def windows(position, force):
        frames = tf.range(n_frame - H)[:, None] + tf.range(H + 1)
        return tf.data.Dataset.from_tensor_slices(
            (tf.gather(position, frames), tf.gather(force, frames[:, -1]))
        )

    runs = (tf.constant(group.position, tf.float32), tf.constant(force, tf.float32))
    data = tf.data.Dataset.from_tensor_slices(runs).repeat().flat_map(windows)
    batches = iter(data.shuffle(SHUFFLED, seed=0).batch(batch_size, drop_remainder=True))
    network = OriginalNetwork(latent_size, pairs=pairs or appended_pairs)
    optimizer = snt.optimizers.Adam(LEARNING_RATE)

    def loss_of(position, force, seed):
        history = position[:, :H]
        shape = (batch_size, position.shape[2], H - 1, position.shape[3])
        scale = np.full((position.shape[2], position.shape[3]), NOISE, np.float32)
        scale[:n_rigid] = 0
        noise = noise_utils.random_walk_velocity_noise(shape, scale, seed)
        noise = tf.transpose(tf.cumsum(noise, axis=2), [0, 2, 1, 3])
        history += tf.pad(noise, [[0, 0], [1, 0], [0, 0], [0, 0]])
        coming = position[:, H] + noise[:, -1]  # Only the velocity is to be corrected.
        target = (coming - 2 * history[:, -1] + history[:, -2]) / std
        decoded = network(history, types)
        motion = (decoded[..., :3] - target)[:, n_rigid:] ** 2
        forces = (tf.reduce_mean(decoded[..., 3:], axis=1) - force / force_std) ** 2
        return tf.reduce_mean(motion) + tf.reduce_mean(forces)

    @tf.function(autograph=False)
    def train_step(position, force, seed):
        with tf.GradientTape() as tape:
            loss = loss_of(position, force, seed)
        variables = network.trainable_variables
        optimizer.apply(tape.gradient(loss, variables), variables)
        return loss

    first_position, first_force = next(batches)
    loss_of(first_position, first_force, tf.constant([0, 0]))  # makes the variables
    count = iter(range(2**31))
    return lambda: float(train_step(*next(batches), tf.constant([1, next(count)])))


def measure(data_path: str, batch_size: int, rounds: int, steps: int, **overrides) -> list[dict]:
    """Samples per second of every method, in turns.

    Args:
      data_path: dataset folder.
      batch_size: windows per step, of all methods.
      rounds: turns of each method.
      steps: training steps of a turn.
      **overrides: config fields of our presets.

    Returns:
      a row per method: samples per second by the clock and by processor time (medians of the
      turns), and how many times those of the original way.
    """
    from reports.speed.original_style import appended_pairs, numpy_pairs

    width = overrides.get('latent_size', 128)
    methods = {
        name: original_step(data_path, batch_size, pairs, width)
        for name, pairs in ((ORIGINAL, appended_pairs), (NUMPY_PAIRS, numpy_pairs))
    }
    for preset in PRESETS:
        methods[preset] = our_step(
            data_path, preset, batch_size, num_steps=(rounds + 1) * steps + 1, **overrides
        )

    def turn(step):
        for _ in range(steps):
            step()

    jobs = {
        name: timing.Job(partial(turn, step), steps * batch_size, warm_up=1)
        for name, step in methods.items()
    }
    times = timing.in_turns(jobs, rounds)
    rates = {
        name: 1e3 / np.median([found.samples_ms, found.processor_ms], axis=1)
        for name, found in times.items()
    }
    return [
        {
            'method': name,
            'batch_size': batch_size,
            'samples_per_s': float(rate[0]),
            'samples_per_processor_s': float(rate[1]),
            'times_original': float(rate[0] / rates[ORIGINAL][0]),
            'times_original_by_processor': float(rate[1] / rates[ORIGINAL][1]),
        }
        for name, rate in rates.items()
    ]


def time_to_error(data_path: str, preset: str, target: float, budget: float, **overrides) -> dict:
    """Trains a preset until its validation rollouts are good enough or the budget is spent.

    Args:
      data_path: dataset folder.
      preset: name.
      target: share of the best trivial prediction's soil MSE.
      budget: seconds of training, compilation included.
      **overrides: config fields.

    Returns:
      a row; 'seconds' is None where the target was not reached; 'curve' holds (seconds, step,
      share) of every validation, share None where a rollout was not finite.
    """
    from learning_to_simulate import evaluation
    from learning_to_simulate.methods import subspace_method
    from learning_to_simulate.training.trainer import Trainer

    config = presets.make_config(preset, **overrides)
    metadata, groups = _read(data_path, 'train', config)
    _, valid = _read(data_path, 'valid', config)
    model = subspace_method.make_model(data_path, metadata, groups, config)
    trainer, evaluator = Trainer(model, groups), evaluation.Evaluator(model, metadata)
    spent, step, curve, reached = 0.0, 0, [], None
    with tqdm.tqdm(total=round(budget), unit='s', desc=preset, disable=None) as bar:
        while reached is None and spent < budget and step < trainer.total_steps:
            start = time.perf_counter()
            while time.perf_counter() - start < budget / CHECKS and step < trainer.total_steps:
                float(trainer.step(step)['loss'])
                step += 1
            spent += time.perf_counter() - start
            with trainer.averaging.in_place():
                share = evaluator.run(valid, 'valid')[1]['soil_mse_over_best_trivial']
            curve.append((spent, step, share))
            if share is not None and share <= target:
                reached = spent
            bar.update(round(spent) - bar.n)
    return {'preset': preset, 'target': target, 'seconds': reached, 'steps': step, 'curve': curve}


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_string('data_path', None, 'Dataset folder.', required=True)
    flags.DEFINE_integer('batch_size', 2, 'Windows per step, of all methods.', 1)
    flags.DEFINE_integer('rounds', 10, 'Turns of each method.', 1)
    flags.DEFINE_integer('steps', 20, 'Training steps of a turn.', 1)
    flags.DEFINE_integer('num_threads', 2, 'CPU threads of TensorFlow.', 1)
    flags.DEFINE_float('time_to_error', 0.0, 'Share of the best trivial MSE; 0: no training.', 0.0)
    flags.DEFINE_float('budget_seconds', 300.0, 'Seconds of training of each preset.', 1.0)
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def table(result: dict) -> str:
    """The rows of `measure` and `time_to_error` as text."""
    columns = {
        'method': 'method', 'samples_per_s': 'samples per s', 'times_original': 'x original',
        'times_original_by_processor': 'by processor time',
    }  # fmt: skip
    cells = [[row[key] for key in columns] for row in result['speed']]
    text = markdown.table(tuple(columns.values()), cells, aligned=True)
    for row in result.get('time_to_error', ()):
        seconds, _, share = row['curve'][-1]
        end = 'not reached' if row['seconds'] is None else f'reached after {row["seconds"]:.0f} s'
        text += (
            f'\n{row["preset"]}: {row["target"]:g} of the best trivial MSE {end} (step '
            f'{row["steps"]}, {seconds:.0f} s: {markdown.cell(share) or "not finite"})'
        )
    return text


def main(values, _) -> None:
    """Runs the command."""
    result = record.provenance(values.num_threads)
    result['speed'] = measure(values.data_path, values.batch_size, values.rounds, values.steps)
    if values.time_to_error:
        result['time_to_error'] = [
            time_to_error(values.data_path, preset, values.time_to_error, values.budget_seconds)
            for preset in PRESETS
        ]
    print(table(result))
    if values.output_path:
        files.write_json(values.output_path, result)


if __name__ == '__main__':
    command.start(define_flags, main)
