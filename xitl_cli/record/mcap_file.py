"""An MCAP file that stays readable when the process is killed.

It is written chunk by chunk (`mcap_writer`) and not with foxglove-sdk's writer. That writer streams a chunk into the
file under a placeholder length, so a killed run ends in a record that readers refuse. It also logs a full disk instead
of raising an error. foxglove-sdk makes the well-known messages.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import repeat
from pathlib import Path
from typing import Any, Protocol

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.logs.model.recording_schema import NEXT_RECORD, SPLIT_RECORD
from xitl_cli.record.mcap_writer import MESSAGE_BYTES, ChunkMessage, ChunkWriter, message_record

FLUSH_INTERVAL_S = 1.0
CHUNK_BYTES = 1 << 20
APART_BYTES = 32 << 10
"""Bytes of a channel from which on it gets a separate chunk. Smaller shared chunks pack worse: 100 s in real time take
5 % more space than without separate chunks. In lockstep, with more data in a second of wall time, they take 12 %. In
return, a reader of one such topic reads 67 % and 15 % of the bytes rather than 79 %. With 8 KiB it would be 16 % in
real time, but with twice as many chunks, and their number sets the time to open a long recording.
"""
_NO_CHANNEL = 0


class RecordingError(UserError):
    """The recording cannot be written."""


class ChannelMirror(Protocol):
    """Shows the recorded data elsewhere too."""

    def open_channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes
    ) -> Callable[[bytes, int], object] | None:
        """Return a function for each payload of the channel and its instant; None for an unwanted channel."""


class PayloadWriter(Protocol):
    """Writes one payload, received at `stamp_ns` and sent at `sent_ns` (None: the same instant)."""

    def __call__(self, payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None: ...


@dataclass(frozen=True, slots=True)
class SplitLimits:
    """When the next file of a set begins. None: no such limit."""

    message_bytes: int | None = None
    """Bytes of the messages of a file before compression, which a seed repeats."""
    time_ns: int | None = None
    """Simulation time from the beginning of a file."""


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """A finished file of a set."""

    file: str
    size_bytes: int
    from_ns: int
    """Earliest stamp."""
    until_ns: int
    """Latest stamp."""


def part_path(first: Path, number: int) -> Path:
    """Path of a file of the set that begins with the file `first`: run.mcap, run-002.mcap, run-003.mcap."""
    return first if number == 1 else first.with_name(f"{first.stem}-{number:03d}{first.suffix}")


@dataclass(frozen=True, slots=True)
class _Kept:
    """A message that the next file of a set repeats."""

    payload: bytes
    stamp_ns: int


class McapFile:
    """Writes `path`, chunked and compressed.

    Messages are kept for about a second, until `flush_if_due` writes them, or until they fill a chunk. A channel with
    APART_BYTES by then gets a separate chunk, so that a reader of one topic unpacks little else. Chunks of the same
    second overlap in time. Within a channel messages keep their order.

    A topic has one channel for all users. Channels of one `kind` share their schema; by default a topic is its own
    kind.

    The file on disk always ends with a whole chunk, also when the disk refuses a write. That raises UserError once, and
    later messages are dropped. Raises UserError also when the file cannot be created.

    mirrors: get the same channels and payloads. split: continue in a next file at these limits. Each file is closed
    with its index before the next begins. The next has all schemas, channels, attachments and metadata so far. It
    begins with the messages given to `repeat`, stamped with its beginning.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "lz4",
        now_s: Callable[[], float] = time.monotonic,
        mirrors: Sequence[ChannelMirror] = (),
        split: SplitLimits | None = None,
    ) -> None:
        self.path = self._first_path = path
        self._compression = compression
        self._split = split
        self._finished: list[RecordedFile] = []
        self._head: list[Callable[[ChunkWriter], None]] = []
        self._repeats: dict[str, dict[tuple[str, ...], _Kept]] = {}
        self._numbers: dict[str, int] = {}
        """Channels by topic."""
        self._from_ns = self._message_bytes = 0
        self._mirrors = tuple(mirrors)
        self._now_s = now_s
        self._flushed_s = now_s()
        self._refused_once = False
        self._kept: list[ChunkMessage] = []
        self._filled_bytes = 0
        self._channels: dict[str, PayloadWriter] = {}
        self._plain: dict[PayloadWriter, int] = {}
        """Channels by writers that only record, without a split or a mirror."""
        self._schemas: dict[str, int] = {}
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise UserError(
                f"{path} cannot be created ({error.strerror}); choose another directory with --out"
            ) from error
        self._writer = ChunkWriter(self._file, compression)
        self._whole_bytes = self._file.tell()
        if split is not None:
            self._guarded(self._writer.metadata, SPLIT_RECORD, {"number": "1", "from_ns": "0", "repeated": "{}"})

    @property
    def mirrored(self) -> bool:
        """Whether something gets the messages at once."""
        return bool(self._mirrors)

    @property
    def is_split(self) -> bool:
        """Whether the recording continues in further files at its limits."""
        return self._split is not None

    @property
    def files(self) -> tuple[RecordedFile, ...]:
        """The closed files of a split recording, in order."""
        return tuple(self._finished)

    def repeat(self, topic: str, key: tuple[str, ...], payload: bytes | None, stamp_ns: int) -> None:
        """Begin each next file with this message of a topic, until another one has its key. None: no longer.

        A key with an empty first text ends the repetition of all keys with the same rest, and () of all keys.
        """
        kept = self._repeats.setdefault(topic, {})
        kept.pop(key, None)
        if payload is not None:
            kept[key] = _Kept(payload, stamp_ns)
        elif not key:
            kept.clear()
        elif not key[0]:
            for other in [other for other in kept if other[1:] == key[1:]]:
                del kept[other]

    def ros_channel(self, topic: str, schema_name: str, definition: str, kind: str = "") -> PayloadWriter:
        """Return a writer of ROS 2 CDR payloads."""
        return self._channel(topic, "cdr", schema_name, "ros2msg", definition.encode(), kind)

    def foxglove_channel(self, topic: str, message_type: Any, kind: str = "") -> PayloadWriter:
        """Return a writer of encoded messages of one type of foxglove.messages."""
        schema = message_type.get_schema()
        return self._channel(topic, "protobuf", schema.name, schema.encoding, schema.data, kind)

    def joined_writer(self, writers: Sequence[PayloadWriter]) -> Callable[[Sequence[bytes], int], None]:
        """Return a function that writes one payload with each of these writers of this file, all at one instant."""
        channels = [self._plain[write] for write in writers if write in self._plain]

        def write_each(payloads: Sequence[bytes], stamp_ns: int) -> None:
            for write, payload in zip(writers, payloads, strict=True):
                write(payload, stamp_ns)

        def write_together(payloads: Sequence[bytes], stamp_ns: int) -> None:
            if self._refused_once:
                return
            rows = zip(channels, payloads, strict=True)
            records = [message_record(channel, stamp_ns, payload, stamp_ns) for channel, payload in rows]
            self._kept += zip(channels, repeat(stamp_ns), records)
            self._filled_bytes += sum(map(len, records))
            if self._filled_bytes >= CHUNK_BYTES:
                self._write_kept(everything=False)

        return write_together if len(channels) == len(writers) else write_each

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a file inside the recording."""
        self._guarded(self._writer.attach, name, media_type, data)
        if self._split is not None:
            self._head.append(lambda writer: writer.attach(name, media_type, data))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Store named texts inside the recording."""
        self._guarded(self._writer.metadata, name, values)
        if self._split is not None:
            self._head.append(lambda writer: writer.metadata(name, values))

    def flush_if_due(self) -> None:
        """Write the kept messages and pass them to the operating system once a second."""
        now_s = self._now_s()
        if now_s - self._flushed_s >= FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._write_kept(everything=True)

    def close(self) -> None:
        """Write the index and close the file; after a refused write, cut the file off after the last whole chunk."""
        try:
            self._write_kept(everything=True)
            self._guarded(self._writer.finish)
        finally:
            was_open = not self._file.closed
            try:
                self._file.close()
            except OSError:  # the rest of the buffer cannot be written either, but the file is closed
                self._refused_once = True
            if self._refused_once and self.path.is_file():
                os.truncate(self.path, min(self._whole_bytes, self.path.stat().st_size))
            if self._split is not None and was_open and self.path.is_file():
                self._note_finished()

    def _note_finished(self) -> None:
        from_ns, until_ns = self._writer.span_ns
        self._finished.append(RecordedFile(self.path.name, self.path.stat().st_size, from_ns, until_ns))

    def _begin_next(self, stamp_ns: int, limits: SplitLimits) -> None:
        """Close the file and continue in the next one, which begins at a message of `stamp_ns`."""
        self._write_kept(everything=True)
        number = len(self._finished) + 2
        path = part_path(self._first_path, number)
        self._guarded(self._writer.metadata, NEXT_RECORD, {"file": path.name})
        self._guarded(self._writer.finish)
        try:
            self._file.close()
            self._note_finished()
            self._file = path.open("xb")
        except OSError as error:
            self._refused_once = True
            raise RecordingError(
                f"{path}: the next file of the recording cannot be created ({error.strerror}); free space or choose "
                "another directory with --out, and run again"
            ) from error
        length_ns = stamp_ns - self._from_ns
        by_time = limits.time_ns is not None and length_ns >= limits.time_ns
        self._from_ns = stamp_ns - (length_ns % limits.time_ns if by_time and limits.time_ns else 0)
        self.path, self._message_bytes = path, 0
        self._writer = ChunkWriter(self._file, self._compression, like=self._writer)
        self._whole_bytes = self._file.tell()
        repeats = {topic: tuple(kept.values()) for topic, kept in self._repeats.items() if kept}
        about = {
            "number": str(number),
            "from_ns": str(stamp_ns),
            "repeated": json.dumps({topic: len(kept) for topic, kept in repeats.items()}),
        }
        self._guarded(self._writer.metadata, SPLIT_RECORD, about)
        for write in self._head:
            self._guarded(write, self._writer)
        for topic, kept in repeats.items():
            channel = self._numbers[topic]
            self._kept += [
                (channel, stamp_ns, message_record(channel, stamp_ns, one.payload, one.stamp_ns)) for one in kept
            ]
        self._filled_bytes = sum(len(record) for _, _, record in self._kept)

    def _channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes, kind: str
    ) -> PayloadWriter:
        if topic in self._channels:
            return self._channels[topic]
        kind = kind or topic
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(schema_name, schema_encoding, definition)
        channel = self._numbers[topic] = self._writer.register_channel(topic, encoding, self._schemas[kind])

        def log(payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None:
            if self._refused_once:
                return
            record = message_record(channel, stamp_ns, payload, stamp_ns if sent_ns is None else max(sent_ns, 0))
            self._kept.append((channel, stamp_ns, record))
            self._filled_bytes += len(record)
            if self._filled_bytes >= CHUNK_BYTES:
                self._write_kept(everything=False)

        write = log if self._split is None else self._splitting(log, self._split)
        described = topic, encoding, schema_name, schema_encoding, definition
        wanted = [show for mirror in self._mirrors if (show := mirror.open_channel(*described)) is not None]
        if not wanted:
            if write is log:
                self._plain[write] = channel
            return self._channels.setdefault(topic, write)

        def log_and_show(payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None:
            write(payload, stamp_ns, sent_ns)
            for show in wanted:
                show(payload, stamp_ns)

        return self._channels.setdefault(topic, log_and_show)

    def _splitting(self, log: PayloadWriter, limits: SplitLimits) -> PayloadWriter:
        """Return `log` with the beginning of a next file in front of the message that reaches a limit."""
        most_bytes = float("inf") if limits.message_bytes is None else limits.message_bytes
        longest_ns = float("inf") if limits.time_ns is None else limits.time_ns

        def log_and_split(payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None:
            size = MESSAGE_BYTES + len(payload)
            is_full = 0 < self._message_bytes > most_bytes - size
            if (is_full or stamp_ns >= self._from_ns + longest_ns) and not self._refused_once:
                self._begin_next(stamp_ns, limits)
            self._message_bytes += size
            log(payload, stamp_ns, sent_ns)

        return log_and_split

    def _write_kept(self, everything: bool) -> None:
        """Write chunks of channels with enough data for one.

        Write one of all others if they fill it, or with `everything`.
        """
        kept_bytes = dict.fromkeys([channel for channel, _, _ in self._kept], 0)
        for channel, _, record in self._kept:
            kept_bytes[channel] += len(record)
        chunks: dict[int, list[ChunkMessage]] = {
            channel: [] for channel, size in kept_bytes.items() if size >= APART_BYTES
        }
        rest: list[ChunkMessage] = []
        for message in self._kept:
            chunks.get(message[0], rest).append(message)
        rest_bytes = sum(size for channel, size in kept_bytes.items() if channel not in chunks)
        if everything or rest_bytes >= CHUNK_BYTES:
            chunks[_NO_CHANNEL], rest, rest_bytes = rest, [], 0
        self._kept, self._filled_bytes = rest, rest_bytes
        for _, messages in sorted(chunks.items()):
            if messages:
                self._guarded(self._writer.write_chunk, messages)

    def _guarded(self, write: Callable[..., object], *arguments: object) -> None:
        """Write whole records and flush them, so that they stay when a later write is refused."""
        if self._refused_once:
            return
        try:
            write(*arguments)
            self._file.flush()
            self._whole_bytes = self._file.tell()
        except OSError as error:
            self._refused_once = True
            raise RecordingError(
                f"{self.path}: the recording cannot be written ({error.strerror}); free space and run again"
            ) from error
