"""`FrameLoop`: a function at a fixed rate, in a thread of its own."""

import collections
import threading
import time

# A loop that is so late, s, does not catch up: its frames are lost, not bunched.
LATE = 0.1


class FrameLoop:
    """Calls a function once every `dt` seconds.

    Args:
      frame: called without arguments; an error in it stops the loop.
      dt: s.

    Attributes:
      error: what stopped it, or None.
      frames: how many were called.
      busy: CPU time of the thread, s, in all of them.
    """

    def __init__(self, frame, dt: float):
        self._frame, self._dt = frame, dt
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name='frames', daemon=True)
        self._recent: collections.deque = collections.deque(maxlen=round(1 / dt) + 1)
        self.error: BaseException | None = None
        self.frames, self.busy = 0, 0.0

    @property
    def rate(self) -> float:
        """Frames per second over the last one."""
        recent = list(self._recent)
        if len(recent) < 2:
            return 0.0
        return (len(recent) - 1) / (recent[-1] - recent[0])

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread after its frame."""
        self._ended.set()
        if self._thread is not threading.current_thread() and self._thread.ident:
            self._thread.join()

    def wait(self) -> None:
        """Waits until the loop has ended; raises what ended it."""
        while self._thread.is_alive():
            self._thread.join(1.0)
        if self.error is not None:
            raise self.error

    def _run(self):
        due = time.monotonic()
        try:
            while not self._ended.is_set():
                self._recent.append(time.monotonic())
                began = time.thread_time()
                self._frame()
                self.busy += time.thread_time() - began
                self.frames += 1
                due += self._dt
                late = time.monotonic() - due
                if late > LATE:
                    due += late
                elif late < 0:
                    self._ended.wait(-late)
        except Exception as error:
            self.error = error
