"""A boat in real time for clients that nobody here wrote: the agent in its own process, and a host that simulates."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.free_ports import free_port
from tests.patience import PATIENCE_S, wait_until

RUN_S = 600
LAT_DEG, LON_DEG = -8.80, -63.95  # about where the shipped profiles start; the tests ask the boat itself


@dataclass(frozen=True)
class Boat:
    """Where a client finds it. `tcp_port` listens; `udp_ports` are sent to."""

    tcp_port: int
    udp_ports: tuple[int, ...]

    @property
    def tcp(self) -> str:
        """For pymavlink and MAVProxy."""
        return f"tcp:127.0.0.1:{self.tcp_port}"


@contextmanager
def boat(udp_ports: int = 1, host: bool = True, agent_options: tuple[str, ...] = ()) -> Iterator[Boat]:
    """Started, in calm water, disarmed in HOLD; it needs some ten seconds to be ready to arm. Ends with the block."""
    link = f"udp://127.0.0.1:{free_port()}"
    made = Boat(free_port(), tuple(free_port() for _ in range(udp_ports)))
    stations = [f"tcp://127.0.0.1:{made.tcp_port}", *(f"udp://127.0.0.1:{port}" for port in made.udp_ports)]
    urls = [word for url in stations for word in ("--gcs", url)]
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory()))
        agent = _start(opened, folder / "agent.log", "-m", "agent", "--link", link, *urls, *agent_options)
        assert agent.stdout is not None
        assert agent.stdout.readline(), (folder / "agent.log").read_text()
        if host:
            settings = {
                "autopilot.runs": "board",
                "autopilot.link": link,
                "driver.kind": "none",
                "mission.waypoints_ned_m": "[]",
                "environment.current.speed_mps": "0",
                "environment.current.deviation_mps": "0",
                "environment.waves.spectrum": "none",
                "environment.wind.mean_mps": "0",
                "environment.wind.gust.spectrum": "none",
            }
            overrides = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
            said = folder / "host.log"
            host_process = _start(
                opened,
                said,
                *("-m", "xitl_cli.main", "sim", "--profile", "hitl-loopback", "--clock", "realtime"),
                *("--duration", str(RUN_S), "--out", str(folder / "run"), *overrides),
            )

            def is_under_way() -> bool:
                assert host_process.poll() is None, said.read_text()
                return "\nt " in f"\n{said.read_text()}"

            wait_until(is_under_way, "the run does not begin")  # its beginning resets the agent: mission and all
        yield made


def _start(opened: ExitStack, log: Path, *arguments: str) -> subprocess.Popen[str]:
    errors = opened.enter_context(log.open("w"))
    process = subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE if "agent" in arguments else errors,
        stderr=errors,
        text=True,
        start_new_session=True,
    )
    opened.callback(_stop, process)
    return process


def _stop(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if process.stdout is not None:
        process.stdout.close()
