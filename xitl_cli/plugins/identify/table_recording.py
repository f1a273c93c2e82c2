"""Recordings from tables of comma-separated values, by a map of their columns."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.keys import Items, Specification, SpecificationError
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.recording import QUANTITIES, Floats, Recording, Samples, channel
from xitl_cli.profile.files.yaml_file import read_yaml
from xitl_cli.profile.reader import read_group

_UNITS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0},
    "m/s": {"m/s": 1.0, "kn": 1852.0 / 3600.0},
    "rad": {"rad": 1.0, "deg": np.pi / 180.0},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180.0},
}
"""Units by the unit that they become, with their factors."""
_FACTORS = {unit: factor for units in _UNITS.values() for unit, factor in units.items()}
_KINDS = {"time": "s", "wind_speed": "m/s", "wind_from": "rad"} | {name: unit for name, (unit, _) in QUANTITIES.items()}
_FASTEST_WIND_MPS = 60.0
_BEYOND_FULL = 1.5
_WIND = ("wind_speed", "wind_from")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnSpec(Specification):
    """A column of the table with its unit."""

    column: str
    unit: Literal["s", "ms", "us", "ns", "m", "m/s", "kn", "rad", "deg", "rad/s", "deg/s"]
    reversed: Annotated[bool, "for an axis in the other direction"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandSpec(Specification):
    """A column of a command: (value - neutral) / (full - neutral)."""

    column: str
    neutral: float = 0.0
    full: Annotated[float, "value at full ahead, or at full angle to starboard"] = 1.0
    astern: Annotated[float | None, "value at full astern; null: as far from neutral as `full`"] = None
    dead: Annotated[float, "values this close to neutral are neutral"] = 0.0
    law: Annotated[Literal["speed", "thrust"], "thrust: the value is a thrust, and the speed is its root"] = "speed"

    def check(self) -> None:
        if self.full == self.neutral or self.astern == self.neutral:
            raise SpecificationError(("full",), f"or astern equals neutral ({self.neutral:g}); give the value at full")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnMap(Specification):
    """Which column of a table is which quantity. Yaw is from north, clockwise; sway and yaw_rate are to starboard."""

    time: ColumnSpec
    yaw: ColumnSpec
    north: ColumnSpec | None = None
    east: ColumnSpec | None = None
    vel_north: ColumnSpec | None = None
    vel_east: ColumnSpec | None = None
    yaw_rate: ColumnSpec | None = None
    surge: ColumnSpec | None = None
    sway: ColumnSpec | None = None
    wind_speed: Annotated[ColumnSpec | None, "of the true wind, over ground"] = None
    wind_from: Annotated[ColumnSpec | None, "where the true wind comes from, from north, clockwise"] = None
    commands: Annotated[tuple[CommandSpec, ...], Items(1, 32)]

    def check(self) -> None:
        pairs = (("north", "east"), ("vel_north", "vel_east"), ("surge", "sway"), ("wind_speed", "wind_from"))
        for first, second in pairs:
            if (getattr(self, first) is None) != (getattr(self, second) is None):
                raise SpecificationError((first,), f"and {second} belong together; give both or neither")
        for name, kind in _KINDS.items():
            if (spec := getattr(self, name)) is not None and spec.unit not in _UNITS[kind]:
                known = " or ".join(_UNITS[kind])
                raise SpecificationError((name, "unit"), f"= {spec.unit} is no unit of {name}; write {known}")
        if self.surge is None and self.vel_north is None and self.north is None:
            raise SpecificationError(
                (), "has no motion; give north and east, vel_north and vel_east, or surge and sway"
            )


def read_column_map(path: Path) -> ColumnMap:
    """Raises UserError with file, line and key."""
    return read_group(read_yaml(path, str(path)), ColumnMap, str(path))


def read_table(path: Path, columns: ColumnMap) -> Recording:
    """Read a table. Rows with an empty cell of a quantity are left out for this quantity.

    Raises UserError with file and column, and for a cell with other text than a finite number.
    """
    table = _columns(path)
    time_s = _numbers(path, table, columns.time.column) * _FACTORS[columns.time.unit]
    back = np.flatnonzero(np.diff(time_s) < 0.0)
    if len(back):
        raise UserError(
            f"{path}: column {columns.time.column!r} goes from {time_s[back[0]]:g} s back to {time_s[back[0] + 1]:g} s "
            f"in row {back[0] + 3}; sort the rows by time, and give each run its own file"
        )
    read = {
        name: _samples(path, table, spec, time_s, unwrap=name == "yaw")
        for name in (*QUANTITIES, *_WIND)
        if (spec := getattr(columns, name)) is not None
    }
    channels = {name: channel(own.time_s, own.values) for name, own in read.items() if name in QUANTITIES}
    commands = np.stack([_command(path, table, spec) for spec in columns.commands], axis=1)
    good = np.isfinite(commands).all(axis=1) & (np.diff(time_s, prepend=-np.inf) > 0.0)
    wind = None
    if columns.wind_speed is not None:
        speed, origin = (read[name] for name in _WIND)
        if not 0.0 <= speed.values.min() <= speed.values.max() <= _FASTEST_WIND_MPS:
            raise UserError(
                f"{path}: column {columns.wind_speed.column!r} has speeds from {speed.values.min():g} to "
                f"{speed.values.max():g} m/s; correct the unit or the column of wind_speed"
            )
        # Velocity of the air, north and east, from its speed and the direction that it comes from
        wind_s = speed.time_s
        cos, sin = (np.interp(wind_s, origin.time_s, part) for part in (np.cos(origin.values), np.sin(origin.values)))
        wind = Samples(wind_s, -speed.values * cos), Samples(wind_s, -speed.values * sin)
    return Recording(str(path), channels, time_s[good], commands[good], wind)  # type: ignore[arg-type]


def _samples(path: Path, table: dict[str, list[str]], spec: ColumnSpec, time_s: Floats, *, unwrap: bool) -> Samples:
    values = _numbers(path, table, spec.column) * _FACTORS[spec.unit] * (-1.0 if spec.reversed else 1.0)
    good = np.isfinite(values) & np.isfinite(time_s) & (np.diff(time_s, prepend=-np.inf) > 0.0)
    if np.count_nonzero(good) < 2:
        raise UserError(f"{path}: column {spec.column!r} has {np.count_nonzero(good)} numbers; check the column")
    return Samples(time_s[good], np.unwrap(values[good]) if unwrap else values[good])


def _columns(path: Path) -> dict[str, list[str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (UnicodeDecodeError, csv.Error):
        raise UserError(
            f"{path} is no table of comma-separated values; give a .csv, or a log without --columns"
        ) from None
    if len(rows) < 3:
        raise UserError(f"{path}: has {max(len(rows) - 1, 0)} rows of data; use a table with names in its first row")
    names = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise UserError(f"{path}:{number}: has {len(row)} cells, but the first row has {len(names)}; write as many")
    return {name: list(cells) for name, cells in zip(names, zip(*rows[1:], strict=True), strict=True)}


def _numbers(path: Path, table: dict[str, list[str]], name: str) -> Floats:
    if name not in table:
        raise UserError(f"{path}: has no column {name!r}; its columns are {', '.join(filter(None, table))}")
    numbers = [_number(cell) for cell in table[name]]
    for row, (cell, number) in enumerate(zip(table[name], numbers, strict=True), start=2):
        if cell.strip() and not math.isfinite(number):
            raise UserError(
                f"{path}:{row}: column {name!r} is {cell[:40]!r}; write a finite number, or leave the cell empty where "
                "the quantity has no value"
            )
    return np.array(numbers)


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _command(path: Path, table: dict[str, list[str]], spec: CommandSpec) -> Floats:
    """Return commands in [-1, 1]. Raises UserError if most values are far beyond full."""
    values = _numbers(path, table, spec.column)
    offset = np.where(np.abs(values - spec.neutral) <= spec.dead, 0.0, values - spec.neutral)
    full = spec.full - spec.neutral
    astern = -full if spec.astern is None else spec.astern - spec.neutral
    share = np.where(offset * full >= 0.0, offset / full, -offset / astern)
    if (beyond := np.mean(np.abs(share) > _BEYOND_FULL)) > 0.5:
        raise UserError(
            f"{path}: {100.0 * beyond:.0f} % of column {spec.column!r} are beyond full (median "
            f"{np.nanmedian(values):g}, neutral {spec.neutral:g}, full {spec.full:g}); "
            "correct neutral and full of this command"
        )
    share = np.clip(share, -1.0, 1.0)
    return np.sign(share) * np.sqrt(np.abs(share)) if spec.law == "thrust" else share
