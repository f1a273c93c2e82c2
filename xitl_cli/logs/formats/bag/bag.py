"""Common base of all bags: topics as tables, with the times of reception as stamps."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from xitl_cli.logs.formats.mcap.cdr import CdrDecoder, Ros1Decoder
from xitl_cli.logs.formats.mcap.container import PayloadBatch, RecordingLosses
from xitl_cli.logs.formats.mcap.file import unit_from_name
from xitl_cli.logs.formats.mcap.table import Decoder, MemoryBudget, TopicTable, UndecodableError, doubtful_rows
from xitl_cli.logs.model.log import Base, Log, LogHealth
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.model.vessel_bag import namespaces_of_vessels

YEAR_2000_NS = 946_684_800 * 1_000_000_000


@dataclass(frozen=True, slots=True)
class BagTopic:
    """One topic of one type."""

    name: str
    type_name: str
    """Such as "sensor_msgs/msg/Imu" or "sensor_msgs/Imu"."""
    definition: str
    """Text of the definition, "" if the bag has none."""
    form: str
    """One of "cdr" and "ros1"."""
    count: int
    """Number of messages."""
    batches: Callable[[], Iterator[PayloadBatch]]
    """Iterates over the messages in the order of the file."""


class BagLog(Log):
    """Tables by topic as in an MCAP recording. A second type on the same topic is called "topic#2".

    A stamp is the time at which the recorder received a message. The time of its creation, `header.stamp`, is a column.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._losses = RecordingLosses()
        self._tables: dict[str, TopicTable] = {}
        self._rowless: set[str] = set()
        self._types: dict[str, str] = {}
        self._span: tuple[int, int] | None = None
        self._closed = True
        self._size = 0

    def _settle(self, topics: Iterable[BagTopic], span_ns: tuple[int, int] | None) -> None:
        """Store the topics and the time span of the bag."""
        budget, named = MemoryBudget(), dict[str, int]()
        for topic in topics:
            if not topic.count:
                self._rowless.add(topic.name)
                continue
            number = named[topic.name] = named.get(topic.name, 0) + 1
            name = topic.name if number == 1 else f"{topic.name}#{number}"
            self._losses.redefined += number > 1
            self._types[name] = topic.type_name
            self._tables[name] = TopicTable(
                name,
                topic.count,
                topic.batches,
                partial(decoder, topic.type_name, topic.definition, topic.form),
                unit_from_name(topic.type_name),
                budget,
                lambda why: False,
            )
        self._tables = dict(sorted(self._tables.items()))
        self._rowless -= self._tables.keys()
        self._span = span_ns

    @property
    def base(self) -> Base:
        return "utc" if self._span is not None and self._span[0] >= YEAR_2000_NS else "unknown"

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @property
    def rowless(self) -> Collection[str]:
        return self._rowless

    @property
    def types(self) -> Mapping[str, str]:
        """Name of the ROS type of each table."""
        return self._types

    @property
    def vessels(self) -> tuple[str, ...]:
        return tuple(namespaces_of_vessels([*self._tables, *self._rowless]))

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._span

    @property
    def health(self) -> LogHealth:
        back, undecoded = doubtful_rows(self._tables)
        return self._losses.health(
            self._size,
            sum(table.indexed_rows for table in self._tables.values()),
            unclosed=not self._closed,
            back_in_time=back,
            redefined=self._losses.redefined,
            undecoded=undecoded,
        )

    @property
    def closed(self) -> bool:
        return self._closed

    def payloads(self, topic: str) -> Iterator[bytes]:
        table = self._tables.get(topic)
        return iter(()) if table is None else table.payloads()


def decoder(type_name: str, definition: str, form: str) -> Decoder:
    """Decoder of a type. Without a definition, use that of the ROS distributions. Raises UndecodableError."""
    if form not in ("cdr", "ros1"):
        raise UndecodableError(f"its messages are serialised as {form[:32] or 'an unnamed format'}, not as CDR")
    text = (definition or _known_definition(type_name, form)).encode("utf-8", "replace")
    return CdrDecoder(type_name, text) if form == "cdr" else Ros1Decoder(type_name, text)


def _known_definition(type_name: str, form: str) -> str:
    from rosbags.typesys import Stores, get_typestore

    first, last = type_name.partition("/")[0], type_name.rpartition("/")[2]
    for store in (Stores.ROS1_NOETIC,) if form == "ros1" else (Stores.ROS2_JAZZY, Stores.ROS2_HUMBLE):
        known = get_typestore(store)
        if (full_name := f"{first}/msg/{last}") in known.fielddefs:
            return known.generate_msgdef(full_name, ros_version=1 if form == "ros1" else 2)[0]
    raise UndecodableError(
        f"the bag has no definition of {type_name[:80]}, and it is not a type of ROS; "
        "record it again with ROS 2 Iron or later, or as MCAP"
    )
