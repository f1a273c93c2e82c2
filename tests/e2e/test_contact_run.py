"""A run into a mesh of the user's own: felt with `world.contact`, seen alone without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl, payloads, summary

from sim_core.world.geometry import ROCK, ellipsoid

PROFILE = """
extends: mitl
world:
  log_boom: null
  dam: null
  meshes: [{file: rock.obj, position_ned_m: [22, -16, 3]}]
mission: {start: {north_m: 12, east_m: -16, heading_deg: 0}, waypoints_ned_m: [[60, -16]]}
"""


@pytest.mark.slow
def test_a_rock_of_10_m_in_the_way(xitl: Xitl, tmp_path: Path) -> None:
    """Without contact the mission leads through it; with it the boat is held, and the summary says by what."""
    rock = ellipsoid((5.0, 5.0, 5.0), ROCK, 16, 12)
    lines = [f"v {x} {y} {z}" for x, y, z in rock.vertices_m] + [f"f {a} {b} {c}" for a, b, c in rock.faces + 1]
    (tmp_path / "rock.obj").write_text("\n".join(lines))
    (tmp_path / "through.yaml").write_text(PROFILE)
    felt = ("--set", "world.contact=true", "--duration", "12")
    xitl("sim", "through.yaml", "--duration", "12", "--out", "seen")
    xitl("sim", "through.yaml", *felt, "--out", "felt")
    xitl("sim", "through.yaml", *felt, "--out", "again")
    seen, hit = summary(tmp_path / "seen"), summary(tmp_path / "felt")
    assert seen["collisions"] is None
    assert set(hit["collisions"]["by"]) == {"rock"}
    assert hit["collisions"]["max_impact_mps"] > 0.5
    assert payloads(tmp_path / "felt/run.mcap") == payloads(tmp_path / "again/run.mcap")
    north = {name: last_north_m(tmp_path / name) for name in ("seen", "felt")}
    assert north["seen"] > 30.0
    assert north["felt"] < 17.6  # the rock begins at 18 m or so, the hull is 1.1 m longer than its middle


def last_north_m(run: Path) -> float:
    stamped = payloads(run / "run.mcap")["/truth/state"]
    return float(np.frombuffer(stamped[-1][1], np.float64, 1, 12)[0])
