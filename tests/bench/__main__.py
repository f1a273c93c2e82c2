"""`make bench`: the figures the project promises, each measured as the median of several runs. Asserts nothing."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tests.bench import (
    bench_ardupilot,
    bench_fleet,
    bench_fleet_step,
    bench_learning,
    bench_lidar,
    bench_logs,
    bench_logs_mcap,
    bench_logs_tlog,
    bench_rays,
    bench_view,
)
from tests.bench.bench_ground import attitude_gap_ms, parameter_list_s
from tests.bench.bench_link import agent_cpu_percent, lost_messages, round_trip_ratios
from tests.bench.bench_vessel_step import median_step_us

RUNS = 5


def main() -> None:
    table = Table("figure", "unit", "wanted", "median", "least", "most", box=None)
    rays = [bench_rays, bench_lidar] if bench_rays.available() else []
    figures = [
        *FIGURES,
        *(PERCEPTION if rays else ()),
        *(figure for part in (bench_logs, bench_logs_tlog, *rays) for figure in part.FIGURES),
    ]
    for name, wanted, unit, measure in figures:
        values = measure()
        cells = (statistics.median(values), min(values), max(values))
        table.add_row(name, unit, wanted, *(f"{value:.3g}" for value in cells))
    if bench_ardupilot.available():
        measured = bench_ardupilot.factors()
        for name, wanted, unit, values in (
            ("sitl-ardupilot at 1200 frames a second", ">= 12", "x real time", measured.run),
            ("the same, of a bare echo of the frames", ">= 0.5", "x", measured.ratios),
            ("of an echo on one processor with ArduPilot", "", "x", measured.close_ratios),
            (f"sitl-ardupilot, {bench_ardupilot.RUN_S} s: the whole command", "", "s", measured.wall_s),
            ("the same, processor time", "", "s", measured.busy_s),
        ):
            cells = (statistics.median(values), min(values), max(values))
            table.add_row(name, unit, wanted, *(f"{value:.3g}" for value in cells))
    Console(width=110).print(table)
    if not rays:
        print("rays were not measured: embreex is not installed; pip install 'xitl[perception]'")
    if not bench_ardupilot.available():
        print("sitl-ardupilot was not measured: no ardurover on the PATH, in the cache, or named by XITL_ARDUROVER")


def real_time_factors() -> list[float]:
    return [run("sim", "--profile", "sitl")["real_time_factor"] for _ in range(RUNS)]


def loopback_lockstep_factors() -> list[float]:
    return [run("sim", "--profile", "hitl-loopback", "--clock", "lockstep")["real_time_factor"] for _ in range(3)]


def perception_factors() -> list[float]:
    """A minute and a half of it: at rest, along the boom, around debris."""
    options = ("--duration", "90")
    return [run("sim", "--profile", "sitl-perception", *options)["real_time_factor"] for _ in range(3)]


def run(*arguments: str, ok: int = 0) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "xitl_cli.main", *arguments, "--out", f"{folder}/run", "--json"]
        result = subprocess.run(command, capture_output=True, check=False)
        if result.returncode != ok:
            raise RuntimeError(f"{' '.join(command)}: exit code {result.returncode}: {result.stderr.decode()}")
        return json.loads(result.stdout)


def one_vessel_us() -> list[float]:
    return [median_step_us(1, 8_000) for _ in range(RUNS)]


def batch_ratios() -> list[float]:
    return [1024 * median_step_us(1, 8_000) / median_step_us(1024, 600) for _ in range(RUNS)]


def help_s() -> list[float]:
    return [timed([sys.executable, "-m", "xitl_cli.main", "--help"]) for _ in range(RUNS)]


def timed(command: list[str]) -> float:
    started_s = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - started_s


def agent_start_s() -> list[float]:
    return [with_agent(lambda _: None)[0] for _ in range(RUNS)]


def agent_resident_mib() -> list[float]:
    """While it waits for a host."""
    return [with_agent(resident_mib)[1] or 0.0 for _ in range(RUNS)]


def agent_flying_mib() -> list[float]:
    """After twenty seconds of a mission, as the agent itself reports it."""
    return [run("sim", "--profile", "hitl-loopback", "--duration", "20")["nodes"][0]["memory_mib"]]


def lost_in_20_s() -> list[float]:
    """Both ways; `make soak` goes on for ten minutes."""
    counts = lost_messages(20.0)
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


PERCEPTION: list[tuple[str, str, str, Callable[[], list[float]]]] = [
    ("sitl-perception with recording and KISS-ICP", ">= 1", "x real time", perception_factors),
]

FIGURES: list[tuple[str, str, str, Callable[[], list[float]]]] = [
    ("sitl with waves, gusts, sensors and recording", ">= 10, aim 20", "x real time", real_time_factors),
    ("fleet of 8 of them in lockstep", ">= 3", "x real time", lambda: bench_fleet.factors(8)),
    ("fleet of 32", ">= 1", "x real time", lambda: bench_fleet.factors(32)),
    ("the same with the agent in its own process", "", "x real time", loopback_lockstep_factors),
    ("one vessel step with environment, N = 1", "< 150, aim 73", "us", one_vessel_us),
    ("a vessel of 1024 is cheaper by", ">= 50", "x", batch_ratios),
    *bench_fleet_step.FIGURES,
    *bench_learning.FIGURES,
    *bench_view.FIGURES,
    ("xitl --help", "< 0.5", "s", help_s),
    ("agent process until it listens", "< 0.5", "s", agent_start_s),
    ("all parameters to a ground station", "< 2", "s", parameter_list_s),
    ("longest gap of 50 Hz attitude to three stations", "< 60", "ms", attitude_gap_ms),
    ("sensor to actuator at 400 Hz, p50, of an echo's", "<= 4", "x", round_trip_ratios(0.5)),
    ("the same, p99", "<= 4", "x", round_trip_ratios(0.99)),
    ("agent's processor time at 100 Hz", "< 10", "% of a core", agent_cpu_percent),
    ("messages lost in 20 s at 2000 a second", "0", "", lost_in_20_s),
    ("agent process resident, waiting", "< 40", "MiB", agent_resident_mib),
    ("agent process resident, flying in real time", "< 40", "MiB", agent_flying_mib),
    *bench_logs_mcap.FIGURES,
]


if __name__ == "__main__":
    main()
