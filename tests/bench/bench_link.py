"""The link under load: round trips beside a bare echo, the agent's processor time, and messages lost."""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng

from agent.node import PROTOCOL
from agent.wire import dialect
from agent.wire.link import Link
from agent.wire.transport import open_transport
from sim_core.simulation import step
from tests.bench.figure import scaled
from xitl_cli.profile import load_profile
from xitl_cli.run.links.setup import embedded_parameters, mission_items, set_parameters, upload_plan
from xitl_cli.run.sensors.sensing import SensorSuite
from xitl_cli.run.world.world import build_simulation, local_frame
from xitl_cli.seeds import Seeds

RATE_HZ = 400
BLOCK, BLOCKS = 200, 20  # trips and echoes take turns, half a second each: the machine is noisy
DEPART_S, LEAD_IN_S = 20, 30  # aligned, then armed and under way before the first trip counts
ECHO = """
import socket
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.bind(("127.0.0.1", 0))
print(s.getsockname()[1], flush=True)
while True:
    data, source = s.recvfrom(2048)
    s.sendto(data, source)
"""


@contextmanager
def agent_process() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """An agent on a free UDP port of the loopback, and its URL."""
    command = [sys.executable, "-m", "agent", "--link", "udp://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().split()[-1]
        finally:
            process.terminate()


@contextmanager
def echo_process() -> Iterator[tuple[subprocess.Popen[str], socket.socket]]:
    """A bare Python echo in a process of its own, and a socket joined to it."""
    with subprocess.Popen([sys.executable, "-c", ECHO], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                sock.connect(("127.0.0.1", int(process.stdout.readline())))
                yield process, sock
        finally:
            process.terminate()


class Rig:
    """The sensors of a vessel under way, an agent that steers it in lockstep, and nothing else of a run."""

    def __init__(self, url: str, opened: ExitStack) -> None:
        profile = load_profile("sitl").runnable()
        assert profile.sensors is not None
        seeds = Seeds(1)
        self._simulation, self._state = build_simulation(profile, seeds)
        self._sensing = SensorSuite(profile.sensors, profile.site, profile.clock.physics_rate_hz, seeds)
        self._rng = default_rng(1)
        self.link = Link(opened.enter_context(open_transport(url, listen=False)), 255, 190)
        self.tick = 0
        self._motors = np.zeros((1, 2))
        self.link.send(dialect.MAVLink_xitl_run_message(0, b"bench", 1, 1, PROTOCOL))
        self.link.receive(1.0)
        ends = self.link.send, self.link.receive
        set_parameters((1, 1), embedded_parameters(profile), *ends)
        upload_plan((1, 1), mission_items(profile, local_frame(profile.site)), *ends)

    def messages(self) -> list[Any]:
        """One physics step: what its sensors say, and the tick."""
        self.tick += 1
        self._state = step(self._simulation, self._state, self._motors, self._rng)
        stamp_ns = self._state.time_ns
        due = self._sensing.due(self.tick, stamp_ns, self._state.vessel.motion, self._state.wind_ned_mps)
        return [*due, dialect.MAVLink_xitl_tick_message(stamp_ns // 1000, self.tick)]

    def trip_s(self, messages: list[Any]) -> float:
        """Send, wait for the actuators of the same tick; how long that took."""
        started_s = time.perf_counter()
        self.link.send(*messages)
        while True:
            for message in self.link.receive(1.0):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_ACTUATORS and message.tick == self.tick:
                    took_s = time.perf_counter() - started_s
                    self._motors[0] = message.command[:2]
                    return took_s

    def depart(self) -> None:
        """Arm and start the mission."""
        mode = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        self.link.send(
            dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, 0, 0, 0, 0, 0, 0),
            dialect.MAVLink_command_long_message(1, 1, dialect.MAV_CMD_DO_SET_MODE, 0, mode, 10.0, 0, 0, 0, 0, 0),
        )

    @property
    def under_way(self) -> bool:
        """Whether the autopilot commands the motors."""
        return bool(self._motors.any())


def round_trips() -> dict[str, list[float]]:
    """Microseconds of sensor → agent → actuator at 400 Hz, and of an echo of as many bytes at the same rate.

    The far ends have a processor of their own, as a board has. Left to the scheduler they sometimes share the near
    end's, which makes a round trip four times as fast and the ratio a matter of luck.
    """
    trips: list[float] = []
    echoes: list[float] = []
    with ExitStack() as opened:
        process, url = opened.enter_context(agent_process())
        echo_server, echo = opened.enter_context(echo_process())
        opened.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))
        near, *far = sorted(os.sched_getaffinity(0))
        for pid, processors in ((0, {near}), (process.pid, far), (echo_server.pid, far)):
            os.sched_setaffinity(pid, processors or {near})
        rig = Rig(url, opened)
        for _ in range(LEAD_IN_S * RATE_HZ):
            rig.trip_s(rig.messages())
            if rig.tick == DEPART_S * RATE_HZ:
                rig.depart()
        for _ in range(scaled(BLOCKS, 1)):
            due_s = time.perf_counter()
            for _ in range(BLOCK):
                messages = rig.messages()
                due_s = _wait_for(due_s + 1 / RATE_HZ)
                trips.append(rig.trip_s(messages) * 1e6)
            for _ in range(BLOCK):
                due_s = _wait_for(due_s + 1 / RATE_HZ)
                echoes.append(_echo_s(echo) * 1e6)
        if not rig.under_way:
            raise RuntimeError("the agent did not drive: this would be a bench of the easy case")
    return {"trip": trips, "echo": echoes}


def round_trip_ratios(share: float, runs: int = 3) -> Callable[[], list[float]]:
    """How many times the echo's quantile the trip's is, once a run."""

    def measure() -> list[float]:
        ratios = []
        for _ in range(scaled(runs, 1)):
            times = round_trips()
            ratios.append(_quantile(times["trip"], share) / _quantile(times["echo"], share))
        return ratios

    return measure


def agent_cpu_percent(runs: int = 3, seconds: int = 20) -> list[float]:
    """Of one core, over a run in real time with IMU and exchanges at 100 Hz."""
    shares = []
    for _ in range(scaled(runs, 1)):
        with agent_process() as (process, url), tempfile.TemporaryDirectory() as folder:
            settings = {
                "autopilot.runs": "board",
                "autopilot.link": url,
                "sensors.imu.rate_hz": "100",
                "clock.exchange_rate_hz": "100",
            }
            sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
            before_s, started_s = _cpu_s(process.pid), time.perf_counter()
            command = [sys.executable, "-m", "xitl_cli.main", "sim", "-p", "hitl-loopback", *sets]
            subprocess.run(
                [*command, "--duration", str(scaled(seconds, 2)), "--out", f"{folder}/run", "--json"],
                check=False,
                capture_output=True,
            )
            shares.append(100.0 * (_cpu_s(process.pid) - before_s) / (time.perf_counter() - started_s))
    return shares


def lost_messages(seconds: float, rate_hz: int = 2000) -> dict[str, int]:
    """Counts of both ends after so long at so many messages a second to the agent, in real time."""
    with ExitStack() as opened:
        _, url = opened.enter_context(agent_process())
        link = Link(opened.enter_context(open_transport(url, listen=False)), 255, 190)
        link.send(dialect.MAVLink_xitl_run_message(0, b"soak", 1, 0, PROTOCOL))
        link.receive(1.0)
        link.reset_counters()
        started_s = time.perf_counter()
        sent = 0
        while sent < seconds * rate_hz:
            link.receive(0.0005)
            wanted = int((time.perf_counter() - started_s) * rate_hz) + 1
            while sent < wanted:
                sent += 1
                stamp_us = round(sent * 1e6 / rate_hz)
                link.send(dialect.MAVLink_xitl_imu_message(stamp_us, [0.0] * 3, [0.0, 0.0, -9.8], 20.0))
        status = None
        asked_s = time.perf_counter()
        link.send(dialect.MAVLink_xitl_run_message(0, b"soak", 0, 0, PROTOCOL))
        while (status is None or status.running) and time.perf_counter() - asked_s < 5.0:
            for message in link.receive(0.1):
                if message.get_msgId() == dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS:
                    status = message
        if status is None or status.running:
            raise RuntimeError("the agent did not answer the end of the run")
        counters = link.counters
        return {
            "to_agent_sent": counters.sent,
            "to_agent_lost": counters.sent - status.frames_received,
            "to_host_received": counters.received,
            "to_host_lost": counters.lost,
            "unsent": counters.unsent + status.frames_unsent,
        }


def _echo_s(echo: socket.socket) -> float:
    started_s = time.perf_counter()
    echo.send(b"x" * 90)
    echo.recv(2048)
    return time.perf_counter() - started_s


def _wait_for(due_s: float) -> float:
    """Sleep until then; returns when that was, later where it had already gone by."""
    while (left_s := due_s - time.perf_counter()) > 0:
        time.sleep(left_s)
    return max(due_s, time.perf_counter() - 0.1 / RATE_HZ)


def _quantile(values: list[float], share: float) -> float:
    return statistics.quantiles(values, n=1000, method="inclusive")[round(share * 1000) - 1]


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
