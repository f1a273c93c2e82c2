"""The page of the same mission sailed several ways, from summaries made for it."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

from xitl_cli.errors import UserError
from xitl_cli.plugins.board.four_ways import Way, table, ways, write_page

LATENCY = {"p50": 800.0, "p99": 4000.0, "max": 9000.0}
BOARD = {
    "mission": {"waypoints_reached": 6, "waypoints_total": 6, "cross_track_rms_m": 0.54, "cross_track_max_m": 2.5},
    "estimation": {"position_rms_m": 0.4},
    "links": [{"name": name, "lost": 0, "latency_us": LATENCY} for name in ("sensors", "actuators")],
    "clocks": [{"node": "LC", "drift_ppm": -0.5, "steps": 0}, {"node": "PS1", "drift_ppm": None, "steps": 0}],
    "actuators": {"age_us": {"p50": 11_000.0, "max": 110_000.0}},
    "tasks": [
        {"node": "LC", "task": "control", "cycles": 7674, "missed": 8},
        {"node": "LC", "task": "telemetry", "cycles": 7674, "missed": 99},
    ],
    "verdict": {"real_time": True},
    "nodes": [{"machine": "emulated <armv7l> board", "cpu_percent": 52.0}],
    "graph": {"claimed": {"wdri": 0.25}, "measured": {"wdri": 0.125}},
}


def sailed() -> list[Way]:
    path = np.array([[0.0, 0.0], [30.0, 10.0], [30.0, 40.0]])
    board = Way("emulated board", "hitl-virtual-board", "", BOARD, path, (0.0214, 0.15))
    return [Way("in process", "sitl", "", {}, path), board]


def test_each_quantity_stands_beside_the_others() -> None:
    rows = {name: values for name, *values in table(sailed())}
    assert rows["cross-track RMS, m"] == ["–", "0.54"]
    assert rows["off the path of the first, at most, m"] == ["–", "0.15"]
    assert rows["commands old, at most, ms"] == ["–", "110"]
    assert rows["control cycles missed"] == ["–", "8"]
    assert rows["clock drift, ppm"] == ["–", "-0.5"]
    assert rows["WDRI measured"] == ["–", "0.125"]
    assert rows["kept real time"] == ["lockstep", "yes"]


def test_the_page_draws_the_paths_and_has_the_table(tmp_path: Path) -> None:
    write_page(sailed(), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "emulated &lt;armv7l&gt; board" in page
    drawn = [json.loads(text) for text in re.findall('<script type="application/json">(.*?)</script>', page)]
    (paths,) = [plot for plot in drawn if plot["kind"] == "map"]
    assert [trace["name"] for trace in paths["traces"]] == ["in process", "emulated board"]
    for trace in paths["traces"]:
        assert {trace[axis]["type"] for axis in "xy"} == {"f4"}
        east, north = (np.frombuffer(base64.b64decode(trace[axis]["data"]), "<f4").tolist() for axis in "xy")
        assert (east, north) == ([0.0, 10.0, 40.0], [0.0, 30.0, 30.0])


def test_only_what_is_there_is_sailed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert [way.title for way in ways(None, "udp://192.168.7.2:14660")] == ["in process", "loopback", "real board"]
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    with pytest.raises(UserError, match="there is no such board"):
        list(ways("virtual", None))
