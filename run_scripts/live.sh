#!/usr/bin/env bash
# A model in the browser: http://localhost:8080.
#
#   bash run_scripts/live.sh                  # the excavation
#   bash run_scripts/live.sh --model=wheel    # flags of `lts live`
#
# Makes its own virtual environment first; see setup_env.sh for its knobs.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
EXTRAS=${EXTRAS:-cpu,live} bash run_scripts/setup_env.sh
export TF_CPP_MIN_LOG_LEVEL=${TF_CPP_MIN_LOG_LEVEL:-2} TF_ENABLE_ONEDNN_OPTS=0
exec "${VENV:-.venv}/bin/python" -m learning_to_simulate.live_page "$@"
