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
"$work/venv/bin/python" -m pip --disable-pip-version-check install --quiet --no-compile -c constraints.txt "$work"/xitl-*.whl
cd "$work"
venv/bin/xitl --help > /dev/null
venv/bin/xitl profiles list > /dev/null
venv/bin/xitl wdri paper/eq35-full-hitl --json | venv/bin/python -c 'import json, sys; assert round(json.load(sys.stdin)["wdri"], 4) == 0.9306'
# A base install: it simulates, and each command that needs more names the extra.
needs() { # EXTRA COMMAND...: it fails, and says what to type
    extra=$1
    shift
    "$@" > /dev/null 2> told && exit 1
    grep -qF "pip install 'xitl[$extra]'" told || { cat told; exit 1; }
}
venv/bin/xitl sim sitl --duration 5 --out run > /dev/null
test -s run/run.mcap && test -s run/summary.json
! command -v cc > /dev/null || grep -q '"compiled": true' run/summary.json
venv/bin/xitl logs analyze run/run.mcap run/autopilot.bin > /dev/null
needs report venv/bin/xitl logs analyze run/autopilot.bin --report report.html
needs report venv/bin/xitl logs plot run/autopilot.bin ATT.Roll --out plot.html
needs parquet venv/bin/xitl logs export run/autopilot.bin ATT --format parquet --out folder
venv/bin/xitl campaign controllers --dry-run > /dev/null
needs campaign venv/bin/xitl campaign environments
needs campaign venv/bin/xitl campaign compare run run
needs perception venv/bin/xitl map run/run.mcap
needs perception venv/bin/xitl sim sitl-perception --duration 1
test "$(du -sm venv | cut -f 1)" -lt 400
"$work/venv/bin/python" -m pip --disable-pip-version-check install --quiet --no-compile -c "$root/constraints.txt" "$(echo "$work"/xitl-*.whl)[report]"
venv/bin/xitl logs analyze run/run.mcap run/autopilot.bin --report report.html > /dev/null && test -s report.html
venv/bin/python -c 'import xitl; assert xitl.wdri("sitl").wdri > 0.16; xitl.open_log("run/run.mcap").close()'
venv/bin/xitl agent package > /dev/null
venv/bin/python -I -S xitl-agent.pyz --version > /dev/null
echo "the wheel works"
