"""How simulation time goes by: as fast as it can, or with the clock on the wall."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from xitl_cli.record.topics import ClockExchange, PaceReport, TaskTiming
from xitl_cli.run.core.statistics import Histogram, Slope, TimeBase

SLIP_NS = 500_000_000
STALL_NS = 40_000_000  # two control cycles at 50 Hz; ArduPilot takes an external IMU for lost after as much
ANCHORS_KEPT = 64
TIME_BASE_HZ = 10.0

Idle = Callable[[float], object]


class Pace(Protocol):
    """Called before every physics step. slips: how often the world stood still because this machine did."""

    slips: int

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        """Return when it is time for the step that ends at `sim_ns`; `idle` passes the time and may return early."""

    def sim_of_host(self, host_ns: int) -> int:
        """Simulation time when the host's monotonic clock shows `host_ns`."""

    def now_sim_ns(self, sim_ns: int) -> int:
        """Simulation time right now, while the step that ended at `sim_ns` is being worked on."""

    def task(self, rate_hz: float) -> TaskTiming:
        """How the physics kept its deadlines."""

    def slope(self, rate_hz: float) -> Slope:
        """The host's clock against the number of the step."""

    def clock(self, step: int, sim_ns: int) -> ClockExchange | None:
        """A point of that curve: when the step that ended at `sim_ns` began. None where time is simulation time."""

    def report(self) -> PaceReport:
        """How it went so far."""


class Lockstep:
    """No waiting: time is what the simulation says it is."""

    def __init__(self) -> None:
        self.slips = 0
        self._cycles = 0

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        self._cycles += 1

    def sim_of_host(self, host_ns: int) -> int:
        return host_ns

    def now_sim_ns(self, sim_ns: int) -> int:
        return sim_ns

    def task(self, rate_hz: float) -> TaskTiming:
        return TaskTiming("PS1", "physics", rate_hz, self._cycles, 0)

    def slope(self, rate_hz: float) -> Slope:
        return Slope(1.0 / rate_hz, 0.0) if self._cycles > 1 else Slope()

    def clock(self, step: int, sim_ns: int) -> ClockExchange | None:
        return None

    def report(self) -> PaceReport:
        return PaceReport()


LISTEN_S = 0.02  # how soon a run that stands still, or waits for its pace, hears who operates it
RESUMED_NS = 500_000_000  # a run that is further behind its pace goes on from there and does not race after it


class OperatedLockstep(Lockstep):
    """Lockstep that a person may stop, let go on for a while, and slow down: none of it touches the result.

    interrupted: whether somebody wants to end the run. listen: set by who operates it; called again and again while the
    run stands still or waits. factor: times real time, None for as fast as it can.
    """

    def __init__(
        self,
        interrupted: Callable[[], bool],
        factor: float | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        super().__init__()
        self.listen: Callable[[], object] = lambda: None
        self.factor = factor
        self._interrupted = interrupted
        self._clock_ns = clock_ns
        self._stands_at_ns: int | None = None
        self._anchor: tuple[int, int] | None = None
        self._free = factor is None

    @property
    def paused(self) -> bool:
        """Whether it stands still, or will when a step is over."""
        return self._stands_at_ns is not None

    def pause(self, sim_ns: int) -> None:
        """Stand still from this instant on."""
        self._stands_at_ns = sim_ns
        self._free = False

    def step(self, duration_ns: int) -> None:
        """While paused: go on for so long, and stand still again."""
        if self._stands_at_ns is not None:
            self._stands_at_ns += duration_ns

    def resume(self) -> None:
        """Go on."""
        self._stands_at_ns = self._anchor = None
        self._free = self.factor is None

    def set_factor(self, factor: float | None) -> None:
        """Times real time from now on; None: as fast as it can."""
        self.factor, self._anchor = factor, None
        self._free = factor is None and self._stands_at_ns is None

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        self._cycles += 1
        if not self._free:
            self._wait(sim_ns)

    def _wait(self, sim_ns: int) -> None:
        while self._stands_at_ns is not None and sim_ns > self._stands_at_ns and not self._interrupted():
            self._anchor = None
            time.sleep(LISTEN_S)
            self.listen()
        while self.factor is not None and not self._interrupted():
            now_ns = self._clock_ns()
            if self._anchor is None:
                self._anchor = (now_ns, sim_ns)
            since_ns, from_ns = self._anchor
            left_ns = since_ns + round((sim_ns - from_ns) / self.factor) - now_ns
            if left_ns <= 0:
                if left_ns < -RESUMED_NS:
                    self._anchor = None
                return
            time.sleep(min(left_ns * 1e-9, LISTEN_S))
            if left_ns * 1e-9 > LISTEN_S:
                self.listen()


class Realtime:
    """Absolute deadlines on the monotonic clock.

    A step that starts later than one period behind its deadline counts as missed. Nothing is skipped: physics has to
    take every step, so a late host catches up, and the count says that it was late. A host that is more than half a
    second behind was asleep, and does not race after the time it slept through: the world stood still, which is a slip.
    A stall is the time between two steps when it is longer than STALL_NS, caught up with or not.
    """

    def __init__(self, period_s: float, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.slips = 0
        self._slipped_s = 0.0
        self._stalls = 0
        self._stalled_ns = 0
        self._longest_stall_ns = 0
        self._clock_ns = clock_ns
        self._period_ns = round(period_s * 1e9)
        self._anchors: deque[tuple[int, int]] = deque(maxlen=ANCHORS_KEPT)
        self._start_ns = 0
        self._step_ns = 0
        self._cycles = 0
        self._missed = 0
        self._jitter = Histogram()
        self._began_ns = 0
        self._run_total_ns = 0
        self._run_max_ns = 0
        self._time_base = TimeBase()
        self._time_base_every = max(round(1.0 / (TIME_BASE_HZ * period_s)), 1)

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        clock_ns = self._clock_ns
        now_ns = clock_ns()
        if not self._anchors:
            self._anchor(now_ns, sim_ns)
        elif self._began_ns:
            run_ns = now_ns - self._began_ns
            self._run_total_ns += run_ns
            self._run_max_ns = max(self._run_max_ns, run_ns)
        due_ns = self._start_ns + sim_ns
        self._step_ns = sim_ns
        while now_ns < due_ns:
            idle((due_ns - now_ns) * 1e-9)
            now_ns = clock_ns()
        late_ns = now_ns - due_ns
        if late_ns > SLIP_NS:
            self.slips += 1
            self._slipped_s += late_ns * 1e-9
            self._anchor(now_ns, sim_ns)
        self._jitter.add(late_ns)
        self._cycles += 1
        self._missed += late_ns > self._period_ns
        stood_ns = now_ns - self._began_ns
        if stood_ns > STALL_NS + self._period_ns and self._began_ns:
            self._stalls += 1
            self._stalled_ns += stood_ns
            self._longest_stall_ns = max(self._longest_stall_ns, stood_ns)
        self._began_ns = now_ns
        if self._cycles % self._time_base_every == 0:
            self._time_base.add(self._cycles, now_ns)

    def _anchor(self, host_ns: int, sim_ns: int) -> None:
        self._anchors.append((host_ns, sim_ns))
        self._start_ns = host_ns - sim_ns

    def sim_of_host(self, host_ns: int) -> int:
        """Piecewise: each anchor's line, never beyond the next anchor. 0 before the first step.

        During a slip nobody has noticed yet it stands at the step that is waited for.
        """
        until_ns: int | None = None
        for anchor_ns, sim_ns in reversed(self._anchors):
            if host_ns >= anchor_ns or sim_ns == self._anchors[0][1]:
                reached_ns = max(sim_ns + host_ns - anchor_ns, 0)
                if until_ns is None:
                    return reached_ns if reached_ns <= self._step_ns + SLIP_NS else self._step_ns
                return min(reached_ns, until_ns)
            until_ns = sim_ns
        return 0

    def now_sim_ns(self, sim_ns: int) -> int:
        return self.sim_of_host(self._clock_ns())

    def task(self, rate_hz: float) -> TaskTiming:
        return TaskTiming(
            "PS1",
            "physics",
            rate_hz,
            self._cycles,
            self._missed,
            start_jitter_max_s=self._jitter.max_ns * 1e-9,
            run_mean_s=self._run_total_ns * 1e-9 / max(self._cycles - 1, 1),
            run_max_s=self._run_max_ns * 1e-9,
        )

    def slope(self, rate_hz: float) -> Slope:
        return self._time_base.slope

    def clock(self, step: int, sim_ns: int) -> ClockExchange:
        late_ns = self._began_ns - self._start_ns - sim_ns
        return ClockExchange(
            "PS1", step, self._began_ns, sim_ns, 0.0, -self._start_ns * 1e-9, 0.0, residual_s=-late_ns * 1e-9
        )

    def report(self) -> PaceReport:
        return PaceReport(
            self.slips, self._slipped_s, self._stalls, self._stalled_ns * 1e-9, self._longest_stall_ns * 1e-9
        )
