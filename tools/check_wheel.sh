#!/bin/sh
# Build the wheel, install it in an environment of its own away from the source tree, and use it.
set -eu
cd "$(dirname "$0")/.."
root=$PWD
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python=$root/.venv/bin/python
"$python" -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir "$work" .
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip --disable-pip-version-check install --quiet -c constraints.txt "$work"/xitl-*.whl
cd "$work"
venv/bin/xitl --help > /dev/null
venv/bin/xitl profiles list > /dev/null
venv/bin/xitl wdri paper/eq35-full-hitl --json | venv/bin/python -c 'import json, sys; assert round(json.load(sys.stdin)["wdri"], 4) == 0.9306'
venv/bin/xitl sim --profile sitl --duration 5 --out run > /dev/null && exit 1 || test $? -eq 1
test -s run/run.mcap && test -s run/summary.json
venv/bin/xitl logs analyze run/run.mcap run/autopilot.bin --report report.html > /dev/null && test -s report.html
venv/bin/python -c 'import xitl; assert xitl.wdri("sitl").wdri > 0.16; xitl.open_log("run/run.mcap").close()'
venv/bin/xitl agent package > /dev/null
venv/bin/python -I -S xitl-agent.pyz --version > /dev/null
echo "the wheel works"
