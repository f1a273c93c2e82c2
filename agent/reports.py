"""Reports of a node to the host. Counters wrap at 32 bits; durations saturate at the largest value that fits."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import NamedTuple

import agent
from agent.machine import REAL, Machine, MachineHealth
from agent.roles.role import Traffic
from agent.timing.realtime import RealtimeState
from agent.timing.tasks import TaskMiss, TaskStats
from agent.wire import dialect
from agent.wire.codec import Message
from agent.wire.link import LinkCounters

PROTOCOL = 2
_MOST = 0xFFFFFFFF
_NO_TEMPERATURE = 32767
UNKNOWN = MachineHealth(0.0, -1.0, None, 0)


class Identity(NamedTuple):
    """Identity of a node."""

    nodes: str
    """Node kinds."""
    machine: Machine
    standing: RealtimeState = RealtimeState()
    signed: bool = False
    """Whether it accepts only signed frames from the host."""


def node_info(now_ns: int, who: Identity) -> Message:
    """XITL_NODE_INFO."""
    machine, standing = who.machine, who.standing
    flags = dialect.XITL_NODE_FLAGS_PREEMPT_RT if machine.preempt_rt else 0
    flags |= dialect.XITL_NODE_FLAGS_REALTIME if standing.priority else 0
    flags |= dialect.XITL_NODE_FLAGS_MEMORY_LOCKED if standing.memory_locked else 0
    flags |= dialect.XITL_NODE_FLAGS_PINNED if standing.pinned else 0
    flags |= dialect.XITL_NODE_FLAGS_SIGNED if who.signed else 0
    message: Message = dialect.MAVLink_xitl_node_info_message(
        now_ns // 1000,
        min(machine.memory_mib, _MOST),
        min(machine.processors, 0xFFFF),
        flags,
        dialect.XITL_NODE_KIND_REAL if machine.kind == REAL else dialect.XITL_NODE_KIND_VIRTUAL,
        standing.priority,
        PROTOCOL,
        _text(who.nodes, 16),
        _text(agent.__version__, 16),
        _text(".".join(map(str, sys.version_info[:3])), 16),
        _text(machine.name, 48),
        _text(machine.kernel, 64),
    )
    return message


def node_status(
    now_ns: int,
    counters: LinkCounters,
    impaired: int,
    traffic: Traffic,
    misses_unreported: int,
    health: MachineHealth,
    running: int,
) -> Message:
    """XITL_NODE_STATUS. counters: values before this message. running: token of the run, 0 between runs.

    A field `frames_x` of the message is the count `x` of the link. Other counts have the names of Traffic.
    """
    degrees = health.temperature_degc
    frames = asdict(counters)
    frames.update(dropped=counters.dropped, refused=counters.refused + counters.strangers, impaired=impaired)
    counts = {**traffic._asdict(), **{f"frames_{name}": count for name, count in frames.items()}}
    kind = dialect.MAVLink_xitl_node_status_message
    message: Message = kind(
        time_usec=now_ns // 1000,
        misses_unreported=misses_unreported & _MOST,
        memory_kib=min(health.memory_kib, _MOST),
        cpu_percent=health.cpu_percent,
        load_1min=health.load_1min,
        temperature=_NO_TEMPERATURE if degrees is None else round(100.0 * degrees),
        running=running,
        protocol=PROTOCOL,
        **{name: counts[name] & _MOST for name in kind.fieldnames if name in counts},
    )
    return message


def task_stats(now_ns: int, stats: TaskStats) -> Message:
    """XITL_TASK_STATS."""
    message: Message = dialect.MAVLink_xitl_task_stats_message(
        now_ns // 1000,
        max(stats.worst_run_ns, 0) // 1000,
        max(stats.worst_start_ns, 0) // 1000,
        stats.rate_hz,
        stats.cycles & _MOST,
        stats.missed & _MOST,
        stats.skipped & _MOST,
        min(stats.start_jitter_max_ns // 1000, _MOST),
        stats.start_jitter_mean_ns * 1e-3,
        min(stats.run_max_ns // 1000, _MOST),
        stats.run_mean_ns * 1e-3,
        list(stats.start_jitter_histogram),
        list(stats.run_histogram),
        _text(stats.name, 16),
    )
    return message


def task_miss(miss: TaskMiss) -> Message:
    """XITL_TASK_MISS."""
    message: Message = dialect.MAVLink_xitl_task_miss_message(
        max(miss.due_ns, 0) // 1000,
        max(miss.start_ns, 0) // 1000,
        max(miss.end_ns, 0) // 1000,
        miss.cycle & _MOST,
        min(miss.skipped, _MOST),
        _text(miss.task, 16),
    )
    return message


def _text(text: str, most: int) -> bytes:
    return text.encode("ascii", "replace")[:most]
