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

import math
import time

from absl import flags

from learning_to_simulate import reading_utils
from learning_to_simulate.config import INPUT_SEQUENCE_LENGTH as H
from learning_to_simulate.config import TrainConfig
from pca_tools import dataset, files
from reports import command, markdown, record, timing

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
        from learning_to_simulate import checkpoints
        from learning_to_simulate.live.stepping import Stepper

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
        self.rigid_motion = checkpoints.read_config(self.name)['scene']['rigid_motion']
        self._given = self.rigid_motion in ('prescribed', 'driven')
        self._run = -1

    @property
    def steps_per_run(self) -> int:
        """Steps of a test run."""
        return self._group.position.shape[1] - H

    def __call__(self) -> list[float]:
        """Steps through the next test run, the first after the last; seconds of each step."""
        group, n = self._group, self._group.n_rigid
        self._run = run = (self._run + 1) % len(group.position)
        seconds = []
        self._stepper.reset(group.position[run, :H], group.context_at(H, run))
        tick = time.perf_counter()
        for k, frame in enumerate(group.position[run, H:], H):
            pose = frame[:n] if self._given else None
            if self._pause:
                time.sleep(max(tick - time.perf_counter(), 0.0))
            context = group.context_at(k, run) if group.context_changes else None
            start = time.perf_counter()
            tick = start + self._pause
            self._stepper.step(pose, context)
            self._stepper.particles()
            seconds.append(time.perf_counter() - start)
        return seconds


def measure(pairs, steps: int, rate_hz: float = 0.0) -> list[dict]:
    """Times all models in turns, run by run, at least `steps` steps each; a row for each."""
    timed = {pair: Timed(pair, rate_hz) for pair in pairs}
    jobs = {
        pair: timing.Job(t, rounds=math.ceil(steps / t.steps_per_run), warm_up=0)
        for pair, t in timed.items()
    }
    times = timing.in_turns(jobs, 1, 'live steps')
    return [
        {'model': t.name, 'rigid_motion': t.rigid_motion, 'steps': len(times[pair].samples_ms)}
        | times[pair].summary('ms_')
        | {'load_seconds': t.load_seconds}
        for pair, t in timed.items()
    ]


def define_flags() -> None:
    """Defines the flags of the command."""
    flags.DEFINE_integer('steps', 2000, 'Steps of each model, rounded up to whole runs.', 1)
    flags.DEFINE_float('rate_hz', 0.0, 'Steps per second; 0: without a pause.', 0.0)
    flags.DEFINE_integer('num_threads', 1, 'CPU threads; more make the worst steps slower.', 1)
    flags.DEFINE_string('output_path', None, 'JSON file for the rows.')


def main(values, pairs) -> None:
    """Runs the command."""
    rows = measure(pairs or PAIRS, values.steps, values.rate_hz)
    header = ('model', *(f'ms {name}' for name in timing.CLOCKS))
    cells = [[row['model'], *(row[f'ms_{name}'] for name in timing.CLOCKS)] for row in rows]
    print(markdown.table(header, cells, aligned=True))
    if values.output_path:
        head = record.provenance(values.num_threads)
        files.write_json(values.output_path, head | {'rows': rows})


if __name__ == '__main__':
    command.start(define_flags, main, n_argument=100)
