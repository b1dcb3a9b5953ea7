"""Children of a process that is killed: they end too."""

import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[3]
# What starts a child that would live for ever, and where the child writes who it is.
POOL = """
import sys
from pca_tools import workers
from tests.pca_tools.storage import test_parent
if __name__ == '__main__':
    with workers.start('', 1) as crew:
        list(crew.run(test_parent.wait_for_ever, [sys.argv[1]]))
"""
PROGRAM = """
import os, subprocess, sys
subprocess.run([sys.executable, '-m', 'pca_tools.storage.parent', str(os.getpid()),
                'tests.pca_tools.storage.test_parent', sys.argv[1]])
"""


def wait_for_ever(path):
    """Names this process in a file and stays."""
    pathlib.Path(path).write_text(str(os.getpid()))
    time.sleep(1000)


def is_alive(pid):
    try:
        state = pathlib.Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state not in 'ZX'


@pytest.mark.parametrize('code', [POOL, PROGRAM], ids=['pool', 'program'])
def test_child_of_a_killed_process_ends(code, tmp_path):
    script, mark = tmp_path / 'parent.py', tmp_path / 'pid'
    script.write_text(code)
    environment = os.environ | {'PYTHONPATH': str(ROOT)}
    parent = subprocess.Popen([sys.executable, str(script), str(mark)], env=environment, cwd=ROOT)
    while not mark.exists() or not mark.read_text():
        assert parent.poll() is None
        time.sleep(0.05)
    child = int(mark.read_text())
    assert is_alive(child)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    for _ in range(600):
        if not is_alive(child):
            return
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    raise AssertionError('the child lives on')


if __name__ == '__main__':
    wait_for_ever(sys.argv[1])
