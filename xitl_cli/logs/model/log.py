"""A log: its tables, the origin of its stamps, and its completeness."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

from xitl_cli.logs.model.table import Table
from xitl_cli.logs.model.text import resolve_name

if TYPE_CHECKING:
    from xitl_cli.logs.model.named_signals import LogSignal

Format = Literal["dataflash", "mcap", "tlog", "ulog", "rosbag1", "rosbag2"]

# boot: since the autopilot started; simulation: since the run began; utc: since 1970; unknown: defined by the writer
Base = Literal["boot", "simulation", "utc", "unknown"]


_MOST_DAMAGE = 1000
_LONGEST_UPTIME_NS = 40 * 86_400 * 1_000_000_000


@dataclass(frozen=True, slots=True)
class Damage:
    """A place in a file that could not be read."""

    place: int
    """Byte offset."""
    lost: int
    """Bytes."""
    why: str
    """A clause, such as "no record begins here"."""


@dataclass(frozen=True, slots=True)
class LogHealth:
    """Completeness of a log. Reports show every count that is not 0."""

    size_bytes: int
    records: int
    damaged: int = 0
    damage: tuple[Damage, ...] = ()
    """At most 1000 places; `damaged` counts all."""
    lost_bytes: int = 0
    suspect: int = 0
    """Records that were kept although the data after them is damaged."""
    truncated_bytes: int = 0
    """Bytes of a last record that was cut off."""
    unclosed: bool = False
    """The writer did not finish the file (an MCAP without its index)."""
    back_in_time: int = 0
    """Rows with an earlier stamp than the previous row of their type."""
    replaced_stamps: int = 0
    """Rows with an impossible time, which get the stamp of the previous row."""
    redefined: int = 0
    """Types with two different descriptions."""
    undecoded: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    """Rows that cannot be decoded, by type or topic, with the reason."""

    gaps: tuple[str, ...] = ()
    """A sentence for each gap: files of a split recording that are missing."""

    @property
    def degraded(self) -> bool:
        """Whether written data is missing or in doubt."""
        doubts = self.damaged, self.lost_bytes, self.suspect, self.truncated_bytes, self.unclosed, self.replaced_stamps
        if self.gaps:
            return True
        return any(doubts)

    def as_json(self) -> dict[str, Any]:
        undecoded = {name: {"rows": rows, "reason": why} for name, (rows, why) in self.undecoded.items()}
        damage = [asdict(place) for place in self.damage]
        counts = {count.name: getattr(self, count.name) for count in fields(self)}
        return {"degraded": self.degraded, **counts, "undecoded": undecoded, "damage": damage}


@dataclass(slots=True)
class Losses:
    """Losses noted while a file is read; the counts are those of `LogHealth`."""

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

    def health(self, size_bytes: int, records: int, **counts: Any) -> LogHealth:
        """These losses as LogHealth. counts: further fields of LogHealth that the reader knows."""
        losses = {loss.name: getattr(self, loss.name) for loss in fields(self)}
        return LogHealth(size_bytes, records, **{**losses, "damage": tuple(self.damage), **counts})


@dataclass(frozen=True, slots=True)
class LogFile:
    """A file of a log."""

    path: Path
    from_ns: int = 0
    """Stamp of its repeated messages."""
    repeated: Mapping[str, int] = field(default_factory=dict)
    """Messages with this stamp at the beginning of each topic that earlier files of the log have too."""


class Log(ABC):
    """An open log. Close it, or use it in a `with`; its tables cannot be read afterwards.

        with xitl.open_log("flight.bin") as log:
            list(log)  # names of messages or topics
            log["ATT"]["Roll"]  # (N,) degrees

    path, format: path and format of the file.
    """

    path: Path
    format: Format

    @property
    @abstractmethod
    def base(self) -> Base:
        """Event from which its stamps count."""

    @property
    @abstractmethod
    def tables(self) -> Mapping[str, Table]:
        """Tables by name of message or topic, sorted by name; none is empty."""

    @property
    def rowless(self) -> Collection[str]:
        """Messages or topics that the log describes but has no row of."""
        return ()

    @property
    @abstractmethod
    def span_ns(self) -> tuple[int, int] | None:
        """Earliest and latest stamp; None without a stamped row. Only the time column is read."""

    @property
    @abstractmethod
    def health(self) -> LogHealth: ...

    @property
    @abstractmethod
    def facts(self) -> Mapping[str, str]:
        """Facts that the format itself contains (library, profile, seed …), for `xitl logs info`."""

    @property
    def files(self) -> tuple[LogFile, ...]:
        """Its files in order: several for a split recording."""
        return (LogFile(self.path),)

    @property
    def vessels(self) -> tuple[str, ...]:
        """Names of the vessels if it has several: the topics of each begin with its name."""
        return ()

    @property
    def vessel(self) -> str:
        """The vessel that was selected when opening the log: its topics have no prefix, and the others are omitted."""
        return ""

    @property
    def closed(self) -> bool:
        """Whether its writer finished the file; True for a format without an end mark."""
        return True

    @property
    def of_topics(self) -> bool:
        """Whether its tables are topics, as in a recording or a bag: a topic without a table was not recorded."""
        return self.format in ("mcap", "rosbag1", "rosbag2")

    def attachment(self, name: str) -> bytes | None:
        """The first file of this name inside the log; None if there is none, or if it is incomplete."""
        return None

    def payloads(self, topic: str) -> Iterator[bytes]:
        """Messages of a topic as they are stored; empty for a format without topics."""
        return iter(())

    @abstractmethod
    def close(self) -> None: ...

    def __getitem__(self, name: str) -> Table:
        """The table of a message or topic; case does not matter. Raises UnknownNameError."""
        topic, _, message = name.rpartition(":")
        if topic in self.tables and f"{topic}:{message.upper()}" in self.tables:  # in frames of a recording
            return self.tables[f"{topic}:{message.upper()}"]
        return self.tables[
            resolve_name(name, self.tables, f"{self.path}: has no message", "`xitl logs info` lists them")
        ]

    def signal(self, text: str, *, raw: bool = False) -> LogSignal:
        """Values of a name or an expression: `ATT.Roll`, `hypot(XKF1[0].VN, XKF1[0].VE)`.

        Its `stamp_ns`, `time_s` and `values` are (N,). `unit` is "" if it is unknown. Names are as for `xitl logs
        plot`. model/named_signals.py describes the alignment of several messages on one time, expressions/evaluation.py
        the functions. raw: use the values as they are stored. Raises LogError.
        """
        from xitl_cli.logs.model.named_signals import find_signal

        return find_signal(self, text, raw=raw)

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __contains__(self, name: object) -> bool:
        return name in self.tables

    def __len__(self) -> int:
        """Number of tables."""
        return len(self.tables)

    def frame_tables(self, topic: str) -> Mapping[str, Table]:
        """The messages in the raw MAVLink frames of a topic, by "topic:MESSAGE"; only recordings have them."""
        raise KeyError(topic)

    @property
    def zero_ns(self) -> int:
        """The stamp from which seconds count: the log's own zero, or its first row if that zero is years earlier."""
        if self.span_ns is None:
            return 0
        first = self.span_ns[0]
        return first if self.base in ("utc", "unknown") or not 0 <= first <= _LONGEST_UPTIME_NS else 0

    @property
    def zero_in_words(self) -> str:
        """The event at second 0, as words after "seconds since"."""
        if self.span_ns is not None and self.zero_ns:
            return "the first row"
        return {"boot": "the autopilot started", "simulation": "the run began"}.get(self.base, "the first row")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_Result = TypeVar("_Result")


def once_per_log(read: Callable[[Log], _Result]) -> Callable[[Log], _Result]:
    """Let a reader read a log once: the log keeps the result for other callers, which must not change it."""

    @wraps(read)
    def kept(log: Log) -> _Result:
        results = vars(log).setdefault("results", {})
        if read not in results:
            results[read] = read(log)
        result: _Result = results[read]
        return result

    return kept


class LogView(Log):
    """A modified view of a log: everything that is not overridden is as in `inner`."""

    def __init__(self, inner: Log) -> None:
        self.inner = inner
        self.path, self.format = inner.path, inner.format

    @property
    def base(self) -> Base:
        return self.inner.base

    @property
    def tables(self) -> Mapping[str, Table]:
        return self.inner.tables

    @property
    def rowless(self) -> Collection[str]:
        return self.inner.rowless

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self.inner.span_ns

    @property
    def health(self) -> LogHealth:
        return self.inner.health

    @property
    def facts(self) -> Mapping[str, str]:
        return self.inner.facts

    @property
    def files(self) -> tuple[LogFile, ...]:
        return self.inner.files

    @property
    def vessels(self) -> tuple[str, ...]:
        return self.inner.vessels

    @property
    def vessel(self) -> str:
        return self.inner.vessel

    @property
    def closed(self) -> bool:
        return self.inner.closed

    def attachment(self, name: str) -> bytes | None:
        return self.inner.attachment(name)

    def payloads(self, topic: str) -> Iterator[bytes]:
        return self.inner.payloads(topic)

    def frame_tables(self, topic: str) -> Mapping[str, Table]:
        return self.inner.frame_tables(topic)

    def close(self) -> None:
        self.inner.close()
