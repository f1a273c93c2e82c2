"""What ROS costs a run, and how late a command of a node is.

`python -m tests.bench.bench_ros`: pairs of runs in lockstep, as fast as they go, with and without `--ros` and by turns:
the speed, and the processor time of the run's own process.

Where `XITL_ROS_PYTHON` names a Python that has rclpy: a run in real time, a node that steps cmd_vel up and down, and
how long it takes from its publish to the exchange that carries it out, and to the first motor command that answers;
beside the way to another node of rclpy and back in the same moments.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

CLOUDS = "sitl-perception"
ANSWERED = 0.02
"""Of a motor command: more than the control changes it between steps."""
ANSWERS_NS = 300_000_000
MEASURED = """
import json, resource, sys
from pathlib import Path
from xitl_cli.main import main
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    Path(sys.argv[sys.argv.index("--out") + 1], "used.json").write_text(json.dumps(used.ru_utime + used.ru_stime))
"""
ROS = ("--ros", "--set", "ros.pace=null", "--set", "ros.domain=104")


def run_once(folder: Path, profile: str, duration_s: float, *arguments: str) -> tuple[float, float, dict[str, Any]]:
    """Speed over real time of the run's loop, processor seconds of its process, and its summary."""
    command = ["sim", profile, "--duration", f"{duration_s:g}", "--out", str(folder), "--overwrite", *arguments]
    subprocess.run([sys.executable, "-c", MEASURED, *command], check=True, stdout=subprocess.DEVNULL)
    summary = json.loads((folder / "summary.json").read_text())
    return summary["real_time_factor"], json.loads((folder / "used.json").read_text()), summary


def ros_ratios(profile: str = CLOUDS, pairs: int = 5, duration_s: float = 60.0) -> tuple[list[float], list[float]]:
    """Of pairs, with ROS over without: speed, and processor time of the run's process."""
    speeds, seconds = [], []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(pairs):
            found = {}
            for arguments in ((), ROS) if number % 2 else (ROS, ()):
                found[arguments] = run_once(Path(folder) / "run", profile, duration_s, *arguments)
            speeds.append(found[ROS][0] / found[()][0])
            seconds.append(found[ROS][1] / found[()][1])
            ros = found[ROS][2]["ros"]
            print(
                f"{profile}: speed {speeds[-1]:.3f}, processor {seconds[-1]:.3f}; "
                f"{sum(ros['published'].values())} published, {sum(ros['dropped'].values())} dropped",
                file=sys.stderr,
            )
    return speeds, seconds


def latencies_ms(python: str, seconds: float = 60.0) -> dict[str, list[float]]:
    """Of each step of cmd_vel: until it is carried out, until motors answer, and of an echo of rclpy there and back."""
    environment = os.environ | {"ROS_DOMAIN_ID": "104"}
    node = [python, str(Path(__file__).with_name("rclpy_stepper.py"))]
    with tempfile.TemporaryDirectory() as folder:
        run = ["sim", "--profile", "ros", "--duration", f"{seconds:g}", "--out", f"{folder}/run"]
        echo = subprocess.Popen([*node, "echo"], env=environment)
        stepper = subprocess.Popen([*node, f"{folder}/steps.json", f"{seconds + 5:g}"], env=environment)
        try:
            xitl = [sys.executable, "-c", "from xitl_cli.main import main; main()", *run]
            subprocess.run(xitl, check=True, stdout=subprocess.DEVNULL, env=environment)
            stepper.wait(120.0)
        finally:
            for process in (echo, stepper):
                process.kill()
                process.wait()
        told = json.loads(Path(f"{folder}/steps.json").read_text())
        found = answered(Path(f"{folder}/run/run.mcap"), told["steps"])
    return {**found, "echo of rclpy, there and back": [trip * 1e-6 for trip in told["trips_ns"]]}


def answered(recording: Path, steps: Sequence[tuple[int, float]]) -> dict[str, list[float]]:
    """Milliseconds from the publish of each step, by what is in the recording of a run in real time."""
    actions: dict[float, int] = {}
    motors: list[tuple[int, tuple[float, ...]]] = []
    clock: list[tuple[int, int]] = []
    topics = ["/operator/action", "/actuators", "/clocks"]
    with recording.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, read in reader.iter_decoded_messages(topics):
            if channel.topic == "/actuators":
                motors.append((message.log_time, tuple(read.command)))
            elif channel.topic == "/clocks" and read.node == "PS1":
                clock.append((read.node_ns, read.host_ns))
            elif channel.topic == "/operator/action" and "speed_mps" in (action := json.loads(read.action)):
                actions.setdefault(action["speed_mps"], message.log_time)
    sim_ns, host_ns = np.array(clock, dtype=np.int64).T
    done, moved = [], []
    for published_ns, speed_mps in steps:
        if speed_mps not in actions:
            continue
        later = [row for row in motors if row[0] >= actions[speed_mps]]
        answers = [ns for ns, row in later if max(map(_apart, row, later[0][1])) > ANSWERED]
        done_ns, *answer_ns = np.interp([actions[speed_mps], *answers[:1]], sim_ns, host_ns - published_ns).tolist()
        done.append(done_ns * 1e-6)
        if answers and answers[0] - actions[speed_mps] < ANSWERS_NS:
            moved.append(answer_ns[0] * 1e-6)
    return {"cmd_vel until it is carried out": done, "cmd_vel until motors answer": moved}


def _apart(one: float, other: float) -> float:
    return abs(one - other)


def main() -> None:
    for profile in ("sitl", CLOUDS):
        speeds, seconds = ros_ratios(profile)
        for what, values in (("speed", speeds), ("processor time of the run", seconds)):
            spread = f"({min(values):.3f} to {max(values):.3f})"
            print(f"{profile}: {what} with ROS over without: {statistics.median(values):.3f} {spread}")
    python = os.environ.get("XITL_ROS_PYTHON")
    if python is None:
        print("latency was not measured: name a Python with rclpy by XITL_ROS_PYTHON")
        return
    for what, milliseconds in latencies_ms(python).items():
        p50, p99 = (statistics.quantiles(milliseconds, n=100)[rank - 1] for rank in (50, 99))
        print(f"{what}: p50 {p50:.1f} ms, p99 {p99:.1f} ms of {len(milliseconds)}")


if __name__ == "__main__":
    main()
