"""A log: its tables, what its stamps count from, and how whole it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, Protocol

from xitl_cli.logs.table import Table

Format = Literal["dataflash", "mcap", "tlog"]

# boot: since the autopilot started; simulation: since the run began; utc: since 1970; unknown: as the writer pleased
Base = Literal["boot", "simulation", "utc", "unknown"]


_MOST_DAMAGE = 1000


@dataclass(frozen=True, slots=True)
class Damage:
    """`lost` bytes at `place` could not be read, and why, in words that end a sentence: "no record begins here"."""

    place: int
    lost: int
    why: str


@dataclass(frozen=True, slots=True)
class Health:
    """How whole a log is. Every count that is not 0 is told to the user.

    suspect: records that were kept although what follows them is damaged. truncated_bytes: of a last record that was
    cut off. unclosed: the writer never finished the file (an MCAP without its index). back_in_time: rows stamped
    earlier than the one before of their type. replaced_stamps: rows with a time that cannot be, which are stamped as
    the row before them. redefined: types described twice, differently. undecoded: rows by type or topic that are there
    and cannot be read, with the reason. damage lists at most 1000 places; damaged counts all.
    """

    size_bytes: int
    records: int
    damaged: int = 0
    damage: tuple[Damage, ...] = ()
    lost_bytes: int = 0
    suspect: int = 0
    truncated_bytes: int = 0
    unclosed: bool = False
    back_in_time: int = 0
    replaced_stamps: int = 0
    redefined: int = 0
    undecoded: Mapping[str, tuple[int, str]] = field(default_factory=dict)

    @property
    def degraded(self) -> bool:
        """Whether something that was written is missing or in doubt."""
        doubts = self.damaged, self.lost_bytes, self.suspect, self.truncated_bytes, self.unclosed, self.replaced_stamps
        return any(doubts)

    def as_json(self) -> dict[str, Any]:
        undecoded = {name: {"rows": rows, "reason": why} for name, (rows, why) in self.undecoded.items()}
        damage = [asdict(each) for each in self.damage]
        counts = {each.name: getattr(self, each.name) for each in fields(self)}
        return {"degraded": self.degraded, **counts, "undecoded": undecoded, "damage": damage}


@dataclass(slots=True)
class Losses:
    """What of a file could not be read, noted while it is read; the counts are those of `Health`."""

    damaged: int = 0
    damage: list[Damage] = field(default_factory=list)
    lost_bytes: int = 0
    suspect: int = 0
    truncated_bytes: int = 0

    def note(self, place: int, lost: int, why: str) -> None:
        self.damaged += 1
        self.lost_bytes += lost
        if len(self.damage) < _MOST_DAMAGE:
            self.damage.append(Damage(place, lost, why))

    def health(
        self,
        size_bytes: int,
        records: int,
        *,
        unclosed: bool = False,
        back_in_time: int = 0,
        replaced_stamps: int = 0,
        redefined: int = 0,
        undecoded: Mapping[str, tuple[int, str]],
    ) -> Health:
        """With what the reader has counted besides."""
        return Health(
            size_bytes,
            records,
            self.damaged,
            tuple(self.damage),
            self.lost_bytes,
            self.suspect,
            self.truncated_bytes,
            unclosed,
            back_in_time,
            replaced_stamps,
            redefined,
            undecoded,
        )


class Log(Protocol):
    """An open log. Close it, or use it in a `with`; its tables cannot be read afterwards.

    facts: what the format itself says (library, profile, seed …), for `xitl logs info`.
    """

    @property
    def path(self) -> Path: ...

    @property
    def format(self) -> Format: ...

    @property
    def base(self) -> Base: ...

    @property
    def tables(self) -> Mapping[str, Table]:
        """By name of message or topic, sorted by name; none is empty."""
        ...

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Earliest and latest stamp; None without a stamped row. Cheap: it reads no column but time."""
        ...

    @property
    def health(self) -> Health: ...

    @property
    def facts(self) -> Mapping[str, str]: ...

    def close(self) -> None: ...

    def __enter__(self) -> Log: ...

    def __exit__(self, *_: object) -> None: ...
