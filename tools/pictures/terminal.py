"""What a command prints, as an SVG of a terminal."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

COLUMNS = 118
# Rich's own format asks a server for a font.
_FORMAT = """<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  font-size: {char_height}px; line-height: {line_height}px; font-variant-east-asian: full-width; }}
.{unique_id}-title {{ font-size: 18px; font-weight: bold; font-family: system-ui, sans-serif; }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}" /></clipPath>{lines}</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}<g class="{unique_id}-matrix">{matrix}</g></g></svg>
"""


def told(command: str, directory: Path) -> str:
    """What `xitl …` prints in a folder. Raises CalledProcessError for an exit code above 1."""
    environment = {**os.environ, "COLUMNS": str(COLUMNS), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-m", "xitl_cli.main", *command.split()[1:]], cwd=directory, env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if done.returncode > 1:
        raise subprocess.CalledProcessError(done.returncode, command, done.stdout)
    return done.stdout


def _abridged(rows: Sequence[str]) -> list[str]:
    """Without most lines of a run's progress, which are as many as the machine is slow."""
    passed = [number for number, row in enumerate(rows) if row.startswith("t ")]
    left_out = passed[2:-1]
    return ["…" if number in left_out else row for number, row in enumerate(rows) if number not in left_out[1:]]


def draw(command: str, printed: str, path: Path, lines: tuple[int, int] = (0, 10_000)) -> None:
    """lines: first and last that are shown; a row of dots where others are left out."""
    rows = _abridged(printed.rstrip().splitlines())
    first, last = lines
    shown = [*(["…"] if first > 0 else []), *rows[first:last], *(["…"] if last < len(rows) else [])]
    console = Console(record=True, width=max(80, *map(len, shown)), file=io.StringIO(), force_terminal=True)
    console.print(Text.assemble(("$ ", "green"), (command, "bold")))
    console.print(Text.from_ansi("\n".join(shown)))
    path.write_text(console.export_svg(title="", code_format=_FORMAT, unique_id=path.stem), encoding="utf-8")
