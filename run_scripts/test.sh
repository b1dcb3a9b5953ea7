#!/usr/bin/env bash
# Sets up the environment (see setup_env.sh for its knobs) and runs the tests.
#
#   bash run_scripts/test.sh                       # everything
#   bash run_scripts/test.sh -m 'not slow'         # without the slow ones
#   bash run_scripts/test.sh tests/mpm -k packing  # further arguments go to pytest
#
# Knobs (environment variables):
#   WORKERS  test processes (default: one per core, at most 4)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
bash run_scripts/setup_env.sh

workers=${WORKERS:-$("${VENV:-.venv}/bin/python" -c 'import os; print(min(4, os.cpu_count() or 1))')}
# The processes share the cores between them: one thread each is faster than each of them taking
# all. A whole file stays in one process, because its tests share compiled functions; files are dealt
# in the order of tests/conftest.py, not by their number of tests, which says nothing of their time.
export OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 TF_NUM_INTRAOP_THREADS=1 TF_NUM_INTEROP_THREADS=1
# TensorFlow's remarks about the processor and missing graphics cards would drown the results.
export TF_CPP_MIN_LOG_LEVEL=${TF_CPP_MIN_LOG_LEVEL:-2}
exec "${VENV:-.venv}/bin/python" -m pytest -n "$workers" --dist loadfile --no-loadscope-reorder "$@"
