"""Reports of real logs. Several tests read one, and each takes most of a second to make."""

from __future__ import annotations

from functools import cache

from tests.recorded import LOGS
from xitl_cli.log_analyses import log_analyses
from xitl_cli.logs.report.build import build_report
from xitl_cli.logs.report.model import Report


@cache
def report_of_log(name: str) -> Report:
    """The report of `tests/data/logs/NAME.bin.xz` with all analyses."""
    return build_report([LOGS / f"{name}.bin"], log_analyses())
