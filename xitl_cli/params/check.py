"""How a live vehicle stands to the parameters that it should have."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from agent.wire import dialect
from xitl_cli.params.renames import Rename, other_name
from xitl_cli.params.text import same
from xitl_cli.params.vehicle import Vehicle

NEAREST = 3
_STAGES = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}  # FIRMWARE_VERSION_TYPE
_VEHICLES = {10: "Rover", 11: "Rover (boat)"}


@dataclass(frozen=True, slots=True)
class Differs:
    """A parameter that the vehicle has at another value."""

    name: str
    wanted: float
    kept: float


@dataclass(frozen=True, slots=True)
class Absent:
    """A name that this version does not have, with the nearest that it has.

    `rename` when it has the parameter by another name; `kept` is then the value there. `behind` names a parameter that
    makes it appear, after a restart.
    """

    name: str
    wanted: float
    nearest: tuple[str, ...] = ()
    rename: Rename | None = None
    kept: float | None = None
    behind: str = ""

    def sentence(self, shown: Callable[[float], str]) -> str:
        """Why it is not there, and what to do."""
        if self.rename is not None and self.kept is not None:
            note = f", {self.rename.note}" if self.rename.note else ""
            since = f"{self.rename.new} since {self.rename.version}{note}"
            return f"this version has it as {self.nearest[0]} = {shown(self.kept)} ({since})"
        if self.behind:
            return f"appears after a restart with {self.behind} on"
        return f"this version has none; nearest: {', '.join(self.nearest)}" if self.nearest else "this version has none"


@dataclass(frozen=True, slots=True)
class Findings:
    """`same` parameters are as they should be."""

    same: int = 0
    differs: tuple[Differs, ...] = ()
    absent: tuple[Absent, ...] = field(default=())

    @property
    def fine(self) -> bool:
        """Whether all is as it should be."""
        return not (self.differs or self.absent)


# What ArduPilot hides until the other is on and it has restarted (its AP_PARAM_FLAG_ENABLE).
_BEHIND = (
    ("SCR_SDEV", "SCR_SDEV_EN"),
    ("SCR_", "SCR_ENABLE"),
    ("EAHRS_", "EAHRS_TYPE"),
    ("FENCE_", "FENCE_ENABLE"),
    ("COMPASS_", "COMPASS_ENABLE"),
    ("EK3_", "EK3_ENABLE"),
)


def findings(wanted: Mapping[str, float], present: Mapping[str, float]) -> Findings:
    """Hold what should be against all that the vehicle has."""
    alike = 0
    differs: list[Differs] = []
    absent: list[Absent] = []
    for name, value in wanted.items():
        kept = present.get(name)
        if kept is None:
            absent.append(_absent(name, value, wanted, present))
        elif same(kept, value):
            alike += 1
        else:
            differs.append(Differs(name, value, kept))
    return Findings(alike, tuple(differs), tuple(absent))


def hidden(name: str, wanted: Mapping[str, float], present: Mapping[str, float]) -> str:
    """The parameter that hides another one on this vehicle as it stands; empty where none does."""
    for prefix, switch in _BEHIND:
        is_off = switch not in present or present[switch] <= 0.0
        comes = wanted.get(switch, 0.0) > 0.0 or switch in present
        siblings = any(other.startswith(prefix) and other != switch for other in present)
        if name.startswith(prefix) and name != switch and comes and (is_off or not siblings):
            return switch
    return ""


def _absent(name: str, value: float, wanted: Mapping[str, float], present: Mapping[str, float]) -> Absent:
    rename = other_name(name, present)
    if rename is not None:
        has = rename.new if rename.old == name else rename.old
        return Absent(name, value, (has,), rename, present[has])
    behind = hidden(name, wanted, present)
    if behind:
        return Absent(name, value, behind=behind)
    return Absent(name, value, tuple(difflib.get_close_matches(name, present, n=NEAREST, cutoff=0.75)))


def firmware(vehicle: Vehicle) -> str:
    """Its kind and version, such as `ArduPilot Rover 4.6.2`; without a version where it does not tell."""
    kind = _VEHICLES.get(vehicle.kind, f"vehicle of MAV_TYPE {vehicle.kind}")
    message = vehicle.request(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    if message is None:
        return f"ArduPilot {kind}"
    number = int(message.flight_sw_version)
    major, minor, patch, stage = number >> 24, number >> 16 & 0xFF, number >> 8 & 0xFF, number & 0xFF
    commit = bytes(message.flight_custom_version).rstrip(b"\0").decode("ascii", "replace")
    also = f" ({commit})" if commit.isalnum() else ""
    return f"ArduPilot {kind} {major}.{minor}.{patch}{_STAGES.get(stage, '')}{also}"
