"""Every analysis of one log, in the order of the report."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Section

Analysis = Callable[[Log], Section | None]

NAMES = (
    "vehicle",
    "modes",
    "arming",
    "events",
    "missions",
    "parameters",
    "scheduler",
    "tasks",
    "time_bases",
    "links",
    "faults",
    "estimator",
    "sensors",
    "gnss",
    "vibration",
    "radio",
    "power",
)
"""Modules of this package, each with a function `analyse`."""


def analysis(name: str) -> Analysis:
    return importlib.import_module(f"xitl_cli.logs.analyses.{name}").analyse  # type: ignore[no-any-return]


def sections(log: Log) -> list[Section]:
    return [found for name in NAMES if (found := analysis(name)(log)) is not None]
