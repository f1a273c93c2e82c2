"""Host, autopilot and companion of `hitl-loopback` as separate programs, the cables between them, and who watches."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from tests.chaos.line import Line
from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until

AGENT, COMPANION = "agent", "companion"
NEUTRAL_US = 1500
SILENT_S = 3.0
OUTPUTS_HZ = 25.0
CLOCK_STEP_S = 4.0
"""Simulation time of a step of the agent's clock."""
_SERVO_OUTPUT_RAW, _SET_MESSAGE_INTERVAL = 36, 511


def profile_of(line: Line, clock_step_s: float | None) -> dict[str, Any]:
    """Return the profile of a run: armed in MANUAL with both propellers ahead from the first second on."""
    profile: dict[str, Any] = {
        "extends": ["hitl-loopback", "sensors/perception"],
        "description": "A vessel with outputs that are not neutral",
        "driver": {
            "kind": "script",
            "script": [{"at_s": 0.5, "mode": "MANUAL", "rc_us": [1500, 1500, 1700]}, {"at_s": 0.8, "arm": True}],
        },
        "mission": {"waypoints_ned_m": []},
        "autopilot": {
            "runs": "board",
            "link": line.host_url(AGENT),
            "silent_s": SILENT_S,
            "connect_timeout_s": 15.0,
            "parameters": {"ARMING_CHECK": 0},
        },
        "companion": {
            "runs": "board",
            "link": line.host_url(COMPANION),
            "silent_s": 8.0,  # a machine under load needs some seconds until its first word
            "connect_timeout_s": 15.0,
            "parameters": {"ODO_ENABLE": 0, "MAP_ENABLE": 0},
        },
        "sensors": {"lidar": {"rate_hz": 2, "points_hz": 2000}, "sonar": None},
        "clock": {"duration_s": 3600.0},
    }
    if clock_step_s is not None:
        profile["faults"] = {"clock-step": {"from_s": CLOCK_STEP_S, "agent": {"clock_offset_s": clock_step_s}}}
    return profile


class OutputsWatch(threading.Thread):
    """A ground station that keeps the outputs and texts of the autopilot, with the time of their arrival."""

    def __init__(self, port: int) -> None:
        super().__init__(name="outputs", daemon=True)
        self.outputs: deque[tuple[float, bool]] = deque(maxlen=20_000)
        """Arrival on the monotonic clock, and whether all outputs were neutral."""
        self.texts: deque[tuple[float, str]] = deque(maxlen=2000)
        self._port = port
        self._stopped = threading.Event()

    def run(self) -> None:
        from pymavlink import mavutil

        link: Any = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{self._port}", source_system=250, dialect="ardupilotmega"
        )
        beat_s = 0.0
        while not self._stopped.is_set():
            message = link.recv_match(blocking=True, timeout=0.1)
            now_s = time.monotonic()
            if now_s - beat_s >= 1.0:
                beat_s = now_s
                link.mav.heartbeat_send(6, 8, 0, 0, 4)
                interval = (_SET_MESSAGE_INTERVAL, 0, _SERVO_OUTPUT_RAW, 1e6 / OUTPUTS_HZ, 0, 0, 0, 0, 0)
                link.mav.command_long_send(1, 1, *interval)
            if message is None:
                continue
            if message.get_type() == "SERVO_OUTPUT_RAW":
                pulses = [getattr(message, f"servo{number}_raw") for number in range(1, 9)]
                self.outputs.append((now_s, all(pulse in (0, NEUTRAL_US) for pulse in pulses)))
            elif message.get_type() == "STATUSTEXT":
                self.texts.append((now_s, message.text))
        link.close()

    def stop(self) -> None:
        self._stopped.set()
        self.join()

    @property
    def driving(self) -> bool:
        """Whether the newest outputs are recent and not neutral."""
        if not self.outputs:
            return False
        at_s, neutral = self.outputs[-1]
        return not neutral and time.monotonic() - at_s < 0.5


class Program:
    """A started program with its output in files."""

    def __init__(self, command: list[str], folder: Path, name: str) -> None:
        self.stdout, self.stderr = folder / f"{name}.out", folder / f"{name}.err"
        with self.stdout.open("w") as out, self.stderr.open("w") as err:
            self.process = subprocess.Popen(
                command,
                cwd=folder,
                stdout=out,
                stderr=err,
                env={**os.environ, "NO_COLOR": "1", "COLUMNS": "200"},
                start_new_session=True,
            )

    def send(self, number: int) -> None:
        self.process.send_signal(number)

    @property
    def said(self) -> str:
        return self.stdout.read_text() + self.stderr.read_text()

    @property
    def gone(self) -> bool:
        return self.process.poll() is not None

    def kill(self) -> None:
        if not self.gone:
            self.process.send_signal(signal.SIGCONT)
            self.process.kill()
        self.process.wait()


class Rig:
    """The boards, which outlive the runs, and one host after the other. folder: for recordings and outputs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        ports = {AGENT: free_port(), COMPANION: free_port()}
        self._station_port = free_port()
        self.line = Line(ports)
        self.line.start()
        self.outputs = OutputsWatch(self._station_port)
        self.outputs.start()
        self._ports = ports
        self._started = 0
        self.boards: dict[str, Program] = {}
        self.absent: frozenset[str] = frozenset()
        """Boards that have left the present run."""
        self.host: Program
        self.run_folder = folder
        for name in ports:
            self.start_board(name)

    def start_board(self, name: str, clock_offset_s: int = 0) -> None:
        """Start the program of a board. clock_offset_s: its monotonic clock is ahead by this time."""
        if name in self.boards:
            self.boards[name].kill()
        self._started += 1
        role = ["--role", "companion"] if name == COMPANION else ["--gcs", f"udp://127.0.0.1:{self._station_port}"]
        command = [sys.executable, "-m", "agent", "--link", f"udp://127.0.0.1:{self._ports[name]}", *role]
        if clock_offset_s:
            offset = str(clock_offset_s)
            command = ["unshare", "--time", "--monotonic", offset, "--boottime", offset, *command]
        program = Program(command, self.folder, f"{name}-{self._started}")
        self.boards[name] = program
        wait_until(lambda: "waits at" in program.said or program.gone, f"{name} does not start")
        assert not program.gone, program.said

    def begin_run(self, number: int, clock_step_s: float | None) -> None:
        """Start a host, and wait until the vessel drives. Boards that have ended are started again."""
        for name, board in self.boards.items():
            if board.gone:
                self.start_board(name)
        self.line.begin_run()
        self.absent = frozenset()
        (self.folder / "chaos.yaml").write_text(json.dumps(profile_of(self.line, clock_step_s)))
        self.run_folder = self.folder / "disk" / f"run-{number}"
        command = [sys.executable, "-m", "xitl_cli.main", "sim", "chaos.yaml", "--out", str(self.run_folder)]
        self.host = Program(command, self.folder, f"host-{number}")
        self.wait_for_drive()

    def wait_for_drive(self) -> None:
        """Wait until the autopilot drives the vessel and all boards talk. Raises AssertionError when they do not."""
        present = self.boards.keys() - self.absent

        def drives() -> bool:
            return self.outputs.driving and all(map(self.line.talks, present))

        wait_until(lambda: drives() or self.host.gone, "the outputs do not resume", PATIENCE_S / 2)
        assert not self.host.gone, f"the run ended: {self.host.said}"

    def summary(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.run_folder / "summary.json").read_text())
        return found

    def close(self) -> None:
        for program in (*self.boards.values(), getattr(self, "host", None)):
            if program is not None:
                program.kill()
        self.outputs.stop()
        self.line.stop()


def time_namespaces_permitted() -> bool:
    """Whether a program can be started with another monotonic clock."""
    if shutil.which("unshare") is None:
        return False
    command = ["unshare", "--time", "--monotonic", "1000000", sys.executable, "-c"]
    shown = subprocess.run(
        [*command, "import time; print(time.monotonic())"], capture_output=True, text=True, check=False
    )
    return shown.returncode == 0 and float(shown.stdout) > time.monotonic() + 900_000


def count(pattern: str, text: str, least: float | None = None) -> int:
    """Number of lines that match. least: smallest value of the number that is the group of the pattern."""
    matches = re.finditer(pattern, text, re.MULTILINE)
    return sum(least is None or float(match[1]) >= least for match in matches)
