"""Tests that may skip in `.ci/run`, and why. Any other skip fails the run: it is a test that nobody runs.

Elsewhere every skip is allowed, because programs that some tests need may be missing.
"""

from __future__ import annotations

import os
import re

import pytest

GUARD = "XITL_GUARD_SKIPS"
"""Environment variable that `.ci/run` sets."""

PERMITTED_SKIPS = {
    r"needs a real ardurover \(": "ArduPilot is built from source, which takes longer than all tests",
    r"needs a real PX4 \(": "PX4 is built from source, which takes longer than all tests",
    r"names no ardurover built for armhf Linux": "ArduPilot is built from source, which takes longer than all tests",
    r"XITL_ULOGS names no folder": "real logs of PX4 are too large for the tree",
    r"needs Node and: npm install": "the client comes from another language's registry; it is run by hand",
    r"root may write everywhere|this user (may read|reads) everything": "root has every permission; other users run it",
    r"rosbag2 compresses the chunks of MCAP instead": "one combination of two parameters does not exist",
}
"""Regular expression of the reason that the test gives, and why it may skip in CI."""


def unexpected_skips(reports: list[pytest.TestReport | pytest.CollectReport]) -> list[str]:
    """Each skipped test, with its reason, that PERMITTED_SKIPS does not cover."""
    found = []
    for report in reports:
        _, _, reason = report.longrepr if isinstance(report.longrepr, tuple) else ("", 0, str(report.longrepr))
        if not any(re.search(permitted, reason) for permitted in PERMITTED_SKIPS):
            found.append(f"{report.nodeid}: {reason.removeprefix('Skipped: ')}")
    return sorted(set(found))


class SkipGuard:
    """Fails a session in which a test skipped that may not."""

    def __init__(self) -> None:
        self._unexpected: list[str] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        if reporter is None or hasattr(session.config, "workerinput"):
            return
        self._unexpected = unexpected_skips(reporter.stats.get("skipped", []))
        if self._unexpected and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self._unexpected:
            terminalreporter.section("skips that CI does not allow", red=True)
            for line in self._unexpected:
                terminalreporter.line(line)
            terminalreporter.line("Install what they need, or give a reason in tests/permitted_skips.py.")


def register(config: pytest.Config) -> None:
    """Guard the session where `.ci/run` asks for it."""
    if os.environ.get(GUARD):
        config.pluginmanager.register(SkipGuard())
