"""Whole commands: `xitl --help`, a run until its first step, runs of shipped profiles, a campaign on two workers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.bench.figure import Figure, scaled

RUNS = 5
CAMPAIGN_RUNS, CAMPAIGN_RUN_S = 60, 60
CAMPAIGN_VARIABLE = "XITL_BENCH_CAMPAIGN_RUNS"
XITL = [sys.executable, "-m", "xitl_cli.main"]
FIRST_STEP = """
import os, time
from pathlib import Path
from xitl_cli.main import main
from xitl_cli.run.world.plant import Plant
def advance(self, *arguments):
    Path(os.environ["FIRST_STEP"]).write_text(str(time.monotonic()))
    os._exit(0)
Plant.advance = advance
main()
"""
"""A run that writes the instant of its first step to a file and ends."""


def simulate(*arguments: str) -> dict[str, Any]:
    """Return the summary of a run. Raises RuntimeError if it does not end with exit code 0."""
    with tempfile.TemporaryDirectory() as folder:
        command = [*XITL, "sim", *arguments, "--out", f"{folder}/run", "--json"]
        result = subprocess.run(command, capture_output=True, check=False)
        if result.returncode:
            raise RuntimeError(f"{' '.join(command)}: exit code {result.returncode}: {result.stderr.decode()}")
        summary: dict[str, Any] = json.loads(result.stdout)
        return summary


def factors(profile: str, runs: int, seconds: float | None, *arguments: str) -> list[float]:
    """Times real time of so many runs. seconds: their length, None for the whole mission."""
    seconds = scaled(seconds, 1.0)
    limit = () if seconds is None else ("--duration", f"{seconds:g}")
    return [simulate("--profile", profile, *limit, *arguments)["real_time_factor"] for _ in range(scaled(runs, 1))]


def help_s() -> list[float]:
    """Seconds of `xitl --help`."""
    return [_timed([*XITL, "--help"]) for _ in range(scaled(RUNS, 1))]


def first_step_s() -> list[float]:
    """Seconds from the start of `xitl sim --profile sitl` to its first physics step."""
    return [_first_step_s() for _ in range(scaled(RUNS, 1))]


def _first_step_s() -> float:
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "first"
        words = ["sim", "--profile", "sitl", "--out", f"{folder}/run"]
        began_s = time.monotonic()
        command = [sys.executable, "-c", FIRST_STEP, *words]
        subprocess.run(command, check=True, capture_output=True, env={**os.environ, "FIRST_STEP": str(told)})
        return float(told.read_text()) - began_s


def campaign_s() -> list[float]:
    """Seconds of a campaign with two workers, once."""
    count, length_s = scaled(campaign_size(), 2), scaled(CAMPAIGN_RUN_S, 1)
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.yaml"
        plan.write_text(f"base: sitl\nset: {{clock.duration_s: {length_s}}}\nseeds: {count}\n", encoding="utf-8")
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        command = [*XITL, "campaign", str(plan), "--workers", "2", "--yes", "--out", f"{folder}/campaign"]
        began_s = time.perf_counter()
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        took_s = time.perf_counter() - began_s
        if done.returncode not in (0, 1):  # 1: runs that are cut short complete no mission
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr}")
        return [took_s * CAMPAIGN_RUNS / count]


def campaign_size() -> int:
    """Return the number of runs of the campaign: of the environment, or CAMPAIGN_RUNS."""
    return int(os.environ.get(CAMPAIGN_VARIABLE, CAMPAIGN_RUNS))


def _timed(command: list[str]) -> float:
    started_s = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - started_s


RUN_FIGURES = [
    Figure(
        "sitl with waves, gusts, sensors and recording", ">= 10, aim 20", "x real time",
        lambda: factors("sitl", RUNS, None),
    ),
    Figure("mitl with waves, gusts and recording", "", "x real time", lambda: factors("mitl", RUNS, None)),
    Figure(
        "hitl-loopback in lockstep, the agent in its own process", "", "x real time",
        lambda: factors("hitl-loopback", 3, None, "--clock", "lockstep"),
    ),
]  # fmt: skip
PERCEPTION_FIGURES = [  # a minute and a half: at rest, along the boom, around debris
    Figure(
        "sitl-perception with recording and KISS-ICP", ">= 1", "x real time",
        lambda: factors("sitl-perception", 3, 90.0),
    ),
]  # fmt: skip
CAMERA = "sensors.cameras=[{name: front, position_frd_m: [1, 0, -0.9], pitch_deg: -6}]"
FOUR_CAMERAS = (
    "sensors.cameras=[{name: front, position_frd_m: [1, 0, -0.9], pitch_deg: -6}, "
    "{name: right, position_frd_m: [1, 0, -0.9], pitch_deg: -6, yaw_deg: 90}, "
    "{name: back, position_frd_m: [-1, 0, -0.9], pitch_deg: -6, yaw_deg: 180}, "
    "{name: left, position_frd_m: [1, 0, -0.9], pitch_deg: -6, yaw_deg: -90}]"
)
CAMERA_FIGURES = [
    Figure(
        "sitl with a camera of 640 x 480 at 10 Hz", ">= 4", "x real time",
        lambda: factors("sitl", 3, 30.0, "--set", CAMERA),
    ),
    Figure(
        "sitl with four cameras of 640 x 480 at 10 Hz", ">= 1", "x real time",
        lambda: factors("sitl", 3, 30.0, "--set", FOUR_CAMERAS),
    ),
]  # fmt: skip
COMMAND_FIGURES = [
    Figure("xitl --help", "< 0.5", "s", help_s),
    Figure("xitl sim until its first step", "", "s", first_step_s),
    Figure(f"campaign of {CAMPAIGN_RUNS} runs of {CAMPAIGN_RUN_S} s, two workers", "", "s", campaign_s),
]
