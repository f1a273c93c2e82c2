"""How old the motor commands were that the vessel was moved by."""

from __future__ import annotations

from dataclasses import replace

from xitl_cli.record.topics import ActuatorAge
from xitl_cli.run.pilot import ActuatorReport


class ActuatorUse:
    """Counts every exchange; a run of exchanges without new commands is as long as it lasts."""

    def __init__(self) -> None:
        self.report = ActuatorReport()
        self._exchanges = 0
        self._stale = 0

    def add(self, fresh: bool, age_ns: int | None) -> None:
        """One exchange: whether a new command has come, and the age of the one in use, None while unknown."""
        report = self.report
        self._exchanges += 1
        if age_ns is not None:
            report.age.add(age_ns)
        if fresh:
            self._stale = 0
            return
        self._stale += 1
        self.report = replace(report, stale=report.stale + 1, longest_stale=max(report.longest_stale, self._stale))

    def record(self) -> ActuatorAge:
        """The same for the recording."""
        report = self.report
        p50_ns, p99_ns = report.age.quantile_ns(0.5), report.age.quantile_ns(0.99)
        return ActuatorAge(
            exchanges=self._exchanges,
            stale=report.stale,
            longest_stale=report.longest_stale,
            age_p50_s=None if p50_ns is None else p50_ns * 1e-9,
            age_p99_s=None if p99_ns is None else p99_ns * 1e-9,
            age_max_s=report.age.max_ns * 1e-9 if report.age.count else None,
        )
