"""The MAVLink side of the autopilot: sensor samples in; parameters, plans, commands and telemetry in and out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from agent.fcu.autopilot import Autopilot
from agent.fcu.mavlink.commands import Commands
from agent.fcu.mavlink.mission_transfer import MissionTransfer
from agent.fcu.mavlink.parameters import ParameterService
from agent.fcu.mavlink.targets import Targets
from agent.fcu.mavlink.telemetry import RATES_HZ, STATION_RATES_HZ, Telemetry
from agent.fcu.mavlink.texts import Texts
from agent.fcu.mavlink.vehicle import Vehicle
from agent.fcu.samples import BarometerSample, GnssSample, ImuSample, MagnetometerSample
from agent.wire import dialect as mav

Messages = list[Any]


class Services:
    """What one station is served: `handle` what arrives, and send what that and, once a cycle, `telemetry` return.

    Several stations are served by as many of these on one `vehicle`. The host is the one that brings the sensors'
    samples; a ground station (`ground=True`) brings none, is told of changes that it did not make, and what it sets
    outlives a restart.

    Field values never raise: a sample that cannot be true is counted in `refused`, a request that cannot be met is
    answered by its protocol and a STATUSTEXT. Messages for another system or component are ignored.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        system_id: int = 1,
        component_id: int = 1,
        rates_hz: Mapping[int, float] | None = None,
        vehicle: Vehicle | None = None,
        ground: bool = False,
    ) -> None:
        self.autopilot = autopilot
        self.vehicle = Vehicle(autopilot) if vehicle is None else vehicle
        self._systems = (0, system_id)
        self._components = (0, component_id)
        self._mailbox = self.vehicle.mailbox()
        texts = Texts()
        if rates_hz is None:
            rates_hz = STATION_RATES_HZ if ground else RATES_HZ
        self.stream = Telemetry(self.vehicle, self._mailbox, texts, rates_hz, announces_changes=ground)
        self._missions = MissionTransfer(self.vehicle, keeps=ground)
        self._parameters = ParameterService(self.vehicle, texts, self._mailbox, keeps=ground, announces_changes=ground)
        commands = Commands(self.vehicle, self.stream, keeps=ground)
        targets = Targets(self.vehicle, system_id)
        self._samples: dict[int, Callable[[Any], bool]] = (
            {}
            if ground
            else {
                mav.MAVLINK_MSG_ID_XITL_IMU: self._on_imu,
                mav.MAVLINK_MSG_ID_XITL_GNSS: self._on_gnss,
                mav.MAVLINK_MSG_ID_XITL_MAGNETOMETER: self._on_magnetometer,
                mav.MAVLINK_MSG_ID_XITL_BAROMETER: self._on_barometer,
            }
        )
        self._requests: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._parameters.on_list,
            mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._parameters.on_read,
            mav.MAVLINK_MSG_ID_PARAM_SET: self._parameters.on_set,
            **self._missions.handlers,
            mav.MAVLINK_MSG_ID_COMMAND_LONG: commands.on_long,
            mav.MAVLINK_MSG_ID_COMMAND_INT: commands.on_int,
            mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self.stream.on_request_data_stream,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: targets.on_local,
            mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: targets.on_global,
            mav.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: targets.on_override,
            mav.MAVLINK_MSG_ID_SETUP_SIGNING: self._on_setup_signing,
        }
        self._system_requests: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_SET_MODE: commands.on_set_mode,
        }
        self._unaddressed: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mav.MAVLINK_MSG_ID_PING: self._on_ping,
            mav.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mav.MAVLINK_MSG_ID_MANUAL_CONTROL: targets.on_manual,
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
        if on_request is not None:
            if message.target_system not in self._systems or message.target_component not in self._components:
                return []
            return on_request(message, now_ns)
        on_request = self._system_requests.get(message_id)
        if on_request is not None:
            return on_request(message, now_ns) if message.target_system in self._systems else []
        on_message = self._unaddressed.get(message_id)
        return [] if on_message is None else on_message(message, now_ns)

    def telemetry(self, now_ns: int) -> Messages:
        """All that is due: telemetry, events, queued parameters, repeated mission requests."""
        messages = self.stream.due(now_ns)
        messages.extend(self._missions.poll(now_ns))
        messages.extend(self._parameters.poll())
        return messages

    def close(self) -> None:
        """The station has left."""
        self.vehicle.remove(self._mailbox)

    # -- samples

    def _on_imu(self, m: Any) -> bool:
        return self.vehicle.on_imu(ImuSample(m.time_usec * 1000, m.gyro, m.accel, m.temperature))

    def _on_gnss(self, m: Any) -> bool:
        return self.vehicle.on_gnss(
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
        return self.vehicle.on_magnetometer(MagnetometerSample(m.time_usec * 1000, m.field))

    def _on_barometer(self, m: Any) -> bool:
        return self.vehicle.on_barometer(BarometerSample(m.time_usec * 1000, m.pressure, m.temperature))

    # -- who is there

    def _on_heartbeat(self, m: Any, now_ns: int) -> Messages:
        if m.type == mav.MAV_TYPE_GCS:
            self.autopilot.heard_ground_station(m.get_srcSystem(), now_ns)
        return []

    def _on_ping(self, m: Any, now_ns: int) -> Messages:
        """A request goes to everybody, an answer to one: that one is not answered again."""
        if m.target_system != 0 or m.target_component != 0:
            return []
        return [mav.MAVLink_ping_message(m.time_usec, m.seq, m.get_srcSystem(), m.get_srcComponent())]

    def _on_timesync(self, m: Any, now_ns: int) -> Messages:
        return [mav.MAVLink_timesync_message(now_ns, m.ts1)] if m.tc1 == 0 else []

    def _on_setup_signing(self, m: Any, now_ns: int) -> Messages:
        """A key that comes over the link it is to guard guards nothing."""
        self.vehicle.warn("SETUP_SIGNING refused: the key is the agent's --signing-key FILE")
        return []
