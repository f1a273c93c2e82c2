"""One MCAP of ROS 2 messages, a topic a message, in the order of the log.

A message with much to say in a batch gets chunks of its own, as in a recording: a reader of one topic unpacks little.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from xitl_cli.logs.export.naming import type_names
from xitl_cli.logs.export.ros_message import RosMessage
from xitl_cli.logs.log import Log
from xitl_cli.logs.query.merged import merged, rows_at_once
from xitl_cli.logs.table import Table

_CHUNK_BYTES = 1 << 20
_APART_BYTES = 32 << 10


def write_mcap(
    path: Path, log: Log, tables: Sequence[Table], span_ns: tuple[int | None, int | None], raw: bool
) -> tuple[int, int]:
    """How many rows were written, and how many of them at 0, as their stamp was before the log's zero."""
    from mcap.writer import CompressionType, Writer

    names = type_names(table.name for table in tables)
    messages = [RosMessage(table, raw) for table in tables]
    rows_written = early = 0
    with path.open("xb") as file:
        writer: Any = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        writer.start("xitl", "xitl")
        channels = []
        for table, message in zip(tables, messages, strict=True):
            name = f"xitl_export/msg/{names[table.name]}"
            schema = writer.register_schema(name, "ros2msg", message.definition.encode())
            channels.append(writer.register_channel(_topic(table.name), "cdr", schema))
        source = {
            "source": log.path.name,
            "format": log.format,
            "time_base": log.base,
            "values": "raw" if raw else "scaled",
        }
        writer.add_metadata("xitl export", source)
        for batch in merged(tables, *span_ns, None, 0, rows_at_once(log, tables), raw=raw):
            rows_written += len(batch.order)
            waiting = []
            for table, message, channel, own in zip(tables, messages, channels, batch.rows, strict=True):
                stamps, payloads = table.stamp_ns[own], list(message.payloads(own))
                early += int(np.count_nonzero(stamps < 0))
                rows = zip(np.clip(stamps, 0, None).tolist(), payloads, strict=True)
                if sum(map(len, payloads)) >= _APART_BYTES:
                    for stamp_ns, payload in rows:
                        writer.add_message(channel, stamp_ns, payload, stamp_ns)
                    writer.flush()
                waiting.append(rows)  # nothing is left of one that was written
            for owner in batch.order.tolist():
                for stamp_ns, payload in islice(waiting[owner], 1):
                    writer.add_message(channels[owner], stamp_ns, payload, stamp_ns)
            writer.flush()
        writer.finish()
    return rows_written, early


def _topic(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
