"""Results of the bench as JSON: figures, and the runs of the bench that measured them.

    {"format": 1,
     "runs": [{"commit": …, "changed": false, "date_utc": …, "sizes": "full", "machine": {…}, "versions": {…}}],
     "figures": [{"name": …, "unit": …, "wanted": …, "run": 0, "values": […]}]}

A figure that could not be measured has `error` instead of values.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from agent.machine import read_machine

ROOT = Path(__file__).parents[2]
FORMAT = 1
FULL, TINY = "full", "tiny"
PACKAGES = ("numpy", "scipy", "mcap", "foxglove-sdk", "pymavlink", "embreex", "kiss-icp", "dask", "viser")


class ResultsError(Exception):
    """A file of results cannot be used. The text names the file and the cause."""


@dataclass(frozen=True)
class BenchRun:
    """One run of the bench."""

    commit: str
    """Empty if it is not known."""
    changed: bool
    """Whether files differed from that commit."""
    date_utc: str
    sizes: str
    """`full`, or `tiny` if the rows only showed that they work."""
    machine: dict[str, Any]
    versions: dict[str, str]


@dataclass(frozen=True)
class Measured:
    """A measured figure."""

    name: str
    unit: str
    wanted: str
    values: tuple[float, ...]
    run: BenchRun
    error: str = ""

    @property
    def median(self) -> float:
        return statistics.median(self.values)

    @property
    def more_is_better(self) -> bool:
        return self.wanted.startswith(">")


@dataclass(frozen=True)
class Results:
    """All figures of a file, by name."""

    figures: dict[str, Measured] = field(default_factory=dict)

    def updated(self, other: Results) -> Results:
        """Return these results with the measured figures of `other` in place of those with the same name."""
        measured = {name: figure for name, figure in other.figures.items() if not figure.error}
        return Results({**self.figures, **measured})

    def to_json(self) -> str:
        runs: list[BenchRun] = []
        rows = []
        for figure in self.figures.values():
            if figure.run not in runs:
                runs.append(figure.run)
            row: dict[str, Any] = {"name": figure.name, "unit": figure.unit, "wanted": figure.wanted}
            row["run"] = runs.index(figure.run)
            rows.append({**row, "error": figure.error} if figure.error else {**row, "values": list(figure.values)})
        text = json.dumps(
            {"format": FORMAT, "runs": [asdict(run) for run in runs], "figures": rows}, indent=1, ensure_ascii=False
        )
        return text + "\n"

    def write(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.to_json(), encoding="utf-8")


def read_results(path: Path) -> Results:
    """Return the results in a file. Raises ResultsError."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        runs = [BenchRun(**run) for run in stored["runs"]]
        figures = [
            Measured(
                row["name"], row["unit"], row["wanted"], tuple(row.get("values", ())), runs[row["run"]],
                row.get("error", ""),
            )
            for row in stored["figures"]
        ]  # fmt: skip
    except OSError as error:
        raise ResultsError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except (ValueError, KeyError, TypeError, IndexError):
        raise ResultsError(f"{path}: no results of the bench; make some with `make bench`") from None
    if stored.get("format") != FORMAT:
        raise ResultsError(f"{path}: has format {stored.get('format')} instead of {FORMAT}; measure again")
    return Results({figure.name: figure for figure in figures})


def this_run(sizes: str, root: Path = ROOT) -> BenchRun:
    """Return commit, machine and versions of a run that begins now. root: tree of the measured product."""
    return BenchRun(
        commit=_git(root, "rev-parse", "HEAD"),
        changed=bool(_git(root, "status", "--porcelain", "--untracked-files=no", "--", ":!tests/bench/measured.json")),
        date_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        sizes=sizes,
        machine={**read_machine()._asdict(), "load_1min_before": round(os.getloadavg()[0], 2)},
        versions={"python": platform.python_version(), **dict(_versions(PACKAGES))},
    )


def measured_in(run: BenchRun, rows: Iterable[tuple[str, str, str, Sequence[float], str]]) -> Results:
    """Return results from rows of (name, unit, wanted, values, error)."""
    return Results({row[0]: Measured(row[0], row[1], row[2], tuple(row[3]), run, row[4]) for row in rows})


def _versions(packages: Iterable[str]) -> Iterable[tuple[str, str]]:
    for package in packages:
        try:
            yield package, version(package)
        except PackageNotFoundError:
            continue


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""
