"""Where compiled kernels are kept."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]


@pytest.mark.parametrize('named', [True, False])
def test_kernels_are_kept_where_the_environment_says(tmp_path, named):
    code = 'import numba, mpm.columns; print(numba.config.CACHE_DIR)'
    environment = {k: v for k, v in os.environ.items() if k != 'NUMBA_CACHE_DIR'}
    if named:
        environment['NUMBA_CACHE_DIR'] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, env=environment, capture_output=True, check=True
    )
    folder = pathlib.Path(done.stdout.decode().strip())
    assert folder.parent == (tmp_path if named else ROOT / 'mpm' / '__pycache__')
    assert len(folder.name) == 16
