"""Orders that a ground station gives to an ArduRover: guided items, attitude targets, origin, devices, modes."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from boat import LAT_DEG, LON_DEG, degrees
from steered_boat import SteeredBoat

from agent.fcu.control.controller import Demand
from agent.fcu.dataflash import records
from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mission import MissionItem, make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle.navigation import COURSE, TURN
from agent.fcu.vehicle_state import Actuators
from agent.wire import dialect as mav

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
GO_TO, ALTITUDE = 2, 3


def sent(message: Any) -> Any:
    message.get_header().srcSystem, message.get_header().srcComponent = 255, 190
    return message


def texts(channel: MavlinkChannel, now_ns: int) -> str:
    return "".join(m.text for m in channel.poll(now_ns) if m.get_type() == "STATUSTEXT")


@pytest.fixture(scope="module")
def _under_way() -> tuple[SteeredBoat, MavlinkChannel]:
    ship = SteeredBoat().set_out(modes.GUIDED)
    return ship, MavlinkChannel(ship.autopilot, ground=True)


@pytest.fixture
def station(_under_way: tuple[SteeredBoat, MavlinkChannel]) -> MavlinkChannel:
    """Of a vessel in GUIDED, armed."""
    channel = _under_way[1]
    channel.autopilot.set_mode(modes.HOLD)
    channel.autopilot.set_mode(modes.GUIDED)
    channel.poll(10**12)
    return channel


def answer(channel: MavlinkChannel, number: int, *values: float) -> int:
    message = mav.MAVLink_command_long_message(1, 1, number, 0, *values, *[0.0] * (7 - len(values)))
    return int(channel.handle(sent(message), 0)[0].result)


def item(current: int, place: tuple[float, float], whole: bool = True, command: int = 16, frame: int = 6) -> Any:
    head = (1, 1, 0, frame, command, current, 1, 0.0, 0.0, 0.0, 0.0)
    if not whole:
        return sent(mav.MAVLink_mission_item_message(*head, *place, 20.0))
    return sent(mav.MAVLink_mission_item_int_message(*head, round(place[0] * 1e7), round(place[1] * 1e7), 20.0))


@pytest.mark.parametrize("whole", [True, False])
def test_a_mission_item_for_guided_is_followed(station: MavlinkChannel, whole: bool) -> None:
    (ack,) = station.handle(item(GO_TO, degrees(30.0, 10.0), whole), 0)
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", mav.MAV_MISSION_ACCEPTED)
    target = station.autopilot.guided_target
    assert target is not None
    frame = station.autopilot.estimator.frame
    assert frame is not None
    # a float32 of -63.95 degrees is good to half a metre
    assert frame.to_local(target.lat_deg, target.lon_deg) == pytest.approx(
        frame.to_local(*degrees(30.0, 10.0)), abs=0.05 if whole else 0.6
    )
    assert station.handle(item(ALTITUDE, degrees(30.0, 10.0), whole), 0)[0].type == mav.MAV_MISSION_ACCEPTED
    assert station.autopilot.guided_target == target
    assert station.autopilot.navigator.mission.items == ()


def test_a_mission_item_for_guided_is_refused_in_other_modes_and_when_it_is_none(station: MavlinkChannel) -> None:
    assert station.handle(item(GO_TO, (95.0, 0.0)), 0)[0].type == mav.MAV_MISSION_INVALID_PARAM5_X
    assert station.handle(item(GO_TO, degrees(9.0, 0.0), command=999), 0)[0].type == mav.MAV_MISSION_UNSUPPORTED
    assert station.handle(item(GO_TO, degrees(9.0, 0.0), frame=1), 0)[0].type == mav.MAV_MISSION_UNSUPPORTED_FRAME
    assert station.handle(item(GO_TO, (0.0, 0.0)), 0)[0].type == mav.MAV_MISSION_ERROR
    station.autopilot.set_mode(modes.HOLD)
    assert station.handle(item(GO_TO, degrees(9.0, 0.0)), 0)[0].type == mav.MAV_MISSION_ERROR
    assert "Guided target refused: not in GUIDED" in texts(station, 2 * 10**12)


def attitude(
    mask: int, yaw_rad: float = 0.0, yaw_rate: float = 0.0, thrust: float = 0.5, w: float | None = None
) -> Any:
    quaternion = [math.cos(yaw_rad / 2) if w is None else w, 0.0, 0.0, math.sin(yaw_rad / 2)]
    return sent(mav.MAVLink_set_attitude_target_message(0, 1, 1, mask, quaternion, 0.0, 0.0, yaw_rate, thrust))


def test_an_attitude_target_is_a_heading_or_a_turn_rate_and_a_part_of_the_cruise_speed(station: MavlinkChannel) -> None:
    cruise_mps = station.autopilot.parameters["WP_SPEED"]
    station.handle(attitude(4, yaw_rad=2.0), 0)
    target = station.autopilot.guided_target
    assert target is not None
    assert (target.kind, target.heading_rad, target.speed_mps) == (COURSE, pytest.approx(2.0), 0.5 * cruise_mps)
    station.handle(attitude(1 | 2 | 128, yaw_rate=0.3, thrust=-7.0), 0)
    target = station.autopilot.guided_target
    assert target is not None
    assert (target.kind, target.turn_rate_radps, target.speed_mps) == (TURN, pytest.approx(0.3), -cruise_mps)
    for refused in (
        attitude(4 | 64),
        attitude(4, w=math.nan),
        attitude(0, yaw_rate=math.inf),
        attitude(4, thrust=math.nan),
    ):
        assert station.handle(refused, 0) == []
        assert station.autopilot.guided_target == target
    station.autopilot.set_mode(modes.HOLD)
    station.handle(attitude(4), 0)
    assert "Attitude target ignored: not in GUIDED" in texts(station, 3 * 10**12)


def test_an_origin_is_taken_once_and_told() -> None:
    channel = MavlinkChannel(Autopilot(), ground=True)

    def origin(lat: int, lon: int, alt: int = 40_000) -> Any:
        return sent(mav.MAVLink_set_gps_global_origin_message(1, lat, lon, alt))

    assert channel.handle(origin(0, 0), 0) == []
    assert channel.handle(origin(950000000, 0), 0) == []
    (told,) = channel.handle(origin(-88000000, -639500000), 0)
    assert (told.get_type(), told.latitude, told.longitude, told.altitude) == (
        "GPS_GLOBAL_ORIGIN",
        -88000000,
        -639500000,
        40_000,
    )
    assert "GPS_GLOBAL_ORIGIN" in [message.get_type() for message in channel.poll(0)]  # to every station
    (told,) = channel.handle(origin(-80000000, -639500000), 0)
    assert told.latitude == -88000000
    assert "Origin refused: the origin is set already" in texts(channel, 2 * 10**9)
    other = mav.MAVLink_set_gps_global_origin_message(7, 1, 1, 0)
    assert channel.handle(sent(other), 0) == []


@pytest.mark.parametrize(
    ("number", "values", "result"),
    [
        # as seen of an ArduRover 4.7-dev without the devices
        (183, (5, 1700), ACCEPTED),
        (183, (1, 1700), FAILED),
        (183, (3, 1700), FAILED),
        (183, (0, 1600), FAILED),
        (183, (40, 1600), FAILED),
        (184, (5, 1700, 2, 1), ACCEPTED),
        (181, (5, 1), FAILED),
        (182, (5, 2, 1), FAILED),
        (195, (0, 0, 0, 0, LAT_DEG, LON_DEG), ACCEPTED),
        (197, (), ACCEPTED),
        (201, (0, 0, 0, 0, LAT_DEG, LON_DEG), ACCEPTED),
        (202, (), ACCEPTED),
        (203, (0, 0, 0, 0, 1), ACCEPTED),
        (205, (), FAILED),
        (206, (5,), ACCEPTED),
        (211, (1, 1), FAILED),
        (216, (1,), ACCEPTED),
        (531, (0, 1), UNSUPPORTED),
        (532, (4,), FAILED),
        (534, (0, 1), DENIED),
        (1000, (), FAILED),
        (2000, (0, 0, 1), FAILED),
        (2001, (), ACCEPTED),
        (2500, (), FAILED),
        (42600, (1, 1), UNSUPPORTED),
        (217, (1,), UNSUPPORTED),
        (208, (1,), UNSUPPORTED),
        (177, (1, 1), UNSUPPORTED),
        (112, (5,), UNSUPPORTED),
        (93, (5,), UNSUPPORTED),
        (222, (5,), UNSUPPORTED),
        (194, (1,), ACCEPTED),
        (194, (0,), ACCEPTED),
        (207, (1,), ACCEPTED),
        (207, (2,), ACCEPTED),
        (207, (3,), FAILED),
        (207, (0,), ACCEPTED),
        (218, (11, 2), ACCEPTED),
        (218, (11, 0), ACCEPTED),
        (218, (11, 3), DENIED),
        (218, (999, 2), FAILED),
        (601, (5,), FAILED),
        (178, (2, 2), DENIED),
        (178, (1, -1), FAILED),
        (178, (1, -2), FAILED),
        (178, (1, 0), FAILED),
        (178, (1, 2, -1), ACCEPTED),
        (213, (90, 1, 0), ACCEPTED),
        (401, (), REJECTED),
        (400, (0.5,), UNSUPPORTED),
        (176, (1, 6), FAILED),
        (176, (1, 8), FAILED),
        (176, (1, 10), FAILED),
        (176, (1, 12), ACCEPTED),
        (176, (1, 7), ACCEPTED),
        (176, (1, 9), ACCEPTED),
    ],
)
def test_a_command_has_ardurovers_answer(
    station: MavlinkChannel, number: int, values: tuple[float, ...], result: int
) -> None:
    assert answer(station, number, *values) == result


def test_a_command_for_a_device_that_is_not_there_is_said(station: MavlinkChannel) -> None:
    answer(station, 206, 5.0)
    assert "SetCamTrigDst ignored: no camera" in texts(station, 4 * 10**12)


def test_a_servo_that_was_set_is_in_the_outputs(station: MavlinkChannel) -> None:
    assert answer(station, 183, 7.0, 1250.0) == ACCEPTED
    outputs = station.streams.message(mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 0)
    assert outputs is not None
    assert (outputs.servo7_raw, outputs.servo1_raw) == (1250, 1500)


def test_outputs_are_those_that_have_a_function() -> None:
    """A boat with throttle and steering: what drives it is seen in telemetry and log, and is for nothing else."""
    autopilot = Autopilot(Parameters({"SERVO1_FUNCTION": 26, "SERVO3_FUNCTION": 0, "SERVO5_FUNCTION": 70}))
    channel = MavlinkChannel(autopilot)
    autopilot.allocator.allocate(Demand(0.25, -0.5), 1.0, by_hand=True)
    actuators = channel.hub.actuators = Actuators(autopilot.allocator.last.command, True)
    seen = channel.streams.message(mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 0)
    assert seen is not None
    assert (seen.servo1_raw, seen.servo3_raw, seen.servo5_raw) == (1300, 0, 1700)
    logged = records.outputs(0, actuators, autopilot.allocator.mixer.outputs)
    assert struct.unpack("<14H", logged[-28:])[:5] == (1300, 0, 0, 0, 1700)
    assert autopilot.servos.set(5, 1200) == "ServoRelayEvent: Channel 5 is already in use"
    assert autopilot.servos.set(3, 1200) == ""


def test_a_tag_is_gone_on_from(station: MavlinkChannel) -> None:
    tag = MissionItem(600, parameters=(7.0, 0.0, 0.0, 0.0))
    items = [waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(10.0, 0.0)), tag, waypoint(*degrees(20.0, 0.0))]
    station.autopilot.commands.set_mission(make_mission(items))
    assert answer(station, 601, 7.0) == ACCEPTED
    assert station.autopilot.navigator.progress.current == 3
    station.autopilot.commands.set_mission(make_mission([]))


def test_the_modes_are_listed(station: MavlinkChannel) -> None:
    def asked(index: float) -> list[Any]:
        message = mav.MAVLink_command_long_message(1, 1, 512, 0, 435.0, index, 0, 0, 0, 0, 0)
        ack, *rest = station.handle(sent(message), 0)
        return rest if ack.result == ACCEPTED else []

    listed = {message.custom_mode: message.mode_name for message in asked(0.0)}
    assert listed == modes.NAMES
    assert {7, 9, 12} <= set(listed)
    (one,) = asked(2.0)
    assert (one.number_modes, one.mode_index) == (len(listed), 2)
    assert asked(99.0) == []


def test_checks_are_told_when_they_are_asked_for() -> None:
    channel = MavlinkChannel(Autopilot())
    assert answer(channel, 401) == ACCEPTED
    assert "PreArm: Gyros not healthy" in texts(channel, 10**9)


@pytest.mark.parametrize(
    ("number", "values", "result"),
    [
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30, -1.0), ACCEPTED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30, -1.5), DENIED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30, 1e10), ACCEPTED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30, 1.1e10), DENIED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30, math.nan), DENIED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (60_000, 1e5), DENIED),
        (mav.MAV_CMD_SET_MESSAGE_INTERVAL, (30.5, 1e5), DENIED),
        (mav.MAV_CMD_GET_MESSAGE_INTERVAL, (0,), ACCEPTED),
        (mav.MAV_CMD_GET_MESSAGE_INTERVAL, (65_535,), ACCEPTED),
        (mav.MAV_CMD_GET_MESSAGE_INTERVAL, (65_536,), DENIED),
        (mav.MAV_CMD_GET_MESSAGE_INTERVAL, (-1,), DENIED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (244, 30), ACCEPTED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (244, 65_536), DENIED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (435, -1), DENIED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (435, len(modes.TABLE)), ACCEPTED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (435, len(modes.TABLE) + 1), DENIED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (60_000,), UNSUPPORTED),
        (mav.MAV_CMD_REQUEST_MESSAGE, (30,), ACCEPTED),
        (mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, (1,), ACCEPTED),
        (mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, (0,), DENIED),
        (mav.MAV_CMD_DO_JUMP_TAG, (65_535,), FAILED),
        (mav.MAV_CMD_DO_JUMP_TAG, (65_536,), DENIED),
        (mav.MAV_CMD_DO_JUMP_TAG, (-1,), DENIED),
        (mav.MAV_CMD_DO_AUX_FUNCTION, (11, -1), DENIED),
        (mav.MAV_CMD_DO_CHANGE_SPEED, (0, 2), ACCEPTED),
        (mav.MAV_CMD_DO_CHANGE_SPEED, (-1, 2), DENIED),
        (mav.MAV_CMD_DO_SET_MODE, (0, 4), DENIED),
        (mav.MAV_CMD_DO_SET_MODE, (-1, 4), DENIED),
        (mav.MAV_CMD_DO_SET_MODE, (81, 15), ACCEPTED),
        (mav.MAV_CMD_DO_SET_MODE, (80, 15), DENIED),
        (mav.MAV_CMD_COMPONENT_ARM_DISARM, (2,), UNSUPPORTED),
        (mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, (1,), DENIED),  # armed
        (mav.MAV_CMD_PREFLIGHT_STORAGE, (0,), REJECTED),  # armed
        (mav.MAV_CMD_PREFLIGHT_STORAGE, (3,), DENIED),
        (mav.MAV_CMD_PREFLIGHT_STORAGE, (-1,), DENIED),
        (mav.MAV_CMD_DO_SET_MISSION_CURRENT, (5,), DENIED),
        (mav.MAV_CMD_GET_HOME_POSITION, (), ACCEPTED),
    ],
)
def test_values_of_commands_on_either_side_of_their_limits(
    station: MavlinkChannel, number: int, values: tuple[float, ...], result: int
) -> None:
    assert answer(station, number, *values) == result


@pytest.mark.parametrize(
    ("storage", "action", "result"), [(False, 0, FAILED), (True, 0, ACCEPTED), (True, 1, ACCEPTED), (True, 2, ACCEPTED)]
)
def test_parameters_are_kept_and_forgotten_where_there_is_a_storage(storage: bool, action: int, result: int) -> None:
    calls: list[str] = []

    class Storage:
        def keep_all_parameters(self, autopilot: Autopilot) -> None:
            calls.append("kept")

        def forget_parameters(self, autopilot: Autopilot) -> None:
            calls.append("forgot")

    channel = MavlinkChannel(Autopilot(), ground=True)
    channel.hub.storage = Storage() if storage else None  # type: ignore[assignment]
    assert answer(channel, mav.MAV_CMD_PREFLIGHT_STORAGE, action) == result
    assert calls == ([] if not storage else [[], ["kept"], ["forgot"]][action])
    of_host = MavlinkChannel(Autopilot())
    of_host.hub.storage = Storage()  # type: ignore[assignment]
    assert answer(of_host, mav.MAV_CMD_PREFLIGHT_STORAGE, action) == FAILED, "the host stores nothing"


def test_a_disarmed_vessel_reboots() -> None:
    channel = MavlinkChannel(Autopilot(), ground=True)
    for value, result in ((0.0, DENIED), (2.0, DENIED), (1.0, ACCEPTED)):
        assert not channel.hub.reboot_asked
        assert answer(channel, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, value) == result
    assert channel.hub.reboot_asked
