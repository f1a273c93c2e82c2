#!/usr/bin/env bash
# Install xitl, and try the commands that need nothing that only Linux has. For macOS and Windows; runs on Linux too.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python}" -m venv "$work/venv"
if [ -d "$work/venv/Scripts" ]; then bin=$work/venv/Scripts; else bin=$work/venv/bin; fi
"$bin/python" -m pip install --quiet --disable-pip-version-check --no-input ".[campaign,report,view]"
cat > "$work/plan.yaml" <<'PLAN'
description: Two short runs
base: sitl
axes: {clock.duration_s: [1, 2]}
seeds: 1
keep: [duration_s]
recordings: none
PLAN
cd "$work"
"$bin/xitl" --version
"$bin/xitl" sim sitl --duration 10 --out run
"$bin/xitl" logs analyze run --report report.html
"$bin/xitl" wdri run
"$bin/xitl" view run --html replay.html
"$bin/xitl" campaign plan.yaml --out campaign --workers 2 || test $? = 1 # no run reaches its waypoints
test "$(grep -c '"status": *"incomplete"' campaign/results.jsonl)" = 2
test -s report.html && test -s replay.html
"$bin/xitl" doctor || true # its problems are those of this machine
echo "the commands work here"
