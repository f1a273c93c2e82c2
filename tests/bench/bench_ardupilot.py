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
from xitl_cli.firmware.find import FIND, find_firmware

TURNS = 3
ECHO_FRAMES = 60_000
RATE_HZ = 1200
_FRAME = (
    b'\n{"timestamp":%.6f,"imu":{"gyro":[0.0, 0.0, 0.0],"accel_body":[0.0, 0.0, -9.81]},'
    b'"position":[0.0, 0.0, 0.0],"quaternion":[1.0, 0.0, 0.0, 0.0],"velocity":[0.0, 0.0, 0.0]}\n'
)


@dataclass(frozen=True)
class Factors:
    """Times real time, by turn."""

    echo: list[float]
    run: list[float]

    @property
    def ratio(self) -> float:
        """Of the medians: what of a bare echo the whole run reaches."""
        return statistics.median(self.run) / statistics.median(self.echo)


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
    """Both, in turns, as the machine is noisy."""
    pairs = [(echo_factor(), run_factor()) for _ in range(turns)]
    return Factors([echo for echo, _ in pairs], [run for _, run in pairs])


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
        ("bare echo", "", measured.echo),
        ("sitl-ardupilot", "12 at least", measured.run),
    ):
        each = ", ".join(f"{value:.1f}" for value in values)
        print(f"{name:16s} {statistics.median(values):6.1f} x real time  ({each})  {wanted}")
    print(f"{'ratio':16s} {measured.ratio:6.2f}                 0.5 at least")


if __name__ == "__main__":
    main()
