"""What is where in a recording, and what was found damaged."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from xitl_cli.logs.formats.mcap.content import Rows
from xitl_cli.logs.formats.mcap.records import Attachment, Channel, Schema
from xitl_cli.logs.log import Losses

MOST_CHUNKS = 1_000_000
MOST_SCHEMA_BYTES = 64 << 20
LARGEST_CHUNK = 1 << 30
_EXPANSION = 256


@dataclass(slots=True)
class Chunk:
    """`data_size` bytes at `data_place`, packed unless `compression` is "". loose: records outside of any chunk.

    size: of the whole record at `place`, for what is lost with it. unpacked_from: its first byte's position, were
    nothing in the file packed. index: places of the message index records by channel, None where there are none that
    can be trusted; rows: then, once they were looked for. cut: it goes on behind the end of the file. holds: the
    channels in it when that is known. headless: its record is damaged at its begin. refused: too large to be true.
    """

    place: int
    size: int
    data_place: int
    data_size: int
    unpacked_size: int
    compression: str
    start_ns: int
    end_ns: int
    unpacked_from: int = 0
    index_places: bytes = b""
    rows: Rows | None = None
    holds: frozenset[int] | None = None
    loose: bool = False
    cut: bool = False
    headless: bool = False
    refused: bool = False

    def index(self) -> dict[int, int]:
        """Places of message index records by channel; empty when there are none."""
        return dict(struct.iter_unpack("<HQ", self.index_places))


@dataclass(slots=True)
class Tally(Losses):
    """What is wrong with the file, counted while it is read."""

    redefined: int = 0


@dataclass(slots=True)
class Index:
    """counts: messages by channel. closed: the writer has finished the file."""

    profile: str = ""
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[Chunk] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None
    attachments: list[Attachment] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    closed: bool = False
    schema_bytes: int = 0
    unpacked_bytes: int = 0
    unpacked_to: int = 0

    def add_schema(self, schema: Schema, tally: Tally) -> None:
        known = self.schemas.get(schema.id)
        if known is not None:
            tally.redefined += known != schema
        elif self.schema_bytes + len(schema.data) <= MOST_SCHEMA_BYTES:
            self.schema_bytes += len(schema.data)
            self.schemas[schema.id] = schema

    def add_channel(self, channel: Channel, tally: Tally) -> None:
        """The first of an id holds: messages before a second one were written for it."""
        known = self.channels.setdefault(channel.id, channel)
        tally.redefined += known != channel

    def settle(self, size_bytes: int, tally: Tally) -> None:
        """Order the chunks, give each its position in the unpacked file, refuse those that would unpack to too much."""
        self.chunks.sort(key=lambda chunk: chunk.place)
        self.unpacked_bytes = self.unpacked_to = 0
        for chunk in self.chunks:
            self._settle(chunk, size_bytes, tally)

    def settle_last(self, size_bytes: int, tally: Tally) -> None:
        """The same for a chunk just added at the end."""
        self._settle(self.chunks[-1], size_bytes, tally)

    def _settle(self, chunk: Chunk, size_bytes: int, tally: Tally) -> None:
        most = LARGEST_CHUNK + _EXPANSION * size_bytes - self.unpacked_bytes
        if chunk.refused or chunk.unpacked_size > min(most, LARGEST_CHUNK):
            if not chunk.refused:
                tally.note(chunk.place, chunk.size, f"a chunk claims {chunk.unpacked_size} bytes unpacked")
            chunk.refused = True
            return
        self.unpacked_bytes += chunk.unpacked_size
        chunk.unpacked_from = max(chunk.data_place, self.unpacked_to)
        self.unpacked_to = chunk.unpacked_from + chunk.unpacked_size
