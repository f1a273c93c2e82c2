"""MAVLink with another autopilot, as its ground station."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import Any, Callable

from agent.bridges.streams import Streams
from agent.timing.clock import Clock
from agent.wire import dialect as mav
from agent.wire.codec import Message
from agent.wire.link import Link, LinkCounters
from agent.wire.tcp import TcpTransport
from agent.wire.transport import open_transport

GROUND_SYSTEM_ID, GROUND_COMPONENT_ID = 255, 190  # whose RC overrides an ArduPilot takes: its MAV_GCS_SYSID
REACH_STEP_S = 0.05
SAMPLES_WAITING = 8  # 60 ms of them on a line of 115200 baud
HEARTBEAT_NS = 1_000_000_000
SILENT_NS = 3_000_000_000
UNHEARD_NS = 5_000_000_000
_ERROR, _WARNING, _NOTICE = 3, 4, 5  # MAV_SEVERITY

Say = Callable[[int, str], None]
Tap = Callable[[Message], None]

_NAMES = {
    0: "something of no known kind",
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
    """The line to the autopilot, open until `close`.

    `send` is for the injectors and the host; what the autopilot says goes to every tap, and from `serve` to the caller.
    Raises TransportError at construction.
    """

    def __init__(self, url: str, outputs_wanted: bool = True) -> None:
        self._transport = open_transport(url, listen=False)
        self._tcp = self._transport if isinstance(self._transport, TcpTransport) else None
        self._link = Link(self._transport, GROUND_SYSTEM_ID, GROUND_COMPONENT_ID, foreign=True)
        self._streams = Streams(outputs_wanted)
        self._taps: list[Tap] = []
        self._say: Say = lambda severity, text: None
        self._arrived: list[Message] = []
        self._clear(0)

    def _clear(self, now_ns: int) -> None:
        self.system_id = self.component_id = 1
        self.armed = False
        self.heard = False
        self.reboots = 0
        self._type: int | None = None
        self._heard_ns = now_ns
        self._beat_ns: int | None = None
        self._boot_ms = 0
        self._silent = False

    def reset(self, clock: Clock, say: Say) -> None:
        """A run starts on this clock: counts from zero, and the streams are asked for again."""
        self._say = say
        self._clear(clock.now_ns())
        self._streams.reset()
        self._link.reset_counters()

    @property
    def line_is_up(self) -> bool:
        """Whether there is a connection, where the line is one that has to be made."""
        return self._tcp is None or self._tcp.connected

    def reach(self, timeout_s: float) -> bool:
        """Wait until the line is up; False at the end of the time."""
        until_s = monotonic() + timeout_s
        while not self.line_is_up and (left_s := until_s - monotonic()) > 0.0:
            self._arrived += self._link.receive(min(left_s, REACH_STEP_S))
        return self.line_is_up

    def add_tap(self, tap: Tap) -> None:
        """Have `tap` called with every message of the dialect from the autopilot; others on its line are not heard."""
        self._taps.append(tap)

    def send(self, *messages: Message) -> bool:
        """Messages to the autopilot, addressed to it; False when the line does not take all of them."""
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
        """The same for what would mislead when it came late: False, and not sent, while others wait for the line."""
        return self._link.waiting < SAMPLES_WAITING and self.send(message)

    def serve(self, now_ns: int) -> list[Message]:
        """Take in what has come, without waiting; returns what the host is to have."""
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
            self._note_time(message)
            self._streams.note(message.get_msgId(), now_ns)
            if isinstance(message, mav.MAVLink_timesync_message) and not message.tc1:
                self._link.send(mav.MAVLink_timesync_message(now_ns, message.ts1))
            elif not self._streams.owns(message, now_ns):
                for_host.append(message)
        return for_host

    def keep(self, now_ns: int) -> None:
        """In runs, some times a second: heartbeat, streams, silence."""
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
                self._say(_WARNING, self._unheard())
            return
        silent = now_ns - self._heard_ns > SILENT_NS
        if silent != self._silent:
            self._silent = silent
            if silent:
                self._say(_WARNING, f"no MAVLink from the autopilot at {self._transport.address}")
            else:
                self._say(_NOTICE, "MAVLink from the autopilot again")
                self._streams.reset()
        wanted = self._streams.due(now_ns)
        if wanted:
            self.send(*wanted)

    def ask_again(self) -> None:
        """The autopilot has started anew: it knows nothing of what was asked of it."""
        self._streams.reset()

    def _on_heartbeat(self, message: Message, now_ns: int) -> None:
        if message.autopilot == mav.MAV_AUTOPILOT_INVALID or message.type == mav.MAV_TYPE_GCS:
            return
        if not self.heard:
            self.system_id, self.component_id = message.get_srcSystem(), message.get_srcComponent()
        elif message.get_srcSystem() != self.system_id or message.get_srcComponent() != self.component_id:
            return
        self.heard = True
        self._heard_ns = now_ns
        self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        if message.type != self._type:
            self._type = message.type
            if message.type not in (mav.MAV_TYPE_GROUND_ROVER, mav.MAV_TYPE_SURFACE_BOAT):
                name = _NAMES.get(message.type, "another vehicle")
                self._say(_ERROR, f"the autopilot is {name} (MAV_TYPE {message.type}), no rover or boat")

    def _unheard(self) -> str:
        address, link = self.address, self._link.counters
        if not self.line_is_up:
            return f"nobody answers at the autopilot's MAVLink, {address}; check the address and that it runs"
        if link.bytes_in:
            return f"what comes from {address} is no MAVLink 2; set SERIALn_PROTOCOL 2 there, and check the baud rate"
        return (
            f"nothing comes from the autopilot's MAVLink at {address}; check the address, the cable and its parameters"
        )

    def _note_time(self, message: Message) -> None:
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is None:
            return
        if boot_ms + 1000 < self._boot_ms:
            self.reboots += 1
            self._streams.reset()
        self._boot_ms = boot_ms

    @property
    def counters(self) -> LinkCounters:
        """Counts of frames since the run began."""
        return self._link.counters

    @property
    def passed(self) -> int:
        """Good frames of kinds that the dialect does not have."""
        return self._link.passed

    @property
    def connected(self) -> bool:
        """Whether the autopilot is heard."""
        return self.heard and not self._silent

    def descriptors(self) -> Sequence[int]:
        """What becomes readable when the autopilot says something."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    @property
    def address(self) -> str:
        """Where the autopilot is, as a URL."""
        return self._transport.address

    def close(self) -> None:
        """Give the line back."""
        self._transport.close()
