"""The MAVLink side of the autopilot: sensor samples in; parameters, mission, commands and telemetry in and out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from agent.fcu.autopilot import Autopilot
from agent.fcu.mission_transfer import MissionTransfer
from agent.fcu.parameters import TABLE, ParameterError, index_of
from agent.fcu.samples import BarometerSample, GnssSample, ImuSample, MagnetometerSample
from agent.fcu.telemetry import RATES_HZ, Telemetry
from agent.wire import dialect as mav

Messages = list[Any]

_PARAMETERS_PER_POLL = 10


class Services:
    """`handle` what arrives, send what it returns; call `telemetry` once per control cycle and send that too.

    Field values never raise: a sample that cannot be true is counted in `refused`, a request that cannot be met is
    answered by its protocol and a STATUSTEXT. Messages for another system or component are ignored.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        system_id: int = 1,
        component_id: int = 1,
        rates_hz: Mapping[int, float] = RATES_HZ,
    ) -> None:
        self.autopilot = autopilot
        self._systems = (0, system_id)
        self._components = (0, component_id)
        self._missions = MissionTransfer(autopilot)
        self._telemetry = Telemetry(autopilot, rates_hz)
        self._parameter_queue: deque[int] = deque()
        self._samples: dict[int, Callable[[Any], bool]] = {
            mav.MAVLINK_MSG_ID_XITL_IMU: self._on_imu,
            mav.MAVLINK_MSG_ID_XITL_GNSS: self._on_gnss,
            mav.MAVLINK_MSG_ID_XITL_MAGNETOMETER: self._on_magnetometer,
            mav.MAVLINK_MSG_ID_XITL_BAROMETER: self._on_barometer,
        }
        self._requests: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_parameter_list,
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_parameter_read,
            mav.MAVLINK_MSG_ID_PARAM_SET: self._on_parameter_set,
            mav.MAVLINK_MSG_ID_MISSION_COUNT: self._missions.on_count,
            mav.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._missions.on_item,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._missions.on_request_list,
            mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._missions.on_request,
            mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._missions.on_clear,
            mav.MAVLINK_MSG_ID_COMMAND_LONG: self._on_command,
        }
        self._commands: dict[int, Callable[[Any, int], int]] = {
            mav.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_or_disarm,
            mav.MAV_CMD_DO_SET_MODE: self._set_mode,
            mav.MAV_CMD_MISSION_START: self._start_mission,
            mav.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
        }

    @property
    def refused(self) -> int:
        """Samples refused for their content since the autopilot was reset."""
        return sum(self.autopilot.estimator.refused.values())

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Take one message; returns the replies, most often none."""
        message_id = message.get_msgId()
        on_sample = self._samples.get(message_id)
        if on_sample is not None:
            on_sample(message)
            return []
        on_request = self._requests.get(message_id)
        if on_request is None:
            return []
        if message.target_system not in self._systems or message.target_component not in self._components:
            return []
        return on_request(message, now_ns)

    def telemetry(self, now_ns: int) -> Messages:
        """All that is due: telemetry, events, queued parameters, repeated mission requests."""
        messages = self._telemetry.due(now_ns)
        messages.extend(self._missions.poll(now_ns))
        for _ in range(min(_PARAMETERS_PER_POLL, len(self._parameter_queue))):
            messages.append(self._parameter_value(self._parameter_queue.popleft()))
        return messages

    # -- samples

    def _on_imu(self, m: Any) -> bool:
        return self.autopilot.on_imu(ImuSample(m.time_usec * 1000, m.gyro, m.accel, m.temperature))

    def _on_gnss(self, m: Any) -> bool:
        return self.autopilot.on_gnss(
            GnssSample(
                m.time_usec * 1000,
                m.lat / 1e7,
                m.lon / 1e7,
                m.alt / 1e3,
                m.velocity,
                m.h_acc,
                m.v_acc,
                m.s_acc,
                m.fix_type,
                m.satellites,
            )
        )

    def _on_magnetometer(self, m: Any) -> bool:
        return self.autopilot.on_magnetometer(MagnetometerSample(m.time_usec * 1000, m.field))

    def _on_barometer(self, m: Any) -> bool:
        return self.autopilot.on_barometer(BarometerSample(m.time_usec * 1000, m.pressure, m.temperature))

    # -- parameters

    def _on_parameter_list(self, message: Any, now_ns: int) -> Messages:
        self._parameter_queue = deque(range(len(TABLE)))
        return []

    def _on_parameter_read(self, message: Any, now_ns: int) -> Messages:
        index = message.param_index if message.param_index >= 0 else index_of(message.param_id)
        return [self._parameter_value(index)] if 0 <= index < len(TABLE) else []

    def _on_parameter_set(self, message: Any, now_ns: int) -> Messages:
        """Answered by the value in force; when refused, by the old one and a sentence."""
        name = message.param_id
        replies: Messages = []
        try:
            self.autopilot.parameters.set(name, message.param_value)
        except ParameterError as error:
            replies += self._telemetry.statustext(mav.MAV_SEVERITY_WARNING, str(error))
        index = index_of(name)
        if index >= 0:
            replies.append(self._parameter_value(index))
        return replies

    def _parameter_value(self, index: int) -> Any:
        name = TABLE[index].name
        value = self.autopilot.parameters[name]
        kind = mav.MAV_PARAM_TYPE_REAL32
        return mav.MAVLink_param_value_message(name.encode("ascii"), value, kind, len(TABLE), index)

    # -- commands

    def _on_command(self, message: Any, now_ns: int) -> Messages:
        source = (message.get_srcSystem(), message.get_srcComponent())
        replies: Messages = []
        if message.command == mav.MAV_CMD_REQUEST_MESSAGE:
            wanted = self._telemetry.one(_whole(message.param1), now_ns)
            result = mav.MAV_RESULT_UNSUPPORTED if wanted is None else mav.MAV_RESULT_ACCEPTED
            replies = [] if wanted is None else [wanted]
        else:
            command = self._commands.get(message.command)
            result = mav.MAV_RESULT_UNSUPPORTED if command is None else command(message, now_ns)
        return [mav.MAVLink_command_ack_message(message.command, result, 0, 0, *source), *replies]

    def _arm_or_disarm(self, message: Any, now_ns: int) -> int:
        wanted = _whole(message.param1)
        if wanted == 1:
            return _result(not self.autopilot.arm(), mav.MAV_RESULT_FAILED)
        if wanted == 0:
            self.autopilot.disarm()
            return int(mav.MAV_RESULT_ACCEPTED)
        return int(mav.MAV_RESULT_DENIED)

    def _set_mode(self, message: Any, now_ns: int) -> int:
        if not _whole(message.param1) & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED or _whole(message.param1) < 0:
            return int(mav.MAV_RESULT_DENIED)
        return _result(not self.autopilot.set_mode(_whole(message.param2)), mav.MAV_RESULT_FAILED)

    def _start_mission(self, message: Any, now_ns: int) -> int:
        return _result(not self.autopilot.start_mission(), mav.MAV_RESULT_FAILED)

    def _change_speed(self, message: Any, now_ns: int) -> int:
        return _result(not self.autopilot.change_speed(message.param2), mav.MAV_RESULT_DENIED)


def _whole(value: float) -> int:
    """A command's parameter as the whole number it stands for, -1 when it is none."""
    return int(value) if 0.0 <= value <= 1e9 and value == int(value) else -1


def _result(done: bool, otherwise: int) -> int:
    return int(mav.MAV_RESULT_ACCEPTED) if done else int(otherwise)
