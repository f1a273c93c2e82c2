"""The MAVLink of a boat: received from a link or read from a telemetry log. Nothing is ever sent.

A source yields the frames. `BoatTelemetry` keeps the signals of one system on its boot clock. `IntervalReader` cuts
them into intervals: the outputs within each, and its measured motion.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from agent.files import read_bytes
from agent.wire import dialect as mav
from agent.wire.codec import Message, decode
from agent.wire.framing import Framer
from agent.wire.transport import TransportError, open_transport
from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.logs.formats import DATAFLASH_START

INTERVAL_S = 1.0
WAIT_S = 10.0
"""Time within which each needed message must arrive."""
SLOW_HZ = 2.0
SHORTEST_US, LONGEST_US = 500.0, 2500.0
MOST_BYTES = 1 << 30
_KEPT_S = 30.0
AUTOPILOT = 1
"""Component of an autopilot."""
_ATTITUDE, _POSITION, _OUTPUTS = "ATTITUDE", "GLOBAL_POSITION_INT", "SERVO_OUTPUT_RAW"
_NEEDED = {
    _ATTITUDE: "SR0_EXTRA1",
    _POSITION: "SR0_POSITION",
    _OUTPUTS: "SR0_RC_CHAN",
}
"""Needed messages, each with the parameter of ArduPilot for its rate."""


@dataclass(frozen=True, slots=True)
class Outputs:
    """Conversion of servo outputs to motor commands: (pulse - trim) / span, limited to [-1, 1]."""

    channels: tuple[int, ...] = (1, 3)
    trim_us: float = 1500.0
    span_us: float = 400.0

    def command(self, pulses_us: Array) -> Array:
        """Return commands for pulses; a pulse of 0 is neutral."""
        command: Array = np.clip((pulses_us - self.trim_us) / self.span_us, -1.0, 1.0)
        return np.where(pulses_us == 0.0, 0.0, command)


@dataclass(frozen=True, slots=True, eq=False)
class BoatInterval:
    """One interval of a boat."""

    end_ns: int
    """On the boat's boot clock."""
    commands: Array
    """Motor commands, (S, C), one for each step of the model."""
    unknown_s: Array
    """Uncertainty of the outputs between their messages, as a time at full thrust, (C,)."""
    motion: Array
    """Measured velocity north and east, heading, yaw rate, position north and east: means of the interval."""
    attitude_rad: Array
    """Roll, pitch and yaw at the end, (3,)."""
    armed: bool
    length_s: float = INTERVAL_S


class LinkFrames:
    """Frames from a link that is only read. It has no method to send."""

    def __init__(self, url: str, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Raises UserError if the link cannot be opened."""
        self.name = url
        try:
            self._transport = open_transport(url, listen=url.startswith("udp://"))
        except TransportError as error:
            raise UserError(f"--boat {error}") from None
        self._framer = Framer(stream=self._transport.stream, mavlink1=True)
        self._clock_s = clock_s

    def batches(self) -> Iterator[list[bytes]]:
        """Yield the frames that arrive, an empty list after each quiet fifth of a second."""
        while True:
            chunks = self._transport.receive(0.2)
            yield [frame for chunk in chunks for frame in self._framer.feed(chunk)]

    @property
    def address(self) -> str:
        """URL of this end, with its port."""
        return self._transport.address

    @property
    def now_s(self) -> float:
        """Time for silences."""
        return self._clock_s()

    def close(self) -> None:
        """Close the link."""
        self._transport.close()


class LogFrames:
    """Frames of a telemetry log (`.tlog`). The framer skips the time stamps between them."""

    def __init__(self, path: Path) -> None:
        """Raises UserError if the file cannot be read, or is a DataFlash log."""
        self.name = str(path)
        self.now_s = 0.0
        try:
            self._data = read_bytes(path, MOST_BYTES)
        except OSError as error:
            raise UserError(f"--boat {path}: cannot be read ({error.strerror}); check the path") from None
        if self._data.startswith(DATAFLASH_START):
            raise UserError(
                f"--boat {path}: is a DataFlash log, which contains no MAVLink; give the telemetry log (.tlog) of a "
                "ground station"
            )

    def batches(self) -> Iterator[list[bytes]]:
        """Yield the frames."""
        framer = Framer(stream=True, mavlink1=True)
        for first in range(0, len(self._data), 2048):
            yield framer.feed(self._data[first : first + 2048])

    def close(self) -> None:
        """Nothing is open."""


Source = LinkFrames | LogFrames


def open_boat(name: str) -> Source:
    """Return the frames of a URL, or of a telemetry log."""
    return LinkFrames(name) if "://" in name else LogFrames(Path(name))


class BoatTelemetry:
    """The signals of one system, from its messages.

    system_id: None for the first autopilot that is heard.
    """

    def __init__(self, source: str, outputs: Outputs, system_id: int | None = None) -> None:
        self.system_id = system_id
        self.armed = False
        self.received: Counter[int] = Counter()
        """Frames of the system by message id."""
        self.frame: LocalFrame | None = None
        """Local axes; the origin is the first position."""
        self._source = source
        self._outputs = outputs
        self._asked = system_id
        self._heard: Counter[int] = Counter()
        self._series: dict[str, deque[tuple[float, ...]]] = {name: deque() for name in _NEEDED}
        self._boot_s = 0.0
        self._began_s: float | None = None

    def handle(self, frame: bytes) -> bool:
        """Take a frame. Return whether it belongs to the boat."""
        system, component = frame[5], frame[6]
        self._heard[system] += 1
        if self.system_id is None and component == AUTOPILOT:
            self.system_id = system
        if system != self.system_id or component != AUTOPILOT:
            return False
        message = decode(frame)
        self.received[message.get_msgId()] += 1
        read = _READERS.get(message.get_type())
        if read is not None:
            read(self, message)
        return True

    @property
    def now_s(self) -> float:
        """Boot time of the newest message."""
        return self._boot_s

    @property
    def began_s(self) -> float | None:
        """Boot time at which all needed signals are present; None before."""
        if self._began_s is None and all(self._series.values()):
            self._began_s = max(series[0][0] for series in self._series.values())
        return self._began_s

    def series(self, name: str) -> Array:
        """Return (n, 1 + columns) of a needed message: boot time in s, then its values."""
        return np.array(self._series[name])

    def forget_before(self, at_s: float) -> None:
        """Drop the values that are older than an instant, but keep one."""
        for series in self._series.values():
            while len(series) > 2 and series[1][0] < at_s:
                series.popleft()

    def check(self, waited_s: float) -> None:
        """Raise UserError if a message that the twin needs is missing after `waited_s`, infinite after a log's end."""
        if waited_s < WAIT_S:
            return
        of_log = math.isinf(waited_s)
        within = "before the end of the log" if of_log else f"in {waited_s:.0f} s"
        if not self._heard and of_log:
            raise UserError(
                f"{self._source}: has no frame of MAVLink; give the telemetry log (.tlog) of a ground station"
            )
        if not self._heard:
            raise UserError(
                f"{self._source}: no MAVLink arrived {within}; let the boat or a ground station forward its "
                "telemetry to this address"
            )
        if not self.received:
            others = ", ".join(f"{system} ({count} messages)" for system, count in sorted(self._heard.items()))
            raise UserError(
                f"{self._source}: system {self._asked} sent nothing {within}, but these did: {others}; "
                "select one with --system"
            )
        for name, parameter in _NEEDED.items():
            if not self._series[name]:
                count = sum(self.received.values())
                raise UserError(
                    f"{self._source}: system {self.system_id} sent {count} messages {within} and 0 {name}; "
                    f"request this message at 10 Hz, in ArduPilot with {parameter} = 10"
                )

    def check_rates(self) -> None:
        """Raise UserError if a needed message is too rare to follow the boat."""
        for name, parameter in _NEEDED.items():
            times = self.series(name)[:, 0]
            rate_hz = (len(times) - 1) / max(times[-1] - times[0], 1e-3)
            if len(times) > 4 and rate_hz < SLOW_HZ:
                raise UserError(
                    f"{self._source}: {name} arrives at {rate_hz:.1f} Hz; the twin needs {SLOW_HZ:g} Hz, better 10, in "
                    f"ArduPilot with {parameter} = 10"
                )

    def check_outputs(self) -> None:
        """Raise UserError if an output of a motor has no pulse in any message."""
        pulses = self.series(_OUTPUTS)[:, 1:]
        for column, channel in enumerate(self._outputs.channels):
            values = pulses[:, column]
            bad = values[(values != 0.0) & ((values < SHORTEST_US) | (values > LONGEST_US))]
            if self.armed and (not values.any() or len(bad)):
                found = f"{bad[0]:.0f} µs" if len(bad) else "no pulse (0 µs)"
                raise UserError(
                    f"{self._source}: output {channel} has {found} while the boat is armed; the vehicle has "
                    f"{len(self._outputs.channels)} actuators at outputs {_listed(self._outputs.channels)}: name "
                    "the right ones with --outputs"
                )

    def _on_attitude(self, message: Message) -> None:
        at_s = self._stamp(message.time_boot_ms * 1e-3)
        self._add(_ATTITUDE, (at_s, message.roll, message.pitch, message.yaw, message.yawspeed))

    def _on_position(self, message: Message) -> None:
        if not message.lat and not message.lon:
            return
        at_s = self._stamp(message.time_boot_ms * 1e-3)
        latitude_deg, longitude_deg = message.lat * 1e-7, message.lon * 1e-7
        if self.frame is None:
            self.frame = LocalFrame(latitude_deg, longitude_deg, 0.0)
        place = (np.array([value]) for value in (latitude_deg, longitude_deg, 0.0))
        north_m, east_m, _ = self.frame.ned(*place)[0].tolist()
        self._add(_POSITION, (at_s, message.vx * 1e-2, message.vy * 1e-2, north_m, east_m))

    def _on_outputs(self, message: Message) -> None:
        if message.port:
            return
        # 32 bits of microseconds repeat after 71 minutes
        behind_us = (round(self._boot_s * 1e6) - message.time_usec + (1 << 31)) % (1 << 32) - (1 << 31)
        at_s = self._stamp(self._boot_s - behind_us * 1e-6) if self._boot_s else self._boot_s
        pulses = [float(getattr(message, f"servo{channel}_raw")) for channel in self._outputs.channels]
        if at_s:
            self._add(_OUTPUTS, (at_s, *pulses))

    def _on_heartbeat(self, message: Message) -> None:
        self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)

    def _stamp(self, at_s: float) -> float:
        if at_s < self._boot_s - _KEPT_S:
            raise UserError(
                f"{self._source}: the boot clock of system {self.system_id} went back from {self._boot_s:.0f} s to "
                f"{at_s:.0f} s, so the autopilot has restarted; start the twin again"
            )
        self._boot_s = max(self._boot_s, at_s)
        return at_s

    def _add(self, name: str, row: tuple[float, ...]) -> None:
        series = self._series[name]
        if not series or row[0] > series[-1][0]:
            series.append(row)


_READERS: dict[str, Callable[[BoatTelemetry, Message], None]] = {
    _ATTITUDE: BoatTelemetry._on_attitude,
    _POSITION: BoatTelemetry._on_position,
    _OUTPUTS: BoatTelemetry._on_outputs,
    "HEARTBEAT": BoatTelemetry._on_heartbeat,
}


class IntervalReader:
    """Cuts telemetry into intervals for a model with steps of dt_s."""

    def __init__(self, telemetry: BoatTelemetry, outputs: Outputs, dt_s: float) -> None:
        self._telemetry = telemetry
        self._outputs = outputs
        self._steps = round(INTERVAL_S / dt_s)
        self._end_s: float | None = None

    def intervals(self) -> Iterator[BoatInterval]:
        """Yield the intervals that have become complete."""
        telemetry = self._telemetry
        began_s = telemetry.began_s
        if began_s is None:
            return
        if self._end_s is None:
            self._end_s = began_s + INTERVAL_S
        ends_s = min(telemetry.series(name)[-1, 0] for name in _NEEDED)
        if self._end_s > ends_s:
            return
        attitude, position, outputs = (telemetry.series(name) for name in _NEEDED)
        while self._end_s <= ends_s:
            yield self._interval(self._end_s, attitude, position, outputs)
            self._end_s += INTERVAL_S
        telemetry.forget_before(self._end_s - 2.0 * INTERVAL_S)

    def _interval(self, end_s: float, attitude: Array, position: Array, outputs: Array) -> BoatInterval:
        yaw = np.unwrap(attitude[:, 3])
        turning = np.column_stack((attitude[:, 0], yaw, attitude[:, 4]))
        yaw_rad, rate_radps = _mean(turning, end_s)
        motion = _mean(position, end_s)
        at_s = end_s - INTERVAL_S + (np.arange(self._steps) + 0.5) * (INTERVAL_S / self._steps)
        columns = [np.interp(at_s, outputs[:, 0], values) for values in self._outputs.command(outputs[:, 1:]).T]
        inside = (outputs[:, 0] > end_s - INTERVAL_S) & (outputs[:, 0] <= end_s)
        thrust = self._outputs.command(outputs[:, 1:])
        thrust *= np.abs(thrust)
        jumps = np.diff(thrust, axis=0, prepend=thrust[:1]) * np.diff(outputs[:, 0], prepend=outputs[0, 0])[:, None]
        unknown_s = np.sqrt((jumps[inside] ** 2).sum(axis=0) / 12.0)
        now = [float(np.interp(end_s, attitude[:, 0], values)) for values in (attitude[:, 1], attitude[:, 2], yaw)]
        return BoatInterval(
            round(end_s * 1e9),
            np.column_stack(columns),
            unknown_s,
            np.array([motion[0], motion[1], yaw_rad, rate_radps, motion[2], motion[3]]),
            np.array(now),
            self._telemetry.armed,
        )


def _mean(series: Array, at_s: float) -> Array:
    """Return the mean of the interval before an instant, of values that change linearly between samples."""
    at = np.linspace(at_s - INTERVAL_S, at_s, 21)
    return np.array([np.interp(at, series[:, 0], values).mean() for values in series[:, 1:].T])


def _listed(channels: Sequence[int]) -> str:
    return ", ".join(map(str, channels))
