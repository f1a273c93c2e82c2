"""`xitl-agent.pyz doctor`: whether this machine is fit to run the agent, and what to do where it is not."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import struct
import sys
import time
from importlib import import_module
from pathlib import Path

from agent.board import checks
from agent.board.findings import OK, PROBLEM, WARNING, Finding, exit_code, text, to_json, to_objects
from agent.board.receive import MARK, OLDEST
from agent.wire.transport import AddressInUseError, TransportError, open_transport

DEFAULT_LINK = "udp://127.0.0.1:14660"
RELEASED = 2024
_PACKAGES = {"serial": "pyserial", "can": "python-can"}


def main(arguments: list[str], program: str) -> int:
    """Print the findings; 1 when something will not work."""
    parser = argparse.ArgumentParser(prog=program, description="Check whether this machine is fit to run the agent.")
    parser.add_argument("--link", metavar="URL", help="link to try as well: its port, device or interface")
    parser.add_argument("--json", action="store_true", help="findings as JSON")
    parser.add_argument("--for-host", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    findings = examine(options.link, OLDEST)
    if options.for_host:
        sys.stdout.write(MARK + json.dumps({"findings": to_objects(findings)}) + "\n")
    elif options.json:
        sys.stdout.write(to_json(findings) + "\n")
    else:
        sys.stdout.write(text(findings, sys.stdout.isatty() and "NO_COLOR" not in os.environ) + "\n")
    return exit_code(findings)


def examine(link_url: str | None, needed: tuple[int, int], root: Path = Path("/")) -> list[Finding]:
    """Everything about this machine. needed: the oldest Python that will do. root: where /proc, /sys and /dev are."""
    system = os.uname()
    place = Path.cwd()
    return [
        checks.python(sys.version_info[:3], needed, 8 * struct.calcsize("P")),
        *packages(link_url),
        checks.kernel(root, system.release, system.version),
        checks.real_time(root),
        checks.memory_lock(root),
        checks.processors(os.cpu_count() or 1),
        checks.governor(root),
        checks.temperature(root),
        checks.memory(root),
        checks.disk(str(place), shutil.disk_usage(place).free),
        checks.clock(root, time.clock_getres(time.CLOCK_MONOTONIC)),
        checks.date(root, time.gmtime().tm_year, RELEASED),
        checks.sockets(root),
        checks.usb_ethernet(root),
        *checks.serial_devices(root),
        *checks.can_interfaces(root),
        link(link_url),
    ]


def packages(link_url: str | None) -> list[Finding]:
    """What is needed for serial and CAN links; a problem only where the link wants it."""
    found = []
    for module, package in _PACKAGES.items():
        wanted = (link_url or "").startswith(f"{module}:")
        try:
            import_module(module)
        except ImportError:
            level = PROBLEM if wanted else OK
            advice = f"pip install {package}, or use the xitl-agent.pyz, which brings it" if wanted else ""
            found.append(Finding(package, level, f"not installed (matters only for {module}:// links)", advice))
        else:
            found.append(Finding(package, OK, "installed"))
    return found


def link(url: str | None) -> Finding:
    """Open the link for a moment, as the agent would, and close it again."""
    wanted = url or DEFAULT_LINK
    try:
        open_transport(wanted, listen=True).close()
    except AddressInUseError as error:
        level = WARNING if url is None else PROBLEM
        return Finding(
            "link", level, f"{error.where}: {error.what}", "does an agent run here already? then all is well"
        )
    except TransportError as error:
        return Finding("link", PROBLEM, f"{error.where}: {error.what}", error.fix)
    return Finding("link", OK, f"{wanted} can be opened")
