"""Who steers, and how the motors get there."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xitl_cli.profile.schema.faults import FaultSpec, LinkFault
from xitl_cli.run.core.faults import FaultSchedule
from xitl_cli.run.links.connection import Silence
from xitl_cli.run.links.standby import AgentSwitch, MotorRamp, TakeoverDecision
from xitl_cli.seeds import Seeds

MS = 1_000_000
PERIOD = 20 * MS
SECOND = 1000 * MS


def steer(takeover: TakeoverDecision, until_ms: int, speaks: dict[int, list[range]]) -> list[tuple[int, AgentSwitch]]:
    """Every 20 ms those who speak are heard, then it is decided; (instant in ms, switch) of each switch."""
    switches = []
    for now_ms in range(0, until_ms, 20):
        for agent, times in speaks.items():
            if any(now_ms in time for time in times):
                takeover.heard(agent, now_ms * MS)
        switch = takeover.decide(now_ms * MS)
        if switch is not None:
            switches.append((now_ms, switch))
    return switches


def test_nobody_takes_over_while_the_first_speaks() -> None:
    assert steer(TakeoverDecision(0.3), 2000, {0: [range(2000)], 1: [range(2000)]}) == []


def test_the_standby_takes_over_after_the_set_time_and_keeps_it() -> None:
    takeover = TakeoverDecision(0.3)
    speaks = {0: [range(1000), range(2000, 4000)], 1: [range(4000)]}
    assert steer(takeover, 4000, speaks) == [(1280, AgentSwitch(1, 300 * MS))]
    assert takeover.active == 1


def test_it_goes_back_only_when_the_new_one_is_silent_and_the_old_one_speaks() -> None:
    takeover = TakeoverDecision(0.3)
    speaks = {0: [range(1000), range(3000, 5000)], 1: [range(2000)]}
    assert [(at, switch.active) for at, switch in steer(takeover, 5000, speaks)] == [(1280, 1), (3000, 0)]


def test_when_both_are_silent_nothing_changes() -> None:
    takeover = TakeoverDecision(0.3)
    assert steer(takeover, 5000, {0: [range(1000)], 1: [range(1000)]}) == []
    assert takeover.active == 0


def test_a_pause_of_the_host_itself_is_no_silence() -> None:
    """What was queued meanwhile is heard before it is decided."""
    takeover = TakeoverDecision(0.3)
    steer(takeover, 1000, {0: [range(1000)], 1: [range(1000)]})
    for agent in (1, 0):
        takeover.heard(agent, 4000 * MS)
    assert takeover.decide(4000 * MS) is None


commands = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=60)


@pytest.mark.medium
@given(commands, st.floats(0.01, 1.0))
def test_no_motor_jumps_further_than_the_step_on_the_way(wanted: list[tuple[float, float]], max_step: float) -> None:
    ramp = MotorRamp(max_step)
    last = ramp.next((0.5, -0.5))
    ramp.start()
    for command in wanted:
        limited = ramp.under_way
        reached = ramp.next(command)
        if limited:
            assert all(abs(to - at) <= max_step * (1 + 1e-12) for to, at in zip(reached, last, strict=True))
        else:
            assert reached == command
        last = reached
    assert ramp.largest <= max_step


def test_it_arrives_and_then_lets_everything_through() -> None:
    ramp = MotorRamp(0.05)
    ramp.next((0.0, 0.0))
    ramp.start()
    on_the_way = [ramp.next((0.2, -0.12)) for _ in range(4)]
    assert [port for port, _ in on_the_way] == pytest.approx([0.05, 0.1, 0.15, 0.2])
    assert [starboard for _, starboard in on_the_way] == pytest.approx([-0.05, -0.1, -0.12, -0.12])
    assert not ramp.under_way
    assert ramp.next((-1.0, 1.0)) == (-1.0, 1.0)


def test_without_a_switch_everything_goes_through() -> None:
    ramp = MotorRamp(0.05)
    for command in [(0.0, 0.0), (1.0, -1.0), (-1.0, 1.0)]:
        assert ramp.next(command) == command


def test_a_silence_is_told_once_when_noticed_and_once_when_it_ends() -> None:
    silence = Silence(10.0, 0)
    told: list[tuple[int, str, float]] = []
    for now_ms in range(0, 4000, 20):
        if not 1000 <= now_ms < 3000:
            lasted_s = silence.heard(now_ms * MS)
            if lasted_s is not None:
                told.append((now_ms, "ended", lasted_s))
        if silence.noticed(now_ms * MS):
            told.append((now_ms, "noticed", 0.0))
        assert not silence.too_long(now_ms * MS)
    assert told == [(1480, "noticed", 0.0), (3000, "ended", pytest.approx(2.02))]
    assert silence.longest_s == pytest.approx(2.02)


def test_a_silence_can_be_too_long() -> None:
    silence = Silence(10.0, 0)
    assert not silence.too_long(9_999 * MS)
    assert silence.too_long(10_000 * MS)


def test_a_cut_of_ours_is_not_held_against_the_agent() -> None:
    """faults.link-cut of just silent_s ended the run and blamed the cable."""
    silence = Silence(10.0, 0)
    for second in range(1, 15):
        silence.made_by_fault(second * SECOND)
        assert not silence.too_long(second * SECOND)
    assert silence.noticed(14 * SECOND)
    assert not silence.too_long(23 * SECOND)
    assert silence.too_long(24 * SECOND)  # ten seconds after the cut it is the agent
    assert silence.heard(24 * SECOND) == pytest.approx(24.0)


@pytest.mark.parametrize(("cut", "loss"), [(True, 0.0), (False, 1.0)])
def test_a_link_that_carries_nothing_is_cut(cut: bool, loss: float) -> None:
    faults = {"radio": FaultSpec(from_s=1.0, until_s=2.0, link=LinkFault(direction="actuators", cut=cut, loss=loss))}
    schedule = FaultSchedule(faults, Seeds(1))
    before, within = schedule.at(0), schedule.at(SECOND)
    assert before is None
    assert within is not None
    assert within.cut
    after = schedule.at(2 * SECOND)
    assert after is not None
    assert not after.cut
