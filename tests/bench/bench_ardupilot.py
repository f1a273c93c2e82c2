"""Real ArduPilot in lockstep beside a bare echo of its JSON frames, in turns: `python -m tests.bench.bench_ardupilot`.

Needs a real ardurover: on the PATH, in the cache, or named by XITL_ARDUROVER.
"""

from __future__ import annotations

import json
import os
import resource
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.ardupilot import Rover
from tests.bench.figure import Figure, scaled
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_firmware

TURNS = 3
RUN_S = 60  # of simulation time
ECHO_FRAMES = 60_000
RATE_HZ = 1200
FAST = "sitl-ardupilot-fast"
_FRAME = (
    b'\n{"timestamp":%.6f,"imu":{"gyro":[0.0, 0.0, 0.0],"accel_body":[0.0, 0.0, -9.81]},'
    b'"position":[0.0, 0.0, 0.0],"quaternion":[1.0, 0.0, 0.0, 0.0],"velocity":[0.0, 0.0, 0.0]}\n'
)


@dataclass(frozen=True)
class RunCost:
    """One run. factor: times real time, as its summary has it. wall_s: the command from start to exit.

    busy_s: processor time of the command and of ArduPilot. Processes that wait for each other show in wall_s alone.
    """

    factor: float
    wall_s: float
    busy_s: float


@dataclass(frozen=True)
class Factors:
    """By turn. Times real time of bare echoes, left to the scheduler or on one processor with ArduPilot; whole runs of
    `sitl-ardupilot` and of `sitl-ardupilot-fast`."""

    echo: list[float]
    close_echo: list[float]
    runs: list[RunCost]
    fast_runs: list[RunCost]

    @property
    def run(self) -> list[float]:
        """Times real time of whole runs."""
        return [run.factor for run in self.runs]

    @property
    def wall_s(self) -> list[float]:
        """Wall time of whole runs."""
        return [run.wall_s for run in self.runs]

    @property
    def busy_s(self) -> list[float]:
        """Processor time of whole runs."""
        return [run.busy_s for run in self.runs]

    @property
    def fast_run(self) -> list[float]:
        """Times real time of whole runs with fewer frames and exchanges."""
        return [run.factor for run in self.fast_runs]

    @property
    def fast_wall_s(self) -> list[float]:
        """Wall time of these."""
        return [run.wall_s for run in self.fast_runs]

    @property
    def fast_busy_s(self) -> list[float]:
        """Processor time of these."""
        return [run.busy_s for run in self.fast_runs]

    @property
    def ratios(self) -> list[float]:
        """What of a bare echo the whole run reaches, by turn."""
        return [run / echo for run, echo in zip(self.run, self.echo, strict=True)]

    @property
    def close_ratios(self) -> list[float]:
        """The same of the echo that shares a processor with ArduPilot, which saves it from waking another."""
        return [run / echo for run, echo in zip(self.run, self.close_echo, strict=True)]


def close_echo_factor() -> float:
    """`echo_factor` with both on one processor."""
    processors = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(processors)})
    try:
        return echo_factor()
    finally:
        os.sched_setaffinity(0, processors)


def echo_factor(frames: int | None = None) -> float:
    """Real-time factor of a loop that answers each frame with a constant, of a vessel at rest."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(10.0)
        with Rover(Path(folder), world=f"udp://127.0.0.1:{sock.getsockname()[1]}"):
            start_s = sim_s = 0.0
            for number in range(frames or scaled(ECHO_FRAMES, 2 * RATE_HZ)):
                packet, sender = sock.recvfrom(256)
                rate_hz = struct.unpack_from("<H", packet, 2)[0]
                sim_s += 1.0 / rate_hz
                sock.sendto(_FRAME % sim_s, sender)
                if number == RATE_HZ:
                    start_s, from_s = time.perf_counter(), sim_s
            return (sim_s - from_s) / (time.perf_counter() - start_s)


def run_cost(profile: str = "sitl-ardupilot", duration_s: int = RUN_S) -> RunCost:
    """A run of so many seconds of simulation time."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "xitl_cli.main", "sim", "--profile", profile, "--json"]
        command += ["--firmware", str(_program()), "--duration", str(duration_s), "--out", f"{folder}/run"]
        before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        wall_s, after = time.perf_counter() - began_s, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr}")
        busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return RunCost(float(json.loads(done.stdout)["real_time_factor"]), wall_s, busy_s)


@cache
def factors(turns: int | None = None) -> Factors:
    """All, in turns, as the machine is noisy."""
    run_s = scaled(RUN_S, 5)
    measured = [
        (echo_factor(), close_echo_factor(), run_cost(duration_s=run_s), run_cost(FAST, run_s))
        for _ in range(turns or scaled(TURNS, 1))
    ]
    return Factors(*(list(values) for values in zip(*measured, strict=True)))


FIGURES = [
    Figure("sitl-ardupilot at 1200 frames a second", ">= 12", "x real time", lambda: factors().run),
    Figure("sitl-ardupilot, of a bare echo of the frames", ">= 0.5", "x", lambda: factors().ratios),
    Figure("sitl-ardupilot, of an echo on one processor with ArduPilot", "", "x", lambda: factors().close_ratios),
    Figure(f"sitl-ardupilot, {RUN_S} s: the whole command", "", "s", lambda: factors().wall_s),
    Figure(f"sitl-ardupilot, {RUN_S} s: processor time", "", "s", lambda: factors().busy_s),
    Figure(f"{FAST} at 400 frames a second", "", "x real time", lambda: factors().fast_run),
    Figure(f"{FAST}, {RUN_S} s: the whole command", "", "s", lambda: factors().fast_wall_s),
    Figure(f"{FAST}, {RUN_S} s: processor time", "", "s", lambda: factors().fast_busy_s),
]


def available() -> bool:
    """Whether there is a Rover to measure with."""
    try:
        _program()
    except UserError:
        return False
    return True


def _program() -> Path:
    return find_firmware("rover", "sitl")


def main() -> None:
    try:
        _program()
    except UserError as error:
        raise SystemExit(f"nothing measured: {error}") from None
    measured = factors()
    for name, wanted, values in (
        ("bare echo, x real time", "", measured.echo),
        ("the same, on one processor with ArduPilot", "", measured.close_echo),
        ("sitl-ardupilot, x real time", "12 at least", measured.run),
        ("of the echo", "0.5 at least", measured.ratios),
        ("of the echo on one processor", "", measured.close_ratios),
        (f"sitl-ardupilot, {RUN_S} s: wall time, s", "", measured.wall_s),
        (f"sitl-ardupilot, {RUN_S} s: processor time, s", "", measured.busy_s),
        (f"{FAST}, x real time", "", measured.fast_run),
        (f"{FAST}, {RUN_S} s: wall time, s", "", measured.fast_wall_s),
        (f"{FAST}, {RUN_S} s: processor time, s", "", measured.fast_busy_s),
    ):
        each = ", ".join(f"{value:.3g}" for value in values)
        print(f"{name:44s} {statistics.median(values):6.3g}  ({each})  {wanted}")


if __name__ == "__main__":
    main()
