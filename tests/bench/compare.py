"""`make bench-compare`: two results of the bench, or two commits, in pairs with intervals.

    python -m tests.bench.compare old.json new.json
    python -m tests.bench.compare main HEAD --only mitl --pairs 7

Two commits are measured by turns, in worktrees below build/bench, with the bench of HEAD. Values of one turn are a
pair, because other programs disturb both alike. Two files are not paired: their values are resampled independently.

The ratio is B over A, with the interval of its median at 95 % (bootstrap). An interval that includes 1 shows no
difference.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tests.bench.results import ROOT, Measured, Results, ResultsError, read_results

RESAMPLES = 4000
CONFIDENCE = 0.95
PAIRS = 5
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """A figure of A and B. ratio: of B over A; low, high: its interval; least, most: of single pairs."""

    name: str
    unit: str
    median_a: float
    median_b: float
    ratio: float
    low: float
    high: float
    least: float
    most: float
    more_is_better: bool | None

    @property
    def verdict(self) -> str:
        """`better`, `worse` or `no difference`; `more` or `less` for a figure without a limit."""
        if self.low <= 1.0 <= self.high:
            return "no difference"
        if self.more_is_better is None:
            return "more" if self.ratio > 1.0 else "less"
        return "better" if (self.ratio > 1.0) == self.more_is_better else "worse"


def compare(a: Results, b: Results, paired: bool) -> list[Comparison]:
    """Return the figures that both have, in the order of B. Figures with a value of 0 have no ratio."""
    return [
        compare_figure(a.figures[name], figure, paired)
        for name, figure in b.figures.items()
        if name in a.figures and _has_ratio(a.figures[name]) and _has_ratio(figure)
    ]


def _has_ratio(figure: Measured) -> bool:
    return bool(figure.values) and min(figure.values) > 0.0


def compare_figure(a: Measured, b: Measured, paired: bool) -> Comparison:
    """Return the comparison of one figure. The bootstrap repeats, because its seed is fixed."""
    values_a, values_b = np.array(a.values), np.array(b.values)
    pairs = values_b / values_a if paired else (values_b[:, None] / values_a[None, :]).ravel()
    ratio = float(np.median(pairs)) if paired else float(np.median(values_b) / np.median(values_a))
    low, high = paired_interval(pairs) if paired else free_interval(values_a, values_b)
    more_is_better = b.more_is_better if b.wanted else None
    return Comparison(
        b.name, b.unit, a.median, b.median, ratio, low, high, float(pairs.min()), float(pairs.max()), more_is_better
    )


def paired_interval(ratios: Array) -> tuple[float, float]:
    """Return the interval of the median of ratios of pairs."""
    rng = np.random.default_rng(1)
    drawn = rng.choice(ratios, (RESAMPLES, len(ratios)))
    return _interval(np.median(drawn, axis=1))


def free_interval(a: Array, b: Array) -> tuple[float, float]:
    """Return the interval of the ratio of two medians of independent values."""
    rng = np.random.default_rng(1)
    medians = [np.median(rng.choice(values, (RESAMPLES, len(values))), axis=1) for values in (b, a)]
    return _interval(medians[0] / medians[1])


def _interval(samples: Array) -> tuple[float, float]:
    low, high = np.quantile(samples, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return float(low), float(high)


# Two commits


def measure_commits(commits: Sequence[str], words: Sequence[str], pairs: int, tiny: bool) -> list[Results]:
    """Measure two commits by turns. Raises ResultsError when git or the bench fails."""
    results = [Results(), Results()]
    with worktree(ROOT, commits[0]) as tree_a, worktree(ROOT, commits[1]) as tree_b:
        for number in range(pairs):
            order = (0, 1) if number % 2 == 0 else (1, 0)
            for side in order:
                print(f"pair {number + 1} of {pairs}: {commits[side]}", file=sys.stderr, flush=True)
                turn = run_bench((tree_a, tree_b)[side], words, tiny)
                results[side] = joined(results[side], turn)
    return results


def joined(before: Results, turn: Results) -> Results:
    """Return results with one more value for each figure: the median of the turn."""
    figures = dict(before.figures)
    for name, figure in turn.figures.items():
        if figure.error:
            continue
        earlier = before.figures[name].values if name in before.figures else ()
        figures[name] = Measured(name, figure.unit, figure.wanted, (*earlier, figure.median), figure.run)
    return Results(figures)


@contextmanager
def worktree(root: Path, commit: str) -> Iterator[Path]:
    """Context with a worktree of the commit that has the tests of HEAD, so that both are measured alike.

    root: a repository. The worktree is below its folder `build` and is removed afterwards.
    """
    sha = _git(root, "rev-parse", "--verify", f"{commit}^{{commit}}")
    folder = root / "build" / "bench" / f"tree-{sha[:12]}-{os.getpid()}"
    while folder.exists():  # the same commit twice
        folder = folder.with_name(f"{folder.name}-again")
    _git(root, "worktree", "add", "--detach", str(folder), sha)
    try:
        _git(folder, "checkout", _git(root, "rev-parse", "HEAD"), "--", "tests")
        yield folder
    finally:
        _git(root, "worktree", "remove", "--force", str(folder))


def run_bench(tree: Path, words: Sequence[str], tiny: bool) -> Results:
    """Return the results of the bench in a tree."""
    out = tree / "build" / "result.json"
    command = [sys.executable, "-m", "tests.bench", "--out", str(out), *(["--tiny"] if tiny else [])]
    command += [word for name in words for word in ("--only", name)]
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
    if not out.exists():
        raise ResultsError(f"the bench failed in {tree}: {done.stderr.strip()[-2000:]}")
    if done.returncode:
        print(done.stderr, file=sys.stderr)
    return read_results(out)


def _git(folder: Path, *words: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ResultsError(f"git {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout.strip()


# The command


def print_comparisons(comparisons: Sequence[Comparison]) -> None:
    """Print a table with a row for each figure."""
    table = Table("figure", "unit", "A", "B", "B / A", "95 %", "pairs", "", box=None)
    for row in comparisons:
        cells = (f"{row.median_a:.3g}", f"{row.median_b:.3g}", f"{row.ratio:.3f}")
        spans = (f"{row.low:.3f} to {row.high:.3f}", f"{row.least:.3f} to {row.most:.3f}")
        table.add_row(row.name, row.unit, *cells, *spans, row.verdict)
    Console(width=140).print(table)


def heading(side: str, results: Results) -> str:
    """Return a line on the machine and commit of results."""
    runs = list(dict.fromkeys((figure.run.commit, figure.run.machine["name"]) for figure in results.figures.values()))
    told = "; ".join(f"{commit[:9] or 'unknown commit'} on {machine}" for commit, machine in runs) or "no figures"
    counts = [len(figure.values) for figure in results.figures.values() if figure.values]
    return f"{side}: {told}, {statistics.median(counts) if counts else 0:g} values for each figure"


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare and print. Return 2 when there is nothing to compare."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("a", help="file of results, or a commit")
    parser.add_argument("b", help="file of results, or a commit")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="figures with WORD in their name")
    parser.add_argument("--pairs", type=int, default=PAIRS, metavar="N", help=f"pairs of commits (default: {PAIRS})")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep the results of two commits as a.json and b.json")
    parser.add_argument("--tiny", action="store_true", help="measure commits with tiny sizes, only to try it")
    options = parser.parse_args(arguments)
    sides = (options.a, options.b)
    files = [Path(side).is_file() for side in sides]
    try:
        if any(files) and not all(files):
            raise ResultsError(f"{sides[files.index(False)]}: is not a file; compare two files or two commits")
        if all(files):
            a, b = (read_results(Path(side)) for side in sides)
        else:
            a, b = measure_commits(sides, options.only, max(options.pairs, 1), options.tiny)
            if options.out is not None:
                a.write(options.out / "a.json")
                b.write(options.out / "b.json")
        comparisons = compare(a, b, paired=not all(files))
        comparisons = [
            row
            for row in comparisons
            if not options.only or any(word.lower() in row.name.lower() for word in options.only)
        ]
        if not comparisons:
            raise ResultsError(f"{sides[0]} and {sides[1]} have no figure in common; --only chooses figures")
    except ResultsError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(heading("A", a))
    print(heading("B", b))
    print_comparisons(comparisons)
    return 0


if __name__ == "__main__":
    sys.exit(main())
