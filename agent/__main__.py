"""`python -m agent`: the agent's process. The same entry serves `xitl agent`."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

import agent
from agent.fcu.autopilot import Autopilot
from agent.fcu.parameters import ParameterError, Parameters
from agent.fcu.services import Services
from agent.node import AgentNode
from agent.wire.link import Link
from agent.wire.transport import TransportError, open_transport

DEFAULT_LINK = "udp://0.0.0.0:14660"
SYSTEM_ID = 1
COMPONENT_ID = 1


def main(arguments: list[str] | None = None, program: str = "python -m agent") -> int:
    """Serve until interrupted. Returns the exit code: 0 after an interrupt, 2 when it could not start."""
    options = _parser(program).parse_args(arguments)
    try:
        parameters = Parameters()
        if options.parameters:
            parameters.load(options.parameters.read_text(), str(options.parameters))
        transport = open_transport(options.link, listen=True)
    except OSError as error:
        return _refuse(f"{options.parameters}: cannot be read ({error.strerror}); check the path")
    except (ParameterError, TransportError) as error:
        return _refuse(str(error))
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: stop.append(received))
    with transport:
        sys.stdout.write(f"xitl agent {agent.__version__}: embedded autopilot waits at {transport.address}\n")
        sys.stdout.flush()
        link = Link(transport, SYSTEM_ID, COMPONENT_ID)
        AgentNode(link, lambda: Services(Autopilot(Parameters({name: parameters[name] for name in parameters})))).serve(
            lambda: not stop
        )
    return 0


def _parser(program: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=program, description="Run the embedded autopilot for a simulation host.")
    parser.add_argument(
        "--link", default=DEFAULT_LINK, metavar="URL", help="where to wait for the host (default: %(default)s)"
    )
    parser.add_argument("--parameters", type=Path, metavar="FILE", help="parameter file (.parm) to start with")
    parser.add_argument("--version", action="version", version=f"xitl agent {agent.__version__}")
    return parser


def _refuse(sentence: str) -> int:
    red, plain = ("\033[1;31m", "\033[0m") if sys.stderr.isatty() else ("", "")
    sys.stderr.write(f"{red}error: {sentence}{plain}\n")
    return 2


if __name__ == "__main__":
    sys.exit(main())
