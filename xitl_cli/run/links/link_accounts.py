"""Counts of both ends of a link, and what an agent says of its machine, for the recording and the summary."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect
from agent.wire.link import Link, LinkCounters
from xitl_cli.record.topics import LinkState, NodeState
from xitl_cli.run.core.reports import LinkReport, NodeReport
from xitl_cli.run.core.statistics import Histogram
from xitl_cli.run.links.link_timing import LinkTiming


class LinkAccounts:
    """One link. The agent's XITL_NODE_STATUS tells its side; the two ends agree once it has answered the stop.

    What came from the agent is counted from the status that answers the start to the one that answers the stop. A
    status counts what was sent before it was made; on a slow line messages made earlier may still go out before it
    does, which the sequence numbers of the two tell. Until the ends agree, lost is what the receiver misses: see
    `SequenceMonitor`. It has the host's totals from XITL_TIMESYNC, the agent's from each status.

    link: the host's end, to be set before a status comes. heard: good frames from the agent so far, to be counted one
    by one, each after it has been looked at. over: the run is; if the ends did not agree then, what arrived at the
    agent stays unknown.
    """

    link: Link

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
        """A status has come: the next that answers the start may be this one."""
        self._latest = status, self.heard
        self.link.heard_total(status.frames_sent, self.heard)

    def started(self) -> None:
        """The latest status answers the start."""
        self._base, self._base_heard = self._latest
        self._base_repeated = self.link.counters.repeated

    def stopped(self, status: Any, sent: int) -> None:
        """The status that answers the stop, the latest if several do; `sent` frames went out up to the latest stop."""
        self._final, self._final_sent = status, sent

    def reports(self, prefix: str, impaired: int, status: Any, timing: LinkTiming) -> tuple[LinkReport, LinkReport]:
        """Towards the agent, and from it. `impaired`: frames that the host kept back; `status`: the latest, or None."""
        counters = self.link.counters
        return (
            self._to_agent(prefix, counters, impaired, status, timing.sensors),
            self._from_agent(prefix, counters, status, timing.actuators),
        )

    def _to_agent(
        self, prefix: str, counters: LinkCounters, impaired: int, status: Any, latency: Histogram
    ) -> LinkReport:
        if status is None:
            return LinkReport(
                f"{prefix}sensors", counters.sent, None, None, counters.unsent, 0, latency, impaired=impaired
            )
        received, lost, sent = status.frames_received, status.frames_lost, counters.sent
        if self._final is not None:
            sent = self._final_sent
            lost = max(sent - (received - status.frames_repeated), 0)
        elif self.over:
            received = lost = None
        return LinkReport(
            name=f"{prefix}sensors",
            sent=sent,
            received=received,
            lost=lost,
            unsent=counters.unsent,
            dropped=status.frames_dropped,
            latency=latency,
            gaps=status.frames_lost,
            late=status.frames_late,
            repeated=status.frames_repeated,
            refused=status.frames_refused,
            impaired=impaired,
        )

    def _from_agent(self, prefix: str, counters: LinkCounters, status: Any, latency: Histogram) -> LinkReport:
        sent: int | None = None
        lost: int | None = counters.lost
        received, repeated = self.heard - self._base_heard, counters.repeated - self._base_repeated
        if self._final is not None and self._base is not None:
            sent = self._sent_by_agent()
            lost = max(sent - (received - repeated), 0)
        elif self.over:
            lost = None
        return LinkReport(
            name=f"{prefix}actuators",
            sent=sent,
            received=received,
            lost=lost,
            unsent=None if status is None else status.frames_unsent,
            dropped=counters.dropped,
            latency=latency,
            gaps=counters.lost,
            late=counters.late,
            repeated=repeated,
            refused=counters.refused,
            impaired=None if status is None else status.frames_impaired,
        )

    def _sent_by_agent(self) -> int:
        """Frames from the status that answered the start, with it, to the one that answered the stop, with it."""
        counted: int = self._final.frames_sent - self._base.frames_sent
        numbers: int = self._final.get_seq() - self._base.get_seq()
        return counted + (numbers - counted + 128) % 256 - 128 + 1


def link_state(report: LinkReport) -> LinkState:
    """The same for the recording."""
    p50_ns, p99_ns = report.latency.quantile_ns(0.5), report.latency.quantile_ns(0.99)
    return LinkState(
        name=report.name,
        sent=report.sent,
        received=report.received,
        lost=report.lost,
        gaps=report.gaps,
        late=report.late,
        repeated=report.repeated,
        dropped=report.dropped,
        unsent=report.unsent,
        refused=report.refused,
        impaired=report.impaired,
        latency_p50_s=None if p50_ns is None else p50_ns * 1e-9,
        latency_p99_s=None if p99_ns is None else p99_ns * 1e-9,
        latency_max_s=report.latency.max_ns * 1e-9 if report.latency.count else None,
    )


_NO_TEMPERATURE = 32767
_FLAGS = {
    dialect.XITL_NODE_FLAGS_PREEMPT_RT: "PREEMPT_RT",
    dialect.XITL_NODE_FLAGS_REALTIME: "SCHED_FIFO",
    dialect.XITL_NODE_FLAGS_MEMORY_LOCKED: "memory locked",
    dialect.XITL_NODE_FLAGS_PINNED: "pinned to processors",
    dialect.XITL_NODE_FLAGS_SIGNED: "signed link",
}


def node_report(link: str, info: Any, status: Any) -> NodeReport:
    """For the summary. `status` is the latest."""
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
        estimates=status.estimates,
        efforts=status.efforts,
        log_dropped=status.log_dropped,
        stations_missed=status.stations_missed,
        events_lost=status.events_lost,
        controller_failures=status.controller_failures,
    )


def node_state(link: str, info: Any, status: Any) -> NodeState:
    """For the recording."""
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
    """An agent that tells its memory tells its processor time too."""
    return status.cpu_percent if status.memory_kib else None


def _temperature_c(status: Any) -> float | None:
    return None if status.temperature == _NO_TEMPERATURE else status.temperature / 100.0
