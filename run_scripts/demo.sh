#!/usr/bin/env bash
# The whole system on two runs that no model has seen: solver, learned simulators, errors, run times.
#
#   bash run_scripts/demo.sh                       # everything goes to demo_output/
#   bash run_scripts/demo.sh --output_path=/tmp/d  # elsewhere
#   bash run_scripts/demo.sh --scenes=wheel        # one scene only
#
# Makes its own virtual environment first; see setup_env.sh for its knobs.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
EXTRAS=${EXTRAS:-cpu,viz,dev} bash run_scripts/setup_env.sh
export TF_CPP_MIN_LOG_LEVEL=${TF_CPP_MIN_LOG_LEVEL:-2} TF_ENABLE_ONEDNN_OPTS=0
exec "${VENV:-.venv}/bin/python" -m run_scripts.demo "$@"
