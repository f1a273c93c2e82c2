"""Plug-ins: objects that installed packages register as entry points in the groups `xitl.*`.

    load("xitl.commands", "logs")       the object, or PluginError with one sentence
    load_all("xitl.commands")           every object that can be loaded, by name
    plugins()                           all of them with their package and load error, for `xitl plugins`

xitl's own plug-ins register in the same way, in its `pyproject.toml`. A plug-in that cannot be loaded never breaks
xitl: its error appears where its name is asked for, in `xitl plugins` and in `xitl doctor`.

The entry points are read once per process, at the first question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import PurePath
from typing import Any

from agent.entry_points import OWN_PACKAGE, EntryPoint, ranked_entry_points
from xitl_cli.errors import UserError

COMMANDS = "xitl.commands"
NODES = "xitl.nodes"
SENSORS = "xitl.sensors"
DETECTORS = "xitl.detectors"
DRIVERS = "xitl.drivers"
BRIDGES = "xitl.bridges"
ACTUATORS = "xitl.actuators"
LOG_ANALYSES = "xitl.log_analyses"
LOG_FORMATS = "xitl.log_formats"
LIVE_OUTPUTS = "xitl.live_outputs"
LOG_EXPORTS = "xitl.log_exports"
LOG_REPLAYS = "xitl.log_replays"
BOARDS = "xitl.boards"
DOCTOR_CHECKS = "xitl.doctor_checks"
PROFILES = "xitl.profiles"

GROUPS = {
    COMMANDS: "a command, or a group of commands: `xitl_cli.plugin.Command`",
    NODES: "nodes of a run with profile keys and topics, such as a sensor: `xitl_cli.plugin.NodeKind`",
    SENSORS: "sensors with their own keys in `sensors` of a profile: `xitl_cli.plugin.NodeKind`",
    DETECTORS: "detectors of objects in images: a function from a `CameraSpec` and a `Lens` to an object with "
    "`detect(image)`",
    DRIVERS: "drivers, which command an autopilot in a run: `xitl_cli.plugin.DriverKind`",
    BRIDGES: "bridges, which feed an autopilot and read its outputs: `agent.bridges.kinds.BridgeKind`",
    ACTUATORS: "actuators of a vessel, such as a sail: keys that derive from `sim_core.vessel.actuators.ActuatorSpec`",
    LOG_ANALYSES: "analyses of `xitl logs analyze`: a function from a `Log` to a `Section`, or to None",
    LOG_FORMATS: "formats of logs beyond those of xitl: `xitl_cli.logs.formats.added.LogFormat`",
    LIVE_OUTPUTS: "live outputs of a run, as a function from profiles to "
    "`xitl_cli.run.core.live_output.LiveOutput`, or `xitl_cli.plugin.LiveOutputKind`",
    LOG_EXPORTS: "formats of `xitl logs export`, as a function that writes a log",
    LOG_REPLAYS: "replays in the page of `xitl logs analyze`, as a function from a report to "
    "`xitl_cli.logs.report.page.Replay`",
    BOARDS: "kinds of boards, by the prefix of their names: a function from a name to `xitl_cli.deploy.ssh.Board`",
    DOCTOR_CHECKS: "checks of `xitl doctor`: a function that returns `agent.board.doctor.DoctorFinding` objects",
    PROFILES: "folders of profiles: a `Path`, searched after the shipped profiles",
}


class PluginError(UserError):
    """A plug-in is missing or cannot be loaded. The message is one sentence with what to do."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """A registered object."""

    group: str
    name: str
    target: str
    """`module:object`."""
    package: str
    version: str
    error: str = ""
    """Reason why it cannot be used, empty when it can."""


def package_of(group: str, name: str) -> str:
    """The package that registers `name`, with its version; empty when there is none."""
    entry = _first_of_each_name(group).get(name)
    return "" if entry is None else f"{entry.package} {entry.version}"


def names(group: str) -> list[str]:
    """Return the names in a group, sorted, those of xitl's plug-ins first. Loads nothing."""
    return list(_first_of_each_name(group))


def load(group: str, name: str) -> Any:
    """Return the object that is registered as `name`. Raises PluginError when it is missing or cannot be loaded."""
    entry = _first_of_each_name(group).get(name)
    if entry is None:
        raise PluginError(
            f"{name}: no installed package registers it in {group}; install its package, or correct the name "
            "(`xitl plugins` lists the installed ones)"
        )
    return _loaded(entry)


def guarded(group: str, name: str, call: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a plug-in's function. An exception of another package becomes PluginError.

    UserError, LogError and OSError are passed on, and so are all exceptions of xitl's own plug-ins.
    """
    try:
        return call(*arguments)
    except (UserError, OSError):
        raise
    except Exception as problem:
        from xitl_cli.logs.model.errors import LogError

        package = package_of(group, name)
        if package.split()[0] == OWN_PACKAGE or isinstance(problem, LogError):
            raise
        raise PluginError(f"{name}: the plug-in of {package} failed ({failure_text(problem)}); correct it") from problem


def failure_text(problem: Exception) -> str:
    """Return an exception of a plug-in with its file and line: `ZeroDivisionError: division by zero, radar.py:12`."""
    import traceback

    last = traceback.extract_tb(problem.__traceback__)[-1]
    path = PurePath(last.filename)
    file = f"{path.parent.name}/{path.name}" if path.name == "__init__.py" else path.name
    reason = " ".join(f"{type(problem).__name__}: {problem}".split()).removesuffix(":")
    return f"{reason}, {file}:{last.lineno}"


def load_all(group: str) -> Iterator[tuple[str, Any]]:
    """Yield each object of a group that can be loaded, with its name."""
    for name, entry in _first_of_each_name(group).items():
        try:
            yield name, _loaded(entry)
        except PluginError:
            continue


def plugins() -> list[Plugin]:
    """Return all plug-ins, with the error of each that cannot be used. Loads every plug-in."""
    rows = []
    for group in GROUPS:
        chosen = _first_of_each_name(group)
        for entry in _entries(group):
            first = chosen[entry.name]
            if entry is not first:
                error = f"the name is taken by {first.package}; rename one of them, or uninstall its package"
            else:
                error = entry.load_error()
            rows.append(Plugin(group, entry.name, entry.target, entry.package, entry.version, error))
    return rows


def rescan() -> None:
    """Forget the entry points, so that the next question reads them again: after a change of `sys.path`."""
    _registered.cache_clear()
    _first_of_each_name.cache_clear()


@cache
def _registered() -> tuple[EntryPoint, ...]:
    """Entry points of all groups: xitl's own first, then by package and name."""
    return ranked_entry_points("xitl.")


def _entries(group: str) -> Iterator[EntryPoint]:
    return (entry for entry in _registered() if entry.group == group)


@cache
def _first_of_each_name(group: str) -> dict[str, EntryPoint]:
    """Return one entry for each name. If two packages register a name, the first of `_entries` counts."""
    chosen: dict[str, EntryPoint] = {}
    for entry in _entries(group):
        chosen.setdefault(entry.name, entry)
    return chosen


def _loaded(entry: EntryPoint) -> Any:
    if error := entry.load_error():
        raise PluginError(error)
    return entry.load()
