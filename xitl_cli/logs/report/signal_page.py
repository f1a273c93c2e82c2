"""A page of the signals that a user asked for: one plot a unit, all on one time line."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.named_signals import LogSignal, signals_named
from xitl_cli.logs.model.sections import Plot, Section, Trace
from xitl_cli.logs.model.table import whole_ns
from xitl_cli.logs.report.build import ReportLog, Style, open_all, short_names, state_marks, time_lines
from xitl_cli.logs.report.file_report import RefusedFile
from xitl_cli.logs.report.model import Overview
from xitl_cli.logs.report.page import FileCard, Page, PagePart, page_marks
from xitl_cli.logs.report.plots import ThinTrace, thin
from xitl_cli.logs.report.wording import damage_sentences

_MOST_NAMES = 3


def signal_page(
    paths: Sequence[Path],
    wanted: Sequence[str],
    from_s: float | None,
    until_s: float | None,
    *,
    raw: bool = False,
    vessel: str | None = None,
) -> tuple[Page, list[RefusedFile]]:
    """from_s and until_s: on the page's time line. vessel: as of `open_all`.

    Raises LogError when no file opens, or none has a signal.
    """
    with ExitStack() as opened:
        logs, refusals = open_all(paths, opened, vessel)
        if not logs:
            raise LogError(refusals[-1].sentence)
        names = short_names([log.path for log in logs])
        sources = [
            ReportLog(log, line, name if len(logs) > 1 else "")
            for log, line, name in zip(logs, time_lines(logs), names, strict=True)
        ]
        by_unit: dict[str, list[Trace]] = {}
        names_by_unit: dict[str, list[str]] = {}
        notes: dict[str, None] = {}
        for text in wanted:
            for source, parts in zip(sources, signals_named(logs, text, raw=raw), strict=True):
                for signal in parts:
                    names_by_unit.setdefault(signal.unit, []).append(signal.name)
                    by_unit.setdefault(signal.unit, []).append(_trace(source, signal, from_s, until_s))
                    said = filter(None, (signal.time_base, *signal.notes))
                    notes.update(dict.fromkeys(map(source.named, said)))
        if not any(len(trace.x) for traces in by_unit.values() for trace in traces):
            raise LogError(f"{paths[0]}: nothing of {', '.join(wanted)} lies between --from and --until; widen them")
        overview = Overview(modes=state_marks(sources, signals.modes), armed=state_marks(sources, signals.armed))
        cards = tuple(
            FileCard(
                source.label or source.log.path.name,
                (("time line", source.time_line.sentence),) if source.label else (),
                damage_sentences(source.log.health),
                source.log.health.degraded,
            )
            for source in sources
            if source.label or source.log.health.degraded
        )
    plots = tuple(
        Plot(f"signals.{unit or 'numbers'}", _title(names_by_unit[unit]), unit, tuple(traces))
        for unit, traces in by_unit.items()
    )
    part = PagePart(Section("signals", "Signals", plots=plots), TimeLine())
    title = " + ".join(names)
    notices = (*(each.sentence for each in refusals), *notes)
    return Page(title, "", (part,), cards, notices, page_marks(overview)), refusals


def _trace(source: ReportLog, signal: LogSignal, from_s: float | None, until_s: float | None) -> ThinTrace:
    at_s = source.time_line.seconds(signal.stamp_ns)
    inside = np.ones(len(at_s), dtype=np.bool_)
    if from_s is not None:
        inside &= at_s >= from_s
    if until_s is not None:
        inside &= at_s <= until_s
    at_ns = whole_ns(at_s[inside] * 1e9)
    style: Style = "steps" if signal.held else "line"
    return thin(Trace(source.named(signal.name), at_ns, signal.values[inside], style), over_time=True)


def _title(names: Sequence[str]) -> str:
    once = list(dict.fromkeys(names))
    return ", ".join(once[:_MOST_NAMES]) + (f" and {len(once) - _MOST_NAMES} more" if len(once) > _MOST_NAMES else "")
