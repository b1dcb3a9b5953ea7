"""Functions that the tests give to workers, which import them from here."""

import os
import signal
import time


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


class Runs(list):
    """Arrays that can be taken in parts."""

    def part(self, start, stop):
        """As `SoilPositions.part`."""
        return Runs(self[start:stop])
