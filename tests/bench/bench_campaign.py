"""What a campaign adds to its runs, beside the same runs as bare subprocesses one after the other.

    python -m tests.bench.bench_campaign                  # whole missions of sitl
    python -m tests.bench.bench_campaign --duration 0.5   # runs that hardly begin

Two figures. Processor time of everything, runs and all, by the kernel's account of ended children: it is the same on a
busy machine, and a campaign keeps a client, a scheduler and workers awake. Wall-clock time with one worker, where
nothing hides behind another run; on a busy machine it says little. What a campaign takes to begin and to end (imports,
workers, the try of the first run, the table) is taken off by a campaign of one run: it is not of each run.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

PROGRAM = [sys.executable, "-m", "xitl_cli.main"]


def cost(work: Callable[[], None]) -> tuple[float, float]:
    """(processor seconds of ended children, wall-clock seconds)."""
    before, begun_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    work()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return processor_s, time.perf_counter() - begun_s


def call(duration_s: float | None, *arguments: str) -> None:
    """Exits with what a command has said that did not do its work, whose time would be no run's.

    Runs that are cut short are not completed, which is exit code 1.
    """
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    told = subprocess.run([*PROGRAM, *arguments], env=environment, capture_output=True, text=True, check=False)
    if told.returncode not in ((0,) if duration_s is None else (0, 1)):
        sys.exit(f"xitl {' '.join(arguments)}: exit code {told.returncode}\n{told.stdout}{told.stderr}")


def bare_runs(folder: Path, runs: int, duration_s: float | None) -> None:
    """Seeds 1 to `runs`."""
    limit = [] if duration_s is None else ["--set", f"clock.duration_s={duration_s}"]
    for seed in range(1, runs + 1):
        call(duration_s, "sim", "sitl", *limit, "--seed", str(seed), "--out", str(folder / f"{seed}"))


def campaign(folder: Path, runs: int, duration_s: float | None) -> None:
    """The same by one worker."""
    limit = "" if duration_s is None else f"set: {{clock.duration_s: {duration_s}}}\n"
    plan = folder / f"plan-{runs}.yaml"
    plan.write_text(f"base: sitl\n{limit}seeds: {runs}\nrecordings: all\n", encoding="utf-8")
    call(duration_s, "campaign", str(plan), "--workers", "1", "--out", str(folder / f"campaign-{runs}"))


def overheads(runs: int, duration_s: float | None, rounds: int) -> Iterator[tuple[float, float, float]]:
    """(share of processor time, share of wall-clock time, seconds a bare run), one a round; turns are taken."""
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            bare = cost(lambda: bare_runs(folder, runs, duration_s))  # noqa: B023  called at once
            one = cost(lambda: campaign(folder, 1, duration_s))  # noqa: B023
            many = cost(lambda: campaign(folder, runs + 1, duration_s))  # noqa: B023
            each = [(many[index] - one[index]) / bare[index] - 1.0 for index in range(2)]
            yield each[0], each[1], bare[1] / runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--duration", type=float, help="simulated seconds of a run; the whole mission if left out")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    for processor, wall, run_s in overheads(given.runs, given.duration, given.rounds):
        added = f"{100 * processor:+.1f} % processor time, {100 * wall:+.1f} % wall clock"
        print(f"a bare run {run_s:.1f} s; a campaign adds {added}")


if __name__ == "__main__":
    main()
