"""Another autopilot's clock against the host's, by the standard TIMESYNC message through the bridge."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from agent.wire import dialect
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import ClockExchange
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.pace import Pace
from xitl_cli.run.core.reports import ClockReport
from xitl_cli.run.links.link_accounts import LinkTiming

NODE = "autopilot"
REALTIME_HZ, LOCKSTEP_HZ = 10.0, 1.0
REQUESTS_KEPT = 256
SETTLING_NS = 500_000_000  # in lockstep, a clock further off belongs to an autopilot from an earlier run
SIMULATED_UNEVEN_NS = 110_000_000
"""Time by which the clock of a SITL build in real time falls behind and catches up. The build sleeps for some ms at a
time. It counts up to 100 ms without processor time as a debt, and never makes up for more (ArduPilot,
libraries/SITL/SIM_Aircraft.cpp, sync_frame_time).
"""
OLDEST_UTC_S = 1e9  # without the time of a satellite, the autopilot counts from 1970

Send = Callable[[Any], object]


class UnevenClock:
    """Steps of a clock that stops whenever its process does, and makes up for at most `uneven_ns` of that.

    A step is a jump back, or a jump ahead by more than the elapsed time and the time that the clock makes up for. All
    else is time that the clock lost, `lost_s` in total.
    """

    def __init__(self, uneven_ns: int) -> None:
        self.steps = 0
        self._uneven_ns = uneven_ns
        self._lost_ns = 0
        self._levels: tuple[int, int] | None = None  # highest and lowest offset since the last step, as bounds
        self._node_ns = 0

    def add(self, sent_ns: int, node_ns: int, returned_ns: int) -> None:
        """Add a reading: the clock showed `node_ns` between the two instants of the host's clock."""
        least_ns, most_ns = node_ns - returned_ns, node_ns - sent_ns
        if self._levels is not None:
            highest_ns, lowest_ns = self._levels
            if node_ns < self._node_ns or least_ns > lowest_ns + self._uneven_ns:
                self.steps += 1
                self._lost_ns += self._lost_since_step_ns()
            else:
                least_ns, most_ns = max(highest_ns, least_ns), min(lowest_ns, most_ns)
        self._levels, self._node_ns = (least_ns, most_ns), node_ns

    def _lost_since_step_ns(self) -> int:
        return 0 if self._levels is None else max(self._levels[0] - self._levels[1] - self._uneven_ns, 0)

    @property
    def lost_s(self) -> float:
        return (self._lost_ns + self._lost_since_step_ns()) * 1e-9


class AutopilotClock:
    """Requests the autopilot's time at intervals, and answers its requests.

    In real time, offset and drift against the host's monotonic clock are estimated as for an agent. In lockstep the
    autopilot gets its time from the run. The offset is that of its answer against the tick with the request. It may be
    an exchange late, and its answer takes more time, which gives the bound. `uneven_ns`: for a simulated clock in real
    time, see UnevenClock. utc_offset_s: the autopilot's UTC (SYSTEM_TIME) less this machine's. It is None in lockstep
    and until the autopilot knows the time.
    """

    def __init__(self, lockstep: bool, send: Send, uneven_ns: int = 0) -> None:
        self.utc_offset_s: float | None = None
        self._lockstep = lockstep
        self._send = send
        self._uneven = UnevenClock(uneven_ns) if uneven_ns else None
        self._timing = LinkTiming(NODE, time.monotonic_ns, uneven_ns)
        self._every_ns = round(1e9 / (LOCKSTEP_HZ if lockstep else REALTIME_HZ))
        self._asked_ns: int | None = None
        self._requests: dict[int, int] = {}
        self._count = 0
        self._offset_ns: int | None = None
        self._trip_ns = 0
        self._ahead_ns = 0
        self._samples = 0
        self._recorder: Recorder | None = None
        self._pace: Pace | None = None
        self._now_ns: Callable[[], int] = lambda: 0

    def begin(self, context: RunContext) -> None:
        """Begin the run."""
        self._recorder, self._pace, self._now_ns = context.recorder, context.pace, context.clock.now_ns

    def update(self, sim_ns: int) -> None:
        """Send a request when it is due."""
        if self._asked_ns is not None and sim_ns - self._asked_ns < self._every_ns:
            return
        self._asked_ns = sim_ns
        stamp_ns = self._local_ns()
        self._count += 1
        self._requests[stamp_ns] = self._count
        if len(self._requests) > REQUESTS_KEPT:
            self._requests.pop(next(iter(self._requests)))
        self._send(dialect.MAVLink_timesync_message(0, stamp_ns))

    def handle(self, message: Any) -> None:
        """Handle a message of the autopilot."""
        number = message.get_msgId()
        if number == dialect.MAVLINK_MSG_ID_TIMESYNC:
            if message.tc1 == 0:
                self._send(dialect.MAVLink_timesync_message(self._local_ns(), message.ts1))
            else:
                self._answered(message)
        elif number == dialect.MAVLINK_MSG_ID_SYSTEM_TIME and not self._lockstep:
            utc_s = message.time_unix_usec * 1e-6
            if utc_s > OLDEST_UTC_S:
                self.utc_offset_s = utc_s - time.time()

    def sim_ns(self, autopilot_us: int) -> int | None:
        """Return the simulation time of an instant on the autopilot's clock, None while their relation is unknown."""
        if self._lockstep:
            stamp_ns = autopilot_us * 1000 - self._ahead_ns
            return stamp_ns if stamp_ns <= self._now_ns() + SETTLING_NS else None
        host_ns = self._timing.host_ns(autopilot_us * 1000)
        if host_ns is None or self._pace is None:
            return None
        return min(self._pace.sim_of_host(host_ns), self._now_ns())

    def report(self) -> ClockReport:
        """Return the relation of the clocks at the end."""
        if not self._lockstep:
            report, uneven = self._timing.report(), self._uneven
            return report if uneven is None else replace(report, steps=uneven.steps, stood_s=uneven.lost_s)
        if self._offset_ns is None:
            return ClockReport(NODE, None, None)
        return ClockReport(NODE, self._offset_ns * 1e-3, 0.0, self._trip_ns * 1e-3, samples=self._samples)

    def _answered(self, message: Any) -> None:
        sequence = self._requests.pop(message.ts1, None)
        if sequence is None:
            return
        if self._lockstep:
            clock: ClockExchange | None = self._exchange(sequence, message.ts1, message.tc1, self._local_ns())
        else:
            clock = self._measured(sequence, message.ts1, message.tc1)
        if clock is not None and self._recorder is not None:
            self._recorder.write(self._now_ns(), clock)

    def _measured(self, sequence: int, sent_ns: int, node_ns: int) -> ClockExchange | None:
        clock = self._timing.answered(dialect.MAVLink_xitl_timesync_message(sent_ns, node_ns, node_ns, sequence))
        if clock is None:
            return None
        uneven = self._uneven
        if uneven is None:
            return clock
        uneven.add(sent_ns, node_ns, sent_ns + round(clock.round_trip_s * 1e9))
        return replace(clock, steps=uneven.steps)

    def _exchange(self, sequence: int, sent_ns: int, node_ns: int, returned_ns: int) -> ClockExchange:
        self._samples += 1
        self._trip_ns = returned_ns - sent_ns
        self._offset_ns = node_ns - sent_ns
        self._ahead_ns = self._offset_ns if abs(self._offset_ns) > SETTLING_NS else 0
        trip_s, offset_s = self._trip_ns * 1e-9, self._offset_ns * 1e-9
        return ClockExchange(NODE, sequence, sent_ns, node_ns, trip_s, offset_s, 0.0, asymmetry_bound_s=trip_s)

    def _local_ns(self) -> int:
        return self._now_ns() if self._lockstep else time.monotonic_ns()
