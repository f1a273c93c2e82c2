"""Tide and tidal stream as data."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.environment.constituents import CONSTITUENTS
from sim_core.keys import (
    Bounds,
    Direction,
    Items,
    NonNegative,
    Positive,
    Specification,
    SpecificationError,
    ValueProblem,
)


def instant_utc(text: str) -> datetime:
    """Return an instant of ISO 8601 text. Text without a time zone is UTC. Raises ValueError."""
    instant = datetime.fromisoformat(text)
    return instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)


def problem_of_instant(value: object) -> str | None:
    """Return the problem of an instant, like `Bounds.problem`."""
    try:
        if isinstance(value, str):
            instant_utc(value)
            return None
    except (ValueError, OverflowError):
        pass
    return "is not a date and time; write a UTC date and time, such as 2026-03-01T06:00:00Z"


def problem_of_time(value: object) -> str | None:
    """Return the problem of a table's time, like `Bounds.problem`."""
    if isinstance(value, str):
        return problem_of_instant(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return "is not a time; write seconds since the start, or UTC such as 2026-03-01T06:00:00Z"
    return None


Time = Annotated[float | str, ValueProblem(problem_of_time)]
Name = Annotated[str, "name at NOAA's stations, such as M2; another name needs speed_degph"]
Speed = Annotated[Positive | None, "angular speed of a constituent with another name; null: from the table"]
GREENWICH = "Greenwich phase lag g; with speed_degph: lag behind the start of the run"


@dataclass(frozen=True, slots=True)
class ConstituentSpec(Specification):
    """A harmonic constituent of the level."""

    name: Name
    amplitude_m: NonNegative
    phase_deg: Annotated[Direction, GREENWICH]
    speed_degph: Speed = None

    def check(self) -> None:
        _check_speed(self.name, self.speed_degph)


@dataclass(frozen=True, slots=True)
class StreamConstituentSpec(Specification):
    """A harmonic constituent of the stream, positive with the flood."""

    name: Name
    amplitude_mps: NonNegative
    phase_deg: Annotated[Direction, GREENWICH]
    speed_degph: Speed = None

    def check(self) -> None:
        _check_speed(self.name, self.speed_degph)


def _check_speed(name: str, speed_degph: float | None) -> None:
    if name in CONSTITUENTS and speed_degph is not None:
        raise SpecificationError(
            ("speed_degph",), f"= {speed_degph:g} is redundant, because the speed of {name} is known; leave it out"
        )
    if name not in CONSTITUENTS and speed_degph is None:
        close = difflib.get_close_matches(name.upper(), CONSTITUENTS, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise SpecificationError(
            ("name",), f"= {name} is not a known constituent; {hint}use {', '.join(CONSTITUENTS)}, or add speed_degph"
        )


def _check_names(constituents: Sequence[ConstituentSpec | StreamConstituentSpec]) -> None:
    names = [constituent.name for constituent in constituents]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise SpecificationError(
                ("constituents", number, "name"), f"= {name} is given twice; leave out one of them"
            )


def _need_start(constituents: Sequence[ConstituentSpec | StreamConstituentSpec]) -> bool:
    return any(constituent.speed_degph is None for constituent in constituents)


@dataclass(frozen=True, slots=True)
class TideSpec(Specification):
    """Height of the tide above the mean level: a sum of harmonic constituents, or a table.

    A table is interpolated by piecewise cubics without overshoot (Fritsch and Carlson 1980). High and low waters of a
    table are highest and lowest levels of the curve.
    """

    constituents: tuple[ConstituentSpec, ...] = ()
    table: Annotated[
        tuple[tuple[Time, float], ...],
        Items(0, 10_000, "the days of the run"),
        "a list of [time, height], in s since the start or UTC, and in m",
    ] = ()
    file: Annotated[
        str | None, "CSV file with the columns time and height of a table; a path relative to the profile"
    ] = None

    def check(self) -> None:
        if bool(self.constituents) == bool(self.table):
            problem = "has constituents and a table" if self.table else "is empty"
            raise SpecificationError((), f"{problem}; give either constituents, or a table or file")
        _check_names(self.constituents)
        if not self.table:
            return
        if len(self.table) < 2:
            raise SpecificationError(("table",), "has a single row; give at least 2")
        utc = isinstance(self.table[0][0], str)
        for number, (before, after) in enumerate(zip(self.table, self.table[1:], strict=False), start=1):
            if isinstance(after[0], str) != utc:
                other = "seconds" if utc else "UTC"
                raise SpecificationError(
                    ("table", number, 0), f"= {after[0]} is in {other}, unlike row 0; use the same"
                )
            if not _seconds(after[0]) > _seconds(before[0]):
                times = [time if isinstance(time, str) else f"{time:g}" for time in (after[0], before[0])]
                raise SpecificationError(
                    ("table", number, 0), f"= {times[0]} is not after {times[1]}; sort the rows by time"
                )

    @property
    def needs_start(self) -> bool:
        """Whether the height depends on the UTC of the start."""
        return _need_start(self.constituents) or any(isinstance(time, str) for time, _ in self.table)

    def span_s(self, start_utc: str | None) -> tuple[float, float] | None:
        """Return the first and the last time of the table, in s since the start; None without a table."""
        if not self.table:
            return None
        first_s, last_s = (table_time_s(self.table[row][0], start_utc) for row in (0, -1))
        return first_s, last_s


def _seconds(time: float | str) -> float:
    return instant_utc(time).timestamp() if isinstance(time, str) else time


def table_time_s(time: float | str, start_utc: str | None) -> float:
    """Return the time of a table's row, in s since the start."""
    if not isinstance(time, str):
        return float(time)
    assert start_utc is not None
    return (instant_utc(time) - instant_utc(start_utc)).total_seconds()


@dataclass(frozen=True, slots=True)
class TidalStreamSpec(Specification):
    """A current to and fro with the tide: it follows the level of `water.tide`, or has its own constituents.

    In a standing wave, the stream follows the rate of the level: slack water is at high and low water. In a progressive
    wave, it follows the level: the flood is strongest at high water.
    """

    flood_deg: Annotated[Direction, "direction towards which the flood flows"]
    ebb_deg: Annotated[Direction | None, "direction towards which the ebb flows; null: against the flood"] = None
    follows: Annotated[Literal["level_rate", "level"], "standing wave, or progressive wave"] = "level_rate"
    peak_mps: Annotated[
        Annotated[float, Bounds(at_least=0, at_most=20)] | None,
        "speed at the largest level, or rate, that the constituents or the table can reach (springs)",
    ] = None
    lag_min: Annotated[float, Bounds(at_least=-1440, at_most=1440), "delay of the stream behind the level"] = 0.0
    constituents: Annotated[
        tuple[StreamConstituentSpec, ...], "in place of peak_mps: constituents of the stream along the flood"
    ] = ()

    def check(self) -> None:
        if (self.peak_mps is None) != bool(self.constituents):
            problem = "is missing" if self.peak_mps is None else "is given with constituents"
            raise SpecificationError(("peak_mps",), f"{problem}; give either peak_mps or constituents")
        _check_names(self.constituents)
        if self.constituents and self.lag_min:
            raise SpecificationError(
                ("lag_min",), f"= {self.lag_min:g} shifts only a stream that follows the level; change phase_deg"
            )

    @property
    def needs_start(self) -> bool:
        """Whether the stream's own constituents depend on the UTC of the start."""
        return _need_start(self.constituents)
