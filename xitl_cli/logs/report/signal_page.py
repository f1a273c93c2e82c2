"""A page of the signals that were asked for: one plot a unit, all on one time line."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.errors import LogError
from xitl_cli.logs.report.build import lay, open_all, short_names
from xitl_cli.logs.report.model import Overview, Refusal
from xitl_cli.logs.report.overview import Source, states
from xitl_cli.logs.report.page import Card, Page, Part, page_marks
from xitl_cli.logs.report.selection import Signal, signals_named
from xitl_cli.logs.report.thinning import ThinTrace, thin
from xitl_cli.logs.report.words import damage_sentences
from xitl_cli.logs.sections import Plot, Section, Trace
from xitl_cli.logs.timeline.line import TimeLine

_MOST_NAMES = 3


def signal_page(
    paths: Sequence[Path], wanted: Sequence[str], from_s: float | None, until_s: float | None, *, raw: bool = False
) -> tuple[Page, list[Refusal]]:
    """from_s and until_s: on the page's time line. Raises LogError when no file opens, or none has a signal."""
    with ExitStack() as opened:
        logs, refusals = open_all(paths, opened)
        if not logs:
            raise LogError(refusals[-1].sentence)
        names = short_names([log.path for log in logs])
        sources = [
            Source(log, line, name if len(logs) > 1 else "")
            for log, line, name in zip(logs, lay(logs), names, strict=True)
        ]
        by_unit: dict[str, list[Trace]] = {}
        names_by_unit: dict[str, list[str]] = {}
        for text in wanted:
            for source, parts in zip(sources, signals_named(logs, text, raw=raw), strict=True):
                for signal in parts:
                    names_by_unit.setdefault(signal.unit, []).append(signal.name)
                    by_unit.setdefault(signal.unit, []).append(_trace(source, signal, from_s, until_s))
        if not any(len(trace.x) for traces in by_unit.values() for trace in traces):
            raise LogError(f"{paths[0]}: nothing of {', '.join(wanted)} lies between --from and --until; widen them")
        overview = Overview(modes=states(sources, signals.modes), armed=states(sources, signals.armed))
        cards = tuple(
            Card(
                source.label,
                (("time line", source.time_line.sentence),),
                damage_sentences(source.log.health),
                source.log.health.degraded,
            )
            for source in sources
            if source.label
        )
    plots = tuple(
        Plot(f"signals.{unit or 'numbers'}", _title(names_by_unit[unit]), unit, tuple(traces))
        for unit, traces in by_unit.items()
    )
    part = Part(Section("signals", "Signals", plots=plots), TimeLine())
    title = " + ".join(names)
    return Page(title, "", (part,), cards, tuple(each.sentence for each in refusals), page_marks(overview)), refusals


def _trace(source: Source, signal: Signal, from_s: float | None, until_s: float | None) -> ThinTrace:
    at_s = source.time_line.seconds(signal.stamp_ns)
    inside = np.ones(len(at_s), dtype=np.bool_)
    if from_s is not None:
        inside &= at_s >= from_s
    if until_s is not None:
        inside &= at_s <= until_s
    at_ns = np.rint(at_s[inside] * 1e9).astype(np.int64)
    return thin(Trace(source.named(signal.name), at_ns, signal.values[inside]), over_time=True)


def _title(names: Sequence[str]) -> str:
    once = list(dict.fromkeys(names))
    return ", ".join(once[:_MOST_NAMES]) + (f" and {len(once) - _MOST_NAMES} more" if len(once) > _MOST_NAMES else "")
