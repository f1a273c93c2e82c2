"""`xitl twin`: its options, its sentences, and what the 3D view is shown of boat and ghost."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import typer
from pymavlink.dialects.v20 import ardupilotmega
from scipy.spatial.transform import Rotation

from xitl_cli.errors import UserError
from xitl_cli.plugins.twin import live
from xitl_cli.plugins.twin.boat import BoatInterval, Outputs
from xitl_cli.plugins.twin.command import _outputs, _show, twin
from xitl_cli.plugins.twin.diagnosis import Alarm
from xitl_cli.plugins.twin.ghost import Ghost
from xitl_cli.plugins.twin.session import (
    TwinReport,
    alarm_sentence,
    check_fit,
    check_possible,
    ghost_scene,
    propeller_names,
)
from xitl_cli.profile import load_profile, load_with_origins
from xitl_cli.record.foxglove_types import foxglove_type

OTTER = load_profile("vehicles/otter").vehicle
assert OTTER is not None
ALARM = Alarm(80_000_000_000, "thrust port", 60_000_000_000, 0.973, 0.7, 0.04, "share", "drag")


BRIDGE = SimpleNamespace(outputs=[2, 4], trim_us=1480.0, span_us=350.0)


@pytest.mark.parametrize(
    ("autopilot", "text", "outputs"),
    [
        (None, None, Outputs((1, 3), 1500.0, 400.0)),
        (SimpleNamespace(bridge=None), "1, 16", Outputs((1, 16), 1500.0, 400.0)),
        (SimpleNamespace(bridge=BRIDGE), None, Outputs((2, 4), 1480.0, 350.0)),
        (SimpleNamespace(bridge=BRIDGE), "3,1", Outputs((3, 1), 1480.0, 350.0)),
    ],
)
def test_outputs_are_those_of_the_option_or_of_the_profile_s_bridge(
    autopilot: Any, text: str | None, outputs: Outputs
) -> None:
    loaded = cast(Any, SimpleNamespace(profile=SimpleNamespace(autopilot=autopilot)))
    assert _outputs(loaded, text) == outputs


@pytest.mark.parametrize("text", ["0,1", "1,17", "1;3", "", "1,", "-1,3"])
def test_outputs_that_are_no_channels_are_refused(text: str) -> None:
    with pytest.raises(UserError, match=r"is not a list of channels from 1 to 16; write for example 1,3"):
        _outputs(load_with_origins("vehicles/otter"), text)


def test_outputs_are_commands_by_trim_and_span() -> None:
    """A pulse of 0 is neutral, and not full astern."""
    pulses_us = np.array([0.0, 1480.0, 1655.0, 1305.0, 1830.0, 1831.0, 1129.0])
    expected = [0.0, 0.0, 0.5, -0.5, 1.0, 1.0, -1.0]
    assert Outputs((1,), 1480.0, 350.0).command(pulses_us) == pytest.approx(expected)


def telemetry(path: Path, seconds: int) -> Path:
    """Write the telemetry of an armed boat at rest."""
    mav, sender = ardupilotmega, ardupilotmega.MAVLink(None, srcSystem=4, srcComponent=1)
    data = b""
    for number in range(10 * seconds):
        at_ms = 5000 + 100 * number
        for message in (
            mav.MAVLink_heartbeat_message(11, 3, mav.MAV_MODE_FLAG_SAFETY_ARMED, 0, 4, 3),
            mav.MAVLink_attitude_message(at_ms, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0),
            mav.MAVLink_global_position_int_message(at_ms, 603913000, 53050000, 0, 0, 0, 0, 0, 0),
            mav.MAVLink_servo_output_raw_message(1000 * at_ms, 0, 1500, 0, 1500, *[0] * 5),
        ):
            data += struct.pack(">Q", 0) + message.pack(sender)
    path.write_bytes(data)
    return path


@pytest.mark.medium
def test_a_boat_at_rest_is_compared_and_does_not_differ(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "400")  # a longer word is broken
    boat, out = telemetry(tmp_path / "boat.tlog", 8), tmp_path / "new" / "twin.mcap"
    with pytest.raises(typer.Exit) as ended:
        twin(str(boat), "vehicles/otter", seconds=5.0, out=out, as_json=True)
    report = json.loads(capsys.readouterr().out)
    assert ended.value.exit_code == 0
    assert out.stat().st_size > 1000
    assert {key: report[key] for key in ("boat", "vehicle", "system_id", "seconds", "silent_s", "alarms")} == {
        "boat": str(boat),
        "vehicle": "otter",
        "system_id": 4,
        "seconds": 5.0,
        "silent_s": 0.0,
        "alarms": [],
    }
    assert report["prediction_30_s"] == {"count": 0, "median_m": None, "p95_m": None}
    with pytest.raises(UserError, match=r"twin\.mcap: exists; choose another file with --out, or add --overwrite"):
        twin(str(boat), "vehicles/otter", out=out)
    with pytest.raises(typer.Exit) as ended:
        twin(str(boat), "vehicles/otter", out=out, overwrite=True)
    shown = " ".join(capsys.readouterr().out.split())
    assert f"twin of otter: listens at {boat}, records {out}" in shown
    assert "boat system 4, 320 messages compared" in shown
    assert "30 s ahead none yet differences none" in shown


def test_a_file_without_a_vehicle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "water.yaml").write_text("environment: {water: {density_kgpm3: 1025}}\n")
    with pytest.raises(UserError, match=r"water.yaml: has no vehicle; use a file with a group `vehicle`"):
        twin("nix.tlog", str(tmp_path / "water.yaml"), out=tmp_path / "twin.mcap")


def test_a_report_is_shown_with_its_errors_and_differences(capsys: pytest.CaptureFixture[str]) -> None:
    """Of 1, 2, 3 and 5 m, the median is 2.5 m, and 95 % lie within 3 + 0.85 * 2 m."""
    wdri = cast(Any, SimpleNamespace(wdri=0.30556))
    _show(TwinReport("udp", "otter", 1, 90, 90.4, 0.0, 812, [ALARM], [1.0, 5.0, 3.0, 2.0], wdri))
    shown = " ".join(capsys.readouterr().out.split())
    assert shown == (
        "boat system 1, 812 messages compared 90 s 30 s ahead median 2.5 m, 95 % within 4.7 m (4) "
        "differences 1 WDRI 0.3056, system in the loop"
    )


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, "at 80 s: thrust port is 70 % (± 4) of the model's, since 60 s, with 97 % confidence; otherwise drag"),
        ({"confidence": 0.999}, "at 80 s: thrust port is 70 % (± 4) of the model's, since 60 s, with 99 % confidence"),
        (
            {"kind": "current", "unit": "m/s", "size": 0.456, "deviation": 0.061, "confidence": 1.0},
            "at 80 s: the current has changed to 0.46 m/s (± 0.06), since 60 s, with 99 % confidence",
        ),
        (
            {"kind": "compass", "unit": "rad", "size": math.radians(15.0), "deviation": math.radians(2.0)},
            "at 80 s: the compass is off by 15° (± 2), since 60 s, with 97 % confidence; otherwise drag",
        ),
        (
            {"kind": "gnss", "unit": "m", "size": 4.26, "deviation": 0.5},
            "at 80 s: the gnss position is off by 4.3 m (± 0.5), since 60 s, with 97 % confidence; otherwise drag",
        ),
    ],
)
def test_an_alarm_names_kind_size_onset_and_confidence(changes: dict[str, Any], sentence: str) -> None:
    assert alarm_sentence(replace(ALARM, **changes)) == sentence


@pytest.mark.parametrize(
    ("size", "unit", "possible"),
    [(-0.3, "share", True), (-0.31, "share", False), (4.0, "share", True), (4.01, "share", False), (9.0, "m", True)],
)
def test_a_share_beyond_reason_is_an_error_of_the_outputs(size: float, unit: str, possible: bool) -> None:
    alarm = replace(ALARM, size=size, unit=unit)
    if possible:
        check_possible("udp", alarm)
        return
    with pytest.raises(UserError, match=rf"thrust port would be {100 * size:.0f} % of the model's, outside -30 to 400"):
        check_possible("udp", alarm)


@pytest.mark.parametrize(
    ("speed_mps", "rate_degps", "fits"), [(0.6, 15.0, True), (0.61, 0.0, False), (0.0, 15.1, False)]
)
def test_a_boat_that_moves_quite_differently_is_another_vehicle(
    speed_mps: float, rate_degps: float, fits: bool
) -> None:
    assert OTTER is not None
    for north, east in ((0.0, speed_mps), (speed_mps, 0.0)):
        noise = np.array([north, east, 9.0, math.radians(rate_degps) * (1.0 - 1e-12), 9.0, 9.0])
        if fits:
            check_fit("udp", OTTER, noise)
            continue
        with pytest.raises(UserError, match=rf"in the first 40 s .* by {speed_mps:.2f} m/s and {rate_degps:.0f}°/s"):
            check_fit("udp", OTTER, noise)


def test_a_pair_side_by_side_is_port_and_starboard() -> None:
    assert OTTER is not None
    port, starboard = OTTER.propellers
    assert propeller_names(OTTER) == ("port", "starboard")
    assert propeller_names(replace(OTTER, propellers=(starboard, port))) == ("propeller 0", "propeller 1")
    middle = replace(port, position_frd_m=(-1.0, 0.0, 0.0))
    assert propeller_names(replace(OTTER, propellers=(middle, starboard))) == ("propeller 0", "propeller 1")
    assert propeller_names(replace(OTTER, propellers=(port, middle))) == ("propeller 0", "propeller 1")
    assert propeller_names(replace(OTTER, propellers=(middle,))) == ("propeller 0",)


def test_the_ghost_has_its_hulls_beside_its_course() -> None:
    """Against scipy: the middle of each hull, turned by the heading, from the ghost's place."""
    assert OTTER is not None
    heading_rad = 0.6
    ghost = Ghost(12.0, np.array([1.0, 0.5, heading_rad, 0.1, 20.0, -7.0]))
    scene = ghost_scene(OTTER, ghost, 3_250_000_000, 1.75)
    (entity,) = foxglove_type("SceneUpdate").FromString(scene.encode()).entities
    assert (entity.frame_id, entity.id) == ("map", "twin ghost")
    assert (entity.timestamp.seconds, entity.timestamp.nanos) == (3, 250_000_000)
    assert (entity.lifetime.seconds, entity.lifetime.nanos) == (1, 750_000_000)
    turn_ned = Rotation.from_euler("z", heading_rad)
    assert len(entity.cubes) == len(OTTER.demi_hulls) == 2
    for cube, hull in zip(entity.cubes, OTTER.demi_hulls, strict=True):
        north_m, east_m, _ = np.array([20.0, -7.0, 0.0]) + turn_ned.apply([*hull.keel_frd_m[:2], 0.0])
        place, turn = cube.pose.position, cube.pose.orientation
        assert (place.x, place.y, place.z) == pytest.approx((east_m, north_m, 0.5 * hull.height_m))
        forward = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([1.0, 0.0, 0.0])
        assert forward == pytest.approx([math.sin(heading_rad), math.cos(heading_rad), 0.0], abs=1e-12)
        assert (cube.size.x, cube.size.y, cube.size.z) == pytest.approx(
            (hull.length_m, 0.15 * hull.length_m, hull.height_m)
        )


class Watching:
    """A node of a live output."""

    def __init__(self, name: str, calls: list[str], fails: str = "") -> None:
        self.name, self.calls, self.fails = name, calls, fails
        self.steps: list[Any] = []

    def __getattr__(self, call: str) -> Callable[..., None]:
        def note(*arguments: Any) -> None:
            self.calls.append(f"{call} {self.name}")
            if call == self.fails:
                raise UserError("no browser")

        return note

    def exchange(self, step: Any) -> None:
        self.steps.append(step)


class Shown:
    """A live output, and the recording of a twin."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, fails: str = "") -> None:
        self.calls: list[str] = []
        self.vessel, self.world = Watching("vessel", self.calls), Watching("world", self.calls, fails)
        self.live_vessel: Any = None
        self.live_run: Any = None
        self.scenes: list[Any] = []
        monkeypatch.setattr(live, "live_outputs", lambda profiles: [self])

    def vessel_node(self, vessel: Any) -> Any:
        self.live_vessel = vessel
        return self.vessel

    def world_nodes(self, run: Any) -> list[Any]:
        self.live_run = run
        return [self.world]

    def scene(self, scene: Any) -> None:
        self.scenes.append(scene)


@pytest.mark.medium
def test_the_view_draws_the_vessel_where_the_boat_is(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Shown(monkeypatch)
    told: list[str] = []
    commands = np.array([[0.1, 0.2], [0.5, -0.25]])
    motion = np.array([1.0, -2.0, 0.4, 0.05, 30.0, 40.0])
    attitude_rad = np.array([0.1, -0.05, -0.4])
    interval = BoatInterval(7_000_000_000, commands, np.zeros(2), motion, attitude_rad, True, 2.0)
    with live.live_observer(
        load_with_origins("vehicles/otter"), "vehicles/otter", cast(Any, shown), told.append
    ) as boat:
        assert shown.calls == ["prepare vessel", "prepare world", "begin vessel", "begin world"]
        assert len(shown.scenes) == 1
        for _ in range(2):
            boat.show(interval, cast(Any, None))
        assert shown.calls[4:] == []
    assert shown.calls[4:] == ["end vessel", "end world", "close vessel", "close world"]
    assert [(step.number, step.now_ns) for step in shown.world.steps] == [(1, 7_000_000_000), (2, 7_000_000_000)]
    step = shown.vessel.steps[-1]
    # The mean of an interval of 2 s is a second before its end.
    assert step.motion.pos_ned_m[0, :2] == pytest.approx([31.0, 38.0])
    assert step.motion.vel_ned_mps.tolist() == [[1.0, -2.0, 0.0]]
    turn = Rotation.from_euler("ZYX", attitude_rad[::-1]).as_matrix()
    assert step.motion.rot_ned_frd[0] == pytest.approx(turn)
    vessel = shown.live_vessel
    assert vessel.plant.state.vessel.motion is step.motion
    assert vessel.plant.state.time_ns == 7_000_000_000
    assert (vessel.control.command.motors, vessel.control.command.armed) == ((0.5, -0.25), True)
    assert vessel.control.progress.armed
    status = vessel.status()
    assert (status.sim_s, status.duration_s, status.armed, status.motors) == (7.0, math.inf, True, (0.5, -0.25))
    assert status.speed_mps == pytest.approx(math.sqrt(5.0))
    assert status.heading_deg == pytest.approx(360.0 - math.degrees(0.4))
    assert (status.cross_track_m, status.position_error_m) == (None, None)
    shown.live_run.tell("listens")
    assert told == ["listens"]
    assert not shown.live_run.interrupted()
    assert shown.live_run.scene() == shown.scenes[0].encode()


@pytest.mark.medium
def test_a_view_that_does_not_open_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = Shown(monkeypatch, "begin")
    loaded = load_with_origins("sitl")
    with pytest.raises(UserError, match="no browser"), live.live_observer(loaded, "sitl", cast(Any, shown), print):
        pytest.fail("it opened")
    assert shown.calls[-2:] == ["close vessel", "close world"]
    assert "end vessel" not in shown.calls
    assert shown.live_vessel.profile.site.name != "boat", "a whole profile keeps its site"
