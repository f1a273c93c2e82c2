"""Checks of `xitl doctor` for simulation: packages, firmware, ports, pseudo-terminals."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

from agent.board.doctor import OK, PROBLEM, WARNING, DoctorFinding
from xitl_cli.errors import UserError
from xitl_cli.extras import EXTRAS
from xitl_cli.firmware.cache import PX4_VARIABLE, ROVER_VARIABLES, SITL, find_firmware, find_px4, named_by
from xitl_cli.profile.schema.profile import USUAL
from xitl_cli.registry import DOCTOR_CHECKS, load_all, plugins

PACKAGES = ("numpy", "yaml", "mcap", "foxglove", "rich", "typer")
"""Packages that every run needs."""


def examine_simulating() -> list[DoctorFinding]:
    """Return findings on this machine, those of plug-ins last."""
    of_plugins = [finding for _, check in load_all(DOCTOR_CHECKS) for finding in check()]
    own = [
        check_packages(),
        check_physics(),
        *check_extras(),
        *check_firmware(),
        *check_ports(),
        check_pseudo_terminals(),
    ]
    return [*own, *check_plugins(), *of_plugins]


def check_plugins() -> Iterator[DoctorFinding]:
    """Yield a warning for each plug-in that cannot be loaded."""
    for plugin in plugins():
        if plugin.error:
            yield DoctorFinding(f"plug-in {plugin.name}", WARNING, plugin.error, "`xitl plugins` lists all of them")


def check_packages() -> DoctorFinding:
    """Check that xitl's required packages are installed."""
    from importlib.util import find_spec

    missing = [package for package in PACKAGES if find_spec(package) is None]
    if missing:
        return DoctorFinding("packages", PROBLEM, f"not installed: {', '.join(missing)}", "pip install xitl")
    return DoctorFinding("packages", OK, "all that a run needs")


def check_physics() -> DoctorFinding:
    """Say whether the physics runs compiled. It runs in numpy otherwise, which needs more time."""
    from sim_core.tape.library import NoKernelError, load_kernel

    try:
        load_kernel()
    except NoKernelError as error:
        reason, _, advice = str(error).partition("; ")
        return DoctorFinding("physics", OK, f"in numpy, which needs more processor time ({reason})", advice)
    return DoctorFinding("physics", OK, "compiled")


def check_extras() -> Iterator[DoctorFinding]:
    """Yield the state of the extras. A missing extra is no problem; the advice shows how to install it."""
    for extra in EXTRAS:
        name, missing = f"extra {extra.name}", extra.missing
        if missing:
            yield DoctorFinding(name, OK, f"not installed (only for {extra.what})", extra.pip_line)
        else:
            yield DoctorFinding(name, OK, f"installed, for {extra.what}")


def check_firmware() -> Iterator[DoctorFinding]:
    """Yield the programs of other autopilots, which the embedded autopilot does not need."""
    advice = f"xitl firmware get rover, or export {ROVER_VARIABLES[SITL]}=…/ardurover"
    yield _program("ArduRover", lambda: find_firmware("rover", SITL), named_by("rover", SITL), advice)
    variable = PX4_VARIABLE if os.environ.get(PX4_VARIABLE) else None
    advice = f"build PX4 with `make px4_sitl_default`, then export {PX4_VARIABLE}=…/bin/px4"
    yield _program("PX4", lambda: find_px4()[0], variable, advice)


def _program(name: str, find: Callable[[], Path], variable: str | None, advice: str) -> DoctorFinding:
    """Return the finding on a program. variable: the environment variable for it, if set."""
    try:
        path = find()
    except UserError as error:
        if variable is None:
            profiles = name.replace("ArduRover", "ArduPilot")
            return DoctorFinding(name, OK, f"none found (only for profiles with {profiles})", advice)
        return DoctorFinding(name, WARNING, str(error), f"correct {variable}, or unset it")
    return DoctorFinding(name, OK, f"{path}" + (f" (from {variable})" if variable else ""))


def check_ports() -> Iterator[DoctorFinding]:
    """Yield the ports of ground stations in a real-time run. A run replaces a port in use by the next free one."""
    sends_to, listens_at = urlsplit(USUAL[0]), USUAL[1]
    if _free(socket.SOCK_STREAM, listens_at):
        yield DoctorFinding("ground stations", OK, f"TCP {listens_at} is free")
    else:
        yield DoctorFinding(
            "ground stations",
            WARNING,
            f"TCP {listens_at} is taken by another program, perhaps another run",
            "a run uses the next free port and prints it; or end that program",
        )
    listening = not _free(socket.SOCK_DGRAM, sends_to.port or 0)
    who = "a program, perhaps a ground station," if listening else "no program yet"
    yield DoctorFinding("ground stations", OK, f"{who} listens at UDP {sends_to.port}, where a run sends its telemetry")


def _free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port that was just closed counts as free
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def check_pseudo_terminals() -> DoctorFinding:
    """Check pseudo-terminals, which serial lines and CAN buses without hardware need."""
    try:
        for descriptor in os.openpty():
            os.close(descriptor)
    except AttributeError:
        return DoctorFinding("pseudo-terminals", OK, "not on this system: no serial and CAN loopback", "")
    except OSError as error:
        return DoctorFinding(
            "pseudo-terminals",
            WARNING,
            f"cannot be opened ({error.strerror}): no serial and CAN loopback",
            "mount /dev/pts",
        )
    return DoctorFinding("pseudo-terminals", OK, "can be opened, for serial and CAN loopback")


def verdict(purpose: str, findings: Iterable[DoctorFinding]) -> tuple[str, str]:
    """Return (level, sentence): whether `purpose` will work."""
    named: dict[str, list[str]] = {PROBLEM: [], WARNING: []}
    for finding in findings:
        if finding.level in named:
            named[finding.level].append(finding.check)
    if named[PROBLEM]:
        return PROBLEM, f"{purpose}: will not work ({', '.join(named[PROBLEM])})"
    if named[WARNING]:
        return WARNING, f"{purpose}: will work with limits ({', '.join(named[WARNING])})"
    return OK, f"{purpose}: ready"


def without_optional(findings: Sequence[DoctorFinding]) -> str:
    """Return the missing optional parts, as the end of the verdict; empty when all are installed."""
    absent = [finding.check.removeprefix("extra ") for finding in findings if finding.level == OK and finding.advice]
    return f", without {', '.join(absent)}" if absent else ""
