"""Times single live steps from Python, decoding to all particles included.

Each step hands over the recorded pose of the coming frame, waits for modes, force and pose, and
decodes the soil. Models take turns run by run. The clock of a step runs from the call to the
decoded particles. Steps follow each other without a pause, or at a rate, as in a program that
sleeps until its next tick.

Examples:
    python -m reports step_latency --steps=2000

    # in the rhythm of a haptic device
    python -m reports step_latency --steps=2000 --rate_hz=1000

    python -m reports step_latency models/wheel/pcg_thesis:datasets/wheel \\
        --output_path=/tmp/latency.json
"""

import sys
import time

import numpy as np
import tensorflow as tf
import tqdm
from absl import app, flags

from learning_to_simulate import checkpoints, reading_utils
from learning_to_simulate.presets import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.presets import TrainConfig
from learning_to_simulate.stepping import Stepper
from pca_tools import dataset, files

PAIRS = (
    'models/excavation/pcg:datasets/excavation',
    'models/wheel/pcg:datasets/wheel',
    'models/wheel/pcg_thesis:datasets/wheel',
)


class Timed:
    """A stepper with the test runs that it is driven by.

    Args:
      pair: 'model folder:dataset folder'.
      rate_hz: steps per second; 0 for no pause between them.

    Raises:
      FileNotFoundError, ValueError: as `Stepper.load`; a pair without a colon.
    """

    def __init__(self, pair: str, rate_hz: float = 0.0):
        if pair.count(':') != 1:
            raise ValueError(f'{pair!r} is not "model folder:dataset folder"')
        self.name, data_path = pair.split(':')
        self._pause = 1 / rate_hz if rate_hz else 0.0
        metadata = dataset.read_metadata(data_path)
        config = TrainConfig(**checkpoints.read_config(self.name)['config'])
        groups = reading_utils.read_groups(data_path, 'test', metadata, **config.nodes)
        self._group = groups[0]
        start = time.perf_counter()
        self._stepper = Stepper.load(self.name, data_path, self._group.n_rigid)
        self.load_seconds = time.perf_counter() - start
        self._given = 'prescribed' in self._motion or 'driven' in self._motion
        self.seconds = []

    @property
    def _motion(self):
        return checkpoints.read_config(self.name)['scene']['rigid_motion']

    def run(self, run: int) -> None:
        """Steps through one test run and keeps the time of each step."""
        group, n = self._group, self._group.n_rigid
        run %= len(group.position)
        context = None if group.context is None else group.context[run]
        self._stepper.reset(group.position[run, :H], context)
        tick = time.perf_counter()
        for frame in group.position[run, H:]:
            pose = frame[:n] if self._given else None
            if self._pause:
                time.sleep(max(tick - time.perf_counter(), 0.0))
            start = time.perf_counter()
            tick = start + self._pause
            self._stepper.step(pose)
            self._stepper.particles()
            self.seconds.append(time.perf_counter() - start)

    def row(self) -> dict:
        """Milliseconds per step."""
        milliseconds = 1e3 * np.array(self.seconds)
        low, middle, p95, p99, worst = np.percentile(milliseconds, [0, 50, 95, 99, 100]).tolist()
        return {
            'model': self.name,
            'rigid_motion': self._motion,
            'steps': len(milliseconds),
            'ms_min': low,
            'ms_median': middle,
            'ms_p95': p95,
            'ms_p99': p99,
            'ms_worst': worst,
            'load_seconds': self.load_seconds,
        }


def measure(pairs, steps: int, rate_hz: float = 0.0) -> list[dict]:
    """Times all models in turns, at least `steps` steps each."""
    timed = [Timed(pair, rate_hz) for pair in pairs]
    run = 0
    with tqdm.tqdm(total=steps * len(timed), unit='step', disable=None) as bar:
        while min(len(t.seconds) for t in timed) < steps:
            for t in timed:
                before = len(t.seconds)
                t.run(run)
                bar.update(len(t.seconds) - before)
            run += 1
    return [t.row() for t in timed]


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('steps', 2000, 'Steps of each model, rounded up to whole runs.', 1)
    flags.DEFINE_float('rate_hz', 0.0, 'Steps per second; 0: without a pause.', 0.0)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads; more make the worst steps slower.', 1)
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def main(argv) -> None:
    """Runs the command."""
    values = flags.FLAGS
    tf.config.threading.set_intra_op_parallelism_threads(values.num_threads)
    try:
        rows = measure(argv[1:] or PAIRS, values.steps, values.rate_hz)
    except (ValueError, OSError) as error:
        sys.exit(f'error: {error}')
    print(f'{"model":32s} {"min":>8s} {"median":>8s} {"p95":>8s} {"p99":>8s} {"worst":>8s} ms/step')
    for row in rows:
        print('{model:32s} {ms_min:8.4f} {ms_median:8.4f} {ms_p95:8.4f} {ms_p99:8.4f} '
              '{ms_worst:8.4f}'.format(**row))  # fmt: skip
    if values.output_path:
        files.write_json(values.output_path, rows)


if __name__ == '__main__':
    define_flags()
    app.run(main)
