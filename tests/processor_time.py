"""Which stage a test belongs to, by the processor time that it takes.

`pytest --processor-time` prints the tests that take more than LIMIT_S without a mark of a later stage. On an idle
machine, `tools/mark_medium.py` marks them.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable
from statistics import fmean
from typing import Any

import pytest

LIMIT_S = 0.1
"""Most processor time of a test of `make test-fast`, with the processes that it started and waited for."""
LATER = ("medium", "slow", "realtime")
_PROPERTY, _OPTION = "processor_s", "--processor-time"


def add_option(parser: pytest.Parser) -> None:
    parser.addoption(_OPTION, action="store_true", help=f"print the unmarked tests of more than {LIMIT_S:g} s")


def register(config: pytest.Config) -> None:
    if config.getoption(_OPTION):
        config.pluginmanager.register(ProcessorTime(), "processor-time")


def used_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def unmarked(reports: Iterable[Any]) -> list[tuple[float, str]]:
    """Return mean time and function of the tests above the limit that have no mark, the longest first.

    reports: of passed tests. A function with parameters counts with its mean.
    """
    times: dict[str, list[float]] = {}
    for report in reports:
        if not any(mark in report.keywords for mark in LATER):
            function = report.nodeid.partition("[")[0]
            times.setdefault(function, []).append(dict(report.user_properties)[_PROPERTY])
    means = [(fmean(all_s), function) for function, all_s in times.items()]
    return sorted((mean for mean in means if mean[0] > LIMIT_S), reverse=True)


class ProcessorTime:
    """Measures the tests, also those of other processes of this session, and prints the unmarked ones."""

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, object, object]:
        before_s = used_s()
        try:
            return (yield)
        finally:
            item.user_properties.append((_PROPERTY, used_s() - before_s))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        terminalreporter.section(f"more than {LIMIT_S:g} s of processor time without a mark")
        for mean_s, function in unmarked(terminalreporter.stats.get("passed", [])):
            terminalreporter.line(f"{mean_s:.2f} s {function}")
