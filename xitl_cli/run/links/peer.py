"""The agent's program behind one interface: in this process, in another process on this machine, or on a board."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from ipaddress import ip_address
from pathlib import Path
from typing import Protocol

from agent.assembly import REFUSALS, assemble
from agent.machine import VIRTUAL
from agent.options import BRIDGE, COMPANION, FCU, WAITS_AT, Options
from agent.wire.memory import memory_pair
from agent.wire.transport import Transport, TransportError, open_transport
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import BridgeSpec
from xitl_cli.run.core.directory import DATAFLASH
from xitl_cli.run.links.agent_workers import AgentWorkers


@dataclass(frozen=True, slots=True)
class AgentOptions:
    """Options of the agent, see `xitl agent --help`."""

    system_id: int = Options.system_id
    """System id of the vessel."""
    ground_stations: tuple[str, ...] = ()
    controller: str | None = None
    signing_key_file: str | None = None
    link_key_file: str | None = None
    log_dir: Path | None = None
    """Folder of the DataFlash log; None for no log."""
    bridge: BridgeSpec | None = None
    """Set when the agent is a bridge to another autopilot."""
    companion: bool = False
    """The agent is a companion computer."""
    fleet: bool = False
    """The vessel belongs to a fleet."""

    @property
    def key(self) -> str:
        """The group of the profile that the options come from."""
        return "companion" if self.companion else "autopilot"

    def arguments(self) -> list[str]:
        """Return the options as a command line."""
        options: dict[str, object] = {
            "--system-id": None if self.system_id == Options.system_id else self.system_id,
            "--controller": self.controller,
            "--signing-key": self.signing_key_file,
            "--link-key": self.link_key_file,
            "--log-dir": self.log_dir,
        }
        bridge = self.bridge
        if bridge is not None:
            options |= {
                "--role": BRIDGE,
                "--autopilot": bridge.mavlink,
                "--world": bridge.world,
                "--sensors": bridge.sensors,
                "--sensor-link": bridge.sensor_link,
                "--outputs": ",".join(map(str, bridge.outputs)),
                "--trim": f"{bridge.trim_us:g}",
                "--span": f"{bridge.span_us:g}",
            }
        if self.companion:
            options["--role"] = COMPANION
        words = [word for url in self.ground_stations for word in ("--gcs", url)]
        for option, value in options.items():
            if value is not None:
                words += [option, str(value)]
        return words + ["--fleet"] * (bridge is not None and self.fleet)


def options_from_profile(
    profile: RunProfile,
    run_directory: Path | None,
    ground_stations: tuple[str, ...] = (),
    bridge: BridgeSpec | None = None,
) -> AgentOptions:
    """Return the options that the profile sets. `run_directory`: folder for a log, None for no log."""
    autopilot = profile.autopilot
    if bridge is not None:
        fleet = bool(profile.vessel)
        return AgentOptions(autopilot.system_id, link_key_file=autopilot.link_key_file, bridge=bridge, fleet=fleet)
    return AgentOptions(
        system_id=autopilot.system_id,
        ground_stations=ground_stations,
        controller=autopilot.controller,
        signing_key_file=autopilot.signing_key_file,
        link_key_file=autopilot.link_key_file,
        log_dir=run_directory.absolute() if run_directory is not None and profile.recording.dataflash else None,
    )


HOST_SYSTEM_ID = 255
HOST_COMPONENT_ID = 190
_STOP_S = 2.0
LINES_KEPT = 20


class Peer(Protocol):
    """An agent that is reachable through `transport`."""

    transport: Transport

    def hand_over(self) -> None:
        """Mark the end of a batch of messages. An agent in another process can start to work on it."""

    def pump(self) -> None:
        """Let the agent work. Does nothing for an agent with its own processor."""

    def check(self) -> None:
        """Raise UserError when the agent is known to have ended."""

    def unreachable(self, waited_s: float) -> UserError:
        """Return the error for an agent that does not answer."""

    def close(self) -> None:
        """Stop the started programs."""


class InProcessAgent:
    """The same agent code in the host's process, over the in-memory transport."""

    def __init__(self, options: AgentOptions) -> None:
        self.transport: Transport
        self.transport, theirs = memory_pair("companion" if options.companion else "agent")
        self._opened = ExitStack()
        try:
            node = assemble(theirs, own_options(options), self._opened)
        except REFUSALS as error:
            self.close()
            raise UserError(str(error)) from error
        self.pump: Callable[[], None] = node.poll

    def hand_over(self) -> None:
        pass

    def check(self) -> None:
        pass

    def unreachable(self, waited_s: float) -> UserError:
        return UserError("the agent in this process did not answer; this is a fault of xitl, please report it")

    def close(self) -> None:
        self._opened.close()
        self.transport.close()


def own_options(options: AgentOptions) -> Options:
    """Return the options as `xitl agent` gets them."""
    if options.bridge is not None:
        bridge = options.bridge
        return Options(
            role=BRIDGE,
            system_id=options.system_id,
            link_key=None if options.link_key_file is None else Path(options.link_key_file),
            kind=VIRTUAL,
            autopilot=bridge.mavlink,
            world=bridge.world or "",
            sensors=bridge.sensors or "",
            sensor_link=bridge.sensor_link or "",
            outputs=bridge.outputs,
            trim_us=bridge.trim_us,
            span_us=bridge.span_us,
            fleet=options.fleet,
        )
    return Options(
        role=COMPANION if options.companion else FCU,
        system_id=options.system_id,
        ground=options.ground_stations,
        controller=options.controller or "",
        signing_key=None if options.signing_key_file is None else Path(options.signing_key_file),
        link_key=None if options.link_key_file is None else Path(options.link_key_file),
        log_file=None if options.log_dir is None else options.log_dir / DATAFLASH,
        kind=VIRTUAL,
    )


class ProcessAgent:
    """The agent as a separate process on this machine, at the other end of `url` or of the line that `url` requests.

    With port 0 the agent chooses a free port, so that parallel runs do not conflict.
    """

    def __init__(self, url: str, options: AgentOptions) -> None:
        agent_url = url
        from xitl_cli.run.links.loopback import open_loopback

        self._loopback = open_loopback(url)
        if self._loopback is not None:
            url, agent_url = self._loopback.host_url, self._loopback.agent_url
        self._what = "companion" if options.companion else "agent"
        self._said: threading.Thread | None = None
        self._process = subprocess.Popen(
            [sys.executable, "-m", "agent", "--attached", "--link", agent_url, *options.arguments()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # the host passes on a Ctrl-C at the terminal
        )
        assert self._process.stdout is not None
        first_line = self._process.stdout.readline()
        if not first_line:
            error = self._gone()
            self.close()
            raise error
        self._said = threading.Thread(target=deque, args=(self._process.stdout, LINES_KEPT), daemon=True)
        self._said.start()  # later output has to be read, or the agent would block on it
        self._url = url = url if self._loopback is not None else waits_at(first_line)
        try:
            self.transport = open_transport(url, listen=False)
        except TransportError as error:
            self.close()
            raise UserError(f"{options.key}.link: {error}") from error

    def hand_over(self) -> None:
        pass

    def pump(self) -> None:
        pass

    def check(self) -> None:
        if self._process.poll() is not None:
            raise self._gone()

    def unreachable(self, waited_s: float) -> UserError:
        return UserError(
            f"{self._url}: the {self._what} process started but did not answer for {waited_s:.0f} s; "
            "check that no firewall filters this port on the loopback interface"
        )

    def close(self) -> None:
        transport = getattr(self, "transport", None)
        if transport is not None:
            transport.close()
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        if self._said is not None:
            self._said.join(_STOP_S)
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()
        if self._loopback is not None:
            self._loopback.close()

    def _gone(self) -> UserError:
        code = self._process.wait()
        stderr = self._process.stderr
        lines = stderr.read().strip().splitlines() if stderr is not None and not stderr.closed else []
        reason = lines[-1].removeprefix("error: ") if lines else f"exit code {code}"
        if code < 0:
            reason = f"signal {-code} killed it; look for who sent it (out of memory?), then run again"
        return UserError(f"the {self._what} process ended: {reason}")


def waits_at(first_line: str) -> str:
    """Return the address at which the agent listens, from its first line of output."""
    return first_line.rpartition(f" {WAITS_AT} ")[2].strip()


class BoardAgent:
    """An agent that the user started on a board."""

    def __init__(self, url: str, options: AgentOptions) -> None:
        self._url = url
        self._what, self._role = ("companion", f"--role {COMPANION} ") if options.companion else ("agent", "")
        try:
            self.transport = open_transport(url, listen=False)
        except TransportError as error:
            raise UserError(f"{options.key}.link: {error}") from error

    def hand_over(self) -> None:
        pass

    def pump(self) -> None:
        pass

    def check(self) -> None:
        pass

    def unreachable(self, waited_s: float) -> UserError:
        return UserError(
            f"{self._url}: no {self._what} answered within {waited_s:.0f} s; "
            f"check that {_advice(self._url, self._role)}"
        )

    def close(self) -> None:
        self.transport.close()


def _advice(url: str, role: str = "") -> str:
    """Return advice for an end that does not answer. `role`: the option that the agent needs, if any."""
    scheme, _, rest = url.partition("://")
    if scheme == "serial":
        return (
            "the cable joins both ends crosswise (TX to RX, ground to ground), and that the board runs "
            f"`xitl agent --link serial:///dev/ttyX?{rest.partition('?')[2] or 'baud=921600'}` at the same baud rate"
        )
    if scheme == "can":
        return (
            "the bus is terminated at both ends, and that the board runs `xitl agent --link can://...` at the same bit "
            "rate with the node numbers exchanged"
        )
    host, _, port = rest.rpartition(":")
    there = f"{host}:{port}"
    try:
        ip_address(host.strip("[]"))
    except ValueError:  # a board may resolve its own name to 127.0.1.1, which is unreachable from outside
        there = f"usb0:{port}"
    return (
        f"{host} answers a ping (cable, power, address of this machine's USB-Ethernet interface), and that the board "
        f"runs `xitl agent {role}--link {scheme}://{there}`, serves no other host and has the same link key as this "
        "one, or none like it"
    )


def open_peer(
    runs: str, link: str | None, options: AgentOptions, workers: AgentWorkers | None = None, vessel: str = ""
) -> Peer:
    """Open the peer that a profile selects for `vessel`. Raises UserError when it cannot be opened.

    workers: they run the autopilots of a fleet in lockstep that would otherwise be in this process.
    """
    if runs == "in-process":
        return InProcessAgent(options) if workers is None else workers.open(own_options(options), vessel)
    if link is None:
        key = options.key
        raise UserError(f"{key}.runs = {runs} needs {key}.link, for instance udp://127.0.0.1:14660")
    return ProcessAgent(link, options) if runs == "process" else BoardAgent(link, options)
