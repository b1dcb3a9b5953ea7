"""One writer per folder, and what becomes of the lock of a writer that died."""

import errno
import fcntl
import json
import os
import pathlib
import signal
import socket
import subprocess
import sys

import pytest

from pca_tools.storage import folder_lock

ROOT = pathlib.Path(__file__).resolve().parents[2]
HOLDER = """
import sys, time
from pca_tools.storage import folder_lock
with folder_lock.locked(sys.argv[1]):
    print('held', flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of `tmp_path`."""
    process = subprocess.Popen(
        [sys.executable, '-c', HOLDER, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == 'held\n'
    yield process
    process.kill()
    process.wait()


def take(folder):
    with folder_lock.locked(str(folder)):
        return json.loads((folder / folder_lock.LOCK_NAME).read_text())


def test_second_writer_learns_who_the_first_is(tmp_path, holder):
    with pytest.raises(ValueError, match=f'process {holder.pid} on {socket.gethostname()} writes'):
        take(tmp_path)
    assert os.listdir(tmp_path) == [folder_lock.LOCK_NAME]


def test_lock_of_a_killed_process_is_taken_over_with_a_message(tmp_path, holder, capsys):
    holder.send_signal(signal.SIGKILL)
    # Not waited for: to the system it exists still, as a zombie.
    assert os.waitid(os.P_PID, holder.pid, os.WEXITED | os.WNOWAIT)
    assert take(tmp_path)['pid'] == os.getpid()
    assert f'took over the lock of process {holder.pid}' in capsys.readouterr().out
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize('text', ['', '[]', '{"host": "a", "pid": -1}', '{"pid"', '[' * 9000])
def test_what_a_lock_says_decides_nothing(tmp_path, text):
    """The system knows whether its owner lives; one that was killed early has written nothing."""
    (tmp_path / folder_lock.LOCK_NAME).write_text(text)
    assert take(tmp_path)['pid'] == os.getpid()


def test_lock_is_held_once_in_a_process_and_released_after_an_error(tmp_path):
    with pytest.raises(KeyError), folder_lock.locked(str(tmp_path)):
        with pytest.raises(ValueError, match='writes into'):
            take(tmp_path)
        raise KeyError
    assert os.listdir(tmp_path) == []


def test_of_many_at_once_one_wins(tmp_path):
    """Eight processes meet a stale lock together; the one that passes waits for seven refusals."""
    owner = {'host': socket.gethostname(), 'pid': os.getpid()}
    folder, refused = tmp_path / 'model', tmp_path / 'refused'
    folder.mkdir()
    refused.mkdir()
    (folder / folder_lock.LOCK_NAME).write_text(json.dumps(owner))
    code = """
import os, sys, time
from pca_tools.storage import folder_lock
folder, refused = sys.argv[1:]
children = []
for number in range(8):
    children.append(os.fork())
    if not children[-1]:
        try:
            with folder_lock.locked(folder):
                while len(os.listdir(refused)) < 7:
                    time.sleep(0.01)
        except ValueError:
            open(f'{refused}/{number}', 'w').close()
            os._exit(3)
        os._exit(0)
print(sorted(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children))
"""
    done = subprocess.run(
        [sys.executable, '-c', code, str(folder), str(refused)],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == '[0, 3, 3, 3, 3, 3, 3, 3]'
    assert os.listdir(folder) == []


def test_a_file_system_without_locks_is_named(tmp_path, monkeypatch):
    def flock(*_):
        raise OSError(errno.ENOLCK, 'No locks available')

    monkeypatch.setattr(fcntl, 'flock', flock)
    with pytest.raises(OSError, match='cannot be locked .No locks available.; name a folder on'):
        take(tmp_path)


def test_lock_that_is_a_link_is_refused_and_its_target_kept(tmp_path):
    victim = tmp_path / 'victim'
    victim.write_text('precious')
    folder = tmp_path / 'model'
    folder.mkdir()
    (folder / folder_lock.LOCK_NAME).symlink_to(victim)
    with pytest.raises(ValueError, match='is a symbolic link'):
        take(folder)
    assert victim.read_text() == 'precious'
