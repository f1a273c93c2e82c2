"""An MCAP recording of xitl, of ROS 2 or of Foxglove's tools as a log."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.formats.mcap import container
from xitl_cli.logs.formats.mcap.container import (
    ChannelRecord,
    Chunks,
    RecordingIndex,
    RecordingLosses,
    SchemaRecord,
    Walk,
    batches,
    between,
    from_summary,
    has_footer,
)
from xitl_cli.logs.formats.mcap.table import Decoder, MemoryBudget, TopicTable, UndecodableError, doubtful_rows
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.file_bytes import FileReader
from xitl_cli.logs.model.log import Base, Format, Log, LogHealth
from xitl_cli.logs.model.recording_schema import RECORD, check_schema_version
from xitl_cli.logs.model.table import Selection, Table
from xitl_cli.logs.model.vessel_bag import namespaces_of_vessels

if TYPE_CHECKING:
    from xitl_cli.logs.formats.mcap.rewrite import Rewritten

LOG_TOPIC = "/log"
FRAMES = "xitl_msgs/msg/MavlinkFrame"
_YEAR_2000_NS = 946_684_800 * 1_000_000_000
_MOST_ATTACHMENT = 1 << 28


class McapLog(Log):
    """An MCAP recording. It is opened by its summary if that is valid. Otherwise, all chunks are decompressed once.

    With a summary, damage inside a chunk is found, and added to `health`, when one of its topics is read. Without one,
    all damage is known after opening.

    Iterating over `tables` yields topics. Raw MAVLink topics (xitl_msgs/msg/MavlinkFrame) also have decoded tables,
    which iteration omits: `tables["/link/agent/rx:ATTITUDE"]` decodes the frames of /link/agent/rx once. `frame_tables`
    lists and decodes them too. Two channels of one topic with different schemas are two tables; the second is called
    "topic#2".

    vessel: for a recording of several vessels, the vessel to show, with topics named as for a single vessel. "": show
    all topics under their names in the file.

    Raises LogError if the file cannot be read, is no MCAP file, or has no such vessel.
    """

    format: Format = "mcap"

    def __init__(self, path: str | PathLike[str], vessel: str = "") -> None:
        self.path = path = Path(path)
        self._vessel = vessel
        self._source = FileReader(path)
        try:
            if self._source.read(0, len(container.MAGIC)) != container.MAGIC:
                raise LogError(f"{path}: is not an MCAP file; choose a recording that begins with the letters MCAP")
            self._open()
        except BaseException:
            self._source.close()
            raise

    def _open(self) -> None:
        losses = RecordingLosses()
        summary = from_summary(self._source, losses)
        self._index = index = summary or RecordingIndex(closed=has_footer(self._source), losses=losses)
        self._chunks = Chunks(self._source, index)
        walk = Walk(self._source, index, self._chunks, counting=summary is None)
        if summary is not None:
            for begin, end in list(between(list(index.chunks), len(container.MAGIC), self._source.size)):
                walk.read_range(begin, end)
            index.settle(self._source.size)
        else:
            walk.read_range(len(container.MAGIC), self._source.size)
        check_schema_version(str(self.path), index.metadata.get(RECORD, {}))
        if self._vessel and self._vessel not in self.vessels:
            there = ", ".join(self.vessels)
            raise LogError(
                f"{self.path}: has no vessel {self._vessel!r}; "
                + (f"choose from {there}" if there else "it has one vessel only: omit --vessel")
            )
        topics = self._topics()
        own_log = {LOG_TOPIC: SaidOfVessel(topics[LOG_TOPIC], self)} if self._vessel and LOG_TOPIC in topics else {}
        self._tables = Tables(topics, self.framed, self.frame_tables, own_log)
        self._frames: dict[str, dict[str, Table]] = {}
        self._frames_left: dict[str, int] = {}

    @property
    def base(self) -> Base:
        if RECORD in self._index.metadata:
            return "simulation"
        span = self._index.span_ns
        return "utc" if span is not None and span[0] >= _YEAR_2000_NS else "unknown"

    @property
    def tables(self) -> Mapping[str, Table]:
        return self._tables

    @property
    def rowless(self) -> Collection[str]:
        named = (self.shown(channel.topic) for channel in self._index.channels.values())
        return {name for name in named if name is not None} - self._tables.topics.keys()

    @property
    def vessels(self) -> tuple[str, ...]:
        if RECORD not in self._index.metadata:
            return tuple(namespaces_of_vessels(channel.topic for channel in self._index.channels.values()))
        names = self._index.metadata[RECORD].get("vessels", "")
        return tuple(name.strip() for name in names.split(",") if name.strip())

    @property
    def vessel(self) -> str:
        return self._vessel

    def shown(self, topic: str) -> str | None:
        """Name of a topic in this view; None if it belongs to another vessel."""
        first, _, rest = topic.removeprefix("/").partition("/")
        if not self._vessel or first not in self.vessels:
            return topic
        return f"/{rest}" if first == self._vessel else None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        return self._index.span_ns

    @property
    def health(self) -> LogHealth:
        losses = self._index.losses
        back, undecoded = doubtful_rows(self._tables.topics)
        for name, left in self._frames_left.items():
            if left:
                undecoded.setdefault(name, (left, "its frames are damaged or have unknown messages"))
        return losses.health(
            self._source.size,
            sum(self._index.counts.values()),
            unclosed=not self._index.closed,
            back_in_time=back,
            redefined=losses.redefined,
            undecoded=undecoded,
        )

    @property
    def facts(self) -> Mapping[str, str]:
        index = self._index
        packed = sorted({chunk.compression or "none" for chunk in index.chunks if not chunk.loose})
        facts = {"library": index.library, "mcap_profile": index.profile, "compression": ", ".join(packed)}
        facts |= index.metadata.get(RECORD, {})
        facts |= {"chunks": str(sum(not chunk.loose for chunk in index.chunks))}
        facts |= {"attachments": ", ".join(attachment.name for attachment in index.attachments)}
        return {key: value for key, value in facts.items() if value}

    def attachment(self, name: str) -> bytes | None:
        for attachment in self._index.attachments:
            if attachment.name == name and attachment.size <= _MOST_ATTACHMENT:
                data = self._source.read(attachment.place, attachment.size)
                return data if len(data) == attachment.size else None
        return None

    def metadata(self, name: str) -> Mapping[str, str]:
        """Texts of a metadata record; empty if there is none."""
        return self._index.metadata.get(name, {})

    @property
    def closed(self) -> bool:
        return self._index.closed

    def examine(self) -> bool:
        """Read everything, so that `health` is complete. Return whether the file is whole and has a valid index."""
        from xitl_cli.logs.formats.mcap.rewrite import examine

        if self._index.summarized:
            examine(self._index, self._chunks)
        return self._index.summarized and not self.health.degraded

    def rewrite(self, out: BinaryIO) -> Rewritten:
        """Write the readable part of the recording to `out`, closed and with its indexes. Raises OSError."""
        from xitl_cli.logs.formats.mcap.rewrite import rewrite

        return rewrite(self._source, self._index, self._chunks, out)

    def frame_tables(self, topic: str) -> Mapping[str, Table]:
        """Messages in the frames of a raw MAVLink topic, by "topic:MESSAGE", decoded at the first call.

        From then on, `health` counts damaged frames and unknown messages as undecoded rows of the topic. Raises
        KeyError if there is no such topic.
        """
        known = self._frames.get(topic)
        if known is not None:
            return known
        from xitl_cli.logs.formats.tlog.frames import frame_tables

        if topic not in self.framed:
            raise KeyError(topic)
        table = self._tables.topics[topic]
        tables: dict[str, Table] = {}
        if "frame" in table.columns:
            frames = table.values("frame").tolist()
            tables, counts = frame_tables(topic, frames, table.stamp_ns, table.file_offset)
            self._frames_left[topic] = counts.frames - counts.decoded
        self._frames[topic] = tables
        return tables

    def close(self) -> None:
        self._source.close()

    def payloads(self, topic: str) -> Iterator[bytes]:
        table = self._tables.topics.get(topic)
        return iter(()) if table is None else table.payloads()

    @cached_property
    def framed(self) -> frozenset[str]:
        """Topics of raw MAVLink frames."""
        index = self._index
        return frozenset(
            name
            for channel in index.channels.values()
            if (schema := index.schemas.get(channel.schema_id)) is not None
            and schema.name == FRAMES
            and (name := self.shown(channel.topic)) is not None
        )

    def _topics(self) -> dict[str, TopicTable]:
        """A table for every topic and schema that has messages."""
        groups: dict[str, list[list[ChannelRecord]]] = {}
        for channel in self._index.channels.values():
            name = self.shown(channel.topic)
            if name is not None and self._index.counts.get(channel.id):
                alike = groups.setdefault(name, [])
                same = next((group for group in alike if self._same(group[0], channel)), None)
                if same is None:
                    alike.append([channel])
                else:
                    same.append(channel)
        tables, budget = dict[str, TopicTable](), MemoryBudget()
        for topic, alike in groups.items():
            self._index.losses.redefined += len(alike) - 1
            for number, channels in enumerate(alike):
                name = topic if number == 0 else f"{topic}#{number + 1}"
                tables[name] = self._table(name, channels, budget)
        return dict(sorted(tables.items()))

    def _same(self, one: ChannelRecord, other: ChannelRecord) -> bool:
        first, second = (self._index.schemas.get(channel.schema_id) for channel in (one, other))
        if one.encoding != other.encoding or first is None or second is None:
            return one.encoding == other.encoding and first is second
        return (first.name, first.encoding, first.data) == (second.name, second.encoding, second.data)

    def _table(self, name: str, channels: list[ChannelRecord], budget: MemoryBudget) -> TopicTable:
        channel, numbers = channels[0], [channel.id for channel in channels]
        schema = self._index.schemas.get(channel.schema_id)
        count = sum(self._index.counts[number] for number in numbers)
        return TopicTable(
            name,
            count,
            partial(batches, self._chunks, self._index.chunks, numbers),
            partial(_decoder, channel, schema),
            unit_from_name(schema.name if schema is not None else ""),
            budget,
            partial(self._distrust, numbers),
        )

    def _distrust(self, channels: Sequence[int], why: str) -> bool:
        """Stop using the message indexes of a topic, because they or the summary are wrong. False if they were unused
        already."""
        self._index.losses.note(0, 0, f"the index is wrong: {why}")
        return self._chunks.distrust(channels)


class SaidOfVessel(Selection):
    """Log messages of one vessel of a fleet, and those of no vessel. They are read on first use."""

    def __init__(self, table: Table, log: Log) -> None:
        self._table, self._log = table, log
        self.name, self.instance = table.name, table.instance

    @cached_property
    def _index(self) -> NDArray[np.intp]:  # type: ignore[override]
        if "name" not in self._table.columns:
            return np.arange(len(self._table), dtype=np.intp)
        speakers = [str(name).partition("/")[0] for name in self._table.values("name")]
        others = set(self._log.vessels) - {self._log.vessel}
        return np.flatnonzero([speaker not in others for speaker in speakers])


AnyTable = TypeVar("AnyTable", bound=Table)


class Tables(Mapping[str, Table], Generic[AnyTable]):
    """Tables by topic, and by "topic:MESSAGE", which iterating omits. in_place: tables that replace those of their
    topics."""

    def __init__(
        self,
        topics: dict[str, AnyTable],
        framed: frozenset[str],
        frame_tables: Callable[[str], Mapping[str, Table]],
        in_place: Mapping[str, Table],
    ) -> None:
        self.topics = topics
        self._in_place = in_place
        self._framed = framed
        self._frame_tables = frame_tables

    def __getitem__(self, name: str) -> Table:
        table = self._in_place.get(name, self.topics.get(name))
        if table is not None:
            return table
        topic = name.rpartition(":")[0]
        if topic in self._framed and topic in self.topics:
            return self._frame_tables(topic)[name]
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.topics)

    def __len__(self) -> int:
        return len(self.topics)


def _decoder(channel: ChannelRecord, schema: SchemaRecord | None) -> Decoder:
    """Decoder of a channel. Raises UndecodableError."""
    if channel.encoding == "json":
        from xitl_cli.logs.formats.mcap.decoders import JsonDecoder

        return JsonDecoder()
    kind = channel.encoding, schema.encoding if schema is not None else ""
    if schema is not None and kind == ("cdr", "ros2msg"):
        from xitl_cli.logs.formats.mcap.cdr import CdrDecoder

        return CdrDecoder(schema.name, schema.data)
    if schema is not None and kind == ("ros1", "ros1msg"):
        from xitl_cli.logs.formats.mcap.cdr import Ros1Decoder

        return Ros1Decoder(schema.name, schema.data)
    if schema is not None and kind == ("protobuf", "protobuf"):
        from xitl_cli.logs.formats.mcap.decoders import ProtobufDecoder

        return ProtobufDecoder(schema.name, schema.data)
    raise UndecodableError(f"its encoding is {kind[0] or 'not given'} with a schema {kind[1] or 'that is not given'}")


_OURS = "xitl_msgs/"
_BY_SUFFIX = {
    "m": "m",
    "s": "s",
    "us": "us",
    "ns": "ns",
    "hz": "Hz",
    "mps": "m/s",
    "mps2": "m/s/s",
    "radps": "rad/s",
    "radpm": "rad/m",
    "deg": "deg",
    "ppm": "ppm",
    "percent": "%",
    "c": "degC",
    "mib": "MiB",
}


def unit_from_name(schema: str) -> Callable[[str], str]:
    """Return the function from a column's name to its unit, for messages of this type; "" means no unit."""
    if not schema.startswith(_OURS):
        return lambda _: ""
    return lambda column: _BY_SUFFIX.get(column.rpartition("_")[2], "") if "_" in column else ""
