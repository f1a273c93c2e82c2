"""The figures of a campaign as a table in a page, between two marks: `make figures`, `make figures-of-vehicles`.

    python tools/write_figures.py runs/figures docs/figures.md

The marks are lines of the page: `<!-- figures -->` and `<!-- end of figures -->`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xitl_cli.plugins.campaign.compare import counted_statuses
from xitl_cli.plugins.campaign.results import ResultTable, Row
from xitl_cli.plugins.campaign.statistics import spread

BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"
COLUMNS = {
    "time": ("duration_s", "s"),
    "cross-track RMS": ("mission.cross_track_rms_m", "m"),
    "at most": ("mission.cross_track_max_m", "m"),
    "estimate off, RMS": ("estimation.position_rms_m", "m"),
    "in heading": ("estimation.heading_rms_deg", "°"),
}
"""Heading of a column, and what it tells: median, then 95th percentile."""


def figures_table(table: ResultTable) -> str:
    """A row for each combination of the axes beside the seed, in Markdown; of COLUMNS those that were kept."""
    axes = [axis for axis in table.axes if axis != "seed"]
    columns = {head: column for head, column in COLUMNS.items() if any(column[0] in row for row in table.rows)}
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in table.rows:
        groups.setdefault(tuple(str(row[axis]).rpartition("/")[2] for axis in axes), []).append(row)
    head = [*("" for _ in axes), "completed", *columns]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    statuses = counted_statuses(table.verdicts)
    for names, rows in groups.items():
        completed = sum(row["status"] == "completed" for row in rows)
        counted = [row for row in rows if row["status"] in statuses]
        cells = [
            *names,
            f"{completed} of {len(rows)}",
            *(_spread_cell(counted, *column) for column in columns.values()),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _spread_cell(rows: Sequence[Row], figure: str, unit: str) -> str:
    values = [row[figure] for row in rows if row.get(figure) is not None]
    if not values:
        return "–"
    told = spread(np.array(values, dtype=np.float64))
    digits, between = (0, " ") if unit == "s" else (2, "" if unit == "°" else " ")
    return ", ".join(f"{value:.{digits}f}{between}{unit}" for value in (told.median, told.p95))


def with_table(page: str, table: str) -> str:
    """The page with this table between its marks. Raises ValueError where it has none."""
    pattern = re.compile(rf"({re.escape(BEGIN)}\n).*?(\n{re.escape(END)})", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"has no place for figures; put the lines {BEGIN} and {END} where they belong")
    return pattern.sub(lambda found: f"{found[1]}\n{table}\n{found[2]}", page)


def main() -> None:
    folder, page = map(Path, sys.argv[1:])
    try:
        text = with_table(page.read_text(encoding="utf-8"), figures_table(ResultTable.read(folder)))
    except ValueError as error:
        sys.exit(f"{page}: {error}")
    page.write_text(text, encoding="utf-8")
    print(f"{page}: the figures of {folder}")


if __name__ == "__main__":
    main()
