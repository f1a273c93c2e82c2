"""What ground stations set outlives a restart, whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agent.fcu.fence import CIRCLE_IN, FenceItem
from agent.fcu.mission import change_speed, jump, make_mission, waypoint
from agent.fcu.vehicle.autopilot import Autopilot
from agent.roles.storage import Storage, StorageError

PLAN = make_mission([waypoint(-8.8, -63.95), waypoint(-8.79, -63.95, hold_s=3.0), change_speed(2.0)])
FENCE = [FenceItem(CIRCLE_IN, -8.8, -63.95, 100.0)]


def restarted(path: Path) -> Autopilot:
    storage, autopilot = Storage(path), Autopilot()
    storage.apply(autopilot)
    storage.close()
    return autopilot


def test_parameters_and_plans_are_back_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    storage, autopilot = Storage(path), Autopilot()
    storage.apply(autopilot)
    storage.keep_parameter("WP_SPEED", 1.5)
    autopilot.commands.set_mission(PLAN)
    assert autopilot.commands.set_fence(FENCE) == ""
    storage.keep_plan(autopilot)
    storage.close()
    again = restarted(path)
    assert again.parameters["WP_SPEED"] == 1.5
    assert again.navigator.mission == PLAN
    assert list(again.fence.items) == FENCE
    assert list(tmp_path.iterdir()) == [path]


def test_a_mission_kept_by_an_earlier_release_is_read(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    kept = {"lat_deg": 0.0, "lon_deg": 0.0, "alt_m": 0.0, "speed_mps": 0.0, "frame": 3, "hold_s": 0.0}
    items = [
        {**kept, "command": 16, "lat_deg": -8.8, "lon_deg": -63.95, "jump_seq": 0, "repeats": 0},
        {**kept, "command": 16, "lat_deg": -8.79, "lon_deg": -63.95, "hold_s": 3.0},
        {**kept, "command": 178, "speed_mps": 2.0},
        {**kept, "command": 177, "jump_seq": 1, "repeats": -1},
    ]
    path.write_text(json.dumps({"format": 1, "parameters": {}, "mission": items, "fence": []}))
    found = restarted(path).navigator.mission.items
    assert found[:2] == PLAN.items[:2]
    assert found[2].parameters[1] == 2.0
    assert found[3] == jump(1, -1)


def test_only_what_was_set_is_kept_until_all_is_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    storage, autopilot = Storage(path), Autopilot()
    storage.keep_parameter("WP_SPEED", 1.5)
    storage.flush()
    assert json.loads(path.read_text())["parameters"] == {"WP_SPEED": 1.5}
    storage.keep_all_parameters(autopilot)
    storage.flush()
    assert len(json.loads(path.read_text())["parameters"]) == len(autopilot.parameters)
    autopilot.parameters.set("WP_RADIUS", 7.0)
    storage.forget_parameters(autopilot)
    storage.close()
    assert json.loads(path.read_text())["parameters"] == {}
    assert autopilot.parameters["WP_RADIUS"] == Autopilot().parameters["WP_RADIUS"]


def test_what_no_longer_fits_is_left_out_and_said(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    values = {"WP_SPEED": 1e9, "GONE": 1.0, "WP_RADIUS": 4.0}
    item = {"command": 16, "lat_deg": 99.0, "lon_deg": 0.0}
    path.write_text(json.dumps({"format": 1, "parameters": values, "mission": [item, item], "fence": []}))
    autopilot = restarted(path)
    assert autopilot.parameters["WP_RADIUS"] == 4.0
    said = " | ".join(event.text for event in autopilot.events.drain())
    assert "kept.json: WP_SPEED = 1e+09 is out of range" in said
    assert "kept.json: GONE is not a parameter" in said
    assert "kept.json: mission item 1: position 99, 0 is not on Earth" in said


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[]", "{}", '{"format": 1}'),
        '{"format": 1, "parameters": {"A": "x"}, "mission": [], "fence": []}',
        '{"format": 1, "parameters": {}, "mission": [{"nonsense": 1}], "fence": []}',
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "kept.json"
    path.write_text(text)
    with pytest.raises(StorageError, match=r"kept\.json: is not a storage file .*; move it away to start"):
        Storage(path)


def test_another_format_and_no_folder_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    path.write_text('{"format": 3}')
    with pytest.raises(StorageError, match="has format 3, this release reads 2; move it away"):
        Storage(path)
    with pytest.raises(StorageError, match=r"there is no folder .*; create it or choose another file"):
        Storage(tmp_path / "no" / "kept.json")


def test_a_failed_write_is_said_once_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    storage, autopilot = Storage(path), Autopilot()
    storage.keep_parameter("WP_SPEED", 1.5)
    storage.flush()
    old = path.read_text()
    (tmp_path / "kept.json.new").mkdir()
    storage.keep_parameter("WP_SPEED", 2.5)
    storage.flush()
    storage.report(autopilot)
    storage.report(autopilot)
    storage.close()
    (event,) = autopilot.events.drain()
    assert "kept.json: not written" in event.text
    assert path.read_text() == old
