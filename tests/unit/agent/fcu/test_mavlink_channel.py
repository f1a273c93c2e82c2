"""The MAVLink side: samples, parameters, commands, telemetry; and that no field value raises."""

from __future__ import annotations

import io
import math
from typing import Any

import pytest
from boat import DECLINATION_RAD, LAT_DEG, LON_DEG, Boat, Noise, Sensors, sail
from hypothesis import given, settings
from hypothesis import strategies as st
from python39 import strict_zip

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import TABLE, Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.wire import dialect as mav

SECOND = 1_000_000_000
TICK = SECOND // 50


def sent(message: Any, system: int = 255, component: int = 190) -> Any:
    message.get_header().srcSystem = system
    message.get_header().srcComponent = component
    return message


def command(number: int, *values: float) -> Any:
    padded = (*values, *[0.0] * (7 - len(values)))
    return sent(mav.MAVLink_command_long_message(1, 1, number, 0, *padded))


def named(messages: list[Any], name: str) -> list[Any]:
    return [message for message in messages if message.get_type() == name]


def sailing() -> tuple[MavlinkChannel, Boat]:
    """Armed and under way in AUTO."""
    boat, sensors = Boat(), Sensors(1, Noise())
    autopilot = Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD}))
    autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(LAT_DEG + 0.001, LON_DEG)]))
    channel = MavlinkChannel(autopilot)
    sail(boat, sensors, autopilot, 12.0, lambda _: False)
    channel.handle(command(mav.MAV_CMD_MISSION_START), boat.time_ns)
    channel.handle(command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0), boat.time_ns)
    sail(boat, sensors, autopilot, 10.0, lambda _: False)
    assert autopilot.state.armed
    return channel, boat


@pytest.mark.medium
def test_a_repeated_start_continues_the_mission() -> None:
    """Ground stations repeat a command whose answer was lost."""
    channel, boat = sailing()
    autopilot, sensors = channel.autopilot, Sensors(1, Noise())

    def item_after_start() -> int:
        ack = channel.handle(command(mav.MAV_CMD_MISSION_START), boat.time_ns)[0]
        assert ack.result == mav.MAV_RESULT_ACCEPTED
        sail(boat, sensors, autopilot, 0.1, lambda _: False)
        return autopilot.navigator.progress.current

    autopilot.commands.set_mission(
        make_mission([waypoint(LAT_DEG + north_deg, LON_DEG) for north_deg in (0.0, 0.001, 0.002)])
    )
    autopilot.set_mode(modes.AUTO)
    assert autopilot.commands.set_current(2) == ""
    assert item_after_start() == 2
    autopilot.set_mode(modes.HOLD)
    assert item_after_start() == 1


def test_samples_arrive_in_si_units() -> None:
    """A second autopilot fed through messages ends where one fed directly does."""
    boat, sensors = Boat(), Sensors(1, Noise())
    direct, channel = Autopilot(), MavlinkChannel(Autopilot())
    for _ in range(1200):
        imu = sensors.imu(boat)
        direct.estimator.on_imu(imu)
        accel, gyro = imu.accel_frd_mps2, imu.gyro_frd_radps
        channel.handle(mav.MAVLink_xitl_imu_message(imu.stamp_ns // 1000, gyro, accel, 20.0), 0)
        if boat.time_ns % 20_000_000 == 0:
            field, air = sensors.magnetometer(boat), sensors.barometer(boat)
            direct.estimator.on_magnetometer(field)
            direct.estimator.on_barometer(air)
            stamp = boat.time_ns // 1000
            channel.handle(mav.MAVLink_xitl_magnetometer_message(stamp, field.field_frd_gauss), 0)
            channel.handle(mav.MAVLink_xitl_barometer_message(stamp, air.pressure_pa, 20.0), 0)
        if boat.time_ns % 200_000_000 == 0:
            fix = sensors.gnss(boat)
            lat, lon, alt = round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7), round(fix.alt_m * 1e3)
            direct.estimator.on_gnss(fix._replace(lat_deg=lat / 1e7, lon_deg=lon / 1e7, alt_m=alt / 1e3))
            channel.handle(
                mav.MAVLink_xitl_gnss_message(
                    boat.time_ns // 1000, lat, lon, alt, fix.vel_ned_mps, 0.6, 0.9, 0.1, fix.fix_type, fix.satellites
                ),
                0,
            )
        boat.step((0.5, 0.3))
    assert channel.autopilot.estimator.estimate() == direct.estimator.estimate()
    assert channel.autopilot.estimator.position_valid()
    assert channel.refused == 0
    channel.handle(mav.MAVLink_xitl_imu_message(10**9, (math.nan, 0.0, 0.0), (0.0, 0.0, -9.8), 20.0), 0)
    assert channel.refused == 1


def test_all_parameters_are_listed_in_under_two_seconds() -> None:
    channel = MavlinkChannel(Autopilot())
    assert channel.handle(sent(mav.MAVLink_param_request_list_message(1, 1)), 0) == []
    values = named([m for tick in range(100) for m in channel.poll(tick * TICK)], "PARAM_VALUE")
    assert [value.param_index for value in values] == list(range(len(TABLE)))
    assert {value.param_count for value in values} == {len(TABLE)}
    assert {value.param_id: value.param_value for value in values} == {row.name: row.default for row in TABLE}


def test_parameters_are_read_and_set() -> None:
    channel = MavlinkChannel(Autopilot())

    def read(name: bytes, index: int) -> list[Any]:
        return channel.handle(sent(mav.MAVLink_param_request_read_message(1, 1, name, index)), 0)

    def set_to(name: bytes, value: float) -> list[Any]:
        return channel.handle(sent(mav.MAVLink_param_set_message(1, 1, name, value, 9)), 0)

    assert read(b"WP_SPEED", -1)[0].param_value == 3.0
    assert read(b"", 0)[0].param_id == TABLE[0].name
    assert read(b"NO_SUCH", -1) == read(b"", 999) == []
    assert set_to(b"WP_SPEED", 2.0)[0].param_value == 2.0
    text, value, error = set_to(b"WP_SPEED", math.nan)
    assert value.param_value == 2.0
    assert (error.param_id, error.param_index, error.error) == ("WP_SPEED", -1, mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE)
    assert text.text.startswith("WP_SPEED = nan is out of range")
    (text, *rest) = set_to(b"WP_SPEDE", 1.0)
    assert rest.pop().error == mav.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert "did you mean WP_SPEED" in "".join(m.text for m in (text, *rest))


@pytest.mark.parametrize(
    ("name", "value", "kept", "words", "why"),
    [
        (b"FS_ACTION", 2.5, 2.0, "FS_ACTION = 2.5 is not a whole number; use 0 to 6", 2),
        (b"FS_ACTION", 7.0, 2.0, "FS_ACTION = 7 is out of range; use 0 to 6", 2),
        (b"INITIAL_MODE", 14.0, 4.0, "INITIAL_MODE = 14 is not one of the choices; use one of 0, 1, 2, 3", 2),
        (b"FRAME_CLASS", 1.0, 2.0, "FRAME_CLASS = 1 is refused: it is 2 and cannot be set", 5),
    ],
)
def test_what_stands_for_nothing_is_refused(name: bytes, value: float, kept: float, words: str, why: int) -> None:
    channel = MavlinkChannel(Autopilot())
    *texts, answer, error = channel.handle(sent(mav.MAVLink_param_set_message(1, 1, name, value, 9)), 0)
    assert "".join(text.text for text in texts).startswith(words)
    assert (answer.param_value, error.error) == (kept, why)


def test_whole_numbers_have_their_type() -> None:
    channel = MavlinkChannel(Autopilot())
    channel.handle(sent(mav.MAVLink_param_request_list_message(1, 1)), 0)
    values = [m for _ in range(40) for m in channel.poll(0) if m.get_type() == "PARAM_VALUE"]
    types = {value.param_id: value.param_type for value in values}
    assert (types["FS_ACTION"], types["RC1_MIN"], types["ARMING_CHECK"], types["WP_SPEED"]) == (2, 4, 6, 9)
    assert all(v.param_type == 9 or v.param_value == int(v.param_value) for v in values)


@pytest.mark.medium
def test_a_parameter_set_in_flight_takes_effect() -> None:
    channel, boat = sailing()
    channel.handle(sent(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.5, 9)), boat.time_ns)
    sail(boat, Sensors(2, Noise()), channel.autopilot, 8.0, lambda _: False)
    assert math.hypot(*boat.vel_ne_mps) == pytest.approx(1.5, abs=0.1)


def test_commands_are_answered() -> None:
    channel = MavlinkChannel(Autopilot())

    def result(message: Any) -> int:
        ack = channel.handle(message, 0)[0]
        assert (ack.command, ack.target_system, ack.target_component) == (message.command, 255, 190)
        return int(ack.result)

    assert result(command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)) == mav.MAV_RESULT_FAILED
    assert result(command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)) == mav.MAV_RESULT_ACCEPTED
    assert result(command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.5)) == mav.MAV_RESULT_UNSUPPORTED
    assert result(command(mav.MAV_CMD_COMPONENT_ARM_DISARM, math.nan)) == mav.MAV_RESULT_UNSUPPORTED
    assert result(command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(modes.MANUAL))) == mav.MAV_RESULT_ACCEPTED
    assert channel.autopilot.state.mode == modes.MANUAL
    assert result(command(mav.MAV_CMD_DO_SET_MODE, 0.0, float(modes.HOLD))) == mav.MAV_RESULT_DENIED
    assert result(command(mav.MAV_CMD_DO_SET_MODE, 1.0, float(modes.AUTO))) == mav.MAV_RESULT_FAILED
    assert result(command(mav.MAV_CMD_DO_SET_MODE, 1.0, 77.0)) == mav.MAV_RESULT_FAILED
    assert result(command(mav.MAV_CMD_MISSION_START)) == mav.MAV_RESULT_FAILED
    assert result(command(mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, 2.0, -1.0)) == mav.MAV_RESULT_FAILED  # not in MANUAL
    channel.autopilot.set_mode(modes.GUIDED)
    assert result(command(mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, 2.0, -1.0)) == mav.MAV_RESULT_ACCEPTED
    assert channel.autopilot.navigator.asked_mps == 2.0
    for speed_mps in (-2.0, -1.0, 0.0, math.nan):
        assert result(command(mav.MAV_CMD_DO_CHANGE_SPEED, 1.0, speed_mps)) == mav.MAV_RESULT_FAILED
    assert result(command(mav.MAV_CMD_DO_CHANGE_SPEED, 2.0, 2.0)) == mav.MAV_RESULT_DENIED  # it does not climb
    assert channel.autopilot.navigator.asked_mps == 2.0
    assert result(command(22)) == mav.MAV_RESULT_UNSUPPORTED
    assert result(command(mav.MAV_CMD_REQUEST_MESSAGE, 0.0)) == mav.MAV_RESULT_ACCEPTED
    assert result(command(mav.MAV_CMD_REQUEST_MESSAGE, 12345.0)) == mav.MAV_RESULT_UNSUPPORTED


@pytest.mark.parametrize(("system", "component", "answered"), [(1, 1, 1), (0, 0, 1), (1, 0, 1), (2, 1, 0), (1, 2, 0)])
def test_only_what_is_addressed_here_is_answered(system: int, component: int, answered: int) -> None:
    channel = MavlinkChannel(Autopilot())
    message = sent(mav.MAVLink_mission_request_list_message(system, component))
    assert len(channel.handle(message, 0)) == answered


@pytest.mark.medium
def test_telemetry_under_way() -> None:
    channel, boat = sailing()
    start = boat.time_ns
    messages: list[Any] = []
    sensors = Sensors(3, Noise())

    def collect(_: object) -> bool:
        messages.extend(channel.poll(boat.time_ns))
        return False

    sail(boat, sensors, channel.autopilot, 2.0, collect)
    rates = {name: len(named(messages, name)) for name in {message.get_type() for message in messages}}
    assert rates["HEARTBEAT"] == 2
    assert rates["ATTITUDE_QUATERNION"] == rates["LOCAL_POSITION_NED"] == 20
    assert rates["GLOBAL_POSITION_INT"] == 10

    beat = named(messages, "HEARTBEAT")[-1]
    assert (beat.type, beat.autopilot, beat.custom_mode, beat.system_status) == (11, 3, modes.AUTO, 4)
    assert beat.base_mode == 128 | 8 | 4 | 1
    status = named(messages, "SYS_STATUS")[-1]
    assert status.onboard_control_sensors_health == status.onboard_control_sensors_present
    place = named(messages, "GLOBAL_POSITION_INT")[-1]
    local = named(messages, "LOCAL_POSITION_NED")[-1]
    origin = named(messages, "GPS_GLOBAL_ORIGIN")[-1]
    assert place.time_boot_ms >= start // 1_000_000
    assert abs(place.lat / 1e7 - LAT_DEG) * 111_000 == pytest.approx(abs(boat.north_m), abs=3.0)
    assert (place.lat - origin.latitude) * 0.01106 == pytest.approx(local.x, abs=2.0)
    assert place.vx == pytest.approx(100.0 * boat.vel_ne_mps[0], abs=30)
    assert place.hdg == pytest.approx(0.0, abs=500) or place.hdg > 35500
    navigation = named(messages, "NAV_CONTROLLER_OUTPUT")[-1]
    assert navigation.wp_dist == pytest.approx(110.6 - boat.north_m, abs=6.0)
    current = named(messages, "MISSION_CURRENT")[-1]
    assert (current.seq, current.total, current.mission_state, current.mission_mode) == (1, 1, 3, 1)
    packer = mav.MAVLink(io.BytesIO(), 1, 1)
    for message in messages:
        assert packer.parse_buffer(message.pack(packer))[0].get_type() == message.get_type()


@pytest.mark.medium
def test_reached_waypoints_and_texts_are_said_once() -> None:
    channel, boat = sailing()
    messages: list[Any] = []
    sensors = Sensors(3, Noise())
    sail(boat, sensors, channel.autopilot, 60.0, lambda _: bool(messages.extend(channel.poll(boat.time_ns))))
    assert [message.seq for message in named(messages, "MISSION_ITEM_REACHED")] == [1]
    said = [message.text for message in named(messages, "STATUSTEXT")]
    assert said.count("Mission complete: HOLD") == 1
    last = named(messages, "MISSION_CURRENT")[-1]
    assert (last.seq, last.mission_state) == (1, 5)


def test_not_ready_shows_in_the_status() -> None:
    channel = MavlinkChannel(Autopilot())
    status = named(channel.poll(0), "SYS_STATUS")[0]
    missing = status.onboard_control_sensors_present & ~status.onboard_control_sensors_health
    assert missing & mav.MAV_SYS_STATUS_PREARM_CHECK
    assert missing & mav.MAV_SYS_STATUS_AHRS


def test_a_clock_that_jumps_does_not_stop_telemetry_nor_flood() -> None:
    channel = MavlinkChannel(Autopilot())
    for start in (10**15, 0, 10**12):
        beats = named([m for tick in range(100) for m in channel.poll(start + tick * TICK)], "HEARTBEAT")
        assert 2 <= len(beats) <= 3


def test_wrong_rates_are_refused() -> None:
    with pytest.raises(ValueError, match="telemetry: message 0 at 0 Hz"):
        MavlinkChannel(Autopilot(), rates_hz={0: 0.0})


INTEGER_BITS = {"int8_t": 8, "int16_t": 16, "int32_t": 32, "int64_t": 64}


def _value(kind: str) -> st.SearchStrategy[Any]:
    if kind == "float":
        edge = st.sampled_from([0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38])
        return edge | st.floats(width=32)
    bits = INTEGER_BITS[kind.lstrip("u")]
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return st.sampled_from([0, 1, high, low]) | st.integers(0, min(high, 20)) | st.integers(low, high)


COMMANDS = sorted(number for number, entry in mav.enums["MAV_CMD"].items() if not entry.name.endswith("_ENUM_END"))


def _message(cls: type) -> st.SearchStrategy[Any]:
    """Any field values that the wire can carry; addressed to this vehicle."""
    fields = []
    for name, kind in strict_zip(cls.fieldnames, cls.fieldtypes):
        length = cls.array_lengths[cls.ordered_fieldnames.index(name)]
        if name in ("target_system", "target_component"):
            fields.append(st.sampled_from([0, 1]))
        elif name == "command":
            fields.append(st.sampled_from(COMMANDS) | _value(kind))
        elif name in ("custom_mode", "coordinate_frame", "frame", "mission_type"):
            fields.append(st.integers(0, 15) | _value(kind))
        elif kind == "char":
            known = st.sampled_from([row.name.encode() for row in TABLE])
            fields.append(known | st.binary(max_size=length))
        elif length:
            fields.append(st.tuples(*[_value(kind)] * length))
        else:
            fields.append(_value(kind))
    return st.tuples(*fields).map(lambda values: sent(cls(*values)))


HANDLED = [
    mav.mavlink_map[number]
    for number in (
        *(mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST, mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ, mav.MAVLINK_MSG_ID_PARAM_SET),
        *(mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT),
        *(mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST, mav.MAVLINK_MSG_ID_MISSION_REQUEST),
        *(mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mav.MAVLINK_MSG_ID_MISSION_REQUEST_PARTIAL_LIST),
        *(mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST, mav.MAVLINK_MSG_ID_MISSION_SET_CURRENT),
        *(mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL, mav.MAVLINK_MSG_ID_MISSION_ACK),
        *(mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE),
        *(mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT),
        *(mav.MAVLINK_MSG_ID_MANUAL_CONTROL, mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE),
        *(mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM, mav.MAVLINK_MSG_ID_SETUP_SIGNING),
        *(mav.MAVLINK_MSG_ID_HEARTBEAT, mav.MAVLINK_MSG_ID_PING, mav.MAVLINK_MSG_ID_TIMESYNC),
        *(mav.MAVLINK_MSG_ID_XITL_IMU, mav.MAVLINK_MSG_ID_XITL_GNSS),
        *(mav.MAVLINK_MSG_ID_XITL_MAGNETOMETER, mav.MAVLINK_MSG_ID_XITL_BAROMETER),
    )
]


@pytest.mark.medium
@settings(max_examples=300)
@given(st.lists(st.one_of([_message(cls) for cls in HANDLED]), max_size=30), st.booleans())
def test_no_field_values_raise_and_the_state_stays_finite(messages: list[Any], imu_runs: bool) -> None:
    """A host and a ground station send anything to one vehicle."""
    boat, sensors = Boat(), Sensors(1, Noise())
    channel = MavlinkChannel(Autopilot())
    station = MavlinkChannel(channel.autopilot, hub=channel.hub, ground=True)
    station.handle(sent(mav.MAVLink_request_data_stream_message(1, 1, 0, 50, 1)), 0)
    packer = mav.MAVLink(io.BytesIO(), 1, 1)
    if imu_runs:
        for _ in range(450):
            channel.autopilot.estimator.on_imu(sensors.imu(boat))
            boat.step((0.0, 0.0))
    now = boat.time_ns
    for message in messages:
        now += TICK
        replies = channel.handle(message, now) + station.handle(message, now)
        for reply in replies + channel.poll(now) + station.poll(now):
            assert len(reply.pack(packer)) >= 12
        if channel.hub.reboot_asked:
            channel.hub.reboot()
        channel.autopilot.estimator.on_imu(sensors.imu(boat))
        boat.step((0.0, 0.0))
        actuators = channel.autopilot.control(now)
        channel.hub.actuators = actuators
        assert all(abs(value) <= 1.0 for value in actuators.command)
        assert channel.autopilot.state.mode in modes.NAMES
    estimate = channel.autopilot.state.estimate
    for value in (*estimate.quat_ned_frd, *estimate.pos_ned_m, *estimate.vel_ned_mps, *estimate.gyro_frd_radps):
        assert math.isfinite(value)
    norm = math.sqrt(sum(value * value for value in estimate.quat_ned_frd))
    assert norm == pytest.approx(1.0, abs=1e-6)
