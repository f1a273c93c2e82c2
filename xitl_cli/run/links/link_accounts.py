"""Counts of both ends of a link, and an agent's report of its machine, for the recording and the summary."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from agent.timing.sync import ClockSync
from agent.wire import dialect
from agent.wire.link import Link
from xitl_cli.graph.graph import AgentTraffic
from xitl_cli.record.topics import RECEIVER, SENDER, ClockExchange, LinkReport, NodeState
from xitl_cli.run.core.reports import ClockReport, NodeReport
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


class LinkAccounts:
    """Counts of one link.

    The agent reports its counts in XITL_NODE_STATUS. The two ends agree once the agent has answered the stop.

    Frames from the agent are counted from the status that answers the start to the status that answers the stop. A
    status counts the frames that were sent before it was made. On a slow line, older messages may still leave before
    the status; the sequence numbers of both show that. Until the ends agree, lost is the number of frames that the
    receiver misses: see `SequenceMonitor`. The agent gets the host's totals from XITL_TIMESYNC, and the host the
    agent's from each status.

    heard: valid frames from the agent so far. Count each frame after it was handled. over: the run is over. If the ends
    did not agree by then, the number of frames that reached the agent stays unknown.
    """

    link: Link
    """The host's end. Set it before the first status."""

    def __init__(self) -> None:
        self.heard = 0
        self.over = False
        self._latest: tuple[Any, int] = (None, 0)
        self._base: Any = None
        self._base_heard = 0
        self._base_repeated = 0
        self._final: Any = None
        self._final_sent = 0

    def status(self, status: Any) -> None:
        """Note a status. It may be the answer to the next start."""
        self._latest = status, self.heard
        self.link.heard_total(status.frames_sent, self.heard)

    def started(self) -> None:
        """Note that the latest status answers the start."""
        self._base, self._base_heard = self._latest
        self._base_repeated = self.link.counters.repeated

    def stopped(self, status: Any, sent: int) -> None:
        """Note the status that answers the stop, or the latest of several.

        sent: frames sent up to the latest stop.
        """
        self._final, self._final_sent = status, sent

    def reports(self, prefix: str, impaired: int, status: Any, timing: LinkTiming) -> tuple[LinkReport, LinkReport]:
        """Return the reports towards the agent and from it.

        `impaired`: frames that the host dropped. `status`: the latest, or None.
        """
        counters = self.link.counters

        def host(name: str) -> int | None:
            return impaired if name == "impaired" else getattr(counters, name)

        def agent(name: str) -> int | None:
            return None if status is None else getattr(status, f"frames_{name}")

        counted = _counts(sender=host, receiver=agent)
        sent, received, lost = host("sent"), agent("received"), counted["gaps"]
        if status is not None and self._final is not None:
            sent = self._final_sent
            lost = max(sent - (status.frames_received - status.frames_repeated), 0)
        elif self.over:
            received = lost = None
        to_agent = LinkReport(f"{prefix}sensors", sent, received, lost, **counted, **_latencies(timing.sensors))

        counted = _counts(sender=agent, receiver=host)
        counted["repeated"] = repeated = counters.repeated - self._base_repeated
        sent, received, lost = None, self.heard - self._base_heard, counted["gaps"]
        if self._final is not None and self._base is not None:
            # Frames from the status that answered the start to the status that answered the stop, both included
            counted_frames: int = self._final.frames_sent - self._base.frames_sent
            numbers: int = self._final.get_seq() - self._base.get_seq()
            sent = counted_frames + (numbers - counted_frames + 128) % 256 - 128 + 1
            lost = max(sent - (received - repeated), 0)
        elif self.over:
            lost = None
        return to_agent, LinkReport(
            f"{prefix}actuators", sent, received, lost, **counted, **_latencies(timing.actuators)
        )


_End = Callable[[str], "int | None"]
"""Returns a count of one end of a link by its name, None if the end has not reported it."""


def _counts(sender: _End, receiver: _End) -> dict[str, Any]:
    """Return the counters of LinkReport by name, each from the end that counts it."""
    ends = {SENDER: sender, RECEIVER: receiver}
    return {
        counter.name: ends[counter.metadata["end"]](counter.metadata["key"] or counter.name)
        for counter in fields(LinkReport)
        if counter.metadata
    }


def _latencies(latency: Histogram) -> dict[str, Any]:
    p50_ns, p99_ns = latency.quantile_ns(0.5), latency.quantile_ns(0.99)
    return {
        "latency_p50_s": None if p50_ns is None else p50_ns * 1e-9,
        "latency_p99_s": None if p99_ns is None else p99_ns * 1e-9,
        "latency_max_s": latency.max_ns * 1e-9 if latency.count else None,
    }


_NO_TEMPERATURE = 32767
_FLAGS = {
    dialect.XITL_NODE_FLAGS_PREEMPT_RT: "PREEMPT_RT",
    dialect.XITL_NODE_FLAGS_REALTIME: "SCHED_FIFO",
    dialect.XITL_NODE_FLAGS_MEMORY_LOCKED: "memory locked",
    dialect.XITL_NODE_FLAGS_PINNED: "pinned to processors",
    dialect.XITL_NODE_FLAGS_SIGNED: "signed link",
}


def node_report(link: str, info: Any, status: Any) -> NodeReport:
    """Return the report for the summary. `status`: the latest status."""
    return NodeReport(
        nodes=info.nodes,
        machine=info.machine,
        version=info.version,
        memory_mib=_memory_mib(status),
        refused=status.messages_refused,
        link=link,
        kind=_kind(info),
        kernel=info.kernel,
        python=info.python,
        flags=_flags(info),
        processors=info.processors or None,
        temperature_c=_temperature_c(status),
        cpu_percent=_cpu_percent(status),
        **{count.name: getattr(status, count.name) for count in fields(NodeReport) if count.metadata},
    )


def agent_traffic(
    node: NodeReport, links: Sequence[LinkReport], frames: Mapping[str, Mapping[int, int]]
) -> AgentTraffic:
    """Return the traffic of an agent for the graph of the run.

    links: reports of its links. If no sensor frame arrived, no frame to the agent counts. frames: numbers of frames by
    direction (`tx` to the agent, `rx` from it) and message id.
    """
    sensors = "sensors" if node.link == "agent" else f"{node.link} sensors"
    cut = any(link.name == sensors and link.received == 0 for link in links)
    return AgentTraffic(
        nodes=node.nodes,
        kind=node.kind,
        machine=node.machine,
        to_agent={} if cut else frames["tx"],
        from_agent=frames["rx"],
        estimates=node.estimates,
        efforts=node.efforts,
    )


def node_state(link: str, info: Any, status: Any) -> NodeState:
    """Return the record of the node's state."""
    return NodeState(
        node=link,
        nodes=info.nodes,
        kind=_kind(info),
        machine=info.machine,
        kernel=info.kernel,
        version=info.version,
        memory_mib=_memory_mib(status),
        cpu_percent=_cpu_percent(status),
        load=status.load_1min if status.load_1min >= 0.0 else None,
        temperature_c=_temperature_c(status),
        running=bool(status.running),
        flags=", ".join(_flags(info)),
    )


def _kind(info: Any) -> str:
    return "real" if info.kind == dialect.XITL_NODE_KIND_REAL else "virtual"


def _flags(info: Any) -> tuple[str, ...]:
    return tuple(words for flag, words in _FLAGS.items() if info.flags & flag)


def _memory_mib(status: Any) -> float | None:
    return status.memory_kib / 1024 if status.memory_kib else None


def _cpu_percent(status: Any) -> float | None:
    """Return the processor load. An agent that reports its memory reports its load too."""
    return status.cpu_percent if status.memory_kib else None


def _temperature_c(status: Any) -> float | None:
    return None if status.temperature == _NO_TEMPERATURE else status.temperature / 100.0
