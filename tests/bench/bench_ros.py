"""What ROS costs a run, and how late a command of a node is.

`python -m tests.bench.bench_ros`: pairs of runs in lockstep, as fast as they go, with and without `--ros` and by turns:
the speed, and the processor time of the run's own process.

Where `XITL_ROS_PYTHON` names a Python that has rclpy: the same with a node that reads every topic; and a run in real
time, a node that turns cmd_vel to and fro, and how long it takes from its publish to the exchange that carries it out,
and to that of the first motor command that answers; beside the way to another node of rclpy and back in that time.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

CLOUDS = "sitl-perception"
ANSWERED = 0.02
"""Of a motor command: so far from the line through the two before the step is an answer."""
STEADY_ROWS, UNDER_WAY = 5, 0.1
"""Before a step: for how many rows motor commands keep to a line, and that one of them is larger than this."""
READ_S, END_S = 0.5, 10.0
"""That a node has to read what came last, and to end."""
MEASURED = """
import json, sys, time
from pathlib import Path
from xitl_cli.main import main
from xitl_cli.run.loop import Loop
run = Loop.run
def measured(self):
    began_s = time.process_time()
    try:
        return run(self)
    finally:
        used_s = time.process_time() - began_s
        Path(sys.argv[sys.argv.index("--out") + 1], "used.json").write_text(json.dumps(used_s))
Loop.run = measured
main()
"""
TIMED = """
import json, sys, time
from pathlib import Path
from xitl_cli.main import main
from xitl_cli.run.nodes.operator import OperatorNode
exchange, at = OperatorNode.exchange, {}
def timed(self, step):
    exchange(self, step)
    at[step.now_ns] = time.monotonic_ns()
OperatorNode.exchange = timed
try:
    main()
finally:
    Path(sys.argv[sys.argv.index("--out") + 1], "exchanges.json").write_text(json.dumps(at))
"""
DOMAIN = "104"
ROS = ("--ros", "--set", "ros.pace=null", "--set", f"ros.domain={DOMAIN}")
NODES = Path(__file__).with_name("rclpy_nodes.py")


@contextmanager
def node(python: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """One of rclpy_nodes.py, until the end of the block."""
    process = subprocess.Popen([python, str(NODES), *arguments], env=os.environ | {"ROS_DOMAIN_ID": DOMAIN})
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """The loop of one: its speed over real time, and processor seconds of its process; ros: of its summary."""

    speed: float
    used_s: float
    ros: Mapping[str, Any]


def run_once(folder: Path, profile: str, duration_s: float, *arguments: str) -> MeasuredRun:
    """Without what is done before its loop and after."""
    command = ["sim", profile, "--duration", f"{duration_s:g}", "--out", str(folder), "--overwrite", *arguments]
    subprocess.run([sys.executable, "-c", MEASURED, *command], check=True, stdout=subprocess.DEVNULL)
    summary = json.loads((folder / "summary.json").read_text())
    return MeasuredRun(
        summary["real_time_factor"], json.loads((folder / "used.json").read_text()), summary.get("ros") or {}
    )


def ros_ratios(
    profile: str = CLOUDS, pairs: int = 4, duration_s: float = 60.0, listener: str | None = None
) -> tuple[list[float], list[float]]:
    """Of pairs, with ROS over without: speed, and processor time of the run's process.

    listener: a Python with rclpy; a node of it then reads every topic.
    """
    speeds, seconds = [], []
    with tempfile.TemporaryDirectory() as name:
        folder, heard = Path(name) / "run", Path(name) / "heard.json"
        for number in range(pairs):
            found = {}
            for arguments in ((), ROS) if number % 2 else (ROS, ()):
                listens = arguments and listener
                with node(listener, "listen", str(heard)) if listens else nullcontext():  # type: ignore[arg-type]
                    found[arguments] = run_once(folder, profile, duration_s, *arguments)
                    if listens:
                        time.sleep(READ_S)
            plain, ros = found[()], found[ROS]
            speeds.append(ros.speed / plain.speed)
            seconds.append(ros.used_s / plain.used_s)
            read = f", {sum(json.loads(heard.read_text()).values())} read" if listener else ""
            print(
                f"{profile}: speed {plain.speed:.2f} and {ros.speed:.2f} = {speeds[-1]:.3f}, processor "
                f"{plain.used_s:.2f} s and {ros.used_s:.2f} s = {seconds[-1]:.3f}; "
                f"{sum(ros.ros['published'].values())} published, {sum(ros.ros['dropped'].values())} dropped{read}",
                file=sys.stderr,
            )
    return speeds, seconds


def latencies_ms(python: str, seconds: float = 180.0) -> dict[str, list[float]]:
    """Of each step of cmd_vel: until it is carried out, until motors answer, and of an echo of rclpy there and back."""
    with tempfile.TemporaryDirectory() as name:
        folder, told = Path(name) / "run", Path(name) / "steps.json"
        run = ["sim", "--profile", "ros", "--duration", f"{seconds:g}", "--out", str(folder)]
        run += ["--set", f"ros.domain={DOMAIN}"]
        with node(python, "echo"), node(python, "step", str(told), f"{seconds + 5:g}") as stepper:
            subprocess.run([sys.executable, "-c", TIMED, *run], check=True, stdout=subprocess.DEVNULL)
            stepper.wait(120.0)
        steps = json.loads(told.read_text())
        at_ns = json.loads((folder / "exchanges.json").read_text())
        exchanges = {int(instant_ns): host_ns for instant_ns, host_ns in at_ns.items()}
        found = answered(folder / "run.mcap", steps["steps"], exchanges)
    return {**found, "echo of rclpy, there and back": [trip * 1e-6 for trip in steps["trips_ns"]]}


def answered(
    recording: Path, steps: Sequence[tuple[int, float]], exchanges: Mapping[int, int]
) -> dict[str, list[float]]:
    """Milliseconds from the publish of each step. exchanges: CLOCK_MONOTONIC at each by its simulation time.

    Steps from before the first exchange are left out, as nothing could carry them out yet. Motors have to be under way
    and steady for what answers to be told from what goes on.
    """
    actions: dict[float, int] = {}
    motors: list[tuple[int, NDArray[np.float64]]] = []
    with recording.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, read in reader.iter_decoded_messages(["/operator/action", "/actuators"]):
            if channel.topic == "/actuators":
                motors.append((message.log_time, np.array(read.command)))
            elif "speed_mps" in (action := json.loads(read.action)):
                actions.setdefault(action["speed_mps"], message.log_time)
    began_ns = min(exchanges.values())
    rows = {ns: number for number, (ns, _) in enumerate(motors)}
    done, moved = [], []
    for published_ns, speed_mps in steps:
        if published_ns < began_ns or speed_mps not in actions:
            continue
        done.append((exchanges[actions[speed_mps]] - published_ns) * 1e-6)
        answer_ns = _answer_ns(motors, rows[actions[speed_mps]])
        if answer_ns is not None:
            moved.append((exchanges[answer_ns] - published_ns) * 1e-6)
    return {"cmd_vel until it is carried out": done, "cmd_vel until motors answer": moved}


def _answer_ns(motors: Sequence[tuple[int, NDArray[np.float64]]], first: int) -> int | None:
    """When commands leave their line after the row `first`; None where they were on none."""
    before = np.array([row for _, row in motors[max(first - STEADY_ROWS, 0) : first + 1]])
    if np.abs(before[-1]).max() < UNDER_WAY or np.abs(np.diff(before, 2, axis=0)).max() > 0.5 * ANSWERED:
        return None
    for number, (instant_ns, row) in enumerate(motors[first + 1 :], start=1):
        if np.abs(row - before[-1] - number * (before[-1] - before[-2])).max() > ANSWERED:
            return instant_ns
    return None


def main() -> None:
    python = os.environ.get("XITL_ROS_PYTHON")
    for profile in ("sitl", CLOUDS):
        for listener, of_whom in (
            (None, "nobody listening"),
            *([(python, "one node reading all topics")] if python else []),
        ):
            speeds, seconds = ros_ratios(profile, listener=listener)
            for what, values in (("speed", speeds), ("processor time of the run", seconds)):
                spread = f"({min(values):.3f} to {max(values):.3f})"
                print(f"{profile}, {of_whom}: {what} with ROS over without: {statistics.median(values):.3f} {spread}")
    if python is None:
        print("latency was not measured, nor with a reader: name a Python with rclpy by XITL_ROS_PYTHON")
        return
    for what, milliseconds in latencies_ms(python).items():
        p50, p99 = np.percentile(milliseconds, [50, 99])
        print(f"{what}: p50 {p50:.1f} ms, p99 {p99:.1f} ms, at most {max(milliseconds):.1f} ms of {len(milliseconds)}")


if __name__ == "__main__":
    main()
