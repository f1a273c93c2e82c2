"""MAVLink connection to another autopilot, as its ground station: the line and the requested message streams."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from time import monotonic
from typing import Any, Callable

from agent.mavlink.commands import command_long
from agent.timing.clock import Clock
from agent.wire import dialect as mav
from agent.wire.codec import Message
from agent.wire.link import Link, LinkCounters
from agent.wire.tcp import TcpTransport
from agent.wire.transport import open_transport

GROUND_SYSTEM_ID, GROUND_COMPONENT_ID = 255, 190  # an ArduPilot accepts RC overrides only from its MAV_GCS_SYSID
REACH_STEP_S = 0.05
SAMPLES_WAITING = 8  # 60 ms of samples on a line of 115200 baud
HEARTBEAT_NS = 1_000_000_000
OTHERS_NS = 2_500_000_000
SILENT_NS = 3_000_000_000
UNHEARD_NS = 5_000_000_000
_ERROR, _WARNING, _NOTICE = mav.MAV_SEVERITY_ERROR, mav.MAV_SEVERITY_WARNING, mav.MAV_SEVERITY_NOTICE

A_CYCLE = 4
ASK_AGAIN_NS = 3_000_000_000
SELDOM_NS = 20_000_000_000
ASKS = 4
ANSWER_NS = 2_000_000_000

RATES_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 2.0,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: 1.0,  # ArduPilot sends it only while a fence is enabled
}
PX4_RATES_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,  # close to every position: its streams are not synchronous
    mav.MAVLINK_MSG_ID_SYS_STATUS: 5.0,
    mav.MAVLINK_MSG_ID_ATTITUDE: 2.0,  # PX4 sends this and the next two 100, 50 and 30 times a second by default
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mav.MAVLINK_MSG_ID_ODOMETRY: 2.0,
}
"""Rates of PX4 that differ from those of ArduPilot."""
OUTPUTS_HZ = (50.0, 40.0, 20.0, 10.0)
"""Rates of SERVO_OUTPUT_RAW to try in this order.

ArduPilot refuses more than 0.8 of its loop rate and then sends 1 Hz.
"""
SPARE_OUTPUTS_HZ = (2.0,)
"""Rate of SERVO_OUTPUT_RAW when the outputs return through an injector."""

_INTERVAL, _ONCE = mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAV_CMD_REQUEST_MESSAGE
_VERSION = mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION

Say = Callable[[int, str], None]
Tap = Callable[[Message], None]

_NAMES = {
    0: "a vehicle of unknown type",
    1: "a fixed-wing aircraft",
    2: "a quadcopter",
    3: "a coaxial helicopter",
    4: "a helicopter",
    5: "an antenna tracker",
    7: "an airship",
    8: "a balloon",
    9: "a rocket",
    12: "a submarine",
    13: "a hexacopter",
    14: "an octocopter",
    15: "a tricopter",
    16: "a flapping-wing aircraft",
    29: "a dodecacopter",
}
_TARGETED = {kind for kind in mav.mavlink_map.values() if "target_system" in kind.fieldnames}
_MANUAL_CONTROL = mav.MAVLink_manual_control_message


class VehicleLink:
    """Line to the autopilot, open until `close`.

    `send` serves injectors and host. Every tap receives the autopilot's messages, and `receive` returns them to the
    caller.

    vessel: expected MAVLink system, None for any. Another system is accepted with a warning, normally at once. In a
    fleet, an autopilot may forward messages of other vessels. So another system is accepted only when the expected one
    is not heard, and is replaced when the expected one appears.

    Raises TransportError at construction.
    """

    def __init__(self, url: str, outputs_wanted: bool = True, vessel: int | None = None, fleet: bool = False) -> None:
        self._vessel, self._fleet = vessel, fleet
        self._transport = open_transport(url, listen=False)
        self._tcp = self._transport if isinstance(self._transport, TcpTransport) else None
        self._link = Link(self._transport, GROUND_SYSTEM_ID, GROUND_COMPONENT_ID, foreign=True)
        self._streams = StreamRequests(outputs_wanted)
        self._taps: list[Tap] = []
        self._say: Say = lambda severity, text: None
        self._arrived: list[Message] = []
        self._clear(0)

    def _clear(self, now_ns: int) -> None:
        self.system_id = 1 if self._vessel is None else self._vessel
        self.component_id = 1
        self.armed = False
        self.heard = False
        self.reboots = 0
        self._type: int | None = None
        self._heard_ns = now_ns
        self._other_ns: int | None = None
        self._beat_ns: int | None = None
        self._boot_ms = 0
        self._silent = False

    def reset(self, clock: Clock, say: Say) -> None:
        """Start a run on this clock: reset the counts and request the streams again."""
        self._say = say
        self._clear(clock.now_ns())
        self._streams.reset()
        self._link.reset_counters()

    @property
    def line_is_up(self) -> bool:
        """Whether the line is connected. A connectionless line always is."""
        return self._tcp is None or self._tcp.connected

    def wait_for_line(self, timeout_s: float) -> bool:
        """Wait until the line is connected. Return False at the timeout.

        The last attempt may have been before the start of the autopilot. So each step tries to connect.
        """
        until_s = monotonic() + timeout_s
        while self._tcp is not None and not self.line_is_up and (left_s := until_s - monotonic()) > 0.0:
            self._tcp.call_at_once()
            self._arrived += self._link.receive(min(left_s, REACH_STEP_S))
        return self.line_is_up

    def add_tap(self, tap: Tap) -> None:
        """Register `tap`, which is called with every message of the dialect from the autopilot.

        Messages of other systems on the line are ignored.
        """
        self._taps.append(tap)

    def send(self, *messages: Message) -> bool:
        """Send messages to the autopilot, with its address as the target.

        Return False when the line does not accept all of them.
        """
        for message in messages:
            kind: Any = type(message)
            target: Any = message
            if kind in _TARGETED:
                target.target_system = self.system_id
                if "target_component" in kind.fieldnames:
                    target.target_component = self.component_id
            elif kind is _MANUAL_CONTROL:
                target.target = self.system_id
        return self._link.send(*messages)

    def send_sample(self, message: Message) -> bool:
        """Send a message that would mislead when late.

        Return False without sending while other messages wait for the line.
        """
        return self._link.waiting < SAMPLES_WAITING and self.send(message)

    def receive(self, now_ns: int) -> list[Message]:
        """Handle the received messages without waiting. Return the messages for the host."""
        messages = self._link.receive()
        if self._arrived:
            messages, self._arrived = self._arrived + messages, []
        if not messages:
            return messages
        for_host = []
        for message in messages:
            if isinstance(message, mav.MAVLink_heartbeat_message):
                self._on_heartbeat(message, now_ns)
            if message.get_srcSystem() != self.system_id or message.get_srcComponent() != self.component_id:
                continue
            for tap in self._taps:
                tap(message)
            boot_ms = getattr(message, "time_boot_ms", None)
            if boot_ms is not None:
                if boot_ms + 1000 < self._boot_ms:
                    self.reboots += 1
                    self._streams.reset()
                self._boot_ms = boot_ms
            self._streams.note_arrival(message.get_msgId(), now_ns)
            if isinstance(message, mav.MAVLink_timesync_message) and not message.tc1:
                self._link.send(mav.MAVLink_timesync_message(now_ns, message.ts1))
            elif not self._streams.is_own_acknowledgement(message, now_ns):
                for_host.append(message)
        return for_host

    def update(self, now_ns: int) -> None:
        """Send the heartbeat and stream requests, and warn when the autopilot is silent.

        Called several times a second in runs.
        """
        if self._beat_ns is None or now_ns - self._beat_ns >= HEARTBEAT_NS:
            self._beat_ns = now_ns
            self._link.send(
                mav.MAVLink_heartbeat_message(
                    mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3
                )
            )
        if not self.heard:
            if not self._silent and now_ns - self._heard_ns > UNHEARD_NS:
                self._silent = True
                self._say(_WARNING, self._silence_text())
            return
        silent = now_ns - self._heard_ns > SILENT_NS
        if silent != self._silent:
            self._silent = silent
            if silent:
                self._say(_WARNING, f"no MAVLink from the autopilot at {self._transport.address}")
            else:
                self._say(_NOTICE, "MAVLink from the autopilot again")
                self._streams.reset()
        requests = self._streams.poll(now_ns)
        if requests:
            self.send(*requests)

    def request_again(self) -> None:
        """Request the streams again from an autopilot that has restarted."""
        self._streams.reset()

    def _on_heartbeat(self, message: Message, now_ns: int) -> None:
        if message.autopilot == mav.MAV_AUTOPILOT_INVALID or message.type == mav.MAV_TYPE_GCS:
            return
        if self.heard and self._fleet and message.get_srcSystem() == self._vessel != self.system_id:
            self._say(_NOTICE, f"the autopilot of this vessel, MAVLink system {self._vessel}, is heard now")
            self.heard, self._boot_ms = False, 0
            self._streams.reset()
        if not self.heard:
            if self._fleet and self._vessel not in (None, message.get_srcSystem()):
                # Another vessel of the fleet: the expected one also sends a heartbeat every second.
                self._other_ns = now_ns if self._other_ns is None else self._other_ns
                if now_ns - self._other_ns < OTHERS_NS:
                    return
            self.system_id, self.component_id = message.get_srcSystem(), message.get_srcComponent()
            if self._vessel not in (None, self.system_id):
                self._say(
                    _WARNING,
                    f"the autopilot is MAVLink system {self.system_id}, but this vessel is {self._vessel}; "
                    "make both equal: MAV_SYSID or SYSID_THISMAV (PX4: MAV_SYS_ID) there, autopilot.system_id here",
                )
        elif message.get_srcSystem() != self.system_id or message.get_srcComponent() != self.component_id:
            return
        if not self.heard and message.autopilot == mav.MAV_AUTOPILOT_PX4:
            for number, rate_hz in PX4_RATES_HZ.items():
                self._streams.set_rate(number, rate_hz)
            self._streams.leave_out(mav.MAVLINK_MSG_ID_FENCE_STATUS)
        self.heard = True
        self._heard_ns = now_ns
        self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        if message.type != self._type:
            self._type = message.type
            if message.type not in (mav.MAV_TYPE_GROUND_ROVER, mav.MAV_TYPE_SURFACE_BOAT):
                name = _NAMES.get(message.type, "another vehicle")
                self._say(_ERROR, f"the autopilot is {name} (MAV_TYPE {message.type}), not a rover or boat")

    def _silence_text(self) -> str:
        """Return the warning about an autopilot that was never heard."""
        address = self.address
        if not self.line_is_up:
            return f"nothing answers at the autopilot's MAVLink, {address}; check the address and that it runs"
        if self._link.counters.bytes_in:
            return f"the data from {address} is not MAVLink 2; set SERIALn_PROTOCOL 2 there, and check the baud rate"
        return (
            f"nothing arrives from the autopilot's MAVLink at {address}; "
            "check the address, the cable and its parameters"
        )

    @property
    def counters(self) -> LinkCounters:
        """Frame counts since the run began."""
        return self._link.counters

    @property
    def passed(self) -> int:
        """Number of valid frames of types that the dialect does not contain."""
        return self._link.passed

    @property
    def connected(self) -> bool:
        """Whether the autopilot is sending."""
        return self.heard and not self._silent

    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable when the autopilot sends."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    @property
    def address(self) -> str:
        """Address of the autopilot, as a URL."""
        return self._transport.address

    def close(self) -> None:
        """Close the line."""
        self._transport.close()


class _RequestedStream:
    """One message stream. It is requested until it arrives, and again when it stops.

    After some tries, requests are rare.

    rates_hz: requested rate, followed by the rates to try when messages arrive at less than a quarter of it.
    """

    def __init__(self, rates_hz: tuple[float, ...]) -> None:
        self.rates_hz = rates_hz
        self.asked_ns: int | None = None
        self.asks = 0
        self.seen_ns: int | None = None
        self.seen = 0

    def is_due(self, now_ns: int) -> bool:
        if self.asked_ns is None:
            return True
        waited_ns = now_ns - self.asked_ns
        if self.seen_ns is not None and (not self.rates_hz[0] or now_ns - self.seen_ns < ASK_AGAIN_NS):
            if len(self.rates_hz) == 1 or waited_ns < ASK_AGAIN_NS or self.is_often_enough(now_ns):
                return False
            self.rates_hz = self.rates_hz[1:]
            return True
        return waited_ns >= (ASK_AGAIN_NS if self.asks < ASKS else SELDOM_NS)

    def is_often_enough(self, now_ns: int) -> bool:
        """Whether messages arrived often enough since the request, or since the last call."""
        assert self.asked_ns is not None
        enough = self.seen >= 0.25 * self.rates_hz[0] * (now_ns - self.asked_ns) * 1e-9
        self.asked_ns, self.seen = now_ns, 0
        return enough


class StreamRequests:
    """Requests streams by MAV_CMD_SET_MESSAGE_INTERVAL, a few at a time, and AUTOPILOT_VERSION until it arrives."""

    def __init__(self, outputs_wanted: bool) -> None:
        self._rates_hz = {
            **{number: (rate_hz,) for number, rate_hz in RATES_HZ.items()},
            mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: OUTPUTS_HZ if outputs_wanted else SPARE_OUTPUTS_HZ,
            _VERSION: (0.0,),
        }
        self._unanswered: dict[int, deque[int]] = {_INTERVAL: deque(), _ONCE: deque()}
        self.reset()

    def reset(self) -> None:
        """Request all streams again."""
        self._wanted = {number: _RequestedStream(rates_hz) for number, rates_hz in self._rates_hz.items()}
        for times in self._unanswered.values():
            times.clear()

    def set_rate(self, number: int, rate_hz: float) -> None:
        """Request this message at another rate from now on."""
        self._rates_hz[number] = (rate_hz,)
        self._wanted[number] = _RequestedStream((rate_hz,))

    def leave_out(self, number: int) -> None:
        """Stop requesting this message, which the autopilot does not support."""
        self._rates_hz.pop(number, None)
        self._wanted.pop(number, None)

    def note_arrival(self, number: int, now_ns: int) -> None:
        """Note that a message of this number has arrived."""
        wanted = self._wanted.get(number)
        if wanted is not None:
            wanted.seen_ns = now_ns
            wanted.seen += 1

    def poll(self, now_ns: int) -> list[Message]:
        """Return the requests to send now."""
        requests: list[Message] = []
        for number, wanted in self._wanted.items():
            if len(requests) == A_CYCLE:
                break
            if not wanted.is_due(now_ns):
                continue
            wanted.asked_ns, wanted.asks, wanted.seen_ns, wanted.seen = now_ns, wanted.asks + 1, None, 0
            rate_hz = wanted.rates_hz[0]
            command = _INTERVAL if rate_hz else _ONCE
            interval_us = round(1e6 / rate_hz) if rate_hz else 0
            self._unanswered[command].append(now_ns)
            requests.append(command_long((1, 1), command, number, interval_us))
        return requests

    def is_own_acknowledgement(self, message: Message, now_ns: int) -> bool:
        """Whether the message acknowledges a request of this link. The host must not receive it."""
        if not isinstance(message, mav.MAVLink_command_ack_message):
            return False
        times = self._unanswered.get(message.command)
        while times and now_ns - times[0] > ANSWER_NS:
            times.popleft()
        if not times:
            return False
        times.popleft()
        return True
