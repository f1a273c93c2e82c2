"""An MCAP file that stays readable when the process is killed.

It is written chunk by chunk (`mcap_writer`) and not with foxglove-sdk's writer. That writer streams a chunk into the
file under a placeholder length, so a killed run ends in a record that readers refuse. It also logs a full disk instead
of raising an error. foxglove-sdk makes the well-known messages.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from xitl_cli.errors import UserError
from xitl_cli.record.mcap_writer import ChunkMessage, ChunkWriter, message_record

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


class McapFile:
    """Writes `path`, chunked and compressed.

    Messages are kept for about a second, until `flush_if_due` writes them, or until they fill a chunk. A channel with
    APART_BYTES by then gets a separate chunk, so that a reader of one topic unpacks little else. Chunks of the same
    second overlap in time. Within a channel messages keep their order.

    A topic has one channel for all users. Channels of one `kind` share their schema; by default a topic is its own
    kind.

    The file on disk always ends with a whole chunk, also when the disk refuses a write. That raises UserError once, and
    later messages are dropped. Raises UserError also when the file cannot be created.

    mirrors: get the same channels and payloads.
    """

    def __init__(
        self,
        path: Path,
        compression: str = "lz4",
        now_s: Callable[[], float] = time.monotonic,
        mirrors: Sequence[ChannelMirror] = (),
    ) -> None:
        self.path = path
        self._mirrors = tuple(mirrors)
        self._now_s = now_s
        self._flushed_s = now_s()
        self._whole_bytes = 0
        self._refused_once = False
        self._kept: list[ChunkMessage] = []
        self._filled_bytes = 0
        self._channels: dict[str, PayloadWriter] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise UserError(
                f"{path} cannot be created ({error.strerror}); choose another directory with --out"
            ) from error
        self._writer = ChunkWriter(self._file, compression)
        self._whole_bytes = self._file.tell()

    def ros_channel(self, topic: str, schema_name: str, definition: str, kind: str = "") -> PayloadWriter:
        """Return a writer of ROS 2 CDR payloads."""
        return self._channel(topic, "cdr", schema_name, "ros2msg", definition.encode(), kind)

    def foxglove_channel(self, topic: str, message_type: Any, kind: str = "") -> PayloadWriter:
        """Return a writer of encoded messages of one type of foxglove.messages."""
        schema = message_type.get_schema()
        return self._channel(topic, "protobuf", schema.name, schema.encoding, schema.data, kind)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a file inside the recording."""
        self._guarded(self._writer.attach, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Store named texts inside the recording."""
        self._guarded(self._writer.metadata, name, values)

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
            try:
                self._file.close()
            except OSError:  # the rest of the buffer cannot be written either, but the file is closed
                self._refused_once = True
            if self._refused_once and self.path.is_file():
                os.truncate(self.path, min(self._whole_bytes, self.path.stat().st_size))

    def _channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes, kind: str
    ) -> PayloadWriter:
        if topic in self._channels:
            return self._channels[topic]
        kind = kind or topic
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(schema_name, schema_encoding, definition)
        channel = self._writer.register_channel(topic, encoding, self._schemas[kind])

        def log(payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None:
            if self._refused_once:
                return
            record = message_record(channel, stamp_ns, payload, stamp_ns if sent_ns is None else max(sent_ns, 0))
            self._kept.append((channel, stamp_ns, record))
            self._filled_bytes += len(record)
            if self._filled_bytes >= CHUNK_BYTES:
                self._write_kept(everything=False)

        described = topic, encoding, schema_name, schema_encoding, definition
        wanted = [show for mirror in self._mirrors if (show := mirror.open_channel(*described)) is not None]
        if not wanted:
            return self._channels.setdefault(topic, log)

        def log_and_show(payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None:
            log(payload, stamp_ns, sent_ns)
            for show in wanted:
                show(payload, stamp_ns)

        return self._channels.setdefault(topic, log_and_show)

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
