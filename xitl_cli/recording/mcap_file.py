"""An MCAP file that keeps what was written when the process is killed.

Written with the `mcap` package and not with foxglove-sdk's writer, which streams a chunk into the file under a
placeholder length (a killed run then ends in a record that readers refuse) and logs a full disk instead of raising it.
foxglove-sdk makes the well-known messages.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from mcap.writer import CompressionType, Writer

from xitl_cli.errors import UserError

FLUSH_INTERVAL_S = 1.0
Log = Callable[[bytes, int], None]
_COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


class McapFile:
    """Writes `path`, chunked and compressed.

    `flush_if_due` closes the chunk about once a second; the file on disk always ends with a whole one.
    Raises UserError when the file cannot be made or the disk refuses a write.
    """

    def __init__(self, path: Path, compression: str = "lz4", now_s: Callable[[], float] = time.monotonic) -> None:
        self.path = path
        self._now_s = now_s
        self._flushed_s = now_s()
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise UserError(
                f"{path}: cannot be made ({error.strerror}); choose another directory with --out"
            ) from error
        self._writer = Writer(self._file, compression=_COMPRESSION[compression])
        self._guarded(self._writer.start, "xitl", "xitl")

    def ros_channel(self, topic: str, schema_name: str, definition: str) -> Log:
        """A writer `log(payload, stamp_ns)` of ROS 2 CDR payloads."""
        return self._channel(topic, "cdr", schema_name, "ros2msg", definition.encode())

    def foxglove_channel(self, topic: str, message_type: Any) -> Callable[[Any, int], None]:
        """A writer `log(message, stamp_ns)` of one of foxglove.messages."""
        schema = message_type.get_schema()
        log = self._channel(topic, "protobuf", schema.name, schema.encoding, schema.data)
        return lambda message, stamp_ns: log(message.encode(), stamp_ns)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file inside the recording."""
        self._guarded(self._writer.add_attachment, 0, 0, name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep named texts inside the recording."""
        self._guarded(self._writer.add_metadata, name, dict(values))

    def flush_if_due(self) -> None:
        """Close the chunk and hand it to the operating system when a second has gone by."""
        now_s = self._now_s()
        if now_s - self._flushed_s >= FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._guarded(self._writer.flush)

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._guarded(self._writer.finish)
        finally:
            self._guarded(self._file.close)

    def _channel(self, topic: str, encoding: str, schema_name: str, schema_encoding: str, definition: bytes) -> Log:
        schema = self._writer.register_schema(schema_name, schema_encoding, definition)
        channel = self._writer.register_channel(topic, encoding, schema)
        add = self._writer.add_message

        def log(payload: bytes, stamp_ns: int) -> None:
            try:
                add(channel, stamp_ns, payload, stamp_ns)
            except OSError as error:
                self._refused(error)

        return log

    def _guarded(self, action: Callable[..., object], *arguments: object) -> None:
        try:
            action(*arguments)
        except OSError as error:
            self._refused(error)

    def _refused(self, error: OSError) -> NoReturn:
        reason = error.strerror
        raise UserError(f"{self.path}: the recording cannot be written ({reason}); free space and run again") from error
