"""The messages in which a node describes itself and its counts, field by field."""

from __future__ import annotations

import platform
from typing import Any

import pytest

import agent
from agent import reports
from agent.machine import Machine, MachineHealth
from agent.reports import Identity, node_info, node_status, task_miss, task_stats
from agent.roles.role import Traffic
from agent.timing.realtime import RealtimeState
from agent.timing.tasks import EMPTY, TaskMiss, TaskStats
from agent.wire import dialect
from agent.wire.link import LinkCounters

MOST = 2**32 - 1


BOARD = Machine("virtual", "b\u00f6ard", "Linux 6.1", False, 4, 512)


def test_a_node_says_what_it_is() -> None:
    message = node_info(5_678_901, Identity("LS,LC", BOARD))
    assert message.time_usec == 5678
    assert (message.memory_total_mib, message.processors, message.flags, message.priority) == (512, 4, 0, 0)
    assert message.kind == dialect.XITL_NODE_KIND_VIRTUAL
    texts = [getattr(message, name) for name in ("nodes", "version", "python", "machine", "kernel")]
    assert texts == [
        "LS,LC", agent.__version__, platform.python_version(), "b?ard", "Linux 6.1"
    ]  # fmt: skip


def test_what_a_node_has_is_a_flag_each() -> None:
    of_machine = {"preempt_rt": dialect.XITL_NODE_FLAGS_PREEMPT_RT}
    of_standing = {
        "memory_locked": dialect.XITL_NODE_FLAGS_MEMORY_LOCKED,
        "pinned": dialect.XITL_NODE_FLAGS_PINNED,
    }
    for name, flag in of_machine.items():
        assert node_info(0, Identity("LS", BOARD._replace(**{name: True}))).flags == flag
    for name, flag in of_standing.items():
        assert node_info(0, Identity("LS", BOARD, RealtimeState()._replace(**{name: True}))).flags == flag
    prioritised = node_info(0, Identity("LS", BOARD, RealtimeState()._replace(priority=7)))
    assert (prioritised.flags, prioritised.priority) == (dialect.XITL_NODE_FLAGS_REALTIME, 7)
    assert node_info(0, Identity("LS", BOARD, signed=True)).flags == dialect.XITL_NODE_FLAGS_SIGNED


def test_figures_that_do_not_fit_are_the_largest() -> None:
    message = node_info(
        0, Identity("x" * 40, BOARD._replace(kind="real", memory_mib=2**40, processors=2**20, name="n" * 90))
    )
    assert (message.memory_total_mib, message.processors) == (MOST, 0xFFFF)
    assert message.kind == dialect.XITL_NODE_KIND_REAL
    assert (message.nodes, message.machine) == ("x" * 16, "n" * 48)


def status(counters: LinkCounters, **keys: Any) -> Any:
    given: dict[str, Any] = {"impaired": 0, "traffic": Traffic(), "misses_unreported": 0, "health": reports.UNKNOWN}
    return node_status(9_000_999, counters, running=77, **{**given, **keys})


def test_a_status_has_the_counts_of_link_and_role() -> None:
    counters = LinkCounters(*range(10, 22), refused=4, strangers=5)
    message = status(counters, impaired=6, traffic=Traffic(1, 2, 3), misses_unreported=2**32 + 8)
    assert (message.time_usec, message.running, message.protocol) == (9000, 77, 2)
    assert (message.frames_sent, message.frames_received, message.frames_lost) == (10, 12, 13)
    assert (message.frames_refused, message.frames_impaired) == (9, 6)
    assert message.misses_unreported == 8  # it wraps at 32 bits
    for name, value in Traffic(1, 2, 3)._asdict().items():
        assert getattr(message, name) == value


def test_a_status_says_what_is_not_known() -> None:
    message = status(LinkCounters(*[0] * 12))
    assert message.temperature == 32767
    counted = status(LinkCounters(*[0] * 12), health=MachineHealth(12.5, 0.75, 41.257, 2**40))
    assert (counted.cpu_percent, counted.load_1min) == (12.5, 0.75)
    assert (counted.temperature, counted.memory_kib) == (4126, MOST)


def test_counts_of_a_task_wrap_and_times_saturate() -> None:
    histogram = tuple(range(100, 100 + len(EMPTY)))
    stats = TaskStats(
        "control loop too long", 50.0, 2**32 + 5, 2**32 + 1, 2**32 + 2, 7_999, 1500.0, 2**60, 2500.0, -1, 4_999,
        histogram, EMPTY,
    )  # fmt: skip
    message = task_stats(3_000, stats)
    assert (message.time_usec, message.rate_hz) == (3, 50.0)
    assert (message.cycles, message.missed, message.skipped) == (5, 1, 2)
    assert message.task == "control loop too"
    assert (message.start_jitter_max_usec, message.start_jitter_mean_usec) == (7, 1.5)
    assert (message.run_max_usec, message.run_mean_usec) == (MOST, 2.5)
    assert (message.worst_run_time_usec, message.worst_start_time_usec) == (0, 4)
    assert (tuple(message.start_jitter_histogram), tuple(message.run_histogram)) == (histogram, EMPTY)


@pytest.mark.parametrize("due_ns", [-5_000, 5_000])
def test_a_missed_deadline_has_its_instants_in_us(due_ns: int) -> None:
    miss = TaskMiss(task="control", cycle=2**32 + 3, due_ns=due_ns, start_ns=8_999, end_ns=9_500, skipped=2**40)
    message = task_miss(miss)
    assert (message.due_usec, message.start_usec, message.end_usec) == (max(due_ns, 0) // 1000, 8, 9)
    assert (message.cycle, message.skipped, message.task) == (3, MOST, "control")
