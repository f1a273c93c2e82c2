"""Simulated navigation unit on a separate line. It sends our sensors as the frames that an external-AHRS driver reads.

Stock firmware treats it as a unit on a serial port (SERIALn_PROTOCOL 36) and runs its own EKF on the data. Two makes
are implemented: `vectornav` and `microstrain`. Every inertial sample is sent at once, with the newest magnetic field
and pressure. Every fix is sent when it arrives, so that it has the latency of our receiver.

The solution of our own estimator is sent at 50 Hz, once the position is known. Before that, a position of zeros would
make software-in-the-loop builds of ArduPilot end with a panic.

In lockstep, the driver's thread still sleeps one millisecond of real time between two reads of its port. Well above
real-time speed, some turns of the main loop would have no inertial sample. The EKF compensates twice for each of them:
at 13 times real time, attitude and heading drifted by degrees. So such a run is limited to `LOCKSTEP_FACTOR`.

Start-up: an ArduPilot without another barometer needs pressure within 0.5 s of its calibration. Otherwise it stays in
"Config Error: Baro: unable to calibrate" permanently. So sensors must flow before it boots. An autopilot started with
`:wait` at its port waits for our connection. We connect when the first sample exists, and never between runs.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from time import monotonic, sleep
from typing import Callable

from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.readings import InertialSample, Navigation, ReceiverFix, SampleDecimator, SensorReadings
from agent.navigation.measurements import ImuMeasurement
from agent.timing.clock import Clock, MonotonicClock
from agent.wire.codec import Message
from agent.wire.dialect import MAV_SEVERITY_NOTICE as _NOTICE
from agent.wire.dialect import MAV_SEVERITY_WARNING as _WARNING
from agent.wire.transport import DATAGRAM_BYTES, SenderStatus, Transport, open_transport

WAITING_FRAMES = 32  # 0.1 s of inertial frames at 200 Hz and the frames between them: older frames would only mislead
DATAGRAM_NS = 15_000_000  # minimum interval between two datagrams: in lockstep, every other tick of 10 ms
BACKLOG_S = 0.02  # largest backlog in the system's buffer of a line; further frames wait here and can be dropped
LISTEN = "?listen"


def open_line(url: str) -> SensorLine:
    """Open the URL of a sensor's line. With `?listen` at its end, wait there for a connection. Raises TransportError.

    tcp://127.0.0.1:5765 connects to an autopilot that serves its port. udp://127.0.0.1:14800?listen waits for an
    autopilot that is a client. serial:///dev/ttyUSB0?baud=921600 is the same for both.
    """
    listen = url.endswith(LISTEN)
    return SensorLine(open_transport(url[: -len(LISTEN)] if listen else url, listen), calls=not listen)


class SensorLine:
    """Line to the autopilot: frames are sent at once on a stream, and bundled on datagrams.

    An ArduPilot reads one datagram every 10 ms, on Linux and in software in the loop. More datagrams would queue
    without limit. Up to `WAITING_FRAMES` frames wait when the line does not accept them. Beyond that, the oldest is
    dropped and counted.

    unsent: number of frames dropped, or sent without a connection.
    sent: number of frames that the line accepted, by kind.
    calls: we connect to the other end, at the next `receive` after each `call`.
    """

    def __init__(self, transport: Transport, calls: bool = False) -> None:
        self.unsent = 0
        self.sent: Counter[str] = Counter()
        self._transport = transport
        self._waiting: deque[tuple[bytes, str]] = deque()
        self._sent_ns: int | None = None
        self._calls = calls
        self._wanted = False

    @property
    def connected(self) -> bool:
        """Whether the other end is connected, as far as the line can detect it."""
        return bool(self._transport.peer)

    @property
    def address(self) -> str:
        """Address of the line, for people."""
        return self._transport.address

    def call(self) -> None:
        """Request a connection, because there is data for the other end."""
        self._wanted = True

    def send(self, frame: bytes, kind: str = "") -> None:
        """Queue a frame. `flush` transmits it."""
        self._waiting.append((frame, kind))
        if len(self._waiting) > WAITING_FRAMES:
            self._waiting.popleft()
            self.unsent += 1

    def flush(self, now_ns: int) -> None:
        """Transmit waiting frames, as far as the line accepts them and the interval permits.

        now_ns: clock of the run.
        """
        waiting, transport = self._waiting, self._transport
        if not waiting:
            return
        if not transport.peer:
            self.unsent += len(waiting)
            waiting.clear()
        elif transport.stream:
            while waiting and transport.backlog_s() < BACKLOG_S and transport.send(waiting[0][0]):
                self.sent[waiting.popleft()[1]] += 1
        elif self._sent_ns is None or not 0 <= now_ns - self._sent_ns < DATAGRAM_NS:
            self._sent_ns = now_ns
            bundle, count = b"", 0
            for frame, _ in waiting:
                if count and len(bundle) + len(frame) > DATAGRAM_BYTES:
                    break
                bundle += frame
                count += 1
            if transport.send(bundle):
                for _ in range(count):
                    self.sent[waiting.popleft()[1]] += 1

    def receive(self) -> list[bytes]:
        """Return the received bytes. Also connect to the other end if necessary."""
        if self._calls and not self._wanted and not self.connected:
            return []
        self._wanted = False
        return self._transport.receive(0.0)

    def accept_sender(self, index: int) -> bool:
        """Accept the sender of chunk `index` of the last `receive` as the other end. Return False when it is not."""
        return self._transport.accept_sender(index, SenderStatus.HEARD)

    def clear(self) -> None:
        """Discard the waiting frames and reset the counts."""
        self._waiting.clear()
        self._sent_ns = None
        self.unsent = 0
        self.sent.clear()

    def descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable with bytes from the other end."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    def close(self) -> None:
        """Close the line."""
        self._transport.close()


RATE_WINDOW = 64
LONGEST_HOLD_S = 0.5


class RateGauge:
    """Measure the sample rate from the stamps."""

    def __init__(self) -> None:
        self._first_ns = 0
        self._count = 0

    def add(self, stamp_ns: int) -> float | None:
        """Return the rate in Hz once every `RATE_WINDOW` samples, None in between."""
        if self._count == 0 or stamp_ns <= self._first_ns:
            self._first_ns, self._count = stamp_ns, 1
            return None
        self._count += 1
        if self._count <= RATE_WINDOW:
            return None
        rate_hz = RATE_WINDOW * 1e9 / (stamp_ns - self._first_ns)
        self._count = 0
        return rate_hz


class SpeedLimit:
    """Limit a lockstep run to `factor` times real time."""

    def __init__(
        self, factor: float, clock_s: Callable[[], float] = monotonic, wait: Callable[[float], None] = sleep
    ) -> None:
        self._wall_s_per_ns = 1e-9 / factor
        self._clock_s = clock_s
        self._wait = wait
        self._last_ns: int | None = None
        self._due_s = 0.0

    def hold(self, now_ns: int) -> None:
        """Wait until the run may be at `now_ns`, at most half a second."""
        clock_s = self._clock_s()
        if self._last_ns is not None:
            self._due_s += (now_ns - self._last_ns) * self._wall_s_per_ns
            early_s = min(self._due_s - clock_s, LONGEST_HOLD_S)
            if early_s > 0.0:
                self._wait(early_s)
                clock_s = self._clock_s()
        self._last_ns = now_ns
        self._due_s = max(self._due_s, clock_s)


SOLUTION_NS = 20_000_000
LOCKSTEP_FACTOR = 8.0
PATIENCE_NS = 5_000_000_000  # on the clock of the run, before a warning reports that the line is silent
_KINDS = _INERTIAL, _SOLUTION, _FIX = "inertial", "solution", "fix"
_SLOW = 0.9  # below this fraction of the requested rate, a warning is sent

Say = Callable[[int, str], None]


class Ahrs(Injector):
    """Common part of the two makes. Each make defines its frames and when they may be sent.

    unix_s: date of runs in real time. Runs in lockstep have a fixed date.
    """

    title = "external AHRS"

    def __init__(self, line: SensorLine, unix_s: Callable[[], float] = time.time) -> None:
        self.counts = InjectorCounters()
        self._line = line
        self._unix_s = unix_s
        self.reset(MonotonicClock(), False, lambda severity, text: None)

    # -- defined by each make

    def inertial_frame(self, sample: InertialSample) -> bytes | None:
        """Return the inertial frame, None while none may be sent."""
        raise NotImplementedError

    def solution_frame(self, navigation: Navigation) -> bytes | None:
        """Return the solution frame, None while none may be sent."""
        raise NotImplementedError

    def receiver_frame(self, fix: ReceiverFix) -> bytes | None:
        """Return the receiver frame, None while none may be sent."""
        raise NotImplementedError

    def handle_bytes(self, chunk: bytes) -> bool:
        """Handle bytes from the autopilot. Return whether they were valid."""
        raise NotImplementedError

    def is_accepted(self) -> bool:
        """Whether the autopilot accepts the frames, as far as can be known."""
        raise NotImplementedError

    def requested_hz(self) -> float:
        """Rate of inertial frames that the autopilot requests, in Hz. 0 for any rate."""
        return 0.0

    def hint(self) -> str:
        """Return a hint for the user when the line is silent."""
        raise NotImplementedError

    # -- called by the role

    def reset(self, clock: Clock, lockstep: bool, say: Say) -> None:
        self.counts = InjectorCounters()
        self._say = say
        self._line.clear()
        self._began_ns = clock.now_ns()
        self._readings = SensorReadings(lockstep, self._unix_s)
        self._solution_pace = SampleDecimator(SOLUTION_NS)
        self._inertial_pace, self._paced_hz = SampleDecimator(0), 0.0
        self._gauge = RateGauge()
        self._limit = SpeedLimit(LOCKSTEP_FACTOR)
        self._reported_slow = self._reported_absent = self._was_accepted = False
        self._newest: InertialSample | None = None

    def handle(self, message: Message, now_ns: int) -> None:
        sample = self._readings.handle(message)
        if isinstance(sample, ImuMeasurement):
            self._on_imu(sample)
        elif isinstance(sample, ReceiverFix):
            self._send_frame(self.receiver_frame(sample), _FIX)
            self._readings.solve(sample)
        self._flush(now_ns)
        self.counts.refused = self._readings.refused

    def repeat(self, now_ns: int) -> None:
        if self._newest is not None:
            self._send_frame(self.inertial_frame(self._newest), _INERTIAL)
            self._flush(now_ns)

    def serve(self, now_ns: int) -> None:
        for index, chunk in enumerate(self._line.receive()):
            if self.handle_bytes(chunk):
                self._line.accept_sender(index)
        self._flush(now_ns)
        accepted = self.is_accepted()
        if accepted and not self._was_accepted:
            self._reported_absent = True  # from here on, the connection can only be lost
            self._say(_NOTICE, f"the autopilot accepts our sensors as a {self.title} at {self._line.address}")
        elif self._was_accepted and not accepted:
            self._say(_WARNING, f"the autopilot no longer accepts sensors at {self._line.address}; they are lost")
        elif not accepted and not self._reported_absent and now_ns - self._began_ns > PATIENCE_NS:
            self._reported_absent = True
            self._say(_WARNING, f"nothing requests a {self.title} at {self._line.address}; {self.hint()}")
        self._was_accepted = self.counts.taken = accepted

    def advance(self, now_ns: int) -> bool:
        self._flush(now_ns)
        self._limit.hold(now_ns)
        return True

    def _flush(self, now_ns: int) -> None:
        counts, line = self.counts, self._line
        line.flush(now_ns)
        counts.imu_out, counts.solution_out, counts.gnss_out = (line.sent[kind] for kind in _KINDS)
        counts.unsent = line.unsent

    def descriptors(self) -> Sequence[int]:
        return self._line.descriptors()

    @property
    def addresses(self) -> tuple[str, ...]:
        return (self._line.address,)

    def close(self) -> None:
        self._line.close()

    # -- samples

    def _on_imu(self, imu: ImuMeasurement) -> None:
        readings = self._readings
        if readings.field is not None and readings.pressure is not None:
            self._line.call()
            requested_hz = self.requested_hz()
            if requested_hz != self._paced_hz:
                period_ns = round(1e9 / requested_hz) if requested_hz else 0
                self._inertial_pace, self._paced_hz = SampleDecimator(period_ns), requested_hz
            rate_hz = self._gauge.add(imu.stamp_ns)
            if rate_hz is not None and rate_hz < _SLOW * requested_hz and not self._reported_slow:
                self._reported_slow = True
                text = f"inertial samples arrive at {rate_hz:.0f} Hz, but the autopilot requests {requested_hz:.0f}"
                self._say(_WARNING, f"{text}; set EAHRS_RATE to sensors.imu.rate_hz")
            if self._inertial_pace.is_due(imu.stamp_ns):
                self._newest = readings.inertial_sample(imu)
                self._send_frame(self.inertial_frame(self._newest), _INERTIAL)
        readings.solve(imu)
        if self._solution_pace.is_due(imu.stamp_ns):
            navigation = readings.solution()
            if navigation is not None:
                self._send_frame(self.solution_frame(navigation), _SOLUTION)

    def _send_frame(self, frame: bytes | None, kind: str) -> None:
        if frame is not None:
            self._line.send(frame, kind)
