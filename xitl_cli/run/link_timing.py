"""How long messages take on the link to an agent, and how its clock runs against the host's."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from agent.timing.sync import ClockSync
from agent.wire import dialect
from xitl_cli.recording.records import Clock
from xitl_cli.run.histogram import Histogram
from xitl_cli.run.pilot import ClockReport

NODE = "LC"
STAMPS_KEPT = 4096


class LinkTiming:
    """Real time: from the stamps of the messages that cross the link and a four-timestamp exchange."""

    def __init__(self) -> None:
        self.sensors = Histogram()
        self.actuators = Histogram()
        self._sync = ClockSync()
        self._requests = 0
        self._sent_at_ns: dict[int, int] = {}
        self._stamps: deque[int] = deque()

    def sent(self, messages: list[Any]) -> None:
        """Sensor samples that have just been sent; the IMU's are timed."""
        for message in messages:
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_IMU:
                self._sent_at_ns[message.time_usec] = time.monotonic_ns()
                self._stamps.append(message.time_usec)
                if len(self._stamps) > STAMPS_KEPT:
                    self._sent_at_ns.pop(self._stamps.popleft(), None)

    def arrived(self, message: Any) -> None:
        """XITL_ACTUATORS: how long it took, and how long the sample took that it was computed from."""
        if not self._sync.ready:
            return
        self.actuators.add(time.monotonic_ns() - self._sync.to_local(message.time_usec * 1000))
        sent_ns = self._sent_at_ns.pop(message.imu_time_usec, None)
        if sent_ns is not None:
            self.sensors.add(self._sync.to_local(message.imu_receive_usec * 1000) - sent_ns)

    def request(self) -> Any:
        """The next XITL_TIMESYNC to send, at once."""
        self._requests += 1
        return dialect.MAVLink_xitl_timesync_message(time.monotonic_ns(), 0, 0, self._requests)

    def answered(self, message: Any) -> Clock | None:
        """XITL_TIMESYNC that came back, as a record; None when no clocks could give such stamps."""
        returned_ns = time.monotonic_ns()
        if not self._sync.add(message.t1_ns, message.t2_ns, message.t3_ns, returned_ns):
            return None
        estimate = self._sync.estimate
        return Clock(
            node=NODE,
            sample=message.sequence,
            host_ns=message.t1_ns,
            node_ns=message.t2_ns,
            round_trip_s=(returned_ns - message.t1_ns - (message.t3_ns - message.t2_ns)) * 1e-9,
            offset_s=estimate.offset_ns * 1e-9,
            drift_ppm=estimate.drift_ppm,
        )

    def host_ns(self, agent_ns: int) -> int | None:
        """The host's monotonic clock at an instant of the agent's, None while their relation is unknown."""
        return self._sync.to_local(agent_ns) if self._sync.ready else None

    def report(self) -> ClockReport:
        """The relation of the clocks at the end."""
        if not self._sync.ready:
            return ClockReport(NODE, None, None)
        estimate = self._sync.estimate
        return ClockReport(
            NODE, estimate.offset_ns * 1e-3, estimate.drift_ppm, estimate.asymmetry_bound_ns * 1e-3, estimate.used
        )


class LockstepTiming(LinkTiming):
    """Time stands still while messages are on their way, and both ends read one clock."""

    def sent(self, messages: list[Any]) -> None:
        pass

    def arrived(self, message: Any) -> None:
        self.sensors.add(0)
        self.actuators.add(0)

    def report(self) -> ClockReport:
        return ClockReport(NODE, 0.0, 0.0, 0.0)
