"""`make bench`: the figures the project promises, each measured as the median of several runs. Asserts nothing.

    python -m tests.bench                                 # all; writes build/bench/<commit>-<time>.json
    python -m tests.bench --list
    python -m tests.bench --only fleet --only mitl --out mine.json
    python -m tests.bench --tiny                          # shows that the rows work; its figures say nothing

`python -m tests.bench.compare` compares two such files, or two commits.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench import (
    bench_ardupilot,
    bench_commands,
    bench_fleet,
    bench_fleet_step,
    bench_latency,
    bench_learning,
    bench_lidar,
    bench_logs,
    bench_logs_mcap,
    bench_logs_tlog,
    bench_px4,
    bench_rays,
    bench_view,
)
from tests.bench.bench_commands import simulate
from tests.bench.bench_ground import attitude_gap_ms, parameter_list_s
from tests.bench.bench_link import agent_cpu_percent, lost_messages, round_trip_ratios
from tests.bench.bench_vessel_step import median_step_us
from tests.bench.figure import Figure, scaled, use_tiny_sizes
from tests.bench.results import FULL, ROOT, TINY, BenchRun, measured_in, this_run
from xitl_cli.extras import CAMERA

RUNS = 5


def one_vessel_us() -> list[float]:
    return [median_step_us(1, scaled(8_000, 40)) for _ in range(scaled(RUNS, 1))]


def batch_step_ms() -> list[float]:
    return [median_step_us(1024, scaled(600, 10)) * 1e-3 for _ in range(scaled(RUNS, 1))]


def agent_start_s() -> list[float]:
    return [with_agent(lambda _: None)[0] for _ in range(scaled(RUNS, 1))]


def agent_resident_mib() -> list[float]:
    """While it waits for a host."""
    return [with_agent(resident_mib)[1] or 0.0 for _ in range(scaled(RUNS, 1))]


def agent_flying_mib() -> list[float]:
    """After twenty seconds of a mission, as the agent itself reports it."""
    return [simulate("--profile", "hitl-loopback", "--duration", scaled("20", "2"))["nodes"][0]["memory_mib"]]


def lost_messages_count() -> list[float]:
    """Both ways; `make soak` goes on for ten minutes."""
    counts = lost_messages(scaled(20.0, 1.0))
    return [counts["to_agent_lost"] + counts["to_host_lost"] + counts["unsent"]]


def with_agent(look: Callable[[int], float | None]) -> tuple[float, float | None]:
    """Seconds until the agent listens, and what `look` says of its process."""
    started_s = time.perf_counter()
    command = [sys.executable, "-m", "agent", "--link", "udp://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        took_s = time.perf_counter() - started_s
        seen = look(process.pid)
        process.terminate()
    return took_s, seen


def resident_mib(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) / 1024
    raise RuntimeError(f"process {pid} has no resident size")


FIGURES: list[Figure] = [
    *bench_commands.RUN_FIGURES,
    *bench_fleet.FIGURES,
    Figure("one vessel step with environment, N = 1", "< 30", "us", one_vessel_us),
    Figure("a step of a batch of 1024 vessels in waves", "", "ms", batch_step_ms),
    *bench_fleet_step.FIGURES,
    *bench_learning.FIGURES,
    *bench_view.FIGURES,
    *bench_commands.COMMAND_FIGURES,
    Figure("agent process until it listens", "< 0.5", "s", agent_start_s),
    Figure("all parameters to a ground station", "< 2", "s", parameter_list_s),
    Figure("longest gap of 50 Hz attitude to three stations", "< 60", "ms", attitude_gap_ms),
    Figure("sensor to actuator at 400 Hz, p50, of an echo's", "<= 4", "x", round_trip_ratios(0.5)),
    Figure("sensor to actuator at 400 Hz, p99, of an echo's", "<= 4", "x", round_trip_ratios(0.99)),
    Figure("agent's processor time at 100 Hz", "< 10", "% of a core", agent_cpu_percent),
    Figure("messages lost in 20 s at 2000 a second", "0", "", lost_messages_count),
    Figure("agent process resident, waiting", "< 40", "MiB", agent_resident_mib),
    Figure("agent process resident, flying in real time", "< 40", "MiB", agent_flying_mib),
    *bench_logs_mcap.FIGURES,
    *bench_logs.FIGURES,
    *bench_logs_tlog.FIGURES,
]
OPTIONAL: list[tuple[Callable[[], bool], str, list[Figure]]] = [
    (
        bench_rays.available,
        "embreex is not installed; pip install 'xitl[perception]'",
        [*bench_commands.PERCEPTION_FIGURES, *bench_rays.FIGURES, *bench_lidar.FIGURES],
    ),
    (
        lambda: not CAMERA.missing,
        "moderngl or OpenCV is not installed; pip install 'xitl[camera]'",
        bench_commands.CAMERA_FIGURES,
    ),
    (
        bench_ardupilot.available,
        "no ardurover on the PATH, in the cache, or named by XITL_ARDUROVER",
        bench_ardupilot.FIGURES,
    ),
    (bench_latency.available, "SCHED_FIFO is not permitted; xitl doctor shows the remedy", bench_latency.FIGURES),
    (bench_px4.available, "no PX4 on the PATH, or named by XITL_PX4", bench_px4.FIGURES),
]
"""Whether figures can be measured here, the reason if not, and the figures."""


def all_figures() -> list[Figure]:
    """Return every figure, also those that cannot be measured here."""
    return [*FIGURES, *(figure for _, _, figures in OPTIONAL for figure in figures)]


def chosen(words: Sequence[str]) -> list[Figure]:
    """Return the figures whose names contain one of the words, all without words. Prints why some are left out."""
    figures = list(FIGURES)
    for available, reason, optional in OPTIONAL:
        if available():
            figures += optional
        elif any(_named(figure, words) for figure in optional):
            print(f"{', '.join(figure.name for figure in optional)}: not measured: {reason}", file=sys.stderr)
    return [figure for figure in figures if _named(figure, words)]


def _named(figure: Figure, words: Sequence[str]) -> bool:
    return not words or any(word.lower() in figure.name.lower() for word in words)


def measure(figures: Sequence[Figure], tell: Callable[[str], object]) -> list[tuple[str, str, str, list[float], str]]:
    """Return (name, unit, wanted, values, error) of each. A figure that fails does not end the bench."""
    rows = []
    for number, figure in enumerate(figures, start=1):
        tell(f"{number} of {len(figures)}: {figure.name}")
        values, error = [], ""
        try:
            values = [float(value) for value in figure.measure()]
        except Exception as problem:  # noqa: BLE001  the other rows are worth having
            error = f"{type(problem).__name__}: {problem}"
        rows.append((figure.name, figure.unit, figure.wanted, values, error))
    return rows


def default_path(run: BenchRun) -> Path:
    """Return a new path in build/bench."""
    instant = run.date_utc.partition("+")[0].replace(":", "").replace("-", "")
    return ROOT / "build" / "bench" / f"{run.commit[:9] or 'unknown'}-{instant}.json"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print a table and write the results. Return 1 when a row failed."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="figures with WORD in their name")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file of the results (default: in build/bench)")
    parser.add_argument("--campaign-runs", type=int, metavar="N", help="runs of the campaign's row (default: 60)")
    parser.add_argument("--tiny", action="store_true", help="measure with tiny sizes, only to try the rows")
    parser.add_argument("--list", action="store_true", help="print the names of the figures")
    options = parser.parse_args(arguments)
    if options.list:
        print("\n".join(figure.name for figure in all_figures()))
        return 0
    if options.campaign_runs is not None:
        os.environ[bench_commands.CAMPAIGN_VARIABLE] = str(max(options.campaign_runs, 1))
    use_tiny_sizes(options.tiny)
    figures = chosen(options.only)
    if not figures:
        print(f"no figure is named like {', '.join(options.only)}; --list prints the names", file=sys.stderr)
        return 2
    run = this_run(TINY if options.tiny else FULL)
    rows = measure(figures, lambda text: print(text, file=sys.stderr, flush=True))
    table = Table("figure", "unit", "wanted", "median", "least", "most", box=None)
    for name, unit, wanted, values, error in rows:
        cells = (statistics.median(values), min(values), max(values)) if values else ()
        table.add_row(name, unit, wanted, *(f"{value:.3g}" for value in cells))
        if error:
            print(f"{name}: {error}", file=sys.stderr)
    Console(width=110).print(table)
    path = options.out or default_path(run)
    measured_in(run, rows).write(path)
    print(f"results: {path}")
    return 1 if any(error for *_, error in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
