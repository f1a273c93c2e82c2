"""Sets of parameters from a file, the embedded autopilot's defaults or a vehicle; their differences; as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from datetime import UTC, datetime

from agent.fcu.parameters import TABLE
from agent.mavlink.exchange import Target
from agent.mavlink.parameter_rows import Parameter
from agent.mavlink.parameters import same_value
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.params.vehicle import connect
from xitl_cli.profile.files.parameter_files import (
    STATION_SUFFIX,
    SUFFIXES,
    find_parameter_file,
    read_parameter_file,
    station_file_text,
)

DEFAULTS = "defaults"
TABLE_BY_NAME: Mapping[str, Parameter] = {row.name: row for row in TABLE}


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """Named values of a source."""

    source: str
    values: Mapping[str, float]
    complete: bool
    """Missing names do not exist in the source. A file is not complete: it leaves other parameters unchanged."""
    types: Mapping[str, int] = field(default_factory=dict)
    """MAV_PARAM_TYPE by name, for a vehicle."""
    target: Target = (1, 1)
    """System and component, for a vehicle."""

    @property
    def described(self) -> bool:
        """Whether the embedded autopilot's table describes these.

        A vehicle with other names is no embedded autopilot.
        """
        return not self.complete or set(self.values) <= set(TABLE_BY_NAME)


def is_vehicle(source: str) -> bool:
    """Whether the source is a vehicle."""
    return "://" in source


def read_source(source: str, key: bytes | None = None) -> ParameterSet:
    """Return the parameters of a file, a shipped file's name, `defaults` or a vehicle's URL. Raises UserError."""
    if source == DEFAULTS:
        return ParameterSet("defaults", {row.name: float(row.default) for row in TABLE}, complete=True)
    if is_vehicle(source):
        with connect(source, key) as vehicle:
            return ParameterSet(source, vehicle.read_all(), True, dict(vehicle.types), vehicle.target)
    return read_file(source)


def read_file(source: str) -> ParameterSet:
    """Return the parameters of a file (.parm, or QGroundControl's .params) or a shipped file's name.

    Raises UserError.
    """
    try:
        find_parameter_file(source)
    except UserError as error:
        also = "" if source.endswith(SUFFIXES) else "; a vehicle is tcp://host:port or udp://host:port"
        raise UserError(f"{error}{also}") from None
    return ParameterSet(source, read_parameter_file(source), complete=False)


def read_wanted(source: str) -> Mapping[str, float]:
    """Return the parameters of a .parm file, a shipped one or a profile's autopilot. Raises UserError."""
    if source.endswith(SUFFIXES):
        return read_file(source).values
    try:
        return read_file(source).values
    except UserError:
        from xitl_cli.profile import load_profile
        from xitl_cli.profile.files.catalogue import SUFFIXES as PROFILE_SUFFIXES
        from xitl_cli.profile.files.catalogue import is_shipped

        if not source.endswith(PROFILE_SUFFIXES) and not is_shipped(source):
            raise
    profile = load_profile(source)
    autopilot = profile.autopilot
    if profile.vessels is not None:
        autopilots = [vessel.autopilot for vessel in profile.sailed.values() if vessel.autopilot is not None]
        different = {(pilot.parameter_files, tuple(pilot.parameters.items())) for pilot in autopilots}
        if len(different) > 1:
            raise UserError(f"{source}: its vessels have different parameters; give the file of one of them")
        autopilot = next(iter(autopilots), None)
    values: dict[str, float] = {}
    if autopilot is not None:
        for file in autopilot.parameter_files:
            values.update(read_file(file).values)
        values.update(autopilot.parameters)
    if not values:
        raise UserError(f"{source}: its autopilot has no parameters; give a profile with autopilot.parameter_files")
    return values


@dataclass(frozen=True, slots=True)
class ParameterDifference:
    """One parameter on both sides; None when that side has no such parameter."""

    name: str
    one: float | None
    other: float | None


def differences(one: ParameterSet, other: ParameterSet) -> list[ParameterDifference]:
    """Return the differences by name. A name on one side only counts if the other side is complete."""
    rows: list[ParameterDifference] = []
    for name in sorted({*one.values, *other.values}):
        a, b = one.values.get(name), other.values.get(name)
        if a is not None and b is not None:
            if not same_value(a, b):
                rows.append(ParameterDifference(name, a, b))
        elif (other if b is None else one).complete:
            rows.append(ParameterDifference(name, a, b))
    return rows


def format_value(value: float) -> str:
    """Return the shortest decimal that gives this 32-bit float."""
    for digits in (7, 8):
        text = f"{value:.{digits}g}"
        if same_value(float(text), value):
            return text
    return f"{value:.9g}"


def file_text(parameters: ParameterSet, name: str) -> str:
    """Return the content for a file of this name: QGroundControl's columns in .params, NAME value in any other."""
    values, source = parameters.values, parameters.source
    if name.endswith(STATION_SUFFIX):
        return station_file_text(values, parameters.types, parameters.target, source, format_value)
    return parm_text(values, source)


def parm_text(values: Mapping[str, float], source: str, now: datetime | None = None) -> str:
    """Return a .parm file for any ground station: a heading, then NAME value and, if known, the meaning."""
    stamp = (now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    lines = [f"# {len(values)} parameters of {source}, {stamp}"]
    described = set(values) <= set(TABLE_BY_NAME)
    for name, value in values.items():
        line = f"{name:<16} {format_value(value)}"
        if described:
            row = TABLE_BY_NAME[name]
            line = f"{line:<32}# {row.meaning}{f' [{row.unit}]' if row.unit else ''}"
        lines.append(line)
    return "\n".join(lines) + "\n"
