"""Where compiled kernels are kept."""

import os
import pathlib
import subprocess
import sys


def test_kernels_are_kept_where_the_environment_says(tmp_path):
    code = 'import numba, mpm.columns; print(numba.config.CACHE_DIR)'
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=pathlib.Path(__file__).parents[2], capture_output=True,
        env=os.environ | {'NUMBA_CACHE_DIR': str(tmp_path)}, check=True,
    )  # fmt: skip
    folder = pathlib.Path(done.stdout.decode().strip())
    assert folder.parent == tmp_path and len(folder.name) == 16
