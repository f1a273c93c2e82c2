"""`python -m agent`: the agent's process. The same entry serves `xitl agent`."""

from __future__ import annotations

import argparse
import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Callable

import agent
from agent.fcu.autopilot import Autopilot
from agent.fcu.control.controller import ControllerError, MakeController, load
from agent.fcu.log.hooks import NullFlightLog
from agent.fcu.mavlink.services import Services
from agent.fcu.parameters import ParameterError, Parameters
from agent.ground.stations import GroundStations
from agent.node import AgentNode
from agent.storage import Storage, StorageError
from agent.wire.link import Link
from agent.wire.signing import Signing, SigningKeyError, read_key
from agent.wire.transport import TransportError, open_transport

DEFAULT_LINK = "udp://0.0.0.0:14660"
SYSTEM_ID = 1
COMPONENT_ID = 1


def main(arguments: list[str] | None = None, program: str = "python -m agent") -> int:
    """Serve until interrupted. Returns the exit code: 0 after an interrupt, 2 when it could not start."""
    options = _parser(program).parse_args(arguments)
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: stop.append(received))
    with ExitStack() as opened:
        try:
            node, places = _node(options, opened)
        except (
            _UnreadableError,
            ParameterError,
            TransportError,
            StorageError,
            SigningKeyError,
            ControllerError,
        ) as error:
            return _refuse(str(error))
        sys.stdout.write(f"xitl agent {agent.__version__}: embedded autopilot waits at {places[0]}\n")
        if len(places) > 1:
            sys.stdout.write(f"ground stations: {', '.join(places[1:])}\n")
        sys.stdout.flush()
        node.serve(lambda: not stop)
    return 0


def _node(options: argparse.Namespace, opened: ExitStack) -> tuple[AgentNode, tuple[str, ...]]:
    """The node that the options describe and where it can be reached; what has to be closed goes to `opened`."""
    parameters = Parameters()
    if options.parameters:
        parameters.load(_text(options.parameters), str(options.parameters))
    make_controller: MakeController | None = load(options.controller) if options.controller else None
    signing = None
    if options.signing_key:
        signing = Signing(read_key(_text(options.signing_key), str(options.signing_key)))
    storage = None
    if options.storage:
        storage = Storage(options.storage)
        opened.callback(storage.close)
    transport = opened.enter_context(open_transport(options.link, listen=True))
    ground = None
    if options.gcs:
        ground = GroundStations(options.gcs, SYSTEM_ID, COMPONENT_ID, signing)
        opened.callback(ground.close)

    def services() -> Services:
        own = Parameters({name: parameters[name] for name in parameters})
        return Services(Autopilot(own, make_controller), SYSTEM_ID, COMPONENT_ID)

    link = Link(transport, SYSTEM_ID, COMPONENT_ID)
    make_log = _log_to(options.log_dir, opened) if options.log_dir else None
    node = AgentNode(link, services, ground=ground, storage=storage, make_log=make_log)
    return node, (transport.address, *(() if ground is None else ground.addresses))


def _log_to(directory: Path, opened: ExitStack) -> Callable[[Callable[[], int]], NullFlightLog]:
    from agent.dataflash.files import in_directory
    from agent.fcu.log.flight_log import FlightLog

    def make(now_ns: Callable[[], int]) -> NullFlightLog:
        log = FlightLog(in_directory(directory), now_ns)
        opened.callback(log.close)
        return log

    return make


class _UnreadableError(Exception):
    """A file named in the options."""


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except UnicodeDecodeError:
        raise _UnreadableError(f"{path}: cannot be read (not text); check the path") from None
    except OSError as error:
        raise _UnreadableError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=program, description="Run the embedded autopilot for a simulation host.")
    parser.add_argument(
        "--link", default=DEFAULT_LINK, metavar="URL", help="where to wait for the host (default: %(default)s)"
    )
    parser.add_argument(
        "--gcs",
        action="append",
        default=[],
        metavar="URL",
        help="ground station, repeatable: udp://host:port is sent to, at tcp://address:port we listen for any number",
    )
    parser.add_argument("--parameters", type=Path, metavar="FILE", help="parameter file (.parm) to start with")
    parser.add_argument(
        "--storage", type=Path, metavar="FILE", help="keep here what ground stations set: parameters, mission, fence"
    )
    parser.add_argument("--log-dir", type=Path, metavar="DIR", help="write a DataFlash log of each run here")
    parser.add_argument(
        "--signing-key",
        type=Path,
        metavar="FILE",
        help="MAVLink 2 signing with ground stations: 64 hexadecimal digits, or a passphrase",
    )
    parser.add_argument(
        "--controller", metavar="MODULE:CLASS", help="controller in place of the built-in one, see docs/controller.md"
    )
    parser.add_argument("--version", action="version", version=f"xitl agent {agent.__version__}")
    return parser


def _refuse(sentence: str) -> int:
    red, plain = ("\033[1;31m", "\033[0m") if sys.stderr.isatty() else ("", "")
    sys.stderr.write(f"{red}error: {sentence}{plain}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
