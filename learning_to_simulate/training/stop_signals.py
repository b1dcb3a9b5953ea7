"""Ctrl-C and SIGTERM as a request that a loop answers at its own pace."""

import signal
import threading


class StopSignals:
    """Notes the first SIGINT or SIGTERM inside a `with` block; a second one acts as usual.

    Outside of the main thread, where Python cannot handle signals, nothing is noted.

    Attributes:
      number: the signal that came, or None.
    """

    def __init__(self):
        self.number = None
        self._before = {}

    @property
    def exit_code(self) -> int:
        """What a shell expects of a program that a signal ended: 130 for Ctrl-C, 143 for
        SIGTERM."""
        return 128 + self.number

    def __enter__(self) -> 'StopSignals':
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_):
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}

    def _note(self, number, _):
        self.number = number
        self.__exit__()
