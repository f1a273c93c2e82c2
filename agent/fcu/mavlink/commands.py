"""Commands of a station: the autopilot's commands, setpoints for GUIDED, and sticks for the manual modes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Callable

from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.mavlink.reports import origin
from agent.fcu.mavlink.telemetry import TelemetryStreams
from agent.fcu.mission import COMMANDS
from agent.fcu.vehicle import modes
from agent.mavlink.commands import FORCE_ARM, FORCE_DISARM, Answer, CommandRequest, command_ack
from agent.mavlink.exchange import Messages
from agent.navigation.geodetic import position_problem
from agent.wire import dialect as mav

_CHANGE_MODE = 1  # param2 of DO_REPOSITION
_REBOOT = 1
_READ, _WRITE, _RESET = range(3)  # param1 of PREFLIGHT_STORAGE

_POSITION_IGNORED = mav.POSITION_TARGET_TYPEMASK_X_IGNORE | mav.POSITION_TARGET_TYPEMASK_Y_IGNORE
_VELOCITY_IGNORED = mav.POSITION_TARGET_TYPEMASK_VX_IGNORE | mav.POSITION_TARGET_TYPEMASK_VY_IGNORE
_ACCELERATION_IGNORED = mav.POSITION_TARGET_TYPEMASK_AX_IGNORE | mav.POSITION_TARGET_TYPEMASK_AY_IGNORE
_YAW_IGNORED = mav.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE_IGNORED = mav.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_GLOBAL_FRAMES = (0, 3, 5, 6, 10, 11)
_BODY_FRAMES = (mav.MAV_FRAME_BODY_NED, mav.MAV_FRAME_BODY_OFFSET_NED, mav.MAV_FRAME_BODY_FRD)
_OFFSET_FRAMES = (mav.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES)
_LOCAL_FRAMES = (mav.MAV_FRAME_LOCAL_NED, *_OFFSET_FRAMES)
_NO_AXIS = 32767

# Commands to absent devices, and the observed answers of an ArduRover 4.7 without them.
_LACKING: Mapping[int, int] = {
    **dict.fromkeys((181, 182, 205, 211, 532, 1000, 2000, 2500, 2501), int(mav.MAV_RESULT_FAILED)),
    **dict.fromkeys((195, 197, 201, 202, 203, 206, 216, 2001), int(mav.MAV_RESULT_ACCEPTED)),
    531: int(mav.MAV_RESULT_UNSUPPORTED),
    534: int(mav.MAV_RESULT_DENIED),
}


class CommandHandlers:
    """Executes the commands of one station: `table` has a function for each MAV_CMD.

    stores: whether this station may change persistent values.
    """

    def __init__(self, hub: MavlinkHub, streams: TelemetryStreams, stores: bool) -> None:
        self._hub = hub
        self._autopilot = hub.autopilot
        self._streams = streams
        self._stores = stores
        pilot = hub.autopilot
        self.table: dict[int, Callable[[CommandRequest, int], Answer]] = {
            # Commands that the autopilot executes, or refuses with a reason
            mav.MAV_CMD_MISSION_START: _executor(lambda c: pilot.commands.start_mission()),
            mav.MAV_CMD_NAV_RETURN_TO_LAUNCH: _executor(lambda c: pilot.set_mode(modes.RTL)),
            mav.MAV_CMD_NAV_LOITER_UNLIM: _executor(lambda c: pilot.set_mode(modes.LOITER)),
            mav.MAV_CMD_DO_SET_MISSION_CURRENT: _executor(
                lambda c: pilot.commands.set_current(_whole(c.p1)), mav.MAV_RESULT_DENIED
            ),
            mav.MAV_CMD_DO_SET_REVERSE: _executor(lambda c: pilot.commands.set_reverse(c.p1 == 1.0)),
            mav.MAV_CMD_DO_SET_SERVO: _executor(lambda c: pilot.commands.set_servo(_whole(c.p1), _whole(c.p2))),
            mav.MAV_CMD_DO_REPEAT_SERVO: _executor(
                lambda c: pilot.commands.repeat_servo(_whole(c.p1), _whole(c.p2), _whole(c.p3), c.p4)
            ),
            # Commands with conditions of their parameters
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            mav.MAV_CMD_DO_SET_MODE: self._set_mode,
            mav.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            mav.MAV_CMD_DO_REPOSITION: self._reposition,
            mav.MAV_CMD_DO_SET_HOME: self._set_home,
            mav.MAV_CMD_GET_HOME_POSITION: lambda c, now_ns: self._message(mav.MAVLINK_MSG_ID_HOME_POSITION, now_ns),
            mav.MAV_CMD_DO_FENCE_ENABLE: self._enable_fence,
            mav.MAV_CMD_DO_JUMP_TAG: self._jump_to_tag,
            mav.MAV_CMD_NAV_SET_YAW_SPEED: self._set_yaw_speed,
            mav.MAV_CMD_DO_AUX_FUNCTION: self._aux_function,
            mav.MAV_CMD_RUN_PREARM_CHECKS: self._run_prearm_checks,
            **dict.fromkeys(_LACKING, self._lack),
            mav.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mav.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mav.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mav.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            mav.MAV_CMD_PREFLIGHT_STORAGE: self._storage,
        }

    def on_set_mode(self, m: Any, now_ns: int) -> Messages:
        """Handle SET_MODE, which ArduPilot answers like a command of the same number."""
        result = mav.MAV_RESULT_DENIED
        if m.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            refused = self._autopilot.set_mode(m.custom_mode)
            result = mav.MAV_RESULT_FAILED if refused else mav.MAV_RESULT_ACCEPTED
        return [command_ack(m, mav.MAVLINK_MSG_ID_SET_MODE, result)]

    # -- state

    def _arm_or_disarm(self, c: CommandRequest, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == 1:
            refused = self._autopilot.arm(force=_whole(c.p2) in (FORCE_ARM, FORCE_DISARM))
            return _accepted(not refused, mav.MAV_RESULT_FAILED)
        if wanted == 0:
            self._autopilot.disarm()
            return _accepted(True)
        return _accepted(False, mav.MAV_RESULT_UNSUPPORTED)

    def _run_prearm_checks(self, c: CommandRequest, now_ns: int) -> Answer:
        if self._autopilot.state.armed:
            return _accepted(False, mav.MAV_RESULT_TEMPORARILY_REJECTED)
        self._autopilot.say_prearm_problems()
        return _accepted(True)

    def _set_mode(self, c: CommandRequest, now_ns: int) -> Answer:
        flags = _whole(c.p1)
        if flags < 0 or not flags & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _accepted(False)
        return _accepted(not self._autopilot.set_mode(_whole(c.p2)), mav.MAV_RESULT_FAILED)

    def _jump_to_tag(self, c: CommandRequest, now_ns: int) -> Answer:
        tag = _whole(c.p1)
        if not 0 <= tag <= 65535:
            return _accepted(False)
        return _accepted(not self._autopilot.commands.jump_to_tag(tag), mav.MAV_RESULT_FAILED)

    def _change_speed(self, c: CommandRequest, now_ns: int) -> Answer:
        """Change the speed. Airspeed counts as ground speed, and climb speeds are denied."""
        if _whole(c.p1) not in (0, 1):
            return _accepted(False)
        return _accepted(not self._autopilot.commands.change_speed(c.p2), mav.MAV_RESULT_FAILED)

    def _set_yaw_speed(self, c: CommandRequest, now_ns: int) -> Answer:
        """Set the course in GUIDED: a heading, absolute or relative to the present one, and a speed."""
        heading_rad = math.radians(c.p1) + (self._autopilot.state.estimate.yaw_rad if c.p3 > 0.0 else 0.0)
        return _accepted(not self._autopilot.commands.set_course(heading_rad, c.p2), mav.MAV_RESULT_FAILED)

    def _aux_function(self, c: CommandRequest, now_ns: int) -> Answer:
        position = _whole(c.p2)
        if position not in (0, 1, 2):
            return _accepted(False)
        return _accepted(not self._autopilot.commands.aux_function(_whole(c.p1), position), mav.MAV_RESULT_FAILED)

    def _lack(self, c: CommandRequest, now_ns: int) -> Answer:
        """Answer a command to an absent device."""
        command = COMMANDS[c.number]
        self._hub.warn(f"{command.name} ignored: no {command.device}")
        return _LACKING[c.number], []

    def _enable_fence(self, c: CommandRequest, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == 2:  # the floor, which a boat's fence lacks
            return _accepted(True)
        if wanted not in (0, 1):
            return _accepted(False, mav.MAV_RESULT_FAILED)
        refused = self._autopilot.commands.enable_fence(wanted == 1)
        if not refused:
            self._hub.parameter_changed("FENCE_ENABLE")
        return _accepted(not refused, mav.MAV_RESULT_FAILED)

    # -- positions

    def _reposition(self, c: CommandRequest, now_ns: int) -> Answer:
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        problem = position_problem(c.lat_deg, c.lon_deg)
        if problem:
            self._hub.warn(f"Reposition refused: {problem}")
            return _accepted(False)
        if self._autopilot.state.mode != modes.GUIDED:
            flags = _whole(c.p2)
            if flags < 0 or not flags & _CHANGE_MODE:
                self._hub.warn("Reposition refused: not in GUIDED, and the command does not change the mode")
                return _accepted(False)
            if self._autopilot.set_mode(modes.GUIDED):
                return _accepted(False, mav.MAV_RESULT_FAILED)
        return _accepted(not self._autopilot.commands.go_to(c.lat_deg, c.lon_deg))

    def _set_home(self, c: CommandRequest, now_ns: int) -> Answer:
        if c.p1 == 1.0:
            return _accepted(not self._autopilot.commands.set_home_here(), mav.MAV_RESULT_FAILED)
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        return _accepted(not self._autopilot.commands.set_home(c.lat_deg, c.lon_deg, c.alt_m))

    def _wrong_frame(self, c: CommandRequest) -> Answer:
        known = ", ".join(map(str, _GLOBAL_FRAMES))
        self._hub.warn(f"Command {c.number} refused: frame {c.frame} is not supported; use {known}")
        return _accepted(False)

    # -- messages on demand

    def _request_message(self, c: CommandRequest, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == mav.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(c._replace(p1=c.p2), now_ns)
        if wanted != mav.MAVLINK_MSG_ID_AVAILABLE_MODES:
            return self._message(wanted, now_ns)
        index, count = _whole(c.p2), len(modes.TABLE)  # one mode, counted from 1, or 0 for all
        if not 0 <= index <= count:
            return _accepted(False)
        return int(mav.MAV_RESULT_ACCEPTED), [
            mav.MAVLink_available_modes_message(count, number, 0, mode.number, 0, mode.name.encode())
            for number, mode in enumerate(modes.TABLE, start=1)
            if index in (0, number)
        ]

    def _message(self, message_id: int, now_ns: int) -> Answer:
        if not self._streams.offers(message_id):
            return int(mav.MAV_RESULT_UNSUPPORTED), []
        message = self._streams.message(message_id, now_ns)
        return (int(mav.MAV_RESULT_FAILED), []) if message is None else (int(mav.MAV_RESULT_ACCEPTED), [message])

    def _capabilities(self, c: CommandRequest, now_ns: int) -> Answer:
        return self._message(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now_ns) if c.p1 == 1.0 else _accepted(False)

    def _set_interval(self, c: CommandRequest, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not self._streams.offers(message_id) or not -1.0 <= c.p2 <= 1e10:
            return _accepted(False)
        self._streams.set_interval(message_id, int(c.p2))
        return _accepted(True)

    def _get_interval(self, c: CommandRequest, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not 0 <= message_id <= 65535:
            return _accepted(False)
        interval_us = self._streams.interval_us(message_id)
        return int(mav.MAV_RESULT_ACCEPTED), [mav.MAVLink_message_interval_message(message_id, interval_us)]

    # -- reboot and storage

    def _reboot(self, c: CommandRequest, now_ns: int) -> Answer:
        if _whole(c.p1) != _REBOOT:
            return _accepted(False)
        if self._autopilot.state.armed:
            self._hub.warn("Reboot refused: armed")
            return _accepted(False)
        self._hub.reboot_asked = True
        return _accepted(True)

    def _storage(self, c: CommandRequest, now_ns: int) -> Answer:
        action = _whole(c.p1)
        storage = self._hub.storage
        if action not in (_READ, _WRITE, _RESET):
            return _accepted(False)
        if self._autopilot.state.armed:
            self._hub.warn("Storage unchanged: armed")
            return int(mav.MAV_RESULT_TEMPORARILY_REJECTED), []
        if storage is None or not self._stores:
            self._hub.warn("Storage: none; start the agent with --storage FILE")
            return _accepted(False, mav.MAV_RESULT_FAILED)
        if action == _WRITE:
            storage.keep_all_parameters(self._autopilot)
        elif action == _RESET:
            storage.forget_parameters(self._autopilot)
        return _accepted(True)


class SetpointHandlers:
    """Forwards consistent setpoints and sticks. The autopilot checks the values.

    These messages have no answer in the protocol, so a refusal is only a sentence.
    """

    def __init__(self, hub: MavlinkHub, system_id: int) -> None:
        self._hub = hub
        self._autopilot = hub.autopilot
        self._system_id = system_id
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_local,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._on_global,
            mav.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: self._on_attitude,
            mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: self._on_override,
        }

    # -- GUIDED

    def _on_local(self, m: Any, now_ns: int) -> Messages:
        """SET_POSITION_TARGET_LOCAL_NED: in the frame of the origin, or relative to the vessel."""
        if not self._may_steer("Local target", m, _LOCAL_FRAMES, now_ns):
            return []
        estimate = self._autopilot.state.estimate
        turned_rad = estimate.yaw_rad if m.coordinate_frame in _BODY_FRAMES else 0.0
        if not m.type_mask & _POSITION_IGNORED:
            north_m, east_m = _rotated(m.x, m.y, turned_rad)
            if m.coordinate_frame in _OFFSET_FRAMES:
                north_m, east_m = north_m + estimate.pos_ned_m[0], east_m + estimate.pos_ned_m[1]
            if not math.isfinite(north_m + east_m):
                self._hub.warn(f"Local target refused: position {m.x:g}, {m.y:g} is not valid")
                return []
            self._autopilot.commands.go_to_local(north_m, east_m)
            return []
        return self._steer("Local target", m, turned_rad, now_ns)

    def _on_global(self, m: Any, now_ns: int) -> Messages:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        if not self._may_steer("Global target", m, _GLOBAL_FRAMES, now_ns):
            return []
        if not m.type_mask & _POSITION_IGNORED:
            self._autopilot.commands.go_to(m.lat_int / 1e7, m.lon_int / 1e7)
            return []
        return self._steer("Global target", m, 0.0, now_ns)

    def _on_attitude(self, m: Any, now_ns: int) -> Messages:
        """SET_ATTITUDE_TARGET: thrust is a part of WP_SPEED. A heading, or a turn rate if it is not masked out."""
        if not self._is_guided("Attitude target"):
            return []
        if m.type_mask & mav.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE:
            self._hub.warn("Attitude target ignored: a boat needs its thrust; clear bit 64 of the type mask")
            return []
        turns = not m.type_mask & mav.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
        w, x, y, z = m.q
        values = (m.thrust, m.body_yaw_rate) if turns else (m.thrust, w, x, y, z)
        if not all(map(math.isfinite, values)):
            self._hub.warn("Attitude target refused: not all of its values are numbers")
            return []
        commands, thrust = self._autopilot.commands, min(max(m.thrust, -1.0), 1.0)
        if turns:
            commands.set_turn_rate_and_thrust(m.body_yaw_rate, thrust)
        else:
            heading_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            commands.set_heading_and_thrust(heading_rad, thrust)
        return []

    def _may_steer(self, name: str, m: Any, frames: tuple[int, ...], now_ns: int) -> bool:
        if m.coordinate_frame not in frames:
            known = ", ".join(map(str, frames))
            self._hub.warn(f"{name} refused: frame {m.coordinate_frame} is not supported; use {known}")
            return False
        return self._is_guided(name)

    def _is_guided(self, name: str) -> bool:
        if not self._autopilot.in_guided:
            self._hub.warn(f"{name} ignored: not in GUIDED")
        return self._autopilot.in_guided

    def _steer(self, name: str, m: Any, turned_rad: float, now_ns: int) -> Messages:
        """Steer by velocity, heading and turn rate, in the combinations that ArduRover accepts."""
        mask = m.type_mask
        velocity = not mask & _VELOCITY_IGNORED
        yaw_rad = None if mask & _YAW_IGNORED else m.yaw + turned_rad
        yaw_rate_radps = None if mask & _YAW_RATE_IGNORED else m.yaw_rate
        if mask & _ACCELERATION_IGNORED != _ACCELERATION_IGNORED or mask & _POSITION_IGNORED in (1, 2):
            self._hub.warn(f"{name} refused: a boat does not support type mask {mask:#06x}")
            return []
        values = [m.vx, m.vy] if velocity else []
        values += [value for value in (yaw_rad, yaw_rate_radps) if value is not None]
        if not values or not all(map(math.isfinite, values)):
            why = "not all of its values are numbers" if values else "its type mask ignores every value"
            self._hub.warn(f"{name} refused: {why}")
            return []
        if not velocity:
            if yaw_rate_radps is not None:
                self._autopilot.commands.set_turn_rate(yaw_rate_radps, 0.0)
            elif yaw_rad is not None:
                self._autopilot.commands.set_course(yaw_rad, 0.0)
            return []
        body = m.coordinate_frame in _BODY_FRAMES
        if body and yaw_rate_radps is not None and yaw_rad is None:
            self._autopilot.commands.set_turn_rate(yaw_rate_radps, math.copysign(math.hypot(m.vx, m.vy), m.vx))
            return []
        north_mps, east_mps = _rotated(m.vx, m.vy, turned_rad)
        self._autopilot.commands.set_velocity(north_mps, east_mps, yaw_rad, yaw_rate_radps)
        return []

    def on_origin(self, m: Any, now_ns: int) -> Messages:
        """SET_GPS_GLOBAL_ORIGIN. The reply is the resulting origin."""
        self._autopilot.commands.set_origin(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)
        message = origin(self._hub, now_ns)
        return [] if message is None else [message]

    # -- sticks

    def _on_override(self, m: Any, now_ns: int) -> Messages:
        """RC_CHANNELS_OVERRIDE."""
        self._heard(m, now_ns)
        widths_us = tuple(getattr(m, f"chan{number}_raw") for number in range(1, 19))
        self._autopilot.commands.rc_override(widths_us, now_ns)
        return []

    def on_manual(self, m: Any, now_ns: int) -> Messages:
        """MANUAL_CONTROL. 32767 marks an absent axis."""
        if m.target not in (0, self._system_id):
            return []
        self._heard(m, now_ns)
        axes = [None if value == _NO_AXIS else value for value in (m.x, m.y, m.z, m.r)]
        self._autopilot.commands.manual_control(axes[0], axes[1], axes[2], axes[3], now_ns)
        return []

    def _heard(self, m: Any, now_ns: int) -> None:
        """Note the sender for the failsafe, because it is steering."""
        self._autopilot.failsafes.heard_ground_station(m.get_srcSystem(), now_ns)


def _rotated(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward * cos - right * sin, forward * sin + right * cos


def _whole(value: float) -> int:
    """Return a command's parameter as an integer, -1 when it is not a valid one."""
    return int(value) if 0.0 <= value <= 1e9 and value == int(value) else -1


def _executor(
    execute: Callable[[CommandRequest], str], otherwise: int = mav.MAV_RESULT_FAILED
) -> Callable[[CommandRequest, int], Answer]:
    """Return the handler of a command. execute: returns the reason of a refusal. otherwise: the result then."""
    return lambda c, now_ns: _accepted(not execute(c), otherwise)


def _accepted(done: bool, otherwise: int = mav.MAV_RESULT_DENIED) -> Answer:
    return int(mav.MAV_RESULT_ACCEPTED if done else otherwise), []
