"""Comparison of a live vehicle with the wanted parameters, including names that changed between versions."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping

from agent.mavlink.commands import version_text
from agent.mavlink.parameters import same_value
from agent.wire import dialect
from sim_core.dataclass import dataclass
from xitl_cli.params.vehicle import VehicleConnection

NEAREST = 3
_VEHICLES = {10: "Rover", 11: "Rover (boat)"}


# -- names that changed between versions of ArduPilot Rover, from its release notes and the conversions in its source,
# which contain old and new names


@dataclass(frozen=True, slots=True)
class ParameterRename:
    """A parameter with a new name since a version."""

    old: str
    new: str
    version: str
    note: str = ""
    """Change of the meaning."""
    values: tuple[tuple[float, float], ...] | None = None
    """Pairs of an old value and the new one of the same meaning; None if every value keeps its meaning."""

    def carried(self, name: str, value: float) -> float | None:
        """Return the value under the other name with the meaning of `value` under `name`; None if it is unknown."""
        if self.values is None:
            return value
        pairs = self.values if name == self.old else [(new, old) for old, new in self.values]
        return dict(pairs).get(value)


def _receivers() -> Iterator[ParameterRename]:
    for number, suffix in ((1, ""), (2, "2")):
        yield ParameterRename(f"GPS_TYPE{suffix}", f"GPS{number}_TYPE", "4.6")
        yield ParameterRename(f"GPS_GNSS_MODE{suffix}", f"GPS{number}_GNSS_MODE", "4.6")
        yield ParameterRename(f"GPS_RATE_MS{suffix}", f"GPS{number}_RATE_MS", "4.6")
        yield ParameterRename(f"GPS_DELAY_MS{suffix}", f"GPS{number}_DELAY_MS", "4.6")
        yield ParameterRename(f"GPS_COM_PORT{suffix}", f"GPS{number}_COM_PORT", "4.6")
        yield ParameterRename(f"GPS_CAN_NODEID{number}", f"GPS{number}_CAN_NODEID", "4.6")
        yield ParameterRename(f"GPS_MB{number}_TYPE", f"GPS{number}_MB_TYPE", "4.6")
        for axis in "XYZ":
            yield ParameterRename(f"GPS_POS{number}_{axis}", f"GPS{number}_POS_{axis}", "4.6")
            yield ParameterRename(f"GPS_MB{number}_OFS_{axis}", f"GPS{number}_MB_OFS_{axis}", "4.6")


_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS", "ADSB")

RENAMES: tuple[ParameterRename, ...] = (
    *_receivers(),
    ParameterRename("COMPASS_TYPEMASK", "COMPASS_DISBLMSK", "4.5"),
    ParameterRename("BRD_SAFETYENABLE", "BRD_SAFETY_DEFLT", "4.4"),
    ParameterRename("SYSID_THISMAV", "MAV_SYSID", "4.7"),
    ParameterRename("SYSID_MYGCS", "MAV_GCS_SYSID", "4.7"),
    ParameterRename("SYSID_ENFORCE", "MAV_OPTIONS", "4.7", "bit 0", values=()),
    ParameterRename("TELEM_DELAY", "MAV_TELEM_DELAY", "4.7"),
    *(ParameterRename(f"SR{port}_{name}", f"MAV{port + 1}_{name}", "4.7") for port in range(7) for name in _STREAMS),
    ParameterRename("ARMING_CHECK", "ARMING_SKIPCHK", "4.7", "it lists the skipped checks: 1 becomes 0", ((1.0, 0.0),)),
)


def other_name(name: str, present: Mapping[str, float]) -> ParameterRename | None:
    """Return the rename by which `present` has the parameter under another name; None if there is none."""
    for rename in RENAMES:
        if (rename.old == name and rename.new in present) or (rename.new == name and rename.old in present):
            return rename
    return None


def in_names_of(present: Mapping[str, float], wanted: Mapping[str, float]) -> dict[str, float]:
    """Return `wanted` in the names and values of the version of `present`.

    A parameter without a known counterpart of its value keeps its name.
    """
    renamed: dict[str, float] = {}
    for name, value in wanted.items():
        rename = None if name in present else other_name(name, present)
        carried = None if rename is None else rename.carried(name, value)
        if rename is None or carried is None:
            renamed[name] = value
        else:
            renamed[rename.new if name == rename.old else rename.old] = carried
    return renamed


# -- comparison of present and wanted parameters


@dataclass(frozen=True, slots=True)
class DifferingParameter:
    """A parameter with another value on the vehicle."""

    name: str
    wanted: float
    kept: float


@dataclass(frozen=True, slots=True)
class AbsentParameter:
    """A name that this version does not have."""

    name: str
    wanted: float
    nearest: tuple[str, ...] = ()
    """Most similar names that it has."""
    rename: ParameterRename | None = None
    """Rename, if it has the parameter by another name."""
    kept: float | None = None
    """Value under the other name."""
    behind: str = ""
    """Parameter that enables it, after a restart."""

    def sentence(self, format_value: Callable[[float], str]) -> str:
        """Return a sentence with the reason and the fix."""
        if self.rename is not None and self.kept is not None:
            note = f", {self.rename.note}" if self.rename.note else ""
            since = f"{self.rename.new} since {self.rename.version}{note}"
            return f"this version has it as {self.nearest[0]} = {format_value(self.kept)} ({since})"
        if self.behind:
            return f"it appears after a restart with {self.behind} on"
        nearest = f"; similar names: {', '.join(self.nearest)}" if self.nearest else ""
        return f"this version does not have it{nearest}"


@dataclass(frozen=True, slots=True)
class ParameterFindings:
    """Result of a comparison."""

    same: int = 0
    """Number of parameters with the wanted value."""
    differs: tuple[DifferingParameter, ...] = ()
    absent: tuple[AbsentParameter, ...] = ()

    @property
    def fine(self) -> bool:
        """True if all parameters have the wanted values."""
        return not (self.differs or self.absent)


# Parameters that ArduPilot hides until the other is on and it has restarted (its AP_PARAM_FLAG_ENABLE).
_BEHIND = (
    ("SCR_SDEV", "SCR_SDEV_EN"),
    ("SCR_", "SCR_ENABLE"),
    ("EAHRS_", "EAHRS_TYPE"),
    ("FENCE_", "FENCE_ENABLE"),
    ("COMPASS_", "COMPASS_ENABLE"),
    ("EK3_", "EK3_ENABLE"),
)


def check_parameters(wanted: Mapping[str, float], present: Mapping[str, float]) -> ParameterFindings:
    """Compare the wanted parameters with all parameters of the vehicle."""
    alike = 0
    differs: list[DifferingParameter] = []
    absent: list[AbsentParameter] = []
    for name, value in wanted.items():
        kept = present.get(name)
        if kept is None:
            absent.append(absent_parameter(name, value, wanted, present))
        elif same_value(kept, value):
            alike += 1
        else:
            differs.append(DifferingParameter(name, value, kept))
    return ParameterFindings(alike, tuple(differs), tuple(absent))


def hiding_parameter(name: str, wanted: Mapping[str, float], present: Mapping[str, float]) -> str:
    """Return the parameter that presently hides another one on this vehicle; empty if there is none."""
    for prefix, switch in _BEHIND:
        is_off = switch not in present or present[switch] <= 0.0
        comes = wanted.get(switch, 0.0) > 0.0 or switch in present
        siblings = any(other.startswith(prefix) and other != switch for other in present)
        if name.startswith(prefix) and name != switch and comes and (is_off or not siblings):
            return switch
    return ""


def absent_parameter(
    name: str, value: float, wanted: Mapping[str, float], present: Mapping[str, float]
) -> AbsentParameter:
    """Return why the vehicle has no parameter of this name. `wanted`: all wanted ones. `present`: all existing ones."""
    rename = other_name(name, present)
    if rename is not None:
        has = rename.new if rename.old == name else rename.old
        return AbsentParameter(name, value, (has,), rename, present[has])
    behind = hiding_parameter(name, wanted, present)
    if behind:
        return AbsentParameter(name, value, behind=behind)
    return AbsentParameter(name, value, tuple(difflib.get_close_matches(name, present, n=NEAREST, cutoff=0.75)))


def firmware_name(vehicle: VehicleConnection) -> str:
    """Return make, type and version, such as `ArduPilot Rover 4.6.2`; without a version if it is unknown."""
    make = "PX4" if vehicle.px4 else "ArduPilot"
    kind = _VEHICLES.get(vehicle.kind, f"vehicle of MAV_TYPE {vehicle.kind}")
    message = vehicle.request_message(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    if message is None:
        return f"{make} {kind}"
    return f"{make} {kind} {version_text(message)}"
