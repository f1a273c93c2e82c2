"""The life of a run at a node, and what it reports: with a clock turned by hand."""

from __future__ import annotations

import pytest
from node_host import BOARD, HELLO, LOCKSTEP, MS, REALTIME, START, STOP, Host, LogDouble, of

import agent
from agent.timing.tasks import MOST_KEPT, TaskMiss
from agent.wire import dialect as mav


def kinds(messages: list[object]) -> list[str]:
    return [message.get_type() for message in messages]  # type: ignore[attr-defined]


def test_hello_is_answered_and_changes_nothing() -> None:
    host = Host()
    for _ in range(2):
        info, status = host.run(HELLO)
        assert (info.get_type(), status.get_type()) == ("XITL_NODE_INFO", "XITL_NODE_STATUS")
        assert status.running == 0
    host.run(START)
    assert host.run(HELLO)[-1].running == 1


def test_who_it_is() -> None:
    info, _ = Host().run(HELLO)
    assert (info.nodes, info.version, info.machine, info.kernel) == (
        "LS,LC,LA",
        agent.__version__,
        BOARD.name,
        BOARD.kernel,
    )
    assert (info.memory_total_mib, info.processors, info.protocol) == (480, 1, 2)
    assert info.kind == mav.XITL_NODE_KIND_REAL
    assert info.flags == mav.XITL_NODE_FLAGS_PREEMPT_RT
    assert info.priority == 0


def test_start_says_that_it_runs_and_counts_from_zero() -> None:
    host = Host()
    host.run(HELLO)
    status = of("XITL_NODE_STATUS", host.run(START))[-1]
    assert (status.running, status.frames_received) == (1, 0)  # the start itself came before the counting
    said = host.live(1.0)
    status = of("XITL_NODE_STATUS", said)[-1]
    assert status.frames_received == 50
    assert status.frames_lost == 0
    assert status.memory_kib > 1000
    assert 0.0 <= status.cpu_percent < 10_000.0


def test_the_counts_of_frames_are_of_the_instant_before_the_status() -> None:
    host = Host()
    host.run(START)
    status = of("XITL_NODE_STATUS", host.live(1.0))[-1]
    assert host.frames[status.frames_sent] == status.get_msgbuf()


def test_stop_ends_neutral_and_is_answered_every_time() -> None:
    host = Host()
    host.run(START)
    host.live(0.5)
    assert host.autopilot.arm(force=True) == ()
    host.live(0.1)
    for _ in range(3):
        said = host.run(STOP)
        assert kinds(said) == [
            "XITL_ACTUATORS",
            *["XITL_TASK_STATS"] * 3,
            "XITL_NODE_INFO",
            "XITL_NODE_STATUS",
        ]
        actuators, *tasks, _, status = said
        assert (actuators.flags, list(actuators.command)) == (0, [0.0] * 8)
        assert {task.task for task in tasks} == {"control", "telemetry", "status"}
        assert status.running == 0
    assert not host.autopilot.state.armed
    assert host.live(2.0) == []


def test_a_stop_before_any_run_has_no_statistics() -> None:
    assert kinds(Host().run(STOP)) == ["XITL_NODE_INFO", "XITL_NODE_STATUS"]


def test_a_second_start_starts_over() -> None:
    host = Host()
    host.run(START)
    host.live(1.0)
    first = host.autopilot
    assert first.arm(force=True) == ()
    assert of("XITL_NODE_STATUS", host.run(START))[-1].running == 1
    assert host.autopilot is not first
    assert not first.state.armed
    said = host.live(1.0)
    (control,) = [task for task in of("XITL_TASK_STATS", said) if task.task == "control"][-1:]
    assert control.cycles == 51


def test_task_statistics_have_their_histograms() -> None:
    host = Host()
    host.run(START)
    said = host.live(2.0, step_ns=23 * MS)  # the tasks are late by 0 to 20 ms and never skip more than they must
    told = [task for task in of("XITL_TASK_STATS", said) if task.task == "control"][-1]
    assert sum(told.start_jitter_histogram) == sum(told.run_histogram) == told.cycles
    assert told.run_histogram[0] == told.cycles  # the clock stands still in a run
    assert 16_384 <= told.start_jitter_max_usec <= 23_000
    assert told.start_jitter_histogram[14] > 0
    assert told.worst_start_time_usec % 23_000 == 0
    assert told.rate_hz == 50.0


def test_each_missed_deadline_is_told_and_logged() -> None:
    log = LogDouble()
    host = Host(log=log)
    host.run(START)
    host.live(0.2)
    host.clock.time_ns += 70 * MS
    said = host.live(0.06)
    told = of("XITL_TASK_MISS", said)
    assert {miss.task for miss in told} == {"control", "log", "telemetry"}
    control = next(miss for miss in told if miss.task == "control")
    # The last run was at 200 ms; that of 220 ms comes at 290 ms, when those of 240 and 260 and 280 are due too.
    assert (control.cycle, control.due_usec, control.start_usec, control.skipped) == (11, 220_000, 290_000, 3)
    assert [miss.task for miss in log.misses] == [miss.task for miss in told]
    assert of("XITL_NODE_STATUS", host.live(1.0))[-1].misses_unreported == 0


def test_of_many_misses_ten_a_cycle_are_told() -> None:
    host = Host(silence_s=0.0)
    host.run(START)
    misses = host.node.executor.misses
    for cycle in range(MOST_KEPT + 3):
        misses.add(TaskMiss("control", cycle, 0, 0, 0, 0))
    told = [len(of("XITL_TASK_MISS", host.live(0.02))) for _ in range(8)]
    assert told == [10] * 6 + [4, 0]
    assert of("XITL_NODE_STATUS", host.live(1.0))[-1].misses_unreported == 3


def test_what_passes_between_its_parts_is_counted() -> None:
    host = Host()
    host.run(START)
    said = host.live(1.0)
    assert of("XITL_NODE_STATUS", said)[-1].estimates == 0  # nothing is steered
    host.autopilot.arm(force=True)
    status = of("XITL_NODE_STATUS", host.live(2.0))[-1]
    assert status.estimates == pytest.approx(100, abs=51)
    assert 0 < status.efforts <= status.estimates


def test_a_host_that_is_gone_takes_its_run_with_it() -> None:
    host = Host(silence_s=5.0)
    host.run(START)
    host.autopilot.arm(force=True)
    said = host.live(4.0, imu=False)
    assert of("XITL_NODE_STATUS", said)[-1].running == 1
    said = host.live(4.0, imu=False)
    assert kinds(said)[-4:] == ["XITL_ACTUATORS", *["XITL_TASK_STATS"] * 3]
    assert not host.autopilot.state.armed
    assert host.run(HELLO)[-1].running == 0


@pytest.mark.medium
def test_silence_does_not_matter_when_it_may_last_or_in_lockstep() -> None:
    for host, mode in ((Host(silence_s=0.0), REALTIME), (Host(silence_s=1.0), LOCKSTEP)):
        host.run(START, mode)
        host.live(100.0, step_ns=500 * MS, imu=False)
        assert host.run(HELLO, mode)[-1].running == 1


def test_time_is_told_as_it_is() -> None:
    host = Host()
    host.run(START)
    host.clock.time_ns = 123_456_789
    (answer,) = of("XITL_TIMESYNC", host.send(mav.MAVLink_xitl_timesync_message(5, 0, 0, 9)))
    assert (answer.t1_ns, answer.t2_ns, answer.t3_ns, answer.sequence) == (5, 123_456_789, 123_456_789, 9)


@pytest.mark.parametrize("lost", [0, 40, 200, 256, 700])
def test_the_totals_of_the_host_tell_how_many_frames_were_lost(lost: int, monkeypatch: pytest.MonkeyPatch) -> None:
    host = Host()
    host.run(START)
    host.link.reset_counters()

    def total() -> mav.MAVLink_xitl_timesync_message:
        return mav.MAVLink_xitl_timesync_message(5, 0, 0, 9, host.link.counters.sent)

    host.live(0.5)
    host.send(total())
    with monkeypatch.context() as unplugged:
        unplugged.setattr(host.link.transport, "send", lambda data: True)
        for _ in range(lost):
            host.link.send(host.imu(0))
    host.live(0.5)
    # many more than half a round behind it in the batch that the node takes in at once
    status = host.send(total(), *[host.imu(host.clock.time_ns)] * 200) and host.run(HELLO)[-1]
    assert status.frames_lost == lost


@pytest.mark.parametrize("start_us", [0, 2**53, 2**63, 2**64 - 1])
def test_any_time_of_the_host_is_taken_and_answered(start_us: int) -> None:
    """Instants have 64 bits on the wire, some of them signed and in nanoseconds."""
    host = Host()
    host.send(mav.MAVLink_xitl_run_message(start_us, b"test", START, LOCKSTEP, 2))
    for tick, time_us in enumerate((start_us, 2**63, 2**64 - 1)):
        said = host.send(
            mav.MAVLink_xitl_timesync_message(5, 0, 0, 9),
            mav.MAVLink_timesync_message(0, 7),
            mav.MAVLink_xitl_tick_message(time_us, tick),
        )
        assert kinds(said)[:2] == ["XITL_TIMESYNC", "TIMESYNC"]
        assert kinds(said)[-1] == "XITL_ACTUATORS"


def test_in_lockstep_every_byte_repeats_and_what_would_not_is_unknown() -> None:
    heard = []
    for pause_ns in (0, 12_345_678):
        host = Host()
        host.clock.time_ns = 5_000 + pause_ns
        host.run(HELLO, LOCKSTEP)
        host.run(START, LOCKSTEP)
        for _ in range(120):
            host.clock.time_ns += pause_ns
            said = host.step()
            assert kinds(said)[-1] == "XITL_ACTUATORS"
        (status,) = of("XITL_NODE_STATUS", host.run(STOP, LOCKSTEP))
        assert (status.memory_kib, status.cpu_percent, status.load_1min, status.temperature) == (0, 0.0, -1.0, 32767)
        heard.append(host.frames)
    assert len(heard[0]) > 150
    assert heard[0] == heard[1]


def test_a_tick_that_is_repeated_is_answered_again_and_runs_nothing() -> None:
    host = Host()
    host.run(START, LOCKSTEP)
    first = host.step()
    again = host.send(mav.MAVLink_xitl_tick_message(host.tick * 20_000, host.tick))
    assert kinds(again) == ["XITL_ACTUATORS"]
    assert again[0].get_msgbuf()[10:-2] == first[-1].get_msgbuf()[10:-2]


def test_what_waits_for_the_next_answer_does_not_go_with_one_that_is_repeated() -> None:
    host, asked_again = Host(), Host()
    for one in (host, asked_again):
        one.run(START, LOCKSTEP)
    for _ in range(60):
        told = host.step()
        assert kinds(asked_again.step()) == kinds(told)
        asked_again.send(mav.MAVLink_xitl_tick_message(asked_again.tick * 20_000, asked_again.tick))
