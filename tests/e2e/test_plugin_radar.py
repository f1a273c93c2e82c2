"""The example of a plug-in, installed by pip into an environment that has xitl and its packages."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import numpy as np
import pytest

from tests.documentation import ROOT, blocks, suppose
from tests.golden import Golden
from xitl_cli.logs import open_log
from xitl_cli.logs.model.log import Log

RADAR = ROOT / "examples/plugin-radar"
MOST_LINES = 250
HALF_DIAGONAL_M, BEAM_DEG = math.hypot(6, 2), 4.0
TRACK = "{length_m: 12, beam_m: 4, track_ned_m: [[30, -60], [30, 60]], speed_mps: 2}"
OPEN_WATER = f"""extends: mitl
clock: {{duration_s: 20}}
world: {{log_boom: null}}
environment: {{current: {{speed_mps: 0}}}}
plugins:
  radar: {{scan_s: 1, range_m: 150, range_noise_m: 0, bearing_noise_deg: 0}}
vessels:
  boat: {{mission: {{start: {{north_m: 0, east_m: 0, heading_deg: 40}}}}}}
  other: {{traffic: {TRACK}}}
"""
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of a new environment: it sees the packages of this one, and the plug-in is installed in it."""
    folder = tmp_path_factory.mktemp("radar")
    venv.create(folder, with_pip=False)
    python = folder / "bin/python"
    (site,) = (folder / "lib").glob("python*/site-packages")
    standard = sysconfig.get_path("stdlib")  # pip hides folders of .pth files while it builds
    outer = [path for path in sys.path if Path(path).is_dir() and path not in (standard, f"{standard}/lib-dynload")]
    (site / "outer.pth").write_text("".join(f"{path}\n" for path in outer), encoding="utf-8")
    isolation = ["--no-build-isolation"] if importlib.util.find_spec("hatchling") else []
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", *isolation, str(RADAR)]
    done = subprocess.run(pip, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return python


@pytest.fixture(scope="module")
def typed(python: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The folder in which the commands of the page were typed, with a short run, and the output by command."""
    folder = tmp_path_factory.mktemp("run")
    suppose(folder)
    printed = {}
    for command in (command for block in blocks("docs/plugins.md") for command in block.commands if command.needs):
        if command.program == "xitl":
            words = command.words[1:]
            done = xitl(python, folder, *words, *(("--duration", "20") if words[0] == "sim" else ()))
            assert done.returncode == 0, f"{command}: {done.stderr}"
            printed[words[0]] = done.stdout
    return folder / "radar-run", printed


def xitl(python: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(python), "-m", "xitl_cli.main", *words],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def targets(log: Log) -> list[tuple[int, int, float, float]]:
    """Instant (ns), scan, range (m) and bearing (degrees) of each target."""
    table = log.tables["/radar/targets"]
    columns = (table.values(key).tolist() for key in ("scan", "range_m", "bearing_deg"))
    return list(zip(table.stamp_ns.tolist(), *columns, strict=True))


def test_the_example_is_short() -> None:
    files = [path for path in RADAR.rglob("*") if path.suffix in (".py", ".toml", ".yaml", ".md")]
    assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files) <= MOST_LINES


def test_the_plug_in_is_listed_in_each_of_its_groups(python: Path, tmp_path: Path) -> None:
    listed = xitl(python, tmp_path, "plugins", "--json")
    rows = [row for row in json.loads(listed.stdout)["plugins"] if row["package"] == "xitl-radar"]
    assert {row["group"]: row["error"] for row in rows} == {
        "xitl.nodes": "",
        "xitl.log_analyses": "",
        "xitl.commands": "",
    }


def test_a_run_has_targets_a_drawing_and_a_finding(typed: tuple[Path, dict[str, str]]) -> None:
    recording, printed = typed
    assert printed.keys() == {"sim", "radar", "logs"}
    with open_log(recording / "run.mcap", "boat") as log:
        assert len(targets(log)) == len(printed["radar"].splitlines()) > 10
        scenes = len(log.tables["/scene"])
    assert scenes >= 10
    summary = json.loads((recording / "summary.json").read_text(encoding="utf-8"))
    assert summary["vessels"]["boat"]["plugins"] == {"radar": {"scans": 10}}
    assert "The nearest target was" in printed["logs"]


def test_a_wrong_key_has_its_file_and_line(python: Path, tmp_path: Path, golden: Golden) -> None:
    (tmp_path / "own.yaml").write_text("extends: sitl\nplugins:\n  radar:\n    range: 50\n", encoding="utf-8")
    refused = xitl(python, tmp_path, "sim", "own.yaml")
    assert refused.returncode == 2
    golden("stderr", refused.stderr)


def test_the_radar_sees_the_other_vessel_where_it_is(python: Path, tmp_path: Path) -> None:
    """Without noise, each scan has a target within the hull of the other vessel, and within a beam beyond it."""
    (tmp_path / "own.yaml").write_text(OPEN_WATER, encoding="utf-8")
    done = xitl(python, tmp_path, "sim", "own.yaml", "--out", "run", "--duration", "20")
    assert done.returncode == 0, done.stderr
    with open_log(tmp_path / "run/run.mcap", "boat") as log:
        seen = targets(log)
        state = log.tables["/truth/state"]
        stamps, places, quat = state.stamp_ns, state.values("position_ned_m"), state.values("quaternion_ned_frd")
    for scan in range(1, 21):
        stamp_ns = scan * 1_000_000_000
        row = int(np.argmin(np.abs(stamps - stamp_ns)))
        w, x, y, z = quat[row]
        heading_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        north_m, east_m = 30.0 - places[row, 0], -60.0 + 2.0 * scan - places[row, 1]
        true_m, true_rad = math.hypot(north_m, east_m), math.atan2(east_m, north_m) - heading_rad
        most_rad = math.atan2(HALF_DIAGONAL_M, true_m) + math.radians(BEAM_DEG)
        assert any(
            true_m - HALF_DIAGONAL_M <= range_m <= true_m
            and abs(math.remainder(math.radians(bearing_deg) - true_rad, math.tau)) < most_rad
            for at_ns, _, range_m, bearing_deg in seen
            if at_ns == stamp_ns
        ), scan
