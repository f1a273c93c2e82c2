"""An MCAP file that keeps what was written when the process is killed.

Written chunk by chunk (`mcap_writer`) and not with foxglove-sdk's writer, which streams a chunk into the file under a
placeholder length (a killed run then ends in a record that readers refuse) and logs a full disk instead of raising it.
foxglove-sdk makes the well-known messages.
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
"""Of a channel, from which on it gets a chunk of its own. Chunks that share less pack worse: 100 s in real time take
5 % more room than without, in lockstep, where a second of wall time holds more, 12 %. One topic of them is had from
67 % and 15 % of the bytes rather than 79 %. With 8 KiB it would be 16 % in real time, for twice as many chunks, which
is what opening a long recording costs."""
_NO_CHANNEL = 0


class RecordingError(UserError):
    """The recording cannot be written."""


class ChannelMirror(Protocol):
    """Shows what is recorded elsewhere too."""

    def open_channel(
        self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes
    ) -> Callable[[bytes, int], object] | None:
        """What takes each payload of the channel and its instant; None for a channel that is not wanted."""


class PayloadWriter(Protocol):
    """Writes one payload, received at `stamp_ns` and sent at `sent_ns` (None: the same instant)."""

    def __call__(self, payload: bytes, stamp_ns: int, sent_ns: int | None = None) -> None: ...


class McapFile:
    """Writes `path`, chunked and compressed.

    Messages are kept for about a second, until `flush_if_due` writes them, or until they fill a chunk. A channel that
    has APART_BYTES by then gets a chunk of its own: who wants one topic unpacks what it shares a chunk with, and that
    is then little. Chunks of the same second overlap in time; within a channel messages keep their order.

    A topic has one channel, whoever asks for it. Channels of one `kind` share their schema; a topic is its own kind.

    The file on disk always ends with a whole chunk, also when the disk refuses a write: that is raised as UserError,
    once, and what comes after it is not kept. Raises UserError too when the file cannot be made.

    mirrors: are given the same channels and payloads.
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
        self._kept_bytes: dict[int, int] = {}
        self._filled_bytes = 0
        self._channels: dict[str, PayloadWriter] = {}
        self._schemas: dict[str, int] = {}
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise UserError(
                f"{path}: cannot be made ({error.strerror}); choose another directory with --out"
            ) from error
        self._writer = ChunkWriter(self._file, compression)
        self._whole_bytes = self._file.tell()

    def ros_channel(self, topic: str, schema_name: str, definition: str, kind: str = "") -> PayloadWriter:
        """A writer of ROS 2 CDR payloads."""
        return self._channel(topic, "cdr", schema_name, "ros2msg", definition.encode(), kind)

    def foxglove_channel(self, topic: str, message_type: Any, kind: str = "") -> PayloadWriter:
        """A writer of encoded messages of one type of foxglove.messages."""
        schema = message_type.get_schema()
        return self._channel(topic, "protobuf", schema.name, schema.encoding, schema.data, kind)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file inside the recording."""
        self._guarded(self._writer.attach, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep named texts inside the recording."""
        self._guarded(self._writer.metadata, name, values)

    def flush_if_due(self) -> None:
        """Write what is kept and hand it to the operating system when a second has gone by."""
        now_s = self._now_s()
        if now_s - self._flushed_s >= FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._write_kept(everything=True)

    def close(self) -> None:
        """Write the index and close the file; after a refusal, cut it off behind the last whole chunk."""
        try:
            self._write_kept(everything=True)
            self._guarded(self._writer.finish)
        finally:
            try:
                self._file.close()
            except OSError:  # what is still in the buffer cannot be written either; the file is closed all the same
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
            size = len(record)
            self._kept_bytes[channel] = self._kept_bytes.get(channel, 0) + size
            self._filled_bytes += size
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
        """Write chunks of channels that have enough for one, and one of all others if they fill it, or `everything`."""
        chunks: dict[int, list[ChunkMessage]] = {
            channel: [] for channel, size in self._kept_bytes.items() if size >= APART_BYTES
        }
        rest: list[ChunkMessage] = []
        for message in self._kept:
            chunks.get(message[0], rest).append(message)
        rest_bytes = {channel: size for channel, size in self._kept_bytes.items() if channel not in chunks}
        if everything or sum(rest_bytes.values()) >= CHUNK_BYTES:
            chunks[_NO_CHANNEL], rest, rest_bytes = rest, [], {}
        self._kept, self._kept_bytes, self._filled_bytes = rest, rest_bytes, sum(rest_bytes.values())
        for _, messages in sorted(chunks.items()):
            if messages:
                self._guarded(self._writer.write_chunk, messages)

    def _guarded(self, write: Callable[..., object], *arguments: object) -> None:
        """Write whole records and hand them to the operating system, so that they stay whatever is refused later."""
        if self._refused_once:
            return
        try:
            write(*arguments)
            self._file.flush()
            self._whole_bytes = self._file.tell()
        except OSError as error:
            self._refused(error)

    def _refused(self, error: OSError) -> None:
        if not self._refused_once:
            self._refused_once = True
            raise RecordingError(
                f"{self.path}: the recording cannot be written ({error.strerror}); free space and run again"
            ) from error
