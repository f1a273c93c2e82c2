"""How simulation time goes by: as fast as it can, or with the clock on the wall."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from xitl_cli.recording.records import Task
from xitl_cli.run.histogram import Histogram

Idle = Callable[[float], object]


class Pace(Protocol):
    """Called before every physics step."""

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        """Return when it is time for the step that ends at `sim_ns`; `idle` passes the time and may return early."""

    def sim_of_host(self, host_ns: int) -> int:
        """Simulation time when the host's monotonic clock shows `host_ns`."""

    def now_sim_ns(self, sim_ns: int) -> int:
        """Simulation time right now, while the step that ended at `sim_ns` is being worked on."""

    def task(self, rate_hz: float) -> Task:
        """How the physics kept its deadlines."""


class Lockstep:
    """No waiting: time is what the simulation says it is."""

    def __init__(self) -> None:
        self._cycles = 0

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        self._cycles += 1

    def sim_of_host(self, host_ns: int) -> int:
        return host_ns

    def now_sim_ns(self, sim_ns: int) -> int:
        return sim_ns

    def task(self, rate_hz: float) -> Task:
        return Task("PS1", "physics", rate_hz, self._cycles, 0)


class Realtime:
    """Absolute deadlines on the monotonic clock.

    A step that starts later than one period behind its deadline counts as missed. Nothing is skipped: physics has to
    take every step, so a late host catches up, and the count says that it was late.
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(period_s * 1e9)
        self._start_ns: int | None = None
        self._cycles = 0
        self._missed = 0
        self._jitter = Histogram()
        self._began_ns = 0
        self._run_total_ns = 0
        self._run_max_ns = 0

    def wait_until(self, sim_ns: int, idle: Idle) -> None:
        now_ns = time.monotonic_ns()
        if self._start_ns is None:
            self._start_ns = now_ns - sim_ns
        elif self._began_ns:
            run_ns = now_ns - self._began_ns
            self._run_total_ns += run_ns
            self._run_max_ns = max(self._run_max_ns, run_ns)
        due_ns = self._start_ns + sim_ns
        while now_ns < due_ns:
            idle((due_ns - now_ns) * 1e-9)
            now_ns = time.monotonic_ns()
        late_ns = now_ns - due_ns
        self._jitter.add(late_ns)
        self._cycles += 1
        self._missed += late_ns > self._period_ns
        self._began_ns = now_ns

    def sim_of_host(self, host_ns: int) -> int:
        return max(host_ns - (host_ns if self._start_ns is None else self._start_ns), 0)

    def now_sim_ns(self, sim_ns: int) -> int:
        return self.sim_of_host(time.monotonic_ns())

    def task(self, rate_hz: float) -> Task:
        return Task(
            "PS1",
            "physics",
            rate_hz,
            self._cycles,
            self._missed,
            start_jitter_max_s=self._jitter.max_ns * 1e-9,
            run_mean_s=self._run_total_ns * 1e-9 / max(self._cycles - 1, 1),
            run_max_s=self._run_max_ns * 1e-9,
        )
