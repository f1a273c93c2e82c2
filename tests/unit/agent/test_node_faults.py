"""Faults that a host asks for, at a node."""

from __future__ import annotations

import math
from typing import Any

import pytest
from node_host import HELLO, LOCKSTEP, MS, START, STOP, Host, of, texts
from python39 import pairwise

from agent.wire import dialect as mav
from agent.wire.impaired import OVERTAKEN_S
from tests.golden import Golden
from tests.patience import let_pass

SECOND = 1000 * MS


@pytest.fixture
def host() -> Host:
    made = Host()
    made.run(START)
    made.live(0.5)
    return made


def lived(host: Host, seconds: float, **fields: float) -> list[Any]:
    """With the faults said again once a second."""
    said: list[Any] = []
    for _ in range(math.ceil(seconds)):
        said += host.faults(**fields)
        said += host.live(1.0)
    return said


def test_a_cut_link_lets_nothing_through_and_says_so_afterwards(host: Host) -> None:
    assert host.faults(cut=1) == []
    assert lived(host, 3.0, cut=1) == []
    said = host.faults() + host.live(1.0)
    status = of("XITL_NODE_STATUS", said)[-1]
    assert status.frames_impaired > 3 * 50
    assert of("XITL_ACTUATORS", said)
    # What the host counts as missing from the sequence is what the agent kept back.
    assert host.link.counters.received + status.frames_impaired >= status.frames_sent


def test_answers_to_run_pass_whatever_the_faults(host: Host) -> None:
    host.faults(cut=1)
    assert [message.get_type() for message in host.run(HELLO)] == ["XITL_NODE_INFO", "XITL_NODE_STATUS"]
    said = host.run(STOP)
    assert said[0].get_type() == "XITL_ACTUATORS"
    assert said[-1].running == 0
    assert said[-1].frames_impaired == 0


@pytest.mark.medium
def test_the_share_that_is_lost_is_the_share_asked_for(host: Host) -> None:
    said = lived(host, 20.0, loss=0.25, seed=3)
    # 1000 actuators: 250 of them lost, give or take three standard deviations of 13.7.
    assert len(of("XITL_ACTUATORS", said)) == pytest.approx(750, abs=41)


def test_a_repetition_changes_nothing(host: Host) -> None:
    once = Host()
    once.run(START)
    once.live(0.5)
    once.faults(loss=0.5, seed=9)
    host.faults(loss=0.5, seed=9)
    first = [message.tick for message in of("XITL_ACTUATORS", once.live(4.0))]
    again = []
    for _ in range(4):
        again += [message.tick for message in of("XITL_ACTUATORS", host.live(1.0))]
        assert of("XITL_ACTUATORS", host.faults(loss=0.5, seed=9)) == []
    assert first == again


def test_faults_of_the_link_lapse_when_the_host_does_not_ask_for_them_any_more(host: Host) -> None:
    host.faults(cut=1)
    assert host.live(9.0) == []
    assert len(of("XITL_ACTUATORS", host.live(3.0))) > 45


def test_a_clock_ahead_and_fast(host: Host) -> None:
    before_us = of("XITL_ACTUATORS", host.live(0.02))[-1].time_usec
    host.faults(clock_offset_ns=3 * SECOND, clock_skew_ppm=1000.0)
    after = of("XITL_ACTUATORS", host.live(10.0))
    assert after[0].time_usec - before_us == pytest.approx(3_020_000, abs=100)
    told_us = of("XITL_TIMESYNC", host.send(mav.MAVLink_xitl_timesync_message(1, 0, 0, 1)))[0].t2_ns // 1000
    assert told_us - before_us == pytest.approx(13_000_000 + 10_000, abs=100)
    # The deadlines move with the clock: no cycle is skipped, and control runs on at its rate.
    stats = next(task for task in of("XITL_TASK_STATS", after[-1:] + host.live(1.0)) if task.task == "control")
    assert (stats.missed, stats.skipped) == (0, 0)


def test_a_clock_that_is_to_step_back_is_refused_once(host: Host, golden: Golden) -> None:
    host.faults(clock_offset_ns=3 * SECOND)
    host.live(0.1)
    said = lived(host, 3.0, clock_offset_ns=1 * SECOND)
    golden("message", "".join(texts(said)), "1 s", "3 s")


def test_all_zero_ends_everything_but_time_goes_on_from_where_it_is(host: Host) -> None:
    host.faults(clock_offset_ns=2 * SECOND, clock_skew_ppm=5000.0, loss=1.0)
    host.live(1.0)
    said = host.faults(seed=7) + host.live(1.0)
    assert texts(said) == []
    stamps_us = [message.time_usec for message in of("XITL_ACTUATORS", said)]
    assert {after - before for before, after in pairwise(stamps_us)} == {20_000}
    assert stamps_us[0] > 3_500_000


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"loss": 1.5}, "Faults refused: loss 1.5 is not within 0 to 1"),
        ({"duplicate": math.nan}, "Faults refused: duplicate nan is not within 0 to 1"),
        ({"cpu_load": -0.1}, "Faults refused: cpu_load -0.1 is not within 0 to 1"),
        ({"delay_usec": 60_000_001}, "Faults refused: delay_usec 60000001 is above 60000000"),
        ({"clock_skew_ppm": math.inf}, "Faults refused: clock_skew_ppm inf is not within 100000"),
        ({"clock_offset_ns": 2**63 - 1}, "Faults refused: clock_offset_ns 9223372036854775807 is not within"),
    ],
)
def test_what_no_fault_can_be_is_refused_and_said(host: Host, fields: dict[str, float], said: str) -> None:
    assert "".join(texts(host.faults(**fields) + host.live(0.1))).startswith(said[:50])
    assert len(of("XITL_ACTUATORS", host.live(1.0))) == 50


def test_in_lockstep_reordering_does_not_depend_on_how_fast_the_machine_is() -> None:
    heard = []
    for pause_s in (0.0, 1.1 * OVERTAKEN_S):
        host = Host()
        host.run(START, LOCKSTEP)
        host.faults(reorder=0.5)
        for tick in range(60):
            if tick % 5 == 2:
                let_pass(pause_s)
            host.step()
        host.run(STOP, LOCKSTEP)
        heard.append(host.frames)
    assert len(heard[0]) > 80
    assert heard[0] == heard[1]


def test_a_new_run_has_none(host: Host) -> None:
    host.faults(cut=1, clock_offset_ns=5 * SECOND)
    host.run(START)
    said = host.live(1.0)
    assert len(of("XITL_ACTUATORS", said)) == 50
    assert said[-1].get_msgbuf() is not None
    assert of("XITL_ACTUATORS", said)[-1].time_usec == host.clock.time_ns // 1000


def test_in_lockstep_ticks_are_answered_and_clocks_keep_time() -> None:
    host = Host()
    host.run(START, LOCKSTEP)
    host.faults(cut=1, clock_offset_ns=SECOND, clock_skew_ppm=9.0, delay_usec=500_000)
    for _ in range(60):
        (answer,) = host.step()
        assert answer.get_type() == "XITL_ACTUATORS"
        assert answer.time_usec == host.tick * 20_000
    assert host.run(STOP, LOCKSTEP)[-1].frames_impaired > 0
