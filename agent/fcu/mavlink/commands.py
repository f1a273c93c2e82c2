"""What a station orders: the autopilot's commands, setpoints for GUIDED, and sticks for the manual modes."""

from __future__ import annotations

import math
from typing import Any, Callable

from agent.fcu.geodetic import position_problem
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.mavlink.telemetry import TelemetryStreams
from agent.fcu.vehicle import modes
from agent.mavlink.commands import FORCE_ARM, Answer, Command, command_ack
from agent.mavlink.exchange import Messages
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


class CommandHandlers:
    """Carries commands out, for one station: a function of `table` for each, by its MAV_CMD.

    stores: whether this station may change what outlives a restart.
    """

    def __init__(self, hub: MavlinkHub, streams: TelemetryStreams, stores: bool) -> None:
        self._hub = hub
        self._autopilot = hub.autopilot
        self._streams = streams
        self._stores = stores
        self.table: dict[int, Callable[[Command, int], Answer]] = {
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

    def on_set_mode(self, m: Any, now_ns: int) -> Messages:
        """The message SET_MODE, which ArduPilot answers as if it were a command of the same number."""
        result = mav.MAV_RESULT_DENIED
        if m.base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            refused = self._autopilot.set_mode(m.custom_mode)
            result = mav.MAV_RESULT_FAILED if refused else mav.MAV_RESULT_ACCEPTED
        return [command_ack(m, mav.MAVLINK_MSG_ID_SET_MODE, result)]

    # -- state

    def _arm_or_disarm(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == 1:
            refused = self._autopilot.arm(force=_whole(c.p2) == FORCE_ARM)
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
        return _accepted(not self._autopilot.commands.start_mission(), mav.MAV_RESULT_FAILED)

    def _set_current(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.commands.set_current(_whole(c.p1)))

    def _change_speed(self, c: Command, now_ns: int) -> Answer:
        return _accepted(not self._autopilot.commands.change_speed(c.p2))

    def _enable_fence(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted not in (0, 1):
            return _accepted(False)
        refused = self._autopilot.commands.enable_fence(wanted == 1)
        if not refused:
            self._hub.parameter_changed("FENCE_ENABLE")
        return _accepted(not refused, mav.MAV_RESULT_FAILED)

    # -- places

    def _reposition(self, c: Command, now_ns: int) -> Answer:
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        problem = position_problem(c.lat_deg, c.lon_deg)
        if problem:
            self._hub.warn(f"Reposition refused: {problem}")
            return _accepted(False)
        if self._autopilot.state.mode != modes.GUIDED:
            flags = _whole(c.p2)
            if flags < 0 or not flags & _CHANGE_MODE:
                self._hub.warn("Reposition refused: not in GUIDED, and the mode is not to be changed")
                return _accepted(False)
            if self._autopilot.set_mode(modes.GUIDED):
                return _accepted(False, mav.MAV_RESULT_FAILED)
        return _accepted(not self._autopilot.commands.go_to(c.lat_deg, c.lon_deg))

    def _set_home(self, c: Command, now_ns: int) -> Answer:
        if c.p1 == 1.0:
            return _accepted(not self._autopilot.commands.set_home_here(), mav.MAV_RESULT_FAILED)
        if c.frame is not None and c.frame not in _GLOBAL_FRAMES:
            return self._wrong_frame(c)
        return _accepted(not self._autopilot.commands.set_home(c.lat_deg, c.lon_deg, c.alt_m))

    def _wrong_frame(self, c: Command) -> Answer:
        known = ", ".join(map(str, _GLOBAL_FRAMES))
        self._hub.warn(f"Command {c.number} refused: frame {c.frame} is not supported; use {known}")
        return _accepted(False)

    def _get_home(self, c: Command, now_ns: int) -> Answer:
        return self._message(mav.MAVLINK_MSG_ID_HOME_POSITION, now_ns)

    # -- messages on demand

    def _request_message(self, c: Command, now_ns: int) -> Answer:
        wanted = _whole(c.p1)
        if wanted == mav.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._get_interval(c._replace(p1=c.p2), now_ns)
        return self._message(wanted, now_ns)

    def _message(self, message_id: int, now_ns: int) -> Answer:
        if not self._streams.offers(message_id):
            return int(mav.MAV_RESULT_UNSUPPORTED), []
        message = self._streams.message(message_id, now_ns)
        return (int(mav.MAV_RESULT_FAILED), []) if message is None else (int(mav.MAV_RESULT_ACCEPTED), [message])

    def _capabilities(self, c: Command, now_ns: int) -> Answer:
        return self._message(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now_ns) if c.p1 == 1.0 else _accepted(False)

    def _set_interval(self, c: Command, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not self._streams.offers(message_id) or not -1.0 <= c.p2 <= 1e10:
            return _accepted(False)
        self._streams.set_interval(message_id, int(c.p2))
        return _accepted(True)

    def _get_interval(self, c: Command, now_ns: int) -> Answer:
        message_id = _whole(c.p1)
        if not 0 <= message_id <= 65535:
            return _accepted(False)
        interval_us = self._streams.interval_us(message_id)
        return int(mav.MAV_RESULT_ACCEPTED), [mav.MAVLink_message_interval_message(message_id, interval_us)]

    # -- the machine

    def _reboot(self, c: Command, now_ns: int) -> Answer:
        if _whole(c.p1) != _REBOOT:
            return _accepted(False)
        if self._autopilot.state.armed:
            self._hub.warn("Reboot refused: armed")
            return _accepted(False)
        self._hub.reboot_asked = True
        return _accepted(True)

    def _storage(self, c: Command, now_ns: int) -> Answer:
        action = _whole(c.p1)
        storage = self._hub.storage
        if action not in (_READ, _WRITE, _RESET):
            return _accepted(False)
        if self._autopilot.state.armed:
            self._hub.warn("Storage left alone: armed")
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
    """Passes on setpoints and sticks that fit together; the autopilot judges the numbers.

    None of these messages has an answer in the protocol, so a refusal is a sentence alone.
    """

    def __init__(self, hub: MavlinkHub, system_id: int) -> None:
        self._hub = hub
        self._autopilot = hub.autopilot
        self._system_id = system_id
        self.handlers: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: self._on_local,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: self._on_global,
            mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: self._on_override,
        }

    # -- GUIDED

    def _on_local(self, m: Any, now_ns: int) -> Messages:
        """SET_POSITION_TARGET_LOCAL_NED: in the frame of the origin, or from where the vessel is and heads."""
        if not self._may_steer("Local target", m, _LOCAL_FRAMES, now_ns):
            return []
        estimate = self._autopilot.state.estimate
        turned_rad = estimate.yaw_rad if m.coordinate_frame in _BODY_FRAMES else 0.0
        if not m.type_mask & _POSITION_IGNORED:
            north_m, east_m = _rotated(m.x, m.y, turned_rad)
            if m.coordinate_frame in _OFFSET_FRAMES:
                north_m, east_m = north_m + estimate.pos_ned_m[0], east_m + estimate.pos_ned_m[1]
            if not math.isfinite(north_m + east_m):
                self._hub.warn(f"Local target refused: position {m.x:g}, {m.y:g} is none")
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

    def _may_steer(self, name: str, m: Any, frames: tuple[int, ...], now_ns: int) -> bool:
        if m.coordinate_frame not in frames:
            known = ", ".join(map(str, frames))
            self._hub.warn(f"{name} refused: frame {m.coordinate_frame} is not supported; use {known}")
            return False
        if self._autopilot.state.mode != modes.GUIDED:
            self._hub.warn(f"{name} ignored: not in GUIDED")
            return False
        return True

    def _steer(self, name: str, m: Any, turned_rad: float, now_ns: int) -> Messages:
        """By velocity, heading and turn rate, in the combinations that ArduRover takes."""
        mask = m.type_mask
        velocity = not mask & _VELOCITY_IGNORED
        yaw_rad = None if mask & _YAW_IGNORED else m.yaw + turned_rad
        yaw_rate_radps = None if mask & _YAW_RATE_IGNORED else m.yaw_rate
        if mask & _ACCELERATION_IGNORED != _ACCELERATION_IGNORED or mask & _POSITION_IGNORED in (1, 2):
            self._hub.warn(f"{name} refused: type mask {mask:#06x} asks for what a boat does not do")
            return []
        given = [m.vx, m.vy] if velocity else []
        given += [value for value in (yaw_rad, yaw_rate_radps) if value is not None]
        if not given or not all(map(math.isfinite, given)):
            why = "nothing in it counts" if not given else "not all of its values are numbers"
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

    # -- sticks

    def _on_override(self, m: Any, now_ns: int) -> Messages:
        """RC_CHANNELS_OVERRIDE."""
        self._heard(m, now_ns)
        widths_us = tuple(getattr(m, f"chan{number}_raw") for number in range(1, 19))
        self._autopilot.commands.rc_override(widths_us, now_ns)
        return []

    def on_manual(self, m: Any, now_ns: int) -> Messages:
        """MANUAL_CONTROL: 32767 stands for an axis that is not there."""
        if m.target not in (0, self._system_id):
            return []
        self._heard(m, now_ns)
        axes = [None if value == _NO_AXIS else value for value in (m.x, m.y, m.z, m.r)]
        self._autopilot.commands.manual_control(axes[0], axes[1], axes[2], axes[3], now_ns)
        return []

    def _heard(self, m: Any, now_ns: int) -> None:
        """Who steers is there."""
        self._autopilot.failsafes.heard_ground_station(m.get_srcSystem(), now_ns)


def _rotated(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward * cos - right * sin, forward * sin + right * cos


def _whole(value: float) -> int:
    """A command's parameter as the whole number it stands for, -1 when it is none."""
    return int(value) if 0.0 <= value <= 1e9 and value == int(value) else -1


def _accepted(done: bool, otherwise: int = mav.MAV_RESULT_DENIED) -> Answer:
    return int(mav.MAV_RESULT_ACCEPTED if done else otherwise), []
