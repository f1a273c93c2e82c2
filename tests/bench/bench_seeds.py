"""A profile with many seeds: median, 95th percentile and worst of what its runs say of themselves.

One good seed proves little; this is where the figures of the docs come from. Run by hand, with seeds that nobody has
looked at:

    python -m tests.bench.bench_seeds sitl --seeds 501-520
    python -m tests.bench.bench_seeds sitl-perception --seeds 501-520 --out runs/perception-seeds
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

Summary = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Figure:
    """keys: where it stands in a summary. more_is_better: its bad side is the low one."""

    name: str
    keys: tuple[str, ...]
    unit: str = "m"
    more_is_better: bool = False
    share: float = 1.0

    def value(self, summary: Summary) -> float | None:
        found: Any = summary
        for key in self.keys:
            if not isinstance(found, dict) or found.get(key) is None:
                return None
            found = found[key]
        return float(found) * self.share


FIGURES = (
    Figure("cross-track, RMS", ("mission", "cross_track_rms_m")),
    Figure("cross-track, at most", ("mission", "cross_track_max_m")),
    Figure("armed after", ("autopilot", "time_to_arm_s"), "s"),
    Figure("estimate off in position, RMS", ("estimation", "position_rms_m")),
    Figure("its mean squared error over its variance (2 is due)", ("estimation", "position_nees"), ""),
    Figure("estimate off in heading, RMS", ("estimation", "heading_rms_deg"), "deg"),
    Figure("odometry aligned (ATE), RMS", ("odometry", "ate_rms_m")),
    Figure("odometry aligned (ATE), at most", ("odometry", "ate_max_m")),
    Figure("odometry from a common start, RMS", ("odometry", "anchored_rms_m")),
    Figure("odometry from a common start, at most", ("odometry", "anchored_max_m")),
    Figure("odometry from a common start, level, RMS", ("odometry", "anchored_level_rms_m")),
    Figure("odometry over a second (RPE), RMS", ("odometry", "rpe_m")),
    Figure("map off the boom within 1 m of it, RMS", ("mapping", "boom_rms_m")),
    Figure("map off the boom, all of it, RMS", ("mapping", "boom_uncut_rms_m")),
    Figure("floats seen of those passed", ("mapping", "coverage"), "%", more_is_better=True, share=100.0),
    Figure("clearance of what drifts, least", ("obstacles", "min_clearance_m"), "m", more_is_better=True),
    Figure("obstacles of nothing", ("obstacles", "false"), ""),
    Figure("collisions", ("collisions", "count"), ""),
)


@dataclass(frozen=True, slots=True)
class Spread:
    """What twenty runs say of a figure: the 95th percentile is toward its bad side, the worst is the run's `seed`."""

    figure: Figure
    median: float
    percentile_95: float
    worst: float
    seed: int
    runs: int


def spreads(summaries: Sequence[Summary]) -> list[Spread]:
    """Of every figure that some run has; percentiles interpolate between runs."""
    found = []
    for figure in FIGURES:
        values = [(value, summary["seed"]) for summary in summaries if (value := figure.value(summary)) is not None]
        if not values:
            continue
        numbers = [value for value, _ in values]
        worst, seed = (min if figure.more_is_better else max)(values)
        bad = 5.0 if figure.more_is_better else 95.0
        found.append(
            Spread(figure, float(np.median(numbers)), float(np.percentile(numbers, bad)), worst, seed, len(values))
        )
    return found


def seed_range(text: str) -> list[int]:
    """`501-520`, or `3,5,8`."""
    first, dash, last = text.partition("-")
    return list(range(int(first), int(last) + 1)) if dash else [int(part) for part in text.split(",")]


def run_seed(profile: str, seed: int, options: Sequence[str], directory: Path) -> Summary:
    """The summary of one run, which takes a process of its own."""
    command = [sys.executable, "-m", "xitl_cli.main", "sim", profile, "--seed", str(seed), "--json", *options]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    result = subprocess.run(
        [*command, "--out", str(directory), "--overwrite"], capture_output=True, check=False, env=environment
    )
    if result.returncode not in (0, 1):
        raise RuntimeError(f"{' '.join(command)}: exit code {result.returncode}: {result.stderr.decode()}")
    summary: Summary = json.loads(result.stdout)
    return summary


def measured(profile: str, seeds: Sequence[int], options: Sequence[str], jobs: int, out: Path | None) -> list[Summary]:
    """One run a seed, `jobs` at a time; recordings are kept in `out` alone."""

    def one(seed: int) -> Summary:
        if out is not None:
            return run_seed(profile, seed, options, out / str(seed))
        with tempfile.TemporaryDirectory() as folder:
            return run_seed(profile, seed, options, Path(folder) / "run")

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(one, seeds))


def show(profile: str, summaries: Sequence[Summary]) -> None:
    table = Table("figure", "unit", "median", "95th percentile", "worst", "of seed", "runs", box=None)
    for spread in spreads(summaries):
        cells = (f"{value:.3g}" for value in (spread.median, spread.percentile_95, spread.worst))
        table.add_row(spread.figure.name, spread.figure.unit, *cells, str(spread.seed), str(spread.runs))
    completed = sum(bool(summary["verdict"]["completed"]) for summary in summaries)
    console = Console(width=120)
    console.print(f"{profile}: {completed} of {len(summaries)} runs completed")
    console.print(table)
    for summary in summaries:
        if not summary["verdict"]["completed"]:
            console.print(f"seed {summary['seed']}: {summary['verdict']['why']}", markup=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("profile")
    parser.add_argument("--seeds", type=seed_range, default=seed_range("501-520"), help="501-520, or 3,5,8")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="runs at once (default: processors)")
    parser.add_argument("--out", type=Path, help="keep the runs here, and summaries.json")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="as of xitl sim")
    parser.add_argument("--duration", metavar="S", help="as of xitl sim")
    given = parser.parse_args()
    options = [part for text in given.set for part in ("--set", text)]
    options += ["--duration", given.duration] if given.duration else []
    summaries = measured(given.profile, given.seeds, options, given.jobs, given.out)
    show(given.profile, summaries)
    if given.out is not None:
        (given.out / "summaries.json").write_text(json.dumps(summaries) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
