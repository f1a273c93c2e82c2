"""MAVLink channel to one station: handles its messages and sends the messages that are due.

The host is also a station.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from agent.fcu.mavlink.commands import CommandHandlers, SetpointHandlers
from agent.fcu.mavlink.files import ServedFiles
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.mavlink.plans import FencePlan, MissionPlan
from agent.fcu.mavlink.telemetry import RATES_HZ, STATION_RATES_HZ, TelemetryStreams
from agent.fcu.mavlink.traffic import TrafficReports
from agent.fcu.parameters import SYSTEM_ID, TABLE
from agent.fcu.vehicle.autopilot import Autopilot
from agent.mavlink.commands import CommandServer, StatusTextSender
from agent.mavlink.exchange import Messages
from agent.mavlink.ftp_server import FtpServer
from agent.mavlink.logs import LogServer
from agent.mavlink.missions import FENCE, MISSION, MissionServer, Plan
from agent.mavlink.parameters import ParameterServer
from agent.navigation.measurements import BarometerMeasurement, GnssMeasurement, ImuMeasurement, MagnetometerMeasurement
from agent.wire import dialect as mav

_TYPES = {row.name: row.type for row in TABLE}
BULK_UNDER_WAY = 5  # messages of lists and files per cycle
_FIXED = frozenset(row.name for row in TABLE if row.fixed) | {SYSTEM_ID}


class MavlinkChannel:
    """Serves one station: call `handle` for each message, and `poll` once a cycle. Send the messages that they return.

    Several stations have as many channels on one `hub`. The host sends the sensor samples and the received AIS. A
    ground station (`ground=True`) sends none, receives changes that others make, and its settings persist over a
    restart.

    Field values never raise. An implausible sample is counted in `refused`. An impossible request is answered by its
    protocol and a STATUSTEXT. Messages for another system or component are ignored.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        system_id: int = 1,
        component_id: int = 1,
        rates_hz: Mapping[int, float] | None = None,
        hub: MavlinkHub | None = None,
        ground: bool = False,
    ) -> None:
        self.autopilot = autopilot
        self.hub = MavlinkHub(autopilot) if hub is None else hub
        self._systems = (0, system_id)
        self._components = (0, component_id)
        self._ground = ground
        self._outbox = self.hub.open_outbox()
        texts = StatusTextSender()
        if rates_hz is None:
            rates_hz = STATION_RATES_HZ if ground else RATES_HZ
        self.streams = TelemetryStreams(self.hub, self._outbox, texts, rates_hz, announces_changes=ground)
        self._parameters = ParameterServer(
            _TYPES,
            autopilot.parameters.__getitem__,
            self._set_parameter,
            lambda problem: texts.messages(mav.MAV_SEVERITY_WARNING, problem),
            read_only=_FIXED,
        )
        mission = MissionPlan(autopilot, self._plan_stored)
        plans: dict[int, Plan] = {
            MISSION: mission,
            FENCE: FencePlan(autopilot, self._plan_stored),
        }
        files = ServedFiles(self.hub)
        self._ftp = FtpServer(files)
        self._logs = LogServer(files, lambda text: texts.messages(mav.MAV_SEVERITY_WARNING, text))
        self._missions = MissionServer(plans, self.hub.warn, self._set_current, mission.guide)
        commands = CommandHandlers(self.hub, self.streams, stores=ground)
        setpoints = SetpointHandlers(self.hub, system_id)
        self._samples: dict[int, Callable[[Any], bool]] = (
            {}
            if ground
            else {
                mav.MAVLINK_MSG_ID_XITL_IMU: lambda m: self.hub.on_imu(
                    ImuMeasurement(m.time_usec * 1000, m.gyro, m.accel, m.temperature)
                ),
                mav.MAVLINK_MSG_ID_XITL_GNSS: self._on_gnss,
                mav.MAVLINK_MSG_ID_XITL_MAGNETOMETER: lambda m: self.hub.on_magnetometer(
                    MagnetometerMeasurement(m.time_usec * 1000, m.field)
                ),
                mav.MAVLINK_MSG_ID_XITL_BAROMETER: lambda m: self.hub.on_barometer(
                    BarometerMeasurement(m.time_usec * 1000, m.pressure, m.temperature)
                ),
            }
        )
        self._requests: dict[int, Callable[[Any, int], Messages]] = {
            **self._parameters.handlers,
            **self._missions.handlers,
            **self._ftp.handlers,
            **self._logs.handlers,
            **CommandServer(commands.table).handlers,
            **setpoints.handlers,
            mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: self.streams.on_request_data_stream,
            mav.MAVLINK_MSG_ID_SETUP_SIGNING: self._on_setup_signing,
        }
        self._system_requests: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_SET_MODE: commands.on_set_mode,
            mav.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN: setpoints.on_origin,
        }
        self._unaddressed: dict[int, Callable[[Any, int], Messages]] = {
            mav.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mav.MAVLINK_MSG_ID_PING: self._on_ping,
            mav.MAVLINK_MSG_ID_TIMESYNC: self._on_timesync,
            mav.MAVLINK_MSG_ID_MANUAL_CONTROL: setpoints.on_manual,
        }
        if not ground:
            self._unaddressed[mav.MAVLINK_MSG_ID_AIS_VESSEL] = self._on_vessel
        self._traffic = TrafficReports(self.hub)

    @property
    def refused(self) -> int:
        """Samples and vessels refused for their content since the autopilot was reset."""
        return sum(self.autopilot.estimator.refused.values()) + self.hub.traffic.refused

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle one message. Return the replies, usually none."""
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

    def poll(self, now_ns: int, most: int | None = None) -> Messages:
        """Return all messages that are due: telemetry, events, repeated mission requests, values of parameters, files
        and logs.

        most: limit for the last three, for a line with less capacity. Under way the limit is low.
        """
        messages = self.streams.poll(now_ns)
        messages.extend(self._missions.poll(now_ns))
        if self.autopilot.state.armed:
            most = min(BULK_UNDER_WAY, BULK_UNDER_WAY if most is None else most)
        if most is None:
            messages.extend(self._parameters.poll())
            messages.extend(self._ftp.poll(now_ns))
            messages.extend(self._logs.poll())
        else:
            bulk = self._parameters.poll(most)
            bulk += self._ftp.poll(now_ns, most - len(bulk))
            messages.extend(bulk + self._logs.poll(most - len(bulk)))
        changed = self._outbox.parameters
        if self._ground:
            messages.extend(self._traffic.poll(now_ns))
            messages.extend(map(self._parameters.value_message, changed))
        changed.clear()
        return messages

    def close(self) -> None:
        """Close the channel, because the station has left."""
        self.hub.close_outbox(self._outbox)

    # -- parameters and plans

    def _set_parameter(self, name: str, value: float) -> None:
        """Set a parameter. Raises ParameterError."""
        stored = self.autopilot.parameters.set(name, value)
        self.hub.parameter_changed(name, self._outbox)
        if self._ground and self.hub.storage is not None:
            self.hub.storage.keep_parameter(name, stored)

    def _plan_stored(self) -> None:
        if self._ground and self.hub.storage is not None:
            self.hub.storage.keep_plan(self.autopilot)

    def _set_current(self, seq: int, now_ns: int) -> Messages:
        """Set the current item. MISSION_CURRENT reports the result, and a sentence the reason of a refusal."""
        self.autopilot.commands.set_current(seq)
        message = self.streams.message(mav.MAVLINK_MSG_ID_MISSION_CURRENT, now_ns)
        return [] if message is None else [message]

    @property
    def unanswered(self) -> int:
        """Number of dropped requests for files and logs, beyond the limit of waiting ones."""
        return self._ftp.dropped + self._logs.dropped

    # -- samples

    def _on_gnss(self, m: Any) -> bool:
        return self.hub.on_gnss(
            GnssMeasurement(
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

    # -- presence

    def _on_vessel(self, m: Any, now_ns: int) -> Messages:
        """Forward AIS_VESSEL to the ground stations."""
        self.hub.traffic.add(m, now_ns)
        return []

    def _on_heartbeat(self, m: Any, now_ns: int) -> Messages:
        if m.type == mav.MAV_TYPE_GCS:
            self.autopilot.failsafes.heard_ground_station(m.get_srcSystem(), now_ns)
        return []

    def _on_ping(self, m: Any, now_ns: int) -> Messages:
        """Answer a ping request, which has no target. A reply has a target and is not answered."""
        if m.target_system != 0 or m.target_component != 0:
            return []
        return [mav.MAVLink_ping_message(m.time_usec, m.seq, m.get_srcSystem(), m.get_srcComponent())]

    def _on_timesync(self, m: Any, now_ns: int) -> Messages:
        return [mav.MAVLink_timesync_message(now_ns, m.ts1)] if m.tc1 == 0 else []

    def _on_setup_signing(self, m: Any, now_ns: int) -> Messages:
        """Refuse a key over the link, because a link cannot securely carry its own key."""
        self.hub.warn("SETUP_SIGNING refused: the key is the agent's --signing-key FILE")
        return []
