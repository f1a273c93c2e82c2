"""What MAVROS sends for the calls of examples/ros/mavros_calls.py, by its sources (ROS 2 branch, mavros/src/plugins).

cmd/arming                            command.cpp: COMMAND_LONG 400
set_mode                              sys_status.cpp: SET_MODE with the number of the mode
setpoint_velocity/cmd_vel_unstamped   setpoint_velocity.cpp: SET_POSITION_TARGET_LOCAL_NED, mask 0x5C7
mission/push, mission/clear           mission_protocol_base.cpp: the mission protocol with MISSION_ITEM_INT
set_message_interval                  sys_status.cpp: COMMAND_LONG 511
"""

from __future__ import annotations

import math
from typing import Any

import pytest
from steered_boat import SteeredBoat

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.navigation import TURN
from agent.wire import dialect as mav
from agent.wire.codec import Packer, decode

MAVROS = (1, 191)  # of its node: the system of the vehicle, as an onboard computer
LOCAL_NED, BODY_NED, VELOCITY_AND_YAW_RATE = 1, 8, 0x5C7


def ask(station: MavlinkChannel, message: Any, now_ns: int = 0) -> list[Any]:
    """The answers that come at once."""
    return [decode(Packer(1, 1).pack(m)) for m in station.handle(decode(Packer(*MAVROS).pack(message)), now_ns)]


def setpoint(frame: int, vx: float, vy: float, yaw_rate: float) -> Any:
    zeros = (0.0,) * 3
    return mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, VELOCITY_AND_YAW_RATE, *zeros, vx, vy, 0.0, *zeros, 0.0, yaw_rate
    )


@pytest.fixture(scope="module")
def ship() -> SteeredBoat:
    return SteeredBoat().set_out(modes.HOLD)


def test_a_mode_by_its_number_and_a_velocity_in_either_frame(ship: SteeredBoat) -> None:
    station = MavlinkChannel(ship.autopilot, ground=True)
    ask(station, mav.MAVLink_set_mode_message(1, 1, modes.GUIDED))
    assert ship.autopilot.in_guided
    for frame, velocity, speed_mps in (
        (LOCAL_NED, (0.6, 0.8), 1.0),  # MAVROS turns x and y of the Twist from ENU
        (BODY_NED, (1.5, 0.0), 1.5),
        (BODY_NED, (-0.5, 0.0), -0.5),
    ):
        ask(station, setpoint(frame, *velocity, 0.2), ship.boat.time_ns)
        target = ship.autopilot.guided_target
        assert target is not None
        assert (target.kind, target.turn_rate_radps) == (TURN, pytest.approx(0.2))
        assert target.speed_mps == pytest.approx(speed_mps)


def test_arming_intervals_and_a_mission(ship: SteeredBoat) -> None:
    station = MavlinkChannel(ship.autopilot, ground=True)
    for command, parameter in ((mav.MAV_CMD_SET_MESSAGE_INTERVAL, 33), (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0)):
        message = mav.MAVLink_command_long_message(1, 1, command, 1, parameter, 0, 0, 0, 0, 0, 0)
        acks = [answer for answer in ask(station, message) if answer.get_type() == "COMMAND_ACK"]
        assert [(ack.command, ack.result) for ack in acks] == [(command, mav.MAV_RESULT_ACCEPTED)]
    (request,) = ask(station, mav.MAVLink_mission_count_message(1, 1, 2, 0))
    for seq in range(2):
        assert (request.get_type(), request.seq) == ("MISSION_REQUEST_INT", seq)
        place = round(-8.8e7), round(-63.95e7) + 1000 * seq, 70.0
        item = (1, 1, seq, mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, int(not seq), 1, 0.0, 0.0, 0.0, math.nan)
        (request,) = ask(station, mav.MAVLink_mission_item_int_message(*item, *place, 0))
    assert (request.get_type(), request.type) == ("MISSION_ACK", mav.MAV_MISSION_ACCEPTED)
    (ack,) = ask(station, mav.MAVLink_mission_clear_all_message(1, 1, 0))
    assert ack.type == mav.MAV_MISSION_ACCEPTED
