"""What every analysis must give of every log: a section or none, never an exception, and no number that is none."""

from __future__ import annotations

import math
from collections.abc import Collection

from xitl_cli.log_analyses import OWN, log_analyses
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Section, Severity


def sound_sections(log: Log, names: Collection[str] = OWN) -> list[Section]:
    """Of these analyses, each looked at."""
    found = [section for analysis in log_analyses(names) if (section := analysis.section(log)) is not None]
    for section in found:
        _assert_sound(section)
    return found


def _assert_sound(section: Section) -> None:
    values = [fact.value for fact in section.facts]
    values += [value for grid in section.grids for row in grid.rows for value in row]
    assert not any(isinstance(value, float) and not math.isfinite(value) for value in values), section.key
    assert all(type(value) in (int, float, str, bool, type(None)) for value in values), section.key
    for grid in section.grids:
        assert all(len(row) == len(grid.columns) for row in grid.rows)
    for finding in section.findings:
        assert finding.next_step or finding.severity is Severity.OK
        assert "nan" not in finding.sentence.lower().split()
    for plot in section.plots:
        assert all(len(trace.x) == len(trace.y) for trace in plot.traces)
