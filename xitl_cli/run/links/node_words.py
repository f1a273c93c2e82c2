"""What a machine in the loop says of itself (XITL_NODE_INFO, XITL_NODE_STATUS), for the recording and the summary."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect
from xitl_cli.record.records import NodeState
from xitl_cli.run.pilot import NodeReport

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
