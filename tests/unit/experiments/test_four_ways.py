"""The page of the same mission sailed several ways, from summaries made for it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from xitl_cli.errors import UserError
from xitl_cli.experiments.four_ways import Way, table, ways, write_page

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
    return [Way("in process", "sitl", "", {}, path), Way("emulated board", "hitl-virtual-board", "", BOARD, path)]


def test_each_quantity_stands_beside_the_others() -> None:
    rows = {name: values for name, *values in table(sailed())}
    assert rows["cross-track RMS, m"] == ["–", "0.54"]
    assert rows["commands old, at most, ms"] == ["–", "110"]
    assert rows["control cycles missed"] == ["–", "8"]
    assert rows["clock drift, ppm"] == ["–", "-0.5"]
    assert rows["WDRI measured"] == ["–", "0.125"]
    assert rows["kept real time"] == ["lockstep", "yes"]


def test_the_page_draws_the_paths_to_one_scale_and_loads_nothing(tmp_path: Path) -> None:
    write_page(sailed(), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "http" not in page
    assert "emulated &lt;armv7l&gt; board" in page
    drawn = [np.array([pair.split(",") for pair in line.split()], float) for line in re.findall('points="(.*?)"', page)]
    assert len(drawn) == 2
    north_px, east_px = drawn[0][0, 1] - drawn[0][1, 1], drawn[0][2, 0] - drawn[0][1, 0]
    assert north_px == pytest.approx(east_px, abs=0.2)  # 30 m each


def test_only_what_is_there_is_sailed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert [way.title for way in ways(None, "udp://192.168.7.2:14660")] == ["in process", "loopback", "real board"]
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    with pytest.raises(UserError, match="there is no such board"):
        list(ways("virtual", None))
