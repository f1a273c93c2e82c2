"""Analyses of logs: those of xitl and of other packages, from the entry points in the group `xitl.log_analyses`."""

from __future__ import annotations

from collections.abc import Collection

from xitl_cli.logs.model.analysis import LogAnalysis
from xitl_cli.logs.model.text import resolve_name
from xitl_cli.logs.report.build import OVERVIEW
from xitl_cli.registry import LOG_ANALYSES, PluginError, load, names, package_of

OWN = (
    "vehicle",
    "px4",
    "modes",
    "arming",
    "events",
    "missions",
    "attitude",
    "control",
    "parameters",
    "real_time",
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
    "actuation",
)
"""Sections of xitl's analyses, in the order of the report. Those of other packages follow."""


def section_names() -> list[str]:
    """All sections of a report, in its order. Loads no analysis."""
    return [OVERVIEW, *OWN, *(name for name in names(LOG_ANALYSES) if name not in OWN)]


def sections_named(only: Collection[str]) -> list[str]:
    """The sections that the user names, in the order of the report. Raises LogError for a name that does not exist."""
    known = section_names()
    named = {resolve_name(name, known, "there is no section", f"choose from {', '.join(known)}") for name in only}
    return [name for name in known if name in named]


def log_analyses(sections: Collection[str] = ()) -> list[LogAnalysis]:
    """The analyses of these sections, or all of them, in the order of the report.

    Raises PluginError for an analysis that cannot be loaded. Without `sections`, those of other packages are left out
    instead.
    """
    analyses = []
    for name in section_names():
        if name == OVERVIEW or (sections and name not in sections):
            continue
        own = name in OWN
        try:
            analyse = load(LOG_ANALYSES, name)
        except PluginError:
            if own or sections:
                raise
            continue
        analyses.append(LogAnalysis(name, analyse, "" if own else package_of(LOG_ANALYSES, name)))
    return analyses
