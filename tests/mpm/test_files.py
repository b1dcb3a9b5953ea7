"""Files of runs: what killed writers leave."""

import os

from mpm import files


def test_left_overs_of_killed_writers_are_removed(tmp_path):
    for name in ('.run_001.npz.0123.tmp', '.lock', 'mine.tmp', 'run_001.npz'):
        (tmp_path / name).write_text('')
    files.remove_temporary(str(tmp_path))
    assert sorted(os.listdir(tmp_path)) == ['.lock', 'mine.tmp', 'run_001.npz']
