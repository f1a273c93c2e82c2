"""The clock of another autopilot, asked for by TIMESYNC."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import pytest

from agent.wire import dialect
from xitl_cli.run.links import bridge_clock as module
from xitl_cli.run.links.bridge_clock import LOCKSTEP_HZ, REALTIME_HZ, AutopilotClock

SECOND = 1_000_000_000
MS = 1_000_000


class Recorder:
    def __init__(self) -> None:
        self.clocks: list[Any] = []

    def write(self, stamp_ns: int, clock: Any) -> None:
        self.clocks.append(clock)


class Pace:
    """Simulation time began at 100 s of the host's clock."""

    def sim_of_host(self, host_ns: int) -> int:
        return host_ns - 100 * SECOND


class Case:
    def __init__(self, lockstep: bool, uneven_ns: int = 0) -> None:
        self.sent: list[Any] = []
        self.recorder = Recorder()
        self.now_ns = 0
        self.clock = AutopilotClock(lockstep, self.sent.append, uneven_ns)
        clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        context: Any = SimpleNamespace(recorder=self.recorder, pace=Pace(), clock=clock)
        self.clock.begin(context)


def test_in_lockstep_the_answer_is_held_against_the_tick_that_asked() -> None:
    case = Case(lockstep=True)
    for second in range(3):
        case.now_ns = second * SECOND
        case.clock.update(case.now_ns)
        case.clock.update(case.now_ns + MS)  # not due
        (request,) = case.sent
        case.sent.clear()
        assert (request.tc1, request.ts1) == (0, case.now_ns)
        case.now_ns += 20 * MS
        case.clock.handle(dialect.MAVLink_timesync_message(request.ts1 - 2 * MS + 1, request.ts1))
    report = case.clock.report()
    assert report.node == "autopilot"
    assert report.offset_us == pytest.approx(-2000, abs=1)
    assert report.asymmetry_bound_us == 20_000
    assert report.samples == 3
    assert [clock.sample for clock in case.recorder.clocks] == [1, 2, 3]
    assert LOCKSTEP_HZ == 1.0
    assert case.clock.sim_ns(2_000_000) == 2 * SECOND


def test_in_lockstep_one_that_has_been_in_a_run_before_is_ahead() -> None:
    case = Case(lockstep=True)
    case.now_ns = 20 * MS
    assert case.clock.sim_ns(62_010_000) is None  # not known yet
    case.clock.update(case.now_ns)
    case.now_ns += 20 * MS
    case.clock.handle(dialect.MAVLink_timesync_message(62 * SECOND + 20 * MS, 20 * MS))
    assert case.clock.sim_ns(62_030_000) == 30 * MS


def test_in_real_time_its_instants_become_simulation_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its clock is 30 s behind the host's and 50 ppm faster; 1 ms there and back."""
    host_ns = 100 * SECOND
    monkeypatch.setattr(module.time, "monotonic_ns", lambda: host_ns)
    case = Case(lockstep=False)
    case.clock._timing._clock_ns = lambda: host_ns
    assert case.clock.sim_ns(1) is None

    def theirs(at_ns: int) -> int:
        return round((at_ns - 70 * SECOND) * (1 + 50e-6))

    for number in range(200):
        case.now_ns = number * round(SECOND / REALTIME_HZ)
        host_ns = 100 * SECOND + case.now_ns
        case.clock.update(case.now_ns)
        request = case.sent.pop()
        heard_ns = theirs(host_ns + MS // 2)
        host_ns += MS
        case.clock.handle(dialect.MAVLink_timesync_message(heard_ns, request.ts1))
    instant_ns = 110 * SECOND
    found_ns = case.clock.sim_ns(theirs(instant_ns) // 1000)
    assert found_ns == pytest.approx(10 * SECOND, abs=5_000)  # stamps are whole microseconds, the fit some more
    report = case.clock.report()
    assert report.drift_ppm == pytest.approx(50.0, abs=0.5)
    assert report.steps == 0


def test_a_simulated_clock_that_runs_unevenly_makes_no_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands still and jumps by 8 ms, while an exchange takes 1 ms."""
    host_ns = 100 * SECOND
    monkeypatch.setattr(module.time, "monotonic_ns", lambda: host_ns)
    steps = []
    for uneven_ns in (0, module.SIMULATED_UNEVEN_NS):
        case = Case(False, uneven_ns)
        for number in range(200):
            case.now_ns = number * 103 * MS
            host_ns = 100 * SECOND + case.now_ns
            case.clock.update(case.now_ns)
            request = case.sent.pop()
            heard_ns = (host_ns + MS // 2) // (8 * MS) * (8 * MS)
            host_ns += MS
            case.clock.handle(dialect.MAVLink_timesync_message(heard_ns, request.ts1))
        report = case.clock.report()
        steps.append(report.steps)
        last = case.recorder.clocks[-1]
        assert (last.host_ns, last.round_trip_s) == (host_ns - MS, pytest.approx(1e-3))
    assert steps[0] > 5
    assert steps[1] == 0
    assert abs(report.offset_us) <= report.asymmetry_bound_us < 12_000  # it was 8 ms behind at times: off by 4


class SimulatedClock:
    """Of a SITL build on a busy machine, by its rule: of what its process did not run it makes up for 100 ms.

    stalls: (from, until) in ms. jump_ms: what it steps by at half time.
    """

    def __init__(self, rng: random.Random, seconds: float, jump_ms: float = 0.0) -> None:
        self._half_ms, self._jump_ms = seconds * 500.0, jump_ms
        self.stalls: list[tuple[float, float]] = []
        at_ms = 0.0
        while at_ms < seconds * 1000.0:
            at_ms += rng.expovariate(1.0 / 400.0)
            length_ms = min(rng.expovariate(1.0 / 40.0), 400.0) if rng.random() < 0.95 else rng.uniform(100.0, 1500.0)
            self.stalls.append((at_ms, at_ms + length_ms))
            at_ms += length_ms

    def answer(self, asked_ms: float) -> tuple[float, float]:
        """(when it answers, what its clock shows then): at once, or when its process runs again."""
        lost_ms = 0.0
        for begin_ms, end_ms in self.stalls:
            if begin_ms > asked_ms:
                break
            lost_ms += max(end_ms - begin_ms - 100.0, 0.0)
            if end_ms > asked_ms:  # it has not made up for it yet
                return end_ms, self._shown(begin_ms, end_ms, lost_ms - max(end_ms - begin_ms - 100.0, 0.0))
        return asked_ms, self._shown(asked_ms - asked_ms % 8.0, asked_ms, lost_ms)

    def _shown(self, reached_ms: float, now_ms: float, lost_ms: float) -> float:
        return 30_000.0 + reached_ms - lost_ms + (self._jump_ms if now_ms >= self._half_ms else 0.0)


def followed(monkeypatch: pytest.MonkeyPatch, theirs: SimulatedClock, seconds: float, rng: random.Random) -> Any:
    host_ns = 0
    monkeypatch.setattr(module.time, "monotonic_ns", lambda: host_ns)
    case = Case(False, module.SIMULATED_UNEVEN_NS)
    while host_ns < seconds * SECOND:
        case.clock.update(case.now_ns)
        for request in case.sent:
            answered_ms, shown_ms = theirs.answer(host_ns / MS + rng.expovariate(5.0))
            host_ns = max(host_ns, round((answered_ms + rng.expovariate(5.0)) * MS))
            case.clock.handle(dialect.MAVLink_timesync_message(round(shown_ms * MS), request.ts1))
        case.sent.clear()
        host_ns += 20 * MS
        case.now_ns = host_ns
    return case.clock.report()


@pytest.mark.medium
@pytest.mark.parametrize("jump_ms", [0.0, 2500.0, -20_000.0])
def test_a_simulated_clock_whose_process_is_kept_waiting_does_not_step_and_one_that_jumps_does(
    monkeypatch: pytest.MonkeyPatch, jump_ms: float
) -> None:
    """Twenty machines that are busy in other ways each: stops of tens of ms, now and then of more than a second."""
    stood = 0
    for seed in range(20):
        rng = random.Random(seed)
        report = followed(monkeypatch, SimulatedClock(rng, 12.0, jump_ms), 12.0, rng)
        assert report.steps == (jump_ms != 0.0), seed
        stood += report.stood_s > 0.1
    assert stood > 10, stood


def test_its_own_requests_are_answered_and_strange_answers_passed_over() -> None:
    case = Case(lockstep=True)
    case.now_ns = 7 * SECOND
    case.clock.handle(dialect.MAVLink_timesync_message(0, 1234))
    (answer,) = case.sent
    assert (answer.tc1, answer.ts1) == (7 * SECOND, 1234)
    case.clock.handle(dialect.MAVLink_timesync_message(99, 98))  # of somebody else's request
    assert case.clock.report().offset_us is None


def test_utc_is_noted_in_real_time_only_once_it_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.time, "time", lambda: 1_800_000_000.0)
    case, other = Case(lockstep=False), Case(lockstep=True)
    case.clock.handle(dialect.MAVLink_system_time_message(12_000_000, 12_000))
    assert case.clock.utc_offset_s is None
    for one in (case, other):
        one.clock.handle(dialect.MAVLink_system_time_message(1_800_000_002_500_000, 12_000))
    assert case.clock.utc_offset_s == pytest.approx(2.5)
    assert other.clock.utc_offset_s is None
