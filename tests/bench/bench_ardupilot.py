"""Real ArduPilot in lockstep beside a bare echo of its JSON frames, in turns: `python -m tests.bench.bench_ardupilot`.

Needs a real ardurover: on the PATH, in the cache, or named by XITL_ARDUROVER.
"""

from __future__ import annotations

import json
import os
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tests.ardupilot import VARIABLES, Rover
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import FIND, find_firmware

TURNS = 3
ECHO_FRAMES = 60_000
RATE_HZ = 1200
_FRAME = (
    b'\n{"timestamp":%.6f,"imu":{"gyro":[0.0, 0.0, 0.0],"accel_body":[0.0, 0.0, -9.81]},'
    b'"position":[0.0, 0.0, 0.0],"quaternion":[1.0, 0.0, 0.0, 0.0],"velocity":[0.0, 0.0, 0.0]}\n'
)


@dataclass(frozen=True)
class Factors:
    """Times real time, by turn: bare echoes, left to the scheduler or on one processor with ArduPilot; whole runs."""

    echo: list[float]
    close_echo: list[float]
    run: list[float]

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


def echo_factor(frames: int = ECHO_FRAMES) -> float:
    """Real-time factor of a loop that answers each frame with a constant, of a vessel at rest."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(10.0)
        with Rover(Path(folder), world=f"udp://127.0.0.1:{sock.getsockname()[1]}"):
            start_s = sim_s = 0.0
            for number in range(frames):
                packet, sender = sock.recvfrom(256)
                rate_hz = struct.unpack_from("<H", packet, 2)[0]
                sim_s += 1.0 / rate_hz
                sock.sendto(_FRAME % sim_s, sender)
                if number == RATE_HZ:
                    start_s, from_s = time.perf_counter(), sim_s
            return (sim_s - from_s) / (time.perf_counter() - start_s)


def run_factor(profile: str = "sitl-ardupilot") -> float:
    """Real-time factor of a whole run with a mission, as its summary has it."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "xitl_cli.main", "sim", "--profile", profile, "--json"]
        command += ["--firmware", str(_program()), "--out", f"{folder}/run"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr}")
        return float(json.loads(done.stdout)["real_time_factor"])


def factors(turns: int = TURNS) -> Factors:
    """All, in turns, as the machine is noisy."""
    measured = [(echo_factor(), close_echo_factor(), run_factor()) for _ in range(turns)]
    echo, close_echo, run = (list(values) for values in zip(*measured, strict=True))
    return Factors(echo, close_echo, run)


def available() -> bool:
    """Whether there is a Rover to measure with."""
    try:
        _program()
    except UserError:
        return False
    return True


def _program() -> Path:
    return find_firmware("rover", "sitl", os.environ.get(VARIABLES["sitl"], FIND))


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
    ):
        each = ", ".join(f"{value:.3g}" for value in values)
        print(f"{name:44s} {statistics.median(values):6.3g}  ({each})  {wanted}")


if __name__ == "__main__":
    main()
