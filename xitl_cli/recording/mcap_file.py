"""An MCAP file that keeps what was written when the process is killed: the one place that touches foxglove-sdk."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.mcap import MCAPCompression, MCAPWriteOptions

from xitl_cli.errors import UserError

FLUSH_INTERVAL_S = 1.0
_COMPRESSION = {"zstd": MCAPCompression.Zstd, "lz4": MCAPCompression.Lz4, "none": None}


class _WatchedFile:
    """A file whose first write error is kept: the writer's own code logs it and goes on."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.error: OSError | None = None

    def write(self, data: bytes | bytearray) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            self.error = self.error or error
            raise

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            self.error = self.error or error
            raise

    def close(self) -> None:
        self._file.close()


class McapFile:
    """Writes `path`, chunked and compressed; `flush_if_due` closes the chunk about once a second.

    Raises UserError when the file cannot be made or the disk refuses a write.
    """

    def __init__(self, path: Path, compression: str = "lz4", now_s: Callable[[], float] = time.monotonic) -> None:
        self.path = path
        self.context = Context()
        self._now_s = now_s
        self._flushed_s = now_s()
        try:
            self._file = _WatchedFile(path.open("xb"))
        except OSError as error:
            raise UserError(
                f"{path}: cannot be written ({error.strerror}); choose another directory with --out"
            ) from error
        self._writer = foxglove.open_mcap(
            self._file,
            context=self.context,
            writer_options=MCAPWriteOptions(
                compression=_COMPRESSION[compression], compression_threads=0, profile="xitl"
            ),
        )

    def channel(self, topic: str, schema_name: str, definition: str) -> Callable[[bytes, int], None]:
        """A writer `log(payload, stamp_ns)` for ROS 2 CDR payloads on `topic`."""
        schema = Schema(name=schema_name, encoding="ros2msg", data=definition.encode())
        channel = Channel(topic, schema=schema, message_encoding="cdr", context=self.context)
        # The base channel skips the JSON detection of the wrapper: bytes go straight through.
        log: Callable[[bytes, int], None] = channel.base.log
        return log

    def typed(self, channel_type: Any, topic: str) -> Any:
        """One of foxglove.channels for `topic`."""
        return channel_type(topic, context=self.context)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file inside the recording."""
        self._writer.attach(log_time=0, create_time=0, name=name, media_type=media_type, data=data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep named texts inside the recording."""
        self._writer.write_metadata(name, dict(values))

    def flush_if_due(self) -> None:
        """Close the chunk and hand it to the operating system when a second has gone by."""
        now_s = self._now_s()
        if now_s - self._flushed_s >= FLUSH_INTERVAL_S:
            self._flushed_s = now_s
            self._guarded(self._writer.flush)

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._guarded(self._writer.close)
        finally:
            self._file.close()

    def _guarded(self, action: Callable[[], None]) -> None:
        failure: Exception | None = None
        try:
            action()
        except Exception as error:  # noqa: BLE001  the SDK raises bare exceptions of its own
            failure = error
        if self._file.error is not None:
            reason = self._file.error.strerror
            raise UserError(f"{self.path}: the recording cannot be written ({reason}); free space and run again")
        if failure is not None:
            raise UserError(f"{self.path}: the recording cannot be written ({failure})") from failure
