"""What a ground station may ask for: commands, targets, sticks, streams, reports, time; each with its own answer."""

from __future__ import annotations

import io
import math
from datetime import datetime, timezone
from typing import Any

import pytest
from boat import DECLINATION_RAD, LAT_DEG, LON_DEG, Boat, Noise, Sensors, sail

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.mavlink.reports import REPORTS
from agent.fcu.mavlink.telemetry import STREAMS
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import TABLE, Parameters
from agent.fcu.vehicle import modes, navigation
from agent.fcu.vehicle.autopilot import Autopilot
from agent.wire import dialect as mav

SECOND = 1_000_000_000
TICK = SECOND // 50
ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)


def sent(message: Any, system: int = 255, component: int = 190) -> Any:
    message.get_header().srcSystem = system
    message.get_header().srcComponent = component
    return message


def long(number: int, *values: float) -> Any:
    return sent(mav.MAVLink_command_long_message(1, 1, number, 0, *values, *[0.0] * (7 - len(values))))


def whole(number: int, x: int = 0, y: int = 0, z: float = 0.0, frame: int = 6, p1: float = 0.0, p2: float = 0.0) -> Any:
    return sent(mav.MAVLink_command_int_message(1, 1, frame, number, 0, 0, p1, p2, 0.0, 0.0, x, y, z))


def ready() -> MavlinkChannel:
    """A station of a vehicle that knows where it is, disarmed in HOLD."""
    boat, sensors = Boat(), Sensors(1, Noise())
    autopilot = Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD}))
    vehicle = MavlinkHub(autopilot)
    channel = MavlinkChannel(autopilot, hub=vehicle, ground=True)
    vehicle.on_gnss(sensors.gnss(boat))
    vehicle.on_magnetometer(sensors.magnetometer(boat))
    vehicle.on_barometer(sensors.barometer(boat))
    vehicle.on_imu(sensors.imu(boat))
    sail(boat, sensors, autopilot, 14.0, lambda _: False)
    channel.poll(boat.time_ns)
    return channel


@pytest.fixture(scope="module")
def _ready() -> MavlinkChannel:
    return ready()


@pytest.fixture
def station(_ready: MavlinkChannel) -> MavlinkChannel:
    """The same one for every test; put back to HOLD, disarmed, without texts."""
    _ready.autopilot.disarm()
    _ready.autopilot.set_mode(modes.HOLD)
    texts(_ready)
    return _ready


_now = [100 * SECOND]


def texts(channel: MavlinkChannel) -> str:
    _now[0] += 2 * SECOND
    said = [m for m in channel.poll(_now[0]) if m.get_type() == "STATUSTEXT"]
    return "".join(m.text if m.chunk_seq else f" | {m.text}" for m in said)[3:]


def result(channel: MavlinkChannel, message: Any) -> int:
    ack = channel.handle(message, _now[0])[0]
    assert ack.get_type() == "COMMAND_ACK"
    assert (ack.command, ack.target_system, ack.target_component) == (message.command, 255, 190)
    return int(ack.result)


# -- commands


def test_arming_by_force(station: MavlinkChannel) -> None:
    bare = MavlinkChannel(Autopilot())
    assert result(bare, long(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)) == FAILED
    assert "Arm: Gyros not healthy" in texts(bare)
    assert result(bare, long(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 21195.0)) == FAILED
    for magic in (2989.0, 21196.0):
        assert result(bare, long(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, magic)) == ACCEPTED
        assert bare.autopilot.state.armed
        bare.autopilot.disarm()
    assert result(bare, long(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)) == ACCEPTED
    assert result(station, long(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)) == ACCEPTED


def test_modes_by_command_and_by_message(station: MavlinkChannel) -> None:
    assert result(station, long(mav.MAV_CMD_NAV_LOITER_UNLIM)) == ACCEPTED
    assert station.autopilot.state.mode == modes.LOITER
    assert result(station, long(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH)) == ACCEPTED
    assert station.autopilot.state.mode == modes.RTL
    assert result(station, whole(mav.MAV_CMD_DO_SET_MODE, p1=1.0, p2=float(modes.GUIDED))) == ACCEPTED
    assert station.autopilot.state.mode == modes.GUIDED
    (ack,) = station.handle(sent(mav.MAVLink_set_mode_message(1, 1, modes.MANUAL)), 0)
    assert (ack.command, ack.result) == (mav.MAVLINK_MSG_ID_SET_MODE, ACCEPTED)
    assert station.autopilot.state.mode == modes.MANUAL
    (ack,) = station.handle(sent(mav.MAVLink_set_mode_message(1, 1, 99)), 0)
    assert ack.result == FAILED
    assert "mode 99 is not supported" in texts(station)
    (ack,) = station.handle(sent(mav.MAVLink_set_mode_message(1, 0, modes.HOLD)), 0)
    assert ack.result == DENIED
    assert station.handle(sent(mav.MAVLink_set_mode_message(2, 1, modes.HOLD)), 0) == []


def test_reposition_changes_the_mode_when_it_may(station: MavlinkChannel) -> None:
    lat, lon = round((LAT_DEG + 0.001) * 1e7), round(LON_DEG * 1e7)
    place = {"x": lat, "y": lon}
    assert result(station, whole(mav.MAV_CMD_DO_REPOSITION, **place)) == DENIED
    assert "Reposition refused: not in GUIDED" in texts(station)
    assert result(station, whole(mav.MAV_CMD_DO_REPOSITION, **place, p2=1.0)) == ACCEPTED
    target = station.autopilot.guided_target
    assert target is not None
    assert (station.autopilot.state.mode, target.kind, target.lat_deg) == (modes.GUIDED, navigation.POSITION, lat / 1e7)
    message = station.streams.message(mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT, 0)
    assert message is not None
    assert (message.lat_int, message.lon_int) == (lat, lon)
    assert result(station, long(mav.MAV_CMD_DO_REPOSITION, 0, 1.0, 0, 0, LAT_DEG, LON_DEG)) == ACCEPTED


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (
            whole(mav.MAV_CMD_DO_REPOSITION, x=910000000, y=1, p2=1.0),
            "Reposition refused: position 91, 1e-07 is not on",
        ),
        (whole(mav.MAV_CMD_DO_REPOSITION, x=1, y=1, frame=1, p2=1.0), "Command 192 refused: frame 1 is not supported"),
        (long(mav.MAV_CMD_DO_REPOSITION, 0, 1.0, 0, 0, math.nan, 1.0), "Reposition refused: position nan, 1 is not on"),
        (long(mav.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, math.inf, 1.0, 0.0), "position inf, 1 is not on Earth"),
        (long(mav.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 1.0, 1.0, math.nan), "altitude nan m"),
        (long(mav.MAV_CMD_DO_SET_MISSION_CURRENT, 7.0), "mission item 7 does not exist"),
    ],
)
def test_bad_commands_are_denied_in_words(station: MavlinkChannel, message: Any, words: str) -> None:
    assert result(station, message) == DENIED
    assert words in texts(station)


def test_home(station: MavlinkChannel) -> None:
    assert result(station, long(mav.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, LAT_DEG, LON_DEG, 51.0)) == ACCEPTED
    ack, message = station.handle(long(mav.MAV_CMD_GET_HOME_POSITION), 0)
    assert (ack.result, message.get_type()) == (ACCEPTED, "HOME_POSITION")
    assert (message.latitude, message.longitude, message.altitude) == (-88000000, -639500000, 51000)
    assert [m.altitude for m in station.poll(_now[0]) if m.get_type() == "HOME_POSITION"] == [51000]
    assert [m for m in station.poll(_now[0] + TICK) if m.get_type() == "HOME_POSITION"] == []
    assert result(station, long(mav.MAV_CMD_DO_SET_HOME, 1.0)) == ACCEPTED
    assert result(MavlinkChannel(Autopilot()), long(mav.MAV_CMD_GET_HOME_POSITION)) == FAILED
    assert result(MavlinkChannel(Autopilot()), long(mav.MAV_CMD_DO_SET_HOME, 1.0)) == FAILED


def test_mission_start_and_current(station: MavlinkChannel) -> None:
    station.autopilot.commands.set_mission(
        make_mission([waypoint(LAT_DEG, LON_DEG)] + [waypoint(LAT_DEG + 0.001, LON_DEG)] * 3)
    )
    assert result(station, long(mav.MAV_CMD_DO_SET_MISSION_CURRENT, 2.0)) == ACCEPTED
    assert station.autopilot.navigator.progress.current == 2
    assert result(station, long(mav.MAV_CMD_MISSION_START)) == ACCEPTED
    assert station.autopilot.state.mode == modes.AUTO


def test_fence_on_and_off(station: MavlinkChannel) -> None:
    assert result(station, long(mav.MAV_CMD_DO_FENCE_ENABLE, 1.0)) == ACCEPTED
    assert station.autopilot.fence.enabled
    status = station.streams.message(mav.MAVLINK_MSG_ID_FENCE_STATUS, 0)
    assert status is not None
    assert status.breach_status == 0
    assert result(station, long(mav.MAV_CMD_DO_FENCE_ENABLE, 0.0)) == ACCEPTED
    assert station.streams.message(mav.MAVLINK_MSG_ID_FENCE_STATUS, 0) is None
    assert result(station, long(mav.MAV_CMD_DO_FENCE_ENABLE, math.nan)) == FAILED


def test_reboot_only_when_disarmed(station: MavlinkChannel) -> None:
    station.autopilot.arm(force=True)
    assert result(station, long(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)) == DENIED
    assert "Reboot refused: armed" in texts(station)
    station.autopilot.disarm()
    assert not station.hub.reboot_asked
    assert result(station, long(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 2.0)) == DENIED
    other = MavlinkChannel(Autopilot())
    assert result(other, long(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)) == ACCEPTED
    assert other.hub.reboot_asked


class Kept:
    """A Keeper that notes what it is told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def keep_parameter(self, name: str, value: float) -> None:
        self.told.append((name, value))

    def keep_plan(self, autopilot: Autopilot) -> None:
        self.told.append(len(autopilot.navigator.mission.items))

    def keep_all_parameters(self, autopilot: Autopilot) -> None:
        self.told.append("all")

    def forget_parameters(self, autopilot: Autopilot) -> None:
        self.told.append("none")


def test_what_a_ground_station_sets_is_kept_and_what_the_host_sets_is_not() -> None:
    vehicle = MavlinkHub(Autopilot())
    vehicle.storage = kept = Kept()
    ground = MavlinkChannel(vehicle.autopilot, hub=vehicle, ground=True)
    host = MavlinkChannel(vehicle.autopilot, hub=vehicle)
    for channel in (ground, host):
        channel.handle(sent(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 2.0, 9)), 0)
        channel.handle(sent(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", math.nan, 9)), 0)
        channel.handle(sent(mav.MAVLink_mission_clear_all_message(1, 1)), 0)
    assert result(ground, long(mav.MAV_CMD_PREFLIGHT_STORAGE, 1.0)) == ACCEPTED
    assert result(ground, long(mav.MAV_CMD_PREFLIGHT_STORAGE, 2.0)) == ACCEPTED
    assert result(host, long(mav.MAV_CMD_PREFLIGHT_STORAGE, 1.0)) == FAILED
    assert kept.told == [("WP_SPEED", 2.0), 0, "all", "none"]
    vehicle.autopilot.arm(force=True)
    assert result(ground, long(mav.MAV_CMD_PREFLIGHT_STORAGE, 1.0)) == REJECTED
    assert result(MavlinkChannel(Autopilot(), ground=True), long(mav.MAV_CMD_PREFLIGHT_STORAGE, 1.0)) == FAILED


# -- messages on demand


def test_intervals_are_set_told_and_kept_to() -> None:
    channel = MavlinkChannel(Autopilot(), rates_hz={})
    attitude = float(mav.MAVLINK_MSG_ID_ATTITUDE)

    def interval() -> int:
        ack, message = channel.handle(long(mav.MAV_CMD_GET_MESSAGE_INTERVAL, attitude), 0)
        assert ack.result == ACCEPTED
        return int(message.interval_us)

    def count() -> int:
        _now[0] += SECOND
        return sum(len(channel.poll(_now[0] + tick * TICK)) for tick in range(50))

    assert (interval(), count()) == (-1, 0)
    assert result(channel, long(mav.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, 100_000.0)) == ACCEPTED
    assert (interval(), count()) == (100_000, 10)
    assert result(channel, long(mav.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, 1.0)) == ACCEPTED
    assert (interval(), count()) == (20_000, 50)
    assert result(channel, long(mav.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, -1.0)) == ACCEPTED
    assert (interval(), count()) == (-1, 0)
    assert result(channel, long(mav.MAV_CMD_SET_MESSAGE_INTERVAL, attitude, math.nan)) == DENIED
    assert result(channel, long(mav.MAV_CMD_SET_MESSAGE_INTERVAL, 9999.0, 1e5)) == DENIED
    assert channel.handle(long(mav.MAV_CMD_GET_MESSAGE_INTERVAL, 9999.0), 0)[1].interval_us == 0
    assert result(channel, long(mav.MAV_CMD_GET_MESSAGE_INTERVAL, -5.0)) == DENIED


def test_stream_groups_are_ardupilots() -> None:
    channel = MavlinkChannel(Autopilot(), ground=True)

    def periods(stream: int) -> set[int | None]:
        return {channel.streams.periods_ns.get(message_id) for message_id in STREAMS[stream]}

    def ask(stream: int, rate_hz: int, start: int) -> None:
        assert channel.handle(sent(mav.MAVLink_request_data_stream_message(1, 1, stream, rate_hz, start)), 0) == []

    assert periods(mav.MAV_DATA_STREAM_EXTRA1) == {SECOND}
    ask(mav.MAV_DATA_STREAM_EXTRA1, 10, 1)
    assert periods(mav.MAV_DATA_STREAM_EXTRA1) == {SECOND // 10}
    assert periods(mav.MAV_DATA_STREAM_POSITION) == {SECOND}
    ask(mav.MAV_DATA_STREAM_ALL, 4, 1)
    assert all(periods(stream) == {SECOND // 4} for stream in STREAMS)
    ask(mav.MAV_DATA_STREAM_POSITION, 4, 0)
    assert periods(mav.MAV_DATA_STREAM_POSITION) == {None}
    ask(mav.MAV_DATA_STREAM_ALL, 0, 1)
    assert set(channel.streams.periods_ns) == {mav.MAVLINK_MSG_ID_HEARTBEAT}


def test_version_and_capabilities(station: MavlinkChannel) -> None:
    ack, message = station.handle(long(mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0), 0)
    assert (ack.result, message.get_type()) == (ACCEPTED, "AUTOPILOT_VERSION")
    assert message.flight_sw_version >> 24 == 4
    for bit in (1, 2, 4, 8, 128, 256, 8192, 16384):
        assert message.capabilities & bit


def test_every_report_packs_before_and_after_there_is_something_to_say(station: MavlinkChannel) -> None:
    packer = mav.MAVLink(io.BytesIO(), 1, 1)
    for channel in (MavlinkChannel(Autopilot()), station):
        for message_id, report in REPORTS.items():
            message = report(channel.hub, 10**10)
            if message is not None:
                assert message.get_msgId() == message_id
                assert len(message.pack(packer)) >= 12
    silent = {m for m, report in REPORTS.items() if report(station.hub, 0) is None}
    names = {mav.mavlink_map[message_id].msgname for message_id in silent}
    assert names <= {
        *("FENCE_STATUS", "NAV_CONTROLLER_OUTPUT", "RC_CHANNELS"),
        *("POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT"),
    }


def test_reports_say_what_the_samples_said(station: MavlinkChannel) -> None:
    fix = station.hub.gnss
    assert fix is not None
    message = station.streams.message(mav.MAVLINK_MSG_ID_GPS_RAW_INT, 0)
    assert message is not None
    assert (message.fix_type, message.satellites_visible) == (fix.fix_type, fix.satellites)
    assert message.lat == pytest.approx(fix.lat_deg * 1e7, abs=1)
    assert message.h_acc == pytest.approx(fix.horizontal_accuracy_m * 1e3, abs=1)
    raw = station.streams.message(mav.MAVLINK_MSG_ID_RAW_IMU, 0)
    assert raw is not None
    assert raw.zacc == pytest.approx(-1000, abs=150)
    status = station.streams.message(mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 0)
    assert status is not None
    assert status.flags == 831
    assert 0.0 <= status.pos_horiz_variance < 1.0
    servos = station.streams.message(mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 0)
    assert servos is not None
    assert (servos.servo1_raw, servos.servo2_raw, servos.servo3_raw) == (1500, 0, 1500)


# -- targets and sticks


def local(mask: int, frame: int = 1, **fields: float) -> Any:
    names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    values = [fields.get(name, 0.0) for name in names]
    return sent(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *values))


def world(mask: int, lat: int = 0, lon: int = 0, frame: int = 6, **fields: float) -> Any:
    names = ("alt", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
    values = [fields.get(name, 0.0) for name in names]
    return sent(mav.MAVLink_set_position_target_global_int_message(0, 1, 1, frame, mask, lat, lon, *values))


POSITION, VELOCITY, VELOCITY_YAW, VELOCITY_RATE, YAW, RATE = 0x0DF8, 0x0DC7, 0x09C7, 0x05C7, 0x09FF, 0x05FF


def in_guided(station: MavlinkChannel) -> Autopilot:
    station.autopilot.set_mode(modes.GUIDED)
    texts(station)
    return station.autopilot


def test_a_local_position_in_every_frame(station: MavlinkChannel) -> None:
    autopilot = in_guided(station)
    frame, estimate = autopilot.estimator.frame, autopilot.state.estimate
    assert frame is not None
    north_m, east_m, _ = estimate.pos_ned_m
    cos, sin = math.cos(estimate.yaw_rad), math.sin(estimate.yaw_rad)
    for number, wanted in (
        (1, (10.0, 5.0)),
        (7, (north_m + 10.0, east_m + 5.0)),
        (9, (north_m + 10.0 * cos - 5.0 * sin, east_m + 10.0 * sin + 5.0 * cos)),
    ):
        assert station.handle(local(POSITION, number, x=10.0, y=5.0), 0) == []
        target = autopilot.guided_target
        assert target is not None
        assert target.kind == navigation.POSITION
        assert frame.to_local(target.lat_deg, target.lon_deg) == pytest.approx(wanted, abs=1e-3)
    message = station.streams.message(mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, 0)
    assert message is not None
    assert (message.x, message.y) == pytest.approx(wanted, abs=1e-3)


def test_velocity_heading_and_turn_rate(station: MavlinkChannel) -> None:
    autopilot = in_guided(station)
    station.handle(local(VELOCITY, vx=1.0, vy=2.0), 0)
    target = autopilot.guided_target
    assert target is not None
    assert (target.kind, target.north_mps, target.east_mps) == (navigation.VELOCITY, 1.0, 2.0)
    station.handle(world(VELOCITY_YAW, vx=1.0, yaw=0.5), 0)
    target = autopilot.guided_target
    assert target is not None
    assert (target.kind, target.heading_rad) == (navigation.VELOCITY, 0.5)
    station.handle(local(VELOCITY_RATE, 8, vx=-1.0, yaw_rate=0.1), 0)
    target = autopilot.guided_target
    assert target is not None
    assert (target.kind, target.turn_rate_radps, target.speed_mps) == (navigation.TURN, 0.1, -1.0)
    station.handle(local(VELOCITY, 8, vx=2.0), 0)
    target = autopilot.guided_target
    assert target is not None
    yaw_rad = autopilot.state.estimate.yaw_rad
    assert (target.north_mps, target.east_mps) == pytest.approx((2.0 * math.cos(yaw_rad), 2.0 * math.sin(yaw_rad)))
    station.handle(local(YAW, yaw=1.0), 0)
    target = autopilot.guided_target
    assert target is not None
    assert (target.kind, target.heading_rad, target.speed_mps) == (navigation.COURSE, 1.0, 0.0)
    station.handle(local(RATE, yaw_rate=-0.2), 0)
    target = autopilot.guided_target
    assert target is not None
    assert (target.kind, target.turn_rate_radps, target.speed_mps) == (navigation.TURN, -0.2, 0.0)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (local(POSITION, x=math.nan), "Local target refused: position nan, 0"),
        (local(POSITION, frame=77), "Local target refused: frame 77"),
        (world(POSITION, 910000000, 0), "position 91, 0 is not on Earth"),
        (world(POSITION, 1, 1, frame=1), "Global target refused: frame 1"),
        (local(VELOCITY, vx=math.inf), "Local target refused: not all of its values are numbers"),
        (local(YAW, yaw=math.nan), "Local target refused: not all of its values are numbers"),
        (local(0x0FFF), "its type mask ignores every value"),
        (local(0x0C3F, afx=1.0), "a boat does not support type mask 0x0c3f"),
        (world(VELOCITY, vx=1000.0), "velocity 1000, 0 m/s"),
    ],
)
def test_bad_targets_are_refused_in_words(station: MavlinkChannel, message: Any, words: str) -> None:
    autopilot = in_guided(station)
    autopilot.commands.go_to(LAT_DEG, LON_DEG)
    old = autopilot.guided_target
    assert station.handle(message, 0) == []
    assert words in texts(station)
    assert autopilot.guided_target == old


def test_targets_outside_guided_are_ignored_and_said_once_a_second(station: MavlinkChannel) -> None:
    said = []
    for tick in range(100):
        station.handle(local(POSITION, x=1.0), 0)
        said += [m for m in station.poll(_now[0] + tick * TICK) if m.get_type() == "STATUSTEXT"]
    assert [m.text for m in said] == ["Local target ignored: not in GUIDED"] * 2
    assert station.autopilot.guided_target is None


def test_sticks_reach_the_channels(station: MavlinkChannel) -> None:
    station.autopilot.set_mode(modes.MANUAL)
    now = _now[0] = _now[0] + SECOND
    station.autopilot.control(now)
    widths = [1600, 65535, 1700, *[65535] * 5, *[0] * 10]
    assert station.handle(sent(mav.MAVLink_rc_channels_override_message(1, 1, *widths)), now) == []
    message = station.streams.message(mav.MAVLINK_MSG_ID_RC_CHANNELS, now)
    assert message is not None
    assert (message.chan1_raw, message.chan2_raw, message.chan3_raw) == (1600, 65535, 1700)
    station.handle(sent(mav.MAVLink_manual_control_message(1, 0, 500, 250, 0, 0)), now)
    assert station.streams.message(mav.MAVLINK_MSG_ID_RC_CHANNELS, now).chan1_raw != 1600  # type: ignore[union-attr]
    station.handle(sent(mav.MAVLink_rc_channels_override_message(1, 1, 100, *[65535] * 17)), now)
    assert "100" in texts(station)
    station.handle(sent(mav.MAVLink_manual_control_message(1, 0, 2000, 0, 0, 0)), now)
    assert "2000" in texts(station)
    assert station.handle(sent(mav.MAVLink_manual_control_message(9, 0, 2000, 0, 0, 0)), now) == []
    assert texts(station) == ""


# -- who is there, and when


def test_heartbeats_of_ground_stations_are_noted(station: MavlinkChannel, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[int, int]] = []
    monkeypatch.setattr(
        station.autopilot.failsafes, "heard_ground_station", lambda system, now: heard.append((system, now))
    )
    station.handle(sent(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 254), 7)
    station.handle(sent(mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3), 2), 8)
    assert heard == [(254, 7)]


def test_time_and_ping_are_answered(station: MavlinkChannel) -> None:
    (reply,) = station.handle(sent(mav.MAVLink_timesync_message(0, 1234)), 5678)
    assert (reply.tc1, reply.ts1) == (5678, 1234)
    assert station.handle(sent(mav.MAVLink_timesync_message(9, 1234)), 5678) == []
    (reply,) = station.handle(sent(mav.MAVLink_ping_message(11, 3, 0, 0)), 0)
    assert (reply.time_usec, reply.seq, reply.target_system, reply.target_component) == (11, 3, 255, 190)
    assert station.handle(sent(mav.MAVLink_ping_message(11, 3, 1, 1)), 0) == []


def test_in_real_time_utc_is_the_date_of_the_machine() -> None:
    hub = MavlinkHub(Autopilot())
    hub.unix_s = lambda: 1.8e9
    boat, sensors = Boat(), Sensors(1, Noise())
    hub.on_imu(sensors.imu(boat))
    hub.on_gnss(sensors.gnss(boat)._replace(fix_type=2))
    assert hub.autopilot.utc_us is None
    hub.on_gnss(sensors.gnss(boat)._replace(stamp_ns=1))
    hub.autopilot.control(0)
    assert hub.autopilot.utc_us == round(1.8e15)


def test_utc_is_told_once_a_receiver_has_a_fix(station: MavlinkChannel) -> None:
    before = MavlinkChannel(Autopilot()).streams.message(mav.MAVLINK_MSG_ID_SYSTEM_TIME, 5 * SECOND)
    assert before is not None
    assert (before.time_unix_usec, before.time_boot_ms) == (0, 5000)
    clock = station.streams.message(mav.MAVLINK_MSG_ID_SYSTEM_TIME, 5 * SECOND)
    assert clock is not None
    since_us = station.autopilot.state.estimate.stamp_ns // 1000
    started = datetime(2025, 6, 15, tzinfo=timezone.utc).timestamp() - 18.0  # the date of runs that repeat, less leaps
    assert clock.time_unix_usec == round(started * 1e6) + since_us


def test_no_key_is_taken_over_the_air(station: MavlinkChannel) -> None:
    assert station.handle(sent(mav.MAVLink_setup_signing_message(1, 1, [0] * 32, 0)), 0) == []
    assert "SETUP_SIGNING refused" in texts(station)


def test_a_ground_station_brings_no_samples(station: MavlinkChannel) -> None:
    before = station.autopilot.estimator.stamp_ns
    message = mav.MAVLink_xitl_imu_message(before // 1000 + 5000, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 20.0)
    station.handle(message, 0)
    assert station.autopilot.estimator.stamp_ns == before


def test_a_list_asked_for_by_many_names_all(station: MavlinkChannel) -> None:
    station.handle(sent(mav.MAVLink_param_request_list_message(0, 0)), 0)
    values = [m for _ in range(len(TABLE) // 10 + 1) for m in station.poll(_now[0]) if m.get_type() == "PARAM_VALUE"]
    assert [value.param_index for value in values] == list(range(len(TABLE)))
