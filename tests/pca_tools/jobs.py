"""Functions that the tests give to workers, which import them from here."""

import os
import signal
import subprocess
import time
from unittest import mock

import numpy as np

from mpm import batch, experiments, scenes
from mpm.simulation import Settings


def square(number):
    """The square."""
    return number**2


def who_and_square(number):
    """(process, square), slowly enough for all workers to get some."""
    time.sleep(0.2)
    return os.getpid(), number**2


def dies_once(job):
    """Kills its own worker the first time that input 3 is run."""
    number, folder = job
    marker = os.path.join(folder, 'died')
    if number == 3 and not os.path.exists(marker):
        with open(marker, 'w', encoding='utf-8') as file:
            file.write(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def fails_at_first(job):
    """Raises twice for input 1, always for input 2."""
    number, folder = job
    if number == 2:
        raise ValueError('never works')
    if number == 1:
        tries = len([name for name in os.listdir(folder) if name.startswith('try')])
        with open(os.path.join(folder, f'try{tries}'), 'w', encoding='utf-8') as file:
            file.write('')
        if tries < 2:
            raise OSError('not yet')
    return number


def write_file(job):
    """One whole file per input; waits where a file `wait` lies beside."""
    number, folder = job
    path = os.path.join(folder, f'{number}.npy')
    if os.path.exists(path):
        return 'there'
    while number > 3 and os.path.exists(os.path.join(folder, 'wait')):
        time.sleep(0.05)
    np.save(path + '.tmp.npy', np.random.default_rng(number).normal(size=100))
    os.replace(path + '.tmp.npy', path)
    return 'made'


class Runs(list):
    """Arrays that can be taken in parts."""

    def part(self, start, stop):
        """As `SoilPositions.part`."""
        return Runs(self[start:stop])


def short_run(job):
    """A real run of the solver, coarse and of a few frames: (content digest, CPU seconds).

    Kills its own worker in the middle of input `fatal`, the first time.
    """
    case, folder, frames, fatal = job
    marker = os.path.join(folder, 'died')
    if case == fatal and not os.path.exists(marker):
        with open(marker, 'w', encoding='utf-8') as file:
            file.write(str(os.getpid()))
        subprocess.Popen(['sh', '-c', f'sleep 0.2; kill -9 {os.getpid()}'])
    start = time.process_time()
    job = batch._Job(experiments.coarse(scenes.EXCAVATION), Settings(), None, folder)
    # Put back: it may be the tests' own process that runs it.
    with mock.patch.object(scenes, 'FRAMES', frames):
        entry = job.simulate(case)
    return entry['content'], time.process_time() - start


class FatalRuns(Runs):
    """As `Runs`, but the worker that gets the third part is killed, once."""

    def __init__(self, runs, folder, first=0):
        super().__init__(runs)
        self.folder, self.first = folder, first
        self.home = os.getpid()  # pickling asks for an iterator, too

    def part(self, start, stop):
        """As `SoilPositions.part`."""
        return FatalRuns(self[start:stop], self.folder, start)

    def __iter__(self):
        marker = os.path.join(self.folder, 'died')
        is_away = os.getpid() != self.home
        if self.first == 4 and is_away and not os.path.exists(marker):
            with open(marker, 'w', encoding='utf-8') as file:
                file.write(str(os.getpid()))
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__iter__()
