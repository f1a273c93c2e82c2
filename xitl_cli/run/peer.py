"""Where the agent runs: in this process, in one of its own on this machine, or on a board. One interface for all."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import Protocol

from agent.dataflash.files import at
from agent.fcu.autopilot import Autopilot as EmbeddedAutopilot
from agent.fcu.control.controller import ControllerError
from agent.fcu.control.controller import load as load_controller
from agent.fcu.log.flight_log import FlightLog
from agent.fcu.mavlink.services import Services
from agent.fcu.parameters import Parameters
from agent.ground.stations import GroundStations
from agent.node import AgentNode
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.signing import Signing
from agent.wire.transport import Transport, TransportError, open_transport
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.operation import Autopilot
from xitl_cli.run.agent_options import AgentOptions
from xitl_cli.run.directory import DATAFLASH
from xitl_cli.signing import read_key_file

HOST_SYSTEM_ID = 255
HOST_COMPONENT_ID = 190
AGENT_SYSTEM_ID = 1
AGENT_COMPONENT_ID = 1
_STOP_S = 2.0


class Peer(Protocol):
    """An agent that can be talked to through `transport`."""

    transport: Transport

    def pump(self) -> None:
        """Let the agent work; does nothing where it has a processor of its own."""

    def check(self) -> None:
        """Raise UserError when the agent is known to be gone."""

    def unreachable(self, waited_s: float) -> UserError:
        """What to say when it does not answer."""

    def close(self) -> None:
        """Stop what was started."""


class InProcess:
    """The same agent code in the host's process, over the in-memory transport."""

    def __init__(self, options: AgentOptions) -> None:
        self.transport: Transport
        self.transport, theirs = memory_pair("agent")
        self._opened = ExitStack()
        try:
            node = _node(Link(theirs, AGENT_SYSTEM_ID, AGENT_COMPONENT_ID), options, self._opened)
        except (TransportError, ControllerError) as error:
            self._opened.close()
            raise UserError(str(error)) from error
        self.pump: Callable[[], None] = node.poll

    def check(self) -> None:
        pass

    def unreachable(self, waited_s: float) -> UserError:
        return UserError("the agent in this process did not answer; this is a fault of xitl, please report it")

    def close(self) -> None:
        self._opened.close()
        self.transport.close()


def _node(link: Link, options: AgentOptions, opened: ExitStack) -> AgentNode:
    """What `xitl agent` makes of the same options. Raises TransportError, ControllerError and UserError."""
    make_controller = None if options.controller is None else load_controller(options.controller)
    signing = None if options.signing_key_file is None else Signing(read_key_file(options.signing_key_file))
    ground = None
    if options.ground_stations:
        ground = GroundStations(options.ground_stations, AGENT_SYSTEM_ID, AGENT_COMPONENT_ID, signing)
        opened.callback(ground.close)
    log_file = None if options.log_dir is None else options.log_dir / DATAFLASH

    def services() -> Services:
        return Services(EmbeddedAutopilot(Parameters(), make_controller), AGENT_SYSTEM_ID, AGENT_COMPONENT_ID)

    def log(now_ns: Callable[[], int]) -> FlightLog:
        assert log_file is not None
        made = FlightLog(at(log_file), now_ns)
        opened.callback(made.close)
        return made

    return AgentNode(link, services, "in-process", ground, make_log=None if log_file is None else log)


class OwnProcess:
    """The agent as a process of its own on this machine."""

    def __init__(self, url: str, options: AgentOptions) -> None:
        self._url = url
        self._process = subprocess.Popen(
            [sys.executable, "-m", "agent", "--link", url, *options.arguments()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,  # a Ctrl-C at the terminal is the host's to pass on
        )
        assert self._process.stdout is not None
        if not self._process.stdout.readline():  # its first line says that it listens
            error = self._gone()
            self.close()
            raise error
        try:
            self.transport = open_transport(url, listen=False)
        except TransportError as error:
            self.close()
            raise UserError(f"autopilot.link: {error}") from error

    def pump(self) -> None:
        pass

    def check(self) -> None:
        if self._process.poll() is not None:
            raise self._gone()

    def unreachable(self, waited_s: float) -> UserError:
        return UserError(
            f"{self._url}: the agent process started but did not answer for {waited_s:.0f} s; "
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
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _gone(self) -> UserError:
        code = self._process.wait()
        stderr = self._process.stderr
        lines = stderr.read().strip().splitlines() if stderr is not None and not stderr.closed else []
        reason = lines[-1].removeprefix("error: ") if lines else f"exit code {code}"
        return UserError(f"the agent process ended: {reason}")


class Board:
    """An agent that somebody started on a board."""

    def __init__(self, url: str) -> None:
        self._url = url
        try:
            self.transport = open_transport(url, listen=False)
        except TransportError as error:
            raise UserError(f"autopilot.link: {error}") from error

    def pump(self) -> None:
        pass

    def check(self) -> None:
        pass

    def unreachable(self, waited_s: float) -> UserError:
        host, _, port = self._url.removeprefix("udp://").rpartition(":")
        return UserError(
            f"{self._url}: no agent answered within {waited_s:.0f} s; check that {host} answers a ping (cable, power, "
            f"address of this machine's USB-Ethernet interface) and that the board runs `xitl agent --link udp://0.0.0.0:{port}`"
        )

    def close(self) -> None:
        self.transport.close()


def open_peer(autopilot: Autopilot, options: AgentOptions) -> Peer:
    """The peer that the profile asks for. Raises UserError when it cannot be opened."""
    if autopilot.runs == "in-process":
        return InProcess(options)
    if autopilot.link is None:
        raise UserError(f"autopilot.runs = {autopilot.runs} needs autopilot.link, for instance udp://127.0.0.1:14660")
    return OwnProcess(autopilot.link, options) if autopilot.runs == "process" else Board(autopilot.link)
