"""Figures of experiments as PNG and SVG, and one page with the tables that opens from the disk. Needs matplotlib."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xitl_cli.experiment.report import ExperimentReport, PaperFigure, told_text
from xitl_cli.experiment.setup import write_file
from xitl_cli.extras import FIGURES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PAGE = "paper.html"
DOTS_PER_INCH = 170
# Okabe and Ito's colours, which colour-blind people can distinguish.
OURS, OTHER, PAPER, THIRD, GREY = "#0072b2", "#e69f00", "#d55e00", "#009e73", "#777777"
STYLE: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.fontsize": 7.5,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "lines.linewidth": 1.2,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "xitl",
    "axes.formatter.useoffset": False,
}


def check_figures_installed() -> None:
    """Raise UserError with an installation command if figures cannot be drawn."""
    FIGURES.require("figures need")


def mark_paper(axes: Axes, value: float, text: str) -> None:
    """Draw a dashed level line at the paper's value."""
    axes.axhline(value, color=PAPER, linestyle="--", linewidth=1.0, label=f"paper: {text}")


def name_lines(axes: Axes, **look: Any) -> None:
    """Add a legend if any line has a name."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(**look)


def write_figures(report: ExperimentReport, directory: Path) -> list[Path]:
    """Write NAME.png and NAME.svg of each figure and replace earlier ones. Raises UserError for a write failure."""
    files = []
    for figure in report.figures:
        for kind in ("png", "svg"):
            files.append(directory / f"{figure.name}.{kind}")
            write_file(files[-1], drawn(figure, kind))
    return files


def write_page(reports: Sequence[ExperimentReport], path: Path) -> None:
    """Write all tables and figures in one file that needs no network."""
    write_file(path, "\n".join(_page(reports)).encode())


def drawn(figure: PaperFigure, kind: str) -> bytes:
    """Return the figure as `png` or `svg`; equal content gives equal bytes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        canvas = Figure(figsize=figure.size_in)
        figure.draw(canvas)
        written = BytesIO()
        canvas.savefig(written, format=kind, dpi=DOTS_PER_INCH, metadata={"Date": None} if kind == "svg" else None)
    return written.getvalue()


_CSS = """
:root { color-scheme: light dark; --text: #1b1b1b; --back: #ffffff; --line: #d0d0d0; --soft: #666666; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e6e6; --back: #16181c; --line: #3a3d44; --soft: #a0a0a0; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--back); margin: 2rem auto;
  max-width: 62rem; padding: 0 1rem; }
h2 { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: 1rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; }
th, td { text-align: left; vertical-align: top; padding: 0.35rem 0.6rem; border-bottom: 1px solid var(--line); }
td.value { white-space: nowrap; font-variant-numeric: tabular-nums; }
figure { margin: 2rem 0; }
figure img { width: 100%; height: auto; background: #ffffff; padding: 0.5rem; box-sizing: border-box; }
figcaption, .note { color: var(--soft); font-size: 0.9rem; }
nav a { margin-right: 1rem; }
"""


def _page(reports: Sequence[ExperimentReport]) -> Iterator[str]:
    yield '<!doctype html><html lang="en"><head><meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>The paper's experiments, repeated</title><style>{_CSS}</style></head><body>"
    yield "<h1>The paper's experiments, repeated</h1>"
    yield (
        "<p>Ribeiro et al., <cite>A novel integrated architecture to X-in-the-loop simulation applied to ASV "
        "navigation</cite>, Robotica, 2024: its values and the values of these runs.</p>"
    )
    links = (f'<a href="#{_anchor(report)}">{escape(report.section)}</a>' for report in reports)
    yield f"<nav>{''.join(links)}</nav>" if len(reports) > 1 else ""
    for report in reports:
        yield f'<section id="{_anchor(report)}"><h2>{escape(report.section)} {escape(report.title)}</h2>'
        yield from (f'<p class="note">{escape(note)}</p>' for note in report.notes)
        yield '<div class="wide"><table><thead><tr><th>quantity</th><th>paper</th><th>ours</th><th>difference</th></tr>'
        yield "</thead><tbody>"
        for row in report.rows:
            cells = "".join(
                f'<td class="value">{escape(told_text(value, row.unit))}</td>' for value in (row.paper, row.ours)
            )
            yield f"<tr><td>{escape(row.quantity)}</td>{cells}<td>{escape(row.difference)}</td></tr>"
        yield "</tbody></table></div>"
        for figure in report.figures:
            picture = base64.b64encode(drawn(figure, "svg")).decode()
            yield f'<figure><img alt="{escape(figure.caption)}" src="data:image/svg+xml;base64,{picture}">'
            yield f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
        yield "</section>"
    yield "</body></html>"


def _anchor(report: ExperimentReport) -> str:
    return f"section-{report.section.lower().replace('.', '-')}"
