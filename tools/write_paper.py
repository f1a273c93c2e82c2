"""The tables of the paper's experiments into docs/paper.md, and their figures into docs/img. `make paper` does it.

python tools/write_paper.py runs/paper

A table stands between two marks of the page: `<!-- table: 4.1 -->` and `<!-- end of table -->`.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from xitl_cli.experiment.report import told_text
from xitl_cli.plugins.studies.api import EXPERIMENTS

ROOT = Path(__file__).resolve().parent.parent
PAGE, IMAGES = ROOT / "docs" / "paper.md", ROOT / "docs" / "img"
END = "<!-- end of table -->"


def table_lines(found: dict[str, Any]) -> str:
    """Of a table.json, as Markdown."""
    rows = ["| quantity | paper | ours | difference |", "|---|---|---|---|"]
    for row in found["table"]:
        values = (told_text(row[side], row["unit"]) for side in ("paper", "ours"))
        rows.append(f"| {row['quantity']} | {' | '.join(values)} | {row['difference']} |")
    return "\n".join(rows)


def with_table(text: str, section: str, table: str) -> str:
    """The page with this table. Raises ValueError where it has no place for it."""
    begin = f"<!-- table: {section} -->"
    if begin not in text or END not in text:
        raise ValueError(f"has no place for {section}; put {begin} and {END} where its table belongs")
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(END), re.DOTALL)
    return pattern.sub(lambda _: f"{begin}\n\n{table}\n\n{END}", text)


def main() -> None:
    folder = Path(sys.argv[1])
    text = PAGE.read_text(encoding="utf-8")
    for section in EXPERIMENTS:
        told = folder / section / "table.json"
        if not told.is_file():
            print(f"{section}: not in {folder}, left as it is")
            continue
        found = json.loads(told.read_text(encoding="utf-8"))
        text = with_table(text, section, table_lines(found))
        for name in found["figures"]:
            with Image.open(told.parent / f"{name}.png") as picture:  # few colours do: a quarter of the size
                picture.convert("RGB").quantize(96).save(IMAGES / f"paper-{name}.png", optimize=True)
    PAGE.write_text(text, encoding="utf-8")
    print(f"{PAGE}: the tables and figures of {folder}")


if __name__ == "__main__":
    main()
