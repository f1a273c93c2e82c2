"""COMMAND_LONG and COMMAND_INT: what a station may order, each answered by COMMAND_ACK."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from agent.fcu import modes
from agent.fcu.control.guided import place_problem
from agent.fcu.mavlink.telemetry import Telemetry
from agent.fcu.mavlink.vehicle import Vehicle
from agent.wire import dialect as mav

Messages = list[Any]
Answer = tuple[int, Messages]

FORCE = 21196  # param2 of COMPONENT_ARM_DISARM: without the checks
_CHANGE_MODE = 1  # param2 of DO_REPOSITION
_GLOBAL_FRAMES = (0, 3, 5, 6, 10, 11)
_REBOOT = 1
_READ, _WRITE, _RESET = range(3)  # param1 of PREFLIGHT_STORAGE


class Command(NamedTuple):
    """Either message in one form. Latitude and longitude are in degrees and may be anything."""

    number: int
    p1: float
    p2: float
    p3: float
    p4: float
    lat_deg: float
    lon_deg: float
    alt_m: float
    frame: int | None  # None in COMMAND_LONG


class Commands:
    """Carries commands out, for one station. `keeps`: whether this station may change what outlives a restart."""

    def __init__(self, vehicle: Vehicle, telemetry: Telemetry, keeps: bool) -> None:
        self._vehicle = vehicle
        self._autopilot = vehicle.autopilot
        self._telemetry = telemetry
        self._keeps = keeps
        self._table: dict[int, Callable[[Command, int], Answer]] = {
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            mav.MAV_CMD_DO_SET_MODE: self._set_mode,
            mav.MAV_CMD_MISSION_START: self._start_mission,
            mav.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return_to_launch,
            mav.MAV_CMD_NAV_LOITER_UNLIM: self._loiter,
            mav.MAV_CMD_DO_REPOSITION: self._reposition,
            mav.MAV_CMD_DO_SET_HOME: self._set_home,
            mav.MAV_CMD_GET_HOME_POSITION: self._get_home,
            mav.MAV_CMD_DO_FENCE_ENABLE: self._enable_fence,
            mav.MAV_CMD_DO_SET_MISSION_CURRENT: self._set_current,
            mav.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mav.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mav.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            mav.MAV_CMD_PREFLIGHT_STORAGE: self._storage,
        }

    def on_long(self, m: Any, now_ns: int) -> Messages:
        """COMMAND_LONG."""
        return self._answer(
            m, Command(m.command, m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7, None), now_ns
        )

    def on_int(self, m: Any, now_ns: int) -> Messages:
        """COMMAND_INT."""
        return self._answer(
            m,
            Command(m.command, m.param1, m.param2, m.param3, m.param4, m.x / 1e7, m.y / 1e7, m.z, m.frame),
            now_ns,
        )

    def on_set_mode(self, m: Any, now_ns: int) -> Messages:
        """The message SET_MODE, which ArduPilot answers as if it were a command of the same number."""
        result = mav.MAV_RESULT_DENIED
        if m.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            result = _result(self._autopilot.set_mode(m.custom_mode), mav.MAV_RESULT_FAILED)
        return [_ack(m, mav.MAVLINK_MSG_ID_SET_MODE, result)]

    def _answer(self, m: Any, command: Command, now_ns: int) -> Messages:
        carry_out = self._table.get(command.number)
        if carry_out is None:
            return [_ack(m, command.number, mav.MAV_RESULT_UNSUPPORTED)]
        result, replies = carry_out(command, now_ns)
        return [_ack(m, command.number, result), *replies]

    # -- state

    def _arm_or_disarm(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == 1:
            refused = self._autopilot.arm(force=_whole(c.p2) == FORCE)
            return _accepted(not refused, mav.MAV_RESULT_FAILED)
        if wanted == 0:
            self._autopilot.disarm()
            return _accepted(True)
        return _accepted(False)

    def _set_mode(self, c: Command, now_ns: int) -> Answer:
        flags = _whole(c.p1)
        if flags < 0 or not flags & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _accepted(False)
        return _accepted(not self._autopilot.set_mode(_whole(c.p2)), mav.MAV_RESULT_FAILED)

    def _return_to_launch(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.set_mode(modes.RTL), mav.MAV_RESULT_FAILED)

    def _loiter(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.set_mode(modes.LOITER), mav.MAV_RESULT_FAILED)

    def _start_mission(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.start_mission(), mav.MAV_RESULT_FAILED)

    def _set_current(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.set_current(_whole(c.p1)))

    def _change_speed(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.change_speed(c.p2))

    def _enable_fence(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted not in (0, 1):
            return _accepted(False)
        refused = self._autopilot.enable_fence(wanted == 1)
        if not refused:
            self._vehicle.parameter_changed("FENCE_ENABLE")
        return _accepted(not refused, mav.MAV_RESULT_FAILED)

    # -- places

    def _reposition(self, c: Command, now_ns: int) -> Answer:
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        problem = place_problem(c.lat_deg, c.lon_deg)
        if problem:
            self._vehicle.warn(f"Reposition refused: {problem}")
            return _accepted(False)
        if self._autopilot.mode != modes.GUIDED:
            flags = _whole(c.p2)
            if flags < 0 or not flags & _CHANGE_MODE:
                self._vehicle.warn("Reposition refused: not in GUIDED, and the mode is not to be changed")
                return _accepted(False)
            if self._autopilot.set_mode(modes.GUIDED):
                return _accepted(False, mav.MAV_RESULT_FAILED)
        return _accepted(not self._autopilot.go_to(c.lat_deg, c.lon_deg))

    def _set_home(self, c: Command, now_ns: int) -> Answer:
        if c.p1 == 1.0:
            return _accepted(not self._autopilot.set_home_here(), mav.MAV_RESULT_FAILED)
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        return _accepted(not self._autopilot.set_home(c.lat_deg, c.lon_deg, c.alt_m))

    def _wrong_frame(self, c: Command) -> Answer:
        known = ", ".join(map(str, _GLOBAL_FRAMES))
        self._vehicle.warn(f"Command {c.number} refused: frame {c.frame} is not supported; use {known}")
        return _accepted(False)

    def _get_home(self, c: Command, now_ns: int) -> Answer:
        return self._one(mav.MAVLINK_MSG_ID_HOME_POSITION, now_ns)

    # -- messages on demand

    def _request_message(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == mav.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(c._replace(p1=c.p2), now_ns)
        return self._one(wanted, now_ns)

    def _one(self, message_id: int, now_ns: int) -> Answer:
        if not self._telemetry.knows(message_id):
            return int(mav.MAV_RESULT_UNSUPPORTED), []
        message = self._telemetry.one(message_id, now_ns)
        return (int(mav.MAV_RESULT_FAILED), []) if message is None else (int(mav.MAV_RESULT_ACCEPTED), [message])

    def _capabilities(self, c: Command, now_ns: int) -> Answer:
        return self._one(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now_ns) if c.p1 == 1.0 else _accepted(False)

    def _set_interval(self, c: Command, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not self._telemetry.knows(message_id) or not -1.0 <= c.p2 <= 1e10:
            return _accepted(False)
        self._telemetry.set_interval(message_id, int(c.p2))
        return _accepted(True)

    def _get_interval(self, c: Command, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not 0 <= message_id <= 65535:
            return _accepted(False)
        interval_us = self._telemetry.interval_us(message_id)
        return int(mav.MAV_RESULT_ACCEPTED), [mav.MAVLink_message_interval_message(message_id, interval_us)]

    # -- the machine

    def _reboot(self, c: Command, now_ns: int) -> Answer:
        if _whole(c.p1) != _REBOOT:
            return _accepted(False)
        if self._autopilot.armed:
            self._vehicle.warn("Reboot refused: armed")
            return _accepted(False)
        self._vehicle.reboot_asked = True
        return _accepted(True)

    def _storage(self, c: Command, now_ns: int) -> Answer:
        action = _whole(c.p1)
        keeper = self._vehicle.keeper
        if action not in (_READ, _WRITE, _RESET):
            return _accepted(False)
        if self._autopilot.armed:
            self._vehicle.warn("Storage left alone: armed")
            return int(mav.MAV_RESULT_TEMPORARILY_REJECTED), []
        if keeper is None or not self._keeps:
            self._vehicle.warn("Storage: none; start the agent with --storage FILE")
            return _accepted(False, mav.MAV_RESULT_FAILED)
        if action == _WRITE:
            keeper.keep_all_parameters(self._autopilot)
        elif action == _RESET:
            keeper.forget_parameters(self._autopilot)
        return _accepted(True)


def _ack(m: Any, number: int, result: int) -> Any:
    return mav.MAVLink_command_ack_message(number, int(result), 0, 0, m.get_srcSystem(), m.get_srcComponent())


def _whole(value: float) -> int:
    """A command's parameter as the whole number it stands for, -1 when it is none."""
    return int(value) if 0.0 <= value <= 1e9 and value == int(value) else -1


def _result(refused: str, otherwise: int) -> int:
    return int(otherwise if refused else mav.MAV_RESULT_ACCEPTED)


def _accepted(done: bool, otherwise: int = mav.MAV_RESULT_DENIED) -> Answer:
    return int(mav.MAV_RESULT_ACCEPTED if done else otherwise), []
