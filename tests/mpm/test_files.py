"""Files that appear whole or not at all, also on a full disk."""

import errno
import os

import pytest

from mpm import files


def fill(text):
    def write(temporary):
        with open(temporary, 'w', encoding='utf-8') as file:
            file.write(text)

    return write


def test_names_are_unique_and_nothing_is_left(tmp_path):
    path, seen = str(tmp_path / 'a.txt'), []

    def write(temporary):
        seen.append(temporary)
        fill('x')(temporary)

    for _ in range(20):
        files.write_whole(path, write)
    assert len(set(seen)) == 20
    assert os.listdir(tmp_path) == ['a.txt']


def test_full_disk_keeps_what_was_there_and_names_the_file(tmp_path):
    path = str(tmp_path / 'a.txt')
    files.write_whole(path, fill('before'))

    def write(temporary):
        fill('half')(temporary)
        # The kernel's own always full device.
        with open('/dev/full', 'w', encoding='utf-8') as file:
            file.write('x')

    with pytest.raises(OSError, match=r'cannot write .*a\.txt: No space left') as error:
        files.write_whole(path, write)
    assert error.value.errno == errno.ENOSPC
    assert os.listdir(tmp_path) == ['a.txt'] and (tmp_path / 'a.txt').read_text() == 'before'


def test_left_overs_of_killed_writers_are_removed(tmp_path):
    for name in ('.run_001.npz.0123.tmp', '.lock', 'mine.tmp', 'run_001.npz'):
        (tmp_path / name).write_text('')
    files.remove_temporary(str(tmp_path))
    assert sorted(os.listdir(tmp_path)) == ['.lock', 'mine.tmp', 'run_001.npz']
