"""Latency of the messages on the link to an agent, and the agent's clock against the host's."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from agent.timing.sync import ClockSync
from agent.wire import dialect
from xitl_cli.record.topics import ClockExchange
from xitl_cli.run.core.reports import ClockReport
from xitl_cli.run.core.statistics import DriftWindows, Histogram, TimeBase

STAMPS_KEPT = 4096


class LinkTiming:
    """Real time: timing from the stamps of the messages on the link and a four-timestamp exchange.

    `node`: owner of the clock. `uneven_ns`: as in ClockSync. `clock_ns`: the host's monotonic clock. sensors,
    actuators: latencies. Each is counted once a later exchange confirms the relation of the clocks. Latencies around a
    step of the clock are left out.
    """

    def __init__(self, node: str, clock_ns: Callable[[], int] = time.monotonic_ns, uneven_ns: float = 0.0) -> None:
        self.sensors = Histogram()
        self.actuators = Histogram()
        self._node = node
        self._clock_ns = clock_ns
        self._sync = ClockSync(uneven_ns=uneven_ns)
        self._drifts = DriftWindows(uneven_ns)
        self._time_base = TimeBase()
        self._requests = 0
        self._time_base_from = 0
        self._steps = 0
        self._unsettled: list[tuple[Histogram, int]] = []
        self._sent_at_ns: dict[int, int] = {}
        self._stamps: deque[int] = deque()

    def begin(self) -> None:
        """Begin the run: its time base starts with the next request."""
        self._time_base = TimeBase()
        self._time_base_from = self._requests

    def sent(self, messages: list[Any]) -> None:
        """Note the sensor samples that are about to be sent; only IMU samples are timed."""
        for message in messages:
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_IMU:
                self._sent_at_ns[message.time_usec] = self._clock_ns()
                self._stamps.append(message.time_usec)
                if len(self._stamps) > STAMPS_KEPT:
                    self._sent_at_ns.pop(self._stamps.popleft(), None)

    def arrived(self, message: Any) -> None:
        """Note XITL_ACTUATORS: its latency, and the latency of the sample that it was computed from."""
        if not self._sync.ready:
            return
        took_ns = self._clock_ns() - self._sync.to_local(message.time_usec * 1000)
        self._unsettled.append((self.actuators, took_ns))
        sent_ns = self._sent_at_ns.pop(message.imu_time_usec, None)
        if sent_ns is not None:
            self._unsettled.append((self.sensors, self._sync.to_local(message.imu_receive_usec * 1000) - sent_ns))
        if len(self._unsettled) > STAMPS_KEPT:
            self.settle()

    def settle(self) -> None:
        """Count the latencies that wait for an exchange, for example at the end of a run."""
        for histogram, took_ns in self._unsettled:
            histogram.add(took_ns)
        self._unsettled.clear()

    def request(self, frames_sent: int) -> Any:
        """Return the next XITL_TIMESYNC, to be sent at once. frames_sent: frames sent before it."""
        self._requests += 1
        return dialect.MAVLink_xitl_timesync_message(self._clock_ns(), 0, 0, self._requests, frames_sent & 0xFFFFFFFF)

    def answered(self, message: Any) -> ClockExchange | None:
        """Return an answered XITL_TIMESYNC as a record, or None for stamps that are impossible for two clocks."""
        t1_ns, t2_ns, t3_ns, t4_ns = message.t1_ns, message.t2_ns, message.t3_ns, self._clock_ns()
        if not self._sync.add(t1_ns, t2_ns, t3_ns, t4_ns):
            return None
        self._drifts.add(t1_ns, t2_ns, t3_ns, t4_ns)
        estimate = self._sync.estimate
        if estimate.steps != self._steps:
            self._steps = estimate.steps
            self._unsettled.clear()
            self._time_base = TimeBase()
        elif not self._sync.doubtful:
            self.settle()
        if message.sequence > self._time_base_from:
            self._time_base.add(message.sequence, t2_ns)
        return ClockExchange(
            node=self._node,
            sample=message.sequence,
            host_ns=t1_ns,
            node_ns=t2_ns,
            round_trip_s=(t4_ns - t1_ns - (t3_ns - t2_ns)) * 1e-9,
            offset_s=estimate.offset_ns * 1e-9,
            drift_ppm=estimate.drift_ppm,
            residual_s=((t2_ns - t1_ns + t3_ns - t4_ns) / 2 - estimate.offset_ns) * 1e-9,
            path_delay_s=estimate.path_delay_ns * 1e-9,
            asymmetry_bound_s=estimate.asymmetry_bound_ns * 1e-9,
            steps=estimate.steps,
            drift_error_ppm=estimate.drift_error_ppm,
        )

    def host_ns(self, agent_ns: int) -> int | None:
        """Return the host's monotonic clock at an instant of the agent's clock, or None while it is unknown."""
        return self._sync.to_local(agent_ns) if self._sync.ready else None

    def report(self) -> ClockReport:
        """Return the relation of the clocks at the end."""
        if not self._sync.ready:
            return ClockReport(self._node, None, None)
        estimate, slope = self._sync.estimate, self._time_base.slope
        return ClockReport(
            self._node,
            offset_us=estimate.offset_ns * 1e-3,
            drift_ppm=estimate.drift_ppm,
            asymmetry_bound_us=estimate.asymmetry_bound_ns * 1e-3,
            samples=estimate.used,
            residual_us=estimate.residual_ns * 1e-3,
            path_delay_us=estimate.path_delay_ns * 1e-3,
            drift_std_ppm=self._drifts.deviation_ppm,
            slope_s=slope.mean_s,
            slope_std_s=slope.deviation_s,
            steps=estimate.steps,
            drift_error_ppm=estimate.drift_error_ppm,
        )


class LockstepTiming(LinkTiming):
    """Lockstep: no time passes while messages are in transit, and both ends read one clock."""

    def sent(self, messages: list[Any]) -> None:
        pass

    def arrived(self, message: Any) -> None:
        self.sensors.add(0)
        self.actuators.add(0)
        self._time_base.add(message.tick, message.time_usec * 1000)

    def host_ns(self, agent_ns: int) -> int | None:
        return agent_ns

    def report(self) -> ClockReport:
        slope = self._time_base.slope
        return ClockReport(self._node, 0.0, 0.0, 0.0, slope_s=slope.mean_s, slope_std_s=slope.deviation_s)
