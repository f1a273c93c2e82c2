"""Recordings from logs of an ArduRover: their channels and commands against the rows of the log."""

from __future__ import annotations

from contextlib import nullcontext
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.recorded import CALM, MISSION_TLOG
from tests.unit.logs.made_log import MadeLog, MadeTable
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.plugins.identify import log_recording
from xitl_cli.plugins.identify.log_recording import read_log
from xitl_cli.plugins.identify.recording import Floats, Recording, check_recording
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.agents import ReplaySpec
from xitl_cli.replay.pulse_log import PulseLog


@cache
def read(path: Path, source: str) -> Recording:
    vessel = load_profile("vehicles/asv-third").vehicle
    assert vessel is not None
    return read_log(path, vessel, ReplaySpec(), source)


@cache
def rows(path: Path, table: str, *columns: str) -> tuple[Floats, ...]:
    """Seconds of the log's clock and columns of a table; of the first instance, if it has several."""
    with open_log(path) as log:
        found = log.tables[table]
        number = next((name for name in ("C", "I") if name in found.columns and table != "RCOU"), None)
        own = np.ones(len(found), dtype=bool) if number is None else found.values(number) == 0
        zero_ns = 0 if log.format == "dataflash" else log.zero_ns
        stamp_s = (found.stamp_ns - zero_ns) * 1e-9
        return tuple(np.asarray(values, dtype=float)[own] for values in (stamp_s, *map(found.values, columns)))


@pytest.mark.medium
def test_the_motion_of_a_dataflash_log_is_that_of_its_estimator() -> None:
    run = read(CALM, "estimate")
    assert check_recording(run, 2) is run
    has = run.channels
    assert sorted(has) == ["east", "north", "vel_east", "vel_north", "yaw", "yaw_rate"]
    time_s, yaw_deg = rows(CALM, "ATT", "Yaw")
    assert np.median(np.diff(has["yaw"].time_s)) == pytest.approx(0.1, abs=0.01)
    own = np.searchsorted(time_s, has["yaw"].time_s - 1e-6)
    assert np.cos(has["yaw"].values - np.radians(yaw_deg[own])) == pytest.approx(np.ones(len(own)), abs=1e-9)
    assert np.abs(np.diff(has["yaw"].values)).max() < 0.2  # continuous through north
    time_s, north_mps, east_mps = rows(CALM, "XKF1", "VN", "VE")
    own = np.searchsorted(time_s, has["vel_north"].time_s - 1e-6)
    assert has["vel_north"].values == pytest.approx(north_mps[own], abs=1e-6)
    assert has["vel_east"].values == pytest.approx(east_mps[own], abs=1e-6)


def test_the_path_of_a_dataflash_log_is_the_integral_of_its_velocity() -> None:
    has = read(CALM, "estimate").channels
    time_s = np.arange(45.0, 140.0, 0.05)
    for place, velocity in (("north", "vel_north"), ("east", "vel_east")):
        way = np.cumsum(has[velocity].at(time_s)) * 0.05  # type: ignore[index]
        moved = has[place].at(time_s)  # type: ignore[index]
        assert moved - moved[0] == pytest.approx(way, abs=1.5)  # the estimate is corrected by fixes
        assert np.ptp(moved) > 20.0


def test_the_rate_of_turn_is_the_mean_of_the_samples_between() -> None:
    rate = read(CALM, "estimate").channels["yaw_rate"]
    assert rate.width_s == pytest.approx(0.06, abs=0.001)
    assert np.median(np.diff(rate.time_s)) == pytest.approx(rate.width_s)
    yaw = read(CALM, "estimate").channels["yaw"]
    time_s = np.arange(50.0, 135.0, 0.5)
    turned = np.array([np.trapezoid(rate.at(np.arange(at, at + 2.0, 0.02)), dx=0.02) for at in time_s])
    assert turned == pytest.approx(yaw.at(time_s + 2.0) - yaw.at(time_s), abs=0.05)


def test_the_receiver_gives_place_and_velocity_of_its_fixes() -> None:
    has = read(CALM, "receiver").channels
    time_s, speed_mps, course_deg, lat_deg, lon_deg = rows(CALM, "GPS", "Spd", "GCrs", "Lat", "Lng")
    own = np.searchsorted(time_s, has["vel_north"].time_s - 1e-6)
    assert has["vel_north"].values == pytest.approx(speed_mps[own] * np.cos(np.radians(course_deg[own])), abs=1e-6)
    assert has["vel_east"].values == pytest.approx(speed_mps[own] * np.sin(np.radians(course_deg[own])), abs=1e-6)
    own = np.searchsorted(time_s, has["north"].time_s - 1e-6)
    assert (has["north"].values[0], has["east"].values[0]) == (0.0, 0.0)
    # A degree of latitude and of longitude on WGS84 at 8.8 degrees south: 110.60 and 110.02 km.
    assert has["north"].values == pytest.approx(110600.0 * (lat_deg[own] - lat_deg[own[0]]), abs=0.1)
    assert has["east"].values == pytest.approx(110020.0 * (lon_deg[own] - lon_deg[own[0]]), abs=0.1)
    assert has["yaw"].values == pytest.approx(read(CALM, "estimate").channels["yaw"].values)


@pytest.mark.parametrize("source", ["estimate", "receiver"])
def test_commands_are_the_outputs_while_armed_and_the_last_is_held(source: str) -> None:
    run = read(CALM, source)
    time_s, steering_us, throttle_us = rows(CALM, "RCOU", "C1", "C3")
    own = np.argmin(np.abs(time_s[:, None] - run.command_s[:-1]), axis=0)
    steering, throttle = (steering_us[own] - 1500.0) / 400.0, (throttle_us[own] - 1500.0) / 400.0
    both = np.column_stack([throttle + steering, throttle - steering])  # port and starboard
    assert run.commands[:-1] == pytest.approx(np.clip(both, -1.0, 1.0), abs=1e-9)
    assert run.commands[-1].tolist() == run.commands[-2].tolist()
    assert np.all(np.diff(run.command_s) > 0.0)
    assert run.command_s[-1] == pytest.approx(time_s[-1], abs=0.2)


@pytest.mark.medium
def test_a_telemetry_log_has_the_same_quantities() -> None:
    run = read(MISSION_TLOG, "estimate")
    time_s, yaw_rad = rows(MISSION_TLOG, "ATTITUDE", "yaw")
    yaw = run.channels["yaw"]
    own = np.argmin(np.abs(time_s[:, None] - yaw.time_s), axis=0)
    assert np.cos(yaw.values - yaw_rad[own]) == pytest.approx(np.ones(len(own)), abs=1e-6)
    time_s, north_mps, east_mps = rows(MISSION_TLOG, "LOCAL_POSITION_NED", "vx", "vy")
    for name, values in (("vel_north", north_mps), ("vel_east", east_mps)):
        found = run.channels[name]  # type: ignore[index]
        own = np.argmin(np.abs(time_s[:, None] - found.time_s), axis=0)
        assert found.values == pytest.approx(values[own], abs=1e-6)
    with pytest.raises(UserError, match="has no position; record GPS or a pose"):
        read(MISSION_TLOG, "receiver")


@pytest.mark.parametrize(
    ("signal", "words"),
    [
        ("yaw", r"has no heading; record ATT \(DataFlash\)"),
        ("position_ned", r"has no position; record POS or XKF1 \(DataFlash\)"),
    ],
)
def test_a_log_without_motion_is_refused(signal: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_recording.signals, signal, lambda log: None)
    with pytest.raises(UserError, match=words):
        read.__wrapped__(CALM, "estimate")


def test_without_a_rate_of_turn_the_heading_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_recording.signals, "yaw_rate", lambda log: None)
    found: Any = read.__wrapped__(CALM, "estimate")
    assert "yaw_rate" not in found.channels
    time_s = np.arange(50.0, 135.0, 0.5)
    ours, theirs = (own.motion_at(time_s)[:, 5] for own in (found, read(CALM, "estimate")))
    assert ours == pytest.approx(theirs, abs=0.05)


def test_a_part_of_a_log_ends_with_the_command_that_is_held_there() -> None:
    vessel = load_profile("vehicles/asv-third").vehicle
    assert vessel is not None
    run = read_log(CALM, vessel, ReplaySpec(start_s=50.0, end_s=60.0), "estimate")
    whole = read(CALM, "estimate")
    assert (run.command_s[0], run.command_s[-1]) == pytest.approx((50.0, 60.0), abs=0.11)
    held = np.searchsorted(whole.command_s, run.command_s + 1e-6, side="right") - 1
    assert run.commands[:-1] == pytest.approx(whole.commands[held[:-1]])
    assert run.commands[-1].tolist() == run.commands[-2].tolist() != run.commands[-3].tolist()


S = 1_000_000_000
NORTHWARD = {"pose.pose.orientation.w": 0.5**0.5, "pose.pose.orientation.z": 0.5**0.5}
"""Of a pose in ENU."""


def odometry(name: str, twist: str, ahead_mps: float, port_mps: float) -> MadeTable:
    """Positions (ENU) at 5 Hz, with a heading of north."""
    at_s = np.arange(10) / 5.0
    fields = {f"pose.pose.orientation.{axis}": 0.0 for axis in "xy"} | NORTHWARD
    fields |= {f"pose.pose.position.{axis}": number * at_s for number, axis in enumerate("xyz", start=1)}
    fields |= {f"{twist}.x": ahead_mps, f"{twist}.y": port_mps, f"{twist}.z": 0.0}
    return MadeTable(
        name, 100 * S + np.arange(10) * S // 5, {key: np.broadcast_to(own, 10) for key, own in fields.items()}
    )


@pytest.mark.parametrize(
    ("tables", "surge_mps", "sway_mps"),
    [
        ([("/boat/odometry", "twist.twist.linear", 1.0, 0.5)], 1.0, -0.5),
        ([("/boat/odometry", "twist.linear", 1.0, -0.5)], 1.0, 0.5),
        (
            [
                ("/boat/odometry", "twist.twist.linear", 7.0, 7.0),
                ("/estimate/odometry", "twist.twist.linear", 1.0, 0.5),
            ],
            1.0,
            -0.5,
        ),
        (
            [
                ("/boat/truth/odometry", "twist.twist.linear", 7.0, 7.0),
                ("/pose", "twist.twist.angular", 7.0, 7.0),
            ],
            None,
            None,
        ),
    ],
)
def test_the_velocity_of_an_odometry_is_in_body_axes(
    tables: list[Any], surge_mps: float | None, sway_mps: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = MadeLog(*(odometry(*table) for table in tables), kind="mcap", base="utc")
    monkeypatch.setattr(log_recording, "open_log", lambda path: nullcontext(log))
    pulses = PulseLog("run.mcap", (0.0, 1.0), {1: (1600.0, 1600.0), 3: (1600.0, 1600.0)})
    monkeypatch.setattr(log_recording, "read_pulse_log", lambda path: pulses)
    has = read.__wrapped__(Path("run.mcap"), "estimate").channels
    assert "vel_north" not in has
    if surge_mps is None:
        assert "surge" not in has
        return
    at_s = np.arange(10) / 5.0
    for quantity, values in (("surge", surge_mps), ("sway", sway_mps), ("north", 2.0 * at_s), ("yaw", 0.0)):
        assert has[quantity].time_s == pytest.approx(at_s)
        assert has[quantity].values == pytest.approx(np.broadcast_to(values, 10))
