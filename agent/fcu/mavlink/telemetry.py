"""Telemetry: messages that the autopilot sends unrequested, each at its rate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from agent.fcu.mavlink.hub import MavlinkHub, Outbox
from agent.fcu.mavlink.reports import REPORTS
from agent.mavlink.commands import StatusTextSender
from agent.mavlink.exchange import Messages
from agent.wire import dialect as mav

RATES_HZ: Mapping[int, float] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 2.0,
    mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: 2.0,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: 2.0,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
}

# Content of ArduRover's stream groups, as far as it is available.
STREAMS: Mapping[int, tuple[int, ...]] = {
    mav.MAV_DATA_STREAM_RAW_SENSORS: (mav.MAVLINK_MSG_ID_RAW_IMU, mav.MAVLINK_MSG_ID_SCALED_PRESSURE),
    mav.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mav.MAVLINK_MSG_ID_SYS_STATUS,
        mav.MAVLINK_MSG_ID_MISSION_CURRENT,
        mav.MAVLINK_MSG_ID_GPS_RAW_INT,
        mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        mav.MAVLINK_MSG_ID_FENCE_STATUS,
        mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
    ),
    mav.MAV_DATA_STREAM_RC_CHANNELS: (mav.MAVLINK_MSG_ID_RC_CHANNELS, mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW),
    mav.MAV_DATA_STREAM_RAW_CONTROLLER: (mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    mav.MAV_DATA_STREAM_POSITION: (mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    mav.MAV_DATA_STREAM_EXTRA1: (mav.MAVLINK_MSG_ID_ATTITUDE,),
    mav.MAV_DATA_STREAM_EXTRA2: (mav.MAVLINK_MSG_ID_VFR_HUD,),
    mav.MAV_DATA_STREAM_EXTRA3: (
        mav.MAVLINK_MSG_ID_SYSTEM_TIME,
        mav.MAVLINK_MSG_ID_BATTERY_STATUS,
        mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    ),
}

# Default rates of ArduRover's SR0 parameters: once a second, until a station requests more.
STATION_RATES_HZ: Mapping[int, float] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    **{message_id: 1.0 for group in STREAMS.values() for message_id in group},
}

_FASTEST_NS = 20_000_000
_EARLY_NS = 5_000_000  # a cycle that is earlier by this, after a late one, is still the due one
_SLOWEST_NS = 60_000_000_000


class TelemetryStreams:
    """Builds the messages that are due. A message without data is omitted.

    announces_changes: whether to send home and origin once after each change.
    """

    def __init__(
        self,
        hub: MavlinkHub,
        outbox: Outbox,
        texts: StatusTextSender,
        rates_hz: Mapping[int, float] = RATES_HZ,
        announces_changes: bool = False,
    ) -> None:
        self._hub = hub
        self._outbox = outbox
        self._texts = texts
        self._announces_changes = announces_changes
        self._home: Any = None
        self._frame: Any = None
        for message_id, rate_hz in rates_hz.items():
            if message_id not in REPORTS or not 0.0 < rate_hz <= 1000.0:
                raise ValueError(f"telemetry: message {message_id} at {rate_hz:g} Hz; use {sorted(REPORTS)}")
        self._default_ns = {message_id: round(1e9 / rate_hz) for message_id, rate_hz in rates_hz.items()}
        self._periods_ns = dict(self._default_ns)
        self._due_ns: dict[int, int] = {}

    @property
    def periods_ns(self) -> dict[int, int]:
        """Periods of all streamed messages."""
        return dict(self._periods_ns)

    def resume(self, periods_ns: Mapping[int, int]) -> None:
        """Continue at the rates that a station set on an earlier channel."""
        self._periods_ns = dict(periods_ns)

    def offers(self, message_id: int) -> bool:
        """Whether this message can be requested."""
        return message_id in REPORTS

    def set_interval(self, message_id: int, interval_us: int) -> None:
        """Set the interval of a known message: 0 restores the default, -1 stops it. At most once per control cycle."""
        if interval_us == 0:
            period_ns = self._default_ns.get(message_id)
        else:
            period_ns = None if interval_us < 0 else min(max(interval_us * 1000, _FASTEST_NS), _SLOWEST_NS)
        self._due_ns.pop(message_id, None)
        if period_ns is None:
            self._periods_ns.pop(message_id, None)
        else:
            self._periods_ns[message_id] = period_ns

    def interval_us(self, message_id: int) -> int:
        """Interval as in MESSAGE_INTERVAL: 0 unknown, -1 not sent."""
        if message_id not in REPORTS:
            return 0
        period_ns = self._periods_ns.get(message_id)
        return -1 if period_ns is None else period_ns // 1000

    def on_request_data_stream(self, m: Any, now_ns: int) -> Messages:
        """Set the rate of a group of messages, or of all groups."""
        if m.req_stream_id == mav.MAV_DATA_STREAM_ALL:
            message_ids = {message_id for group in STREAMS.values() for message_id in group}
        else:
            message_ids = set(STREAMS.get(m.req_stream_id, ()))
        runs = m.start_stop == 1 and m.req_message_rate > 0
        for message_id in sorted(message_ids):
            self.set_interval(message_id, round(1e6 / m.req_message_rate) if runs else -1)
        return []

    def poll(self, now_ns: int) -> Messages:
        """Return the messages due at `now_ns`, and every event since the last call."""
        hub, outbox = self._hub, self._outbox
        messages: Messages = []
        for message_id, period_ns in self._periods_ns.items():
            due_ns = self._due_ns.get(message_id, now_ns)
            if due_ns - period_ns <= now_ns < due_ns - _EARLY_NS:
                continue
            # Keep the grid of its period, unless the clock was set or a whole period was missed.
            on_grid = due_ns - _EARLY_NS <= now_ns < due_ns + period_ns
            self._due_ns[message_id] = (due_ns if on_grid else now_ns) + period_ns
            message = REPORTS[message_id](hub, now_ns)
            if message is not None:
                messages.append(message)
        if self._announces_changes:
            frame, home = hub.autopilot.estimator.frame, hub.autopilot.navigator.home
            changed = []
            if frame is not self._frame:
                changed.append(mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
            if home != self._home:
                changed.append(mav.MAVLINK_MSG_ID_HOME_POSITION)
            self._frame, self._home = frame, home
            announcements = (self.message(message_id, now_ns) for message_id in changed)
            messages.extend(message for message in announcements if message is not None)
        hub.distribute(now_ns)
        while outbox.reached:
            messages.append(mav.MAVLink_mission_item_reached_message(outbox.reached.popleft()))
        while outbox.events:
            event = outbox.events.popleft()
            messages.extend(self._texts.messages(event.severity, event.text))
        return messages

    def message(self, message_id: int, now_ns: int) -> Any | None:
        """Return one message now, None when it is unknown or has no data."""
        report = REPORTS.get(message_id)
        return None if report is None else report(self._hub, now_ns)
