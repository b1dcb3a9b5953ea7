"""Processes that end with the one that started them, however that one ends.

A pool's workers, or a training that a worker started, would outlive a parent that is killed with
SIGKILL: they would hold locks and memory, and finish files that nobody waits for.

    ProcessPoolExecutor(initializer=parent.end_with_parent)
    [sys.executable, '-m', 'pca_tools.storage.parent', str(os.getpid()), 'some.module', '--flag=1']
"""

import multiprocessing
import os
import runpy
import sys
import threading
import time

_SECONDS = 0.2  # between two looks


def end_with_parent(pid: int | None = None) -> None:
    """Lets this process end within a moment of the death of its parent: `pid`, else the process
    that `multiprocessing` started this one from, or the present parent."""
    starter = multiprocessing.parent_process()
    wanted = pid or (starter.pid if starter else os.getppid())

    def watch() -> None:
        while os.getppid() == wanted:  # an orphan is given to another process
            time.sleep(_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == '__main__':
    end_with_parent(int(sys.argv.pop(1)))
    runpy.run_module(sys.argv.pop(1), run_name='__main__', alter_sys=True)
