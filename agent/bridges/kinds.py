"""Kinds of bridges by name: those of xitl, and those that other packages register in the group `xitl.bridges`.

xitl's own kinds are in one table, so that an agent without installed packages, such as `xitl-agent.pyz`, has them.
`pyproject.toml` registers the same objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Callable

from agent.entry_points import EntryPoint, ranked_entry_points

if TYPE_CHECKING:
    from agent.bridges.injector import Injector
    from agent.bridges.vehicle_link import VehicleLink

GROUP = "xitl.bridges"
NO_LINK, OPTIONAL_LINK, NEEDED_LINK = "none", "optional", "needed"


class BridgeError(ValueError):
    """Raised for a bridge that is missing or cannot be loaded. The message is one sentence."""


@dataclass(frozen=True)
class BridgeKind:
    """A kind of bridge to an autopilot, under the name of its entry point (group `xitl.bridges`).

    An autopilot has the bridge when its profile says `autopilot.bridge.sensors: NAME`, and an agent when it was started
    with `--sensors NAME`. Its module must run on a board: Python 3.9, imports of `agent` and of the standard library.
    """

    open: Callable[[str, VehicleLink], Injector]
    """`open(url, vehicle)` returns the injector of one autopilot.

    url: `autopilot.bridge.sensor_link`, empty without one. vehicle: the line to the autopilot's MAVLink. Raises
    `agent.bridges.injector.InjectorError`, or TransportError, when it cannot be opened.
    """

    autopilots: tuple[str, ...] = ("ardupilot", "other")
    """Values of `autopilot.kind` that it goes with."""

    sensor_link: str = OPTIONAL_LINK
    """Whether it has a separate line, at `url`: `none`, `optional` or `needed`."""

    sets_time: bool = False
    """Whether it lets the autopilot run in lockstep (`Injector.advance`)."""

    returns_outputs: bool = False
    """Whether the outputs return through it (`Injector.commands` or `pulses`), and not as SERVO_OUTPUT_RAW."""

    truth: bool = False
    """Whether it needs the true motion: `Injector.handle` then gets XITL_TRUTH too."""


def _opens(module: str, name: str) -> Callable[[str, VehicleLink], Injector]:
    """Return a function that imports an injector's module when a bridge is opened."""

    def opened(url: str, vehicle: VehicleLink) -> Injector:
        injector: Injector = getattr(import_module(f"agent.bridges.{module}"), name).open(url, vehicle)
        return injector

    return opened


JSON_WORLD = BridgeKind(
    _opens("json_world", "JsonWorld"), sensor_link=NEEDED_LINK, sets_time=True, returns_outputs=True, truth=True
)
"""The bridge of `autopilot.bridge.world`, which may be there together with one of `autopilot.bridge.sensors`."""
VECTORNAV = BridgeKind(_opens("vectornav", "VectorNav"), ("ardupilot",), NEEDED_LINK)
MICROSTRAIN7 = BridgeKind(_opens("microstrain", "MicroStrain7"), ("ardupilot",), NEEDED_LINK)
HIL = BridgeKind(_opens("hil", "HilMessages"), ("ardupilot",), NO_LINK)
PX4 = BridgeKind(_opens("px4", "Px4Injector"), ("px4",), OPTIONAL_LINK, sets_time=True, returns_outputs=True)

OWN_SENSORS = {"vectornav": VECTORNAV, "microstrain7": MICROSTRAIN7, "hil": HIL, "px4": PX4}


def bridge_kind(name: str) -> BridgeKind:
    """Return the kind of a bridge for `autopilot.bridge.sensors`. Raises BridgeError."""
    if name in OWN_SENSORS:
        return OWN_SENSORS[name]
    entry = _entry_of(name)
    if entry is None:
        raise BridgeError(
            f"{name}: no installed package registers it in {GROUP}; install its package for the Python of the agent, "
            f"or use {', '.join(OWN_SENSORS)}"
        )
    if error := entry.load_error():
        raise BridgeError(error)
    kind = entry.load()
    if not isinstance(kind, BridgeKind):
        raise BridgeError(
            f"{name}: the plug-in of {entry.package} {entry.version} registers {type(kind).__name__} in {GROUP}, which "
            "is not agent.bridges.kinds.BridgeKind; correct it"
        )
    return kind


def package_of_bridge(name: str) -> str:
    """The package of a bridge with its version; empty for one of xitl."""
    entry = None if name in OWN_SENSORS else _entry_of(name)
    return "" if entry is None else f"{entry.package} {entry.version}"


def bridge_kinds(world: str | None, sensors: str | None) -> list[BridgeKind]:
    """Return the kinds for the keys of `autopilot.bridge`. Raises BridgeError."""
    return [JSON_WORLD] * bool(world) + ([bridge_kind(sensors)] if sensors else [])


def _entry_of(name: str) -> EntryPoint | None:
    entries = (entry for entry in ranked_entry_points(GROUP) if entry.group == GROUP and entry.name == name)
    return next(entries, None)
