"""A page of the signals that a user selected: one plot per unit, all on one time line."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.named_signals import LogSignal, signals_named
from xitl_cli.logs.model.sections import Plot, Section, Trace
from xitl_cli.logs.model.table import whole_ns
from xitl_cli.logs.report.build import ReportLog, Style, open_all, short_names, state_marks, time_lines
from xitl_cli.logs.report.file_report import RefusedFile
from xitl_cli.logs.report.html import refuse_other, replace_file
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
    """Build a page of signals.

    from_s, until_s: on the page's time line. vessel: as in `open_all`. Raises LogError if no file opens, or none has a
    signal.
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
                    sentences = [sentence for sentence in (signal.time_base, *signal.notes) if sentence]
                    notes.update(dict.fromkeys(map(source.named, sentences)))
        if not any(len(trace.x) for traces in by_unit.values() for trace in traces):
            raise LogError(f"{paths[0]}: {', '.join(wanted)} has no value between --from and --until; widen the span")
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
    plots = []
    for unit, traces in by_unit.items():
        signal_names = list(dict.fromkeys(names_by_unit[unit]))
        title = ", ".join(signal_names[:_MOST_NAMES])
        if len(signal_names) > _MOST_NAMES:
            title += f" and {len(signal_names) - _MOST_NAMES} more"
        plots.append(Plot(f"signals.{unit or 'numbers'}", title, unit, tuple(traces)))
    part = PagePart(Section("signals", "Signals", plots=tuple(plots)), TimeLine())
    notices = (*(refusal.sentence for refusal in refusals), *notes)
    return Page(" + ".join(names), "", (part,), cards, notices, page_marks(overview)), refusals


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


# Time plots as one PNG, SVG or PDF file, drawn by matplotlib.

IMAGE_KINDS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
"""Suffixes of images, and the first bytes of each kind of file."""
PAGE_SUFFIXES = (".html", ".htm")

_WIDTH_IN, _PLOT_HEIGHT_IN, _MARGIN_IN = 10.0, 2.6, 0.9
_DOTS_PER_INCH = 150
_STYLE: Any = {"font.size": 9.0, "axes.grid": True, "grid.alpha": 0.3, "svg.fonttype": "none", "svg.hashsalt": "xitl",
          "axes.formatter.useoffset": False}  # fmt: skip
_DATES: dict[str, dict[str, Any]] = {".png": {}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def is_image(path: Path) -> bool:
    """Whether the suffix is that of an image.

    Raises LogError for a suffix of neither an image nor a page, and if matplotlib is missing.
    """
    suffix = path.suffix.lower()
    if suffix not in IMAGE_KINDS:
        if suffix and suffix not in PAGE_SUFFIXES:
            raise LogError(f"{path}: cannot plot to {suffix}; name a file that ends in .html, .png, .svg or .pdf")
        return False
    if importlib.util.find_spec("matplotlib") is None:
        raise LogError(
            f"{path}: {suffix} needs matplotlib, which is not installed; install it with "
            "`pip install 'xitl[figures]'`, or name a file that ends in .html"
        )
    return True


def refuse_other_image(path: Path) -> None:
    """Raise LogError if a file of another kind exists at the path, because a log would be lost."""
    suffix = path.suffix.lower()
    refuse_other(path, IMAGE_KINDS[suffix], f"{suffix} image", f"plot{suffix}")


def write_image(page: Page, path: Path) -> None:
    """Write all time plots below each other, on one time axis. Equal content gives equal bytes.

    Replaces an earlier image of this kind. Raises LogError if it cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    refuse_other_image(path)
    suffix = path.suffix.lower()
    plots = [(part, plot) for part in page.parts for plot in part.section.plots if plot.kind == "time"]
    with rc_context(_STYLE):
        size_in = (_WIDTH_IN, _PLOT_HEIGHT_IN * len(plots) + _MARGIN_IN)
        figure = Figure(figsize=size_in, layout="constrained")
        figure.suptitle(_plain(page.title))
        rows = figure.subplots(len(plots), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (part, plot) in zip(rows, plots, strict=True):
            for trace in plot.traces:
                kept = thin(trace, over_time=True)
                at_s = part.time_line.seconds(kept.x.astype("int64"))
                style = "steps-post" if trace.style == "steps" else "default"
                line, marker = ("", ".") if trace.style == "points" else ("-", "")
                look = {"drawstyle": style, "linestyle": line, "marker": marker, "linewidth": 1.0}
                axes.plot(at_s, kept.y, label=_plain(trace.name), **look)
            axes.set_title(_plain(plot.title), fontsize="medium", loc="left")
            axes.set_ylabel(_plain(plot.y_label))
            if len(plot.traces) > 1:
                axes.legend(fontsize="small", loc="upper right", ncols=min(len(plot.traces), 4))
        rows[-1].set_xlabel("time (s)")
        image = BytesIO()
        figure.savefig(image, format=suffix[1:], dpi=_DOTS_PER_INCH, metadata=_DATES[suffix])
    replace_file(path, image.getvalue())


def _plain(text: str) -> str:
    """Text without the sign that begins a formula, and without the underscore that hides a label."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
