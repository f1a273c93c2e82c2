"""The loop of a node against a clock that only the waits advance: how long it waits, and when its tasks run."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from node_host import BOARD, HandClock

from agent import node
from agent.faults import AgentFaults
from agent.node import IDLE_WAIT_S, AgentNode
from agent.reports import Identity
from agent.roles.role import Role
from agent.timing import deadline
from agent.timing.deadline import SPIN_NS
from agent.timing.tasks import Executor
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair

MS = 1_000_000


class Tasks(Role):
    """Two tasks in a run, and perhaps one for peers. ran: their starts, in nanoseconds after the start of the clock."""

    title, nodes, telemetry_hz = "tasks", "LC", 4.0

    def __init__(self, rates_hz: dict[str, float], peers_hz: float = 0.0) -> None:
        self.ran: dict[str, list[int]] = {}
        self._rates_hz, self._peers_hz = rates_hz, peers_hz
        self.served_ns: list[int] = []

    def reset(self, clock: Any, lockstep: bool) -> None:
        pass

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        for name, rate_hz in self._rates_hz.items():
            self._add(executor, name, rate_hz)

    def add_peer_tasks(self, executor: Executor) -> None:
        if self._peers_hz:
            self._add(executor, "peers", self._peers_hz)

    def _add(self, executor: Executor, name: str, rate_hz: float) -> None:
        starts = self.ran.setdefault(name, [])
        executor.add(name, rate_hz, starts.append)

    def handle(self, message: Any, now_ns: int) -> Sequence[Any]:
        return []

    def telemetry(self, now_ns: int) -> Sequence[Any]:
        return []

    def serve_peers(self, now: Callable[[], int]) -> None:
        self.served_ns.append(now())


class Bench:
    """A node whose link waits as long as it is asked to, and `late_ns` longer. waits_s: how long it was asked to.

    collects: whether Python collected garbage by itself meanwhile.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, role: Tasks, late_ns: int = 0) -> None:
        here, there = memory_pair()
        self.host, self.clock, self.waits_s, self.role = Link(here, 255, 190), HandClock(), list[float](), role
        self.collects: list[bool] = []
        faults = AgentFaults(self.clock)
        self.link = link = Link(faults.wrap(there), 1, 1)
        receive = link.receive

        def waited(timeout_s: float = 0.0) -> list[Any]:
            self.waits_s.append(timeout_s)
            self.collects.append(gc.isenabled())
            messages = receive(0.0)
            if timeout_s and not messages:
                self.clock.time_ns += round(timeout_s * 1e9) + late_ns
            return messages

        def spin(left_ns: int) -> None:
            assert 0 < left_ns <= SPIN_NS
            self.clock.time_ns += left_ns

        monkeypatch.setattr(link, "receive", waited)
        monkeypatch.setattr(deadline, "spin_ns", spin)
        monkeypatch.setattr(deadline, "set_timer_slack_ns", lambda slack_ns: None)
        self.node = AgentNode(link, role, Identity(role.nodes, BOARD), faults, 0.0, self.clock)

    def start(self, mode: int) -> None:
        self.host.send(mav.MAVLink_xitl_run_message(0, b"test", mav.XITL_RUN_COMMAND_START, mode, 2))

    def serve_until(self, time_ns: int) -> None:
        left = iter(range(1000))
        self.node.serve(lambda: next(left) >= 0 and self.clock.time_ns < time_ns)


def test_tasks_start_at_their_deadlines_and_nothing_else_wakes_the_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 10 Hz and 25 Hz: each wait ends 50 µs before the next deadline, and the rest is spent on reading the clock."""
    role = Tasks({"slow": 10.0, "fast": 25.0})
    bench = Bench(monkeypatch, role)
    bench.start(mav.XITL_CLOCK_MODE_REALTIME)
    bench.node.poll()
    bench.serve_until(1000 * MS)
    assert role.ran == {"slow": [100 * MS * n for n in range(11)], "fast": [40 * MS * n for n in range(26)]}
    deadlines = sorted({*range(0, 1001, 100), *range(0, 1001, 40), *range(0, 1001, 250)})
    waits_ms = [deadlines[n + 1] - deadlines[n] - SPIN_NS / MS for n in range(len(deadlines) - 1)]
    assert [1e3 * wait_s for wait_s in bench.waits_s if wait_s] == pytest.approx(waits_ms)
    assert not bench.node.executor.misses
    assert not any(bench.collects[1:]), "before a deadline, garbage is collected only where there is time"
    assert gc.isenabled()


@pytest.mark.medium
@pytest.mark.parametrize("late_ns", [SPIN_NS, SPIN_NS + 1, 3 * MS])
def test_a_wait_that_ends_late_is_followed_by_the_task_at_once(monkeypatch: pytest.MonkeyPatch, late_ns: int) -> None:
    role = Tasks({"fast": 25.0})
    bench = Bench(monkeypatch, role, late_ns)
    bench.start(mav.XITL_CLOCK_MODE_REALTIME)
    bench.node.poll()
    bench.serve_until(200 * MS)
    assert role.ran["fast"] == [0, *(40 * MS * n + late_ns - SPIN_NS for n in range(1, 6))]


@pytest.mark.medium
def test_deadlines_far_ahead_are_waited_for_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    role = Tasks({}, peers_hz=0.5)
    bench = Bench(monkeypatch, role)
    bench.serve_until(2000 * MS)
    assert role.ran["peers"] == [0, 2000 * MS]
    assert [wait_s for wait_s in bench.waits_s if wait_s] == pytest.approx([0.49995] * 4 + [0.00015])


@pytest.mark.medium
@pytest.mark.parametrize("lockstep", [False, True])
def test_without_deadlines_it_waits_for_the_host(monkeypatch: pytest.MonkeyPatch, lockstep: bool) -> None:
    """Between runs, and in lockstep, in which only ticks run the tasks."""
    role = Tasks({"fast": 25.0})
    bench = Bench(monkeypatch, role)
    if lockstep:
        bench.start(mav.XITL_CLOCK_MODE_LOCKSTEP)
        bench.node.poll()
    bench.serve_until(1500 * MS)
    assert [wait_s for wait_s in bench.waits_s if wait_s] == [IDLE_WAIT_S] * 3
    assert role.ran.get("fast", []) == ([0] if lockstep else [])
    if not lockstep:
        assert role.served_ns[-3:] == [500 * MS, 1000 * MS, 1500 * MS], "peers are served with each poll"
    assert all(bench.collects)
    bench.serve_until(0)
    assert bench.clock.time_ns == 1500 * MS


@pytest.mark.parametrize(
    ("peers", "host", "wake_s", "waited", "left_s"),
    [
        ((), 5, None, [], 0.3),
        ((7, 8), None, None, [], 0.3),  # a host without a descriptor
        ((7, 8), 5, None, [((5, 7, 8), 0.3)], 0.0),
        ((7, 8), 5, 0.1, [((5, 7, 8), 0.1)], 0.0),  # the link has something to send by then
        ((7, 8), 5, 0.5, [((5, 7, 8), 0.3)], 0.0),
    ],
)
def test_a_wait_ends_with_bytes_of_the_host_or_of_a_peer(
    monkeypatch: pytest.MonkeyPatch, peers: tuple[int, ...], host: int | None, wake_s: float | None,
    waited: list[Any], left_s: float,
) -> None:  # fmt: skip
    waits: list[Any] = []
    monkeypatch.setattr(node, "wait_readable", lambda descriptors, timeout_s: waits.append((descriptors, timeout_s)))
    role = Tasks({})
    monkeypatch.setattr(role, "descriptors", lambda: peers)
    bench = Bench(monkeypatch, role)
    monkeypatch.setattr(bench.link.transport, "fileno", lambda: host)
    monkeypatch.setattr(bench.link, "wake_s", lambda: wake_s)
    bench.node.poll(0.3)
    assert (waits, bench.waits_s) == (waited, [left_s])
    waits.clear()
    bench.node.poll()
    assert waits == [], "a poll does not wait"
