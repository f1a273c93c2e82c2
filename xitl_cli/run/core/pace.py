"""Pace of the simulation time: as fast as possible, or with the wall clock."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from agent.timing.deadline import DeadlineWait
from xitl_cli.record.topics import ClockExchange, PaceReport, TaskTiming
from xitl_cli.run.core.statistics import Histogram, Slope, TimeBase

SOURCE = "pace"
"""Source of the log messages about pauses of the world."""
SLIP_NS = 500_000_000
STALL_NS = 40_000_000  # two control cycles at 50 Hz; after this time ArduPilot treats an external IMU as lost
ANCHORS_KEPT = 64
TIME_BASE_HZ = 10.0

Idle = Callable[[float], object]


class Pace(Protocol):
    """Pace of a run. The run calls it before every physics step, or before several if it does not wait."""

    slips: int
    """Number of times that the world paused because this machine stalled."""
    slip_s: float
    """Length of the latest of these pauses."""

    @property
    def waits(self) -> bool:
        """Whether each step has its own instant to wait for."""

    def running(self) -> AbstractContextManager[None]:
        """Return the context of the run, from before its agents start."""

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        """Return when the step that ends at `sim_ns` is due. `idle` waits for up to the given time in seconds."""

    def sim_of_host(self, host_ns: int) -> int:
        """Return the simulation time when the host's monotonic clock shows `host_ns`."""

    def now_sim_ns(self, sim_ns: int) -> int:
        """Return the simulation time right now, during the work on the step that ended at `sim_ns`."""

    def task(self, rate_hz: float) -> TaskTiming:
        """Return the timing of the physics task against its deadlines."""

    def slope(self, rate_hz: float) -> Slope:
        """Return the slope of the host's clock against the step number."""

    def clock(self, step: int, sim_ns: int) -> ClockExchange | None:
        """Return the time at which the step that ended at `sim_ns` began; None in lockstep."""

    def report(self) -> PaceReport:
        """Return the report so far."""


class Lockstep:
    """No waiting: the simulation alone defines the time."""

    def __init__(self) -> None:
        self.slips = 0
        self.slip_s = 0.0
        self._sim_ns = 0

    @property
    def waits(self) -> bool:
        return False

    def running(self) -> AbstractContextManager[None]:
        return nullcontext()

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        self._sim_ns = sim_ns

    def sim_of_host(self, host_ns: int) -> int:
        return host_ns

    def now_sim_ns(self, sim_ns: int) -> int:
        return sim_ns

    def task(self, rate_hz: float) -> TaskTiming:
        return TaskTiming("PS1", "physics", rate_hz, self._cycles(rate_hz), 0)

    def slope(self, rate_hz: float) -> Slope:
        return Slope(1.0 / rate_hz, 0.0) if self._cycles(rate_hz) > 1 else Slope()

    def _cycles(self, rate_hz: float) -> int:
        return round(self._sim_ns * 1e-9 * rate_hz)

    def clock(self, step: int, sim_ns: int) -> ClockExchange | None:
        return None

    def report(self) -> PaceReport:
        return PaceReport()


LISTEN_S = 0.02  # interval at which a paused or waiting run reads the user's commands
RESUMED_NS = 500_000_000  # a run that is further behind its pace continues from there and does not catch up


class OperatedLockstep(Lockstep):
    """Lockstep that a person may pause, step and slow down. This does not change the result.

    interrupted: returns True when the user asked to stop. listen: callable that the operator node sets; it is called
    repeatedly while the run is paused or waits. factor: multiple of real time, None for as fast as possible.
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
        self._pause_ns: int | None = None
        self._anchor: tuple[int, int] | None = None
        self._free = factor is None

    @property
    def waits(self) -> bool:
        return not self._free

    @property
    def paused(self) -> bool:
        """Whether the run is paused, or will be after the current step."""
        return self._pause_ns is not None

    def pause(self, sim_ns: int) -> None:
        """Pause from this instant on."""
        self._pause_ns = sim_ns
        self._free = False

    def step(self, duration_ns: int) -> None:
        """While paused, run for this duration and pause again."""
        if self._pause_ns is not None:
            self._pause_ns += duration_ns

    def resume(self) -> None:
        """Continue the run."""
        self._pause_ns = self._anchor = None
        self._free = self.factor is None

    def set_factor(self, factor: float | None) -> None:
        """Set the multiple of real time from now on. None: as fast as possible."""
        self.factor, self._anchor = factor, None
        self._free = factor is None and self._pause_ns is None

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        self._sim_ns = sim_ns
        if self._free:
            return
        while self._pause_ns is not None and sim_ns > self._pause_ns and not self._interrupted():
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

    A step that starts more than one period after its deadline counts as missed. Physics needs every step, so a late
    host catches up and skips none. A host that is more than half a second late was asleep. It does not catch up: the
    world was paused, which counts as a slip. A stall is an interval between two steps that is longer than STALL_NS,
    even if the host catches up.

    wait: waits for the deadlines.
    """

    def __init__(
        self,
        period_s: float,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: DeadlineWait | None = None,
    ) -> None:
        self.slips = 0
        self.slip_s = 0.0
        self._slipped_s = 0.0
        self._stalls = 0
        self._stalled_ns = 0
        self._longest_stall_ns = 0
        self._clock_ns = clock_ns
        self._wait = DeadlineWait() if wait is None else wait
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

    @property
    def waits(self) -> bool:
        return True

    def running(self) -> AbstractContextManager[None]:
        return self._wait.deferred()

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
        if now_ns >= due_ns:
            self._wait.missed()
        while now_ns < due_ns:
            self._wait.until(due_ns - now_ns, idle)
            now_ns = clock_ns()
        late_ns = now_ns - due_ns
        if late_ns > SLIP_NS:
            self.slips += 1
            self.slip_s = late_ns * 1e-9
            self._slipped_s += self.slip_s
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
        """Piecewise linear: each anchor's line, limited to the simulation time of the next anchor.

        It is 0 before the first step. During a slip that is not yet detected, it is the time of the step that is due.
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
