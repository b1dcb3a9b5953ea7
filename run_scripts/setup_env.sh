#!/usr/bin/env bash
# Makes the virtual environment of the project, or leaves it alone if it is up to date.
#
#   bash run_scripts/setup_env.sh
#
# The packages come from setup.py at the versions of constraints.txt; the project itself is
# installed as a link to this folder (pip -e), so that edits take effect at once.
#
# Knobs (environment variables):
#   PYTHON   interpreter to make the environment with (default: the first of python3.11, python3.12,
#            python3.13, python3 that is at least 3.11)
#   VENV     folder of the environment (default: .venv in the project)
#   EXTRAS   extras of setup.py (default: cpu,viz,dev; with a graphics card: gpu,viz,dev)
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

venv=${VENV:-.venv}
extras=${EXTRAS:-cpu,viz,dev}

fail() {
    printf 'setup_env: %s\n' "$*" >&2
    exit 1
}

is_new_enough() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

version_of() {
    { "$1" --version 2>&1 || true; } | head -n 1
}

find_python() {
    local candidate
    if [ -n "${PYTHON:-}" ]; then
        is_new_enough "$PYTHON" ||
            fail "PYTHON=$PYTHON is not Python 3.11 or newer: $(version_of "$PYTHON")"
        printf '%s\n' "$PYTHON"
        return
    fi
    for candidate in python3.11 python3.12 python3.13 python3; do
        if is_new_enough "$candidate"; then
            printf '%s\n' "$candidate"
            return
        fi
    done
    fail "Python 3.11 or newer is needed, python3 here is: $(version_of python3)." \
        'Install it (Debian, Ubuntu: apt install python3.11 python3.11-venv), or name an' \
        'interpreter: PYTHON=/path/to/python3.11 bash run_scripts/setup_env.sh'
}

# Two commands started at once (demo and tests) must not install into one folder together.
mkdir -p "$(dirname "$venv")"
if command -v flock >/dev/null 2>&1; then
    exec 9>"$venv.lock"
    flock 9
fi

if [ ! -x "$venv/bin/python" ]; then
    python=$(find_python)
    printf 'setup_env: making %s with %s\n' "$venv" "$("$python" --version)"
    "$python" -m venv "$venv" ||
        fail "'$python -m venv $venv' failed; on Debian and Ubuntu the module comes with" \
            "apt install python3-venv"
fi
is_new_enough "$venv/bin/python" ||
    fail "$venv holds $(version_of "$venv/bin/python"), Python 3.11 or newer is needed:" \
        "remove the folder and start again"

stamp="$venv/installed"
wanted=$(
    { cat setup.py constraints.txt; echo "$extras" "$PWD"; } |
        "$venv/bin/python" -c 'import hashlib, sys; print(hashlib.sha256(sys.stdin.buffer.read()).hexdigest())'
)
if [ "$(cat "$stamp" 2>/dev/null || true)" = "$wanted" ]; then
    exit 0
fi
printf 'setup_env: installing into %s (first run: 1 to 3 minutes, 2.3 GB on disk) ...\n' "$venv"
rm -f "$stamp"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --constraint constraints.txt --editable ".[$extras]" ||
    fail 'pip failed, see above; the next run starts the install again'
printf '%s\n' "$wanted" >"$stamp"
printf 'setup_env: %s is ready\n' "$venv"
