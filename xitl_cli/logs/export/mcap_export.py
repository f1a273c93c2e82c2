"""One MCAP of ROS 2 messages, a topic a message, in the order of the log."""

from __future__ import annotations

from pathlib import Path

from xitl_cli.logs.export.naming import type_names
from xitl_cli.logs.export.ros_message import RosMessage
from xitl_cli.logs.log import Log
from xitl_cli.logs.query.merged import merged, rows_at_once
from xitl_cli.logs.table import Table

_LATEST_NS = 2**63 - 1


def write_mcap(
    path: Path, log: Log, tables: list[Table], span_ns: tuple[int | None, int | None], raw: bool
) -> tuple[int, int]:
    """How many rows were written, and how many of them at 0, as their stamp was before the log's zero."""
    from xitl_cli.record.mcap_file import McapFile

    names = type_names(table.name for table in tables)
    messages = [RosMessage(table, raw) for table in tables]
    file = McapFile(path)
    rows_written = early = 0
    try:
        logs = [
            file.ros_channel(_topic(table.name), f"xitl_export/msg/{names[table.name]}", message.definition)
            for table, message in zip(tables, messages, strict=True)
        ]
        source = {
            "source": log.path.name,
            "format": log.format,
            "time_base": log.base,
            "values": "raw" if raw else "scaled",
        }
        file.metadata("xitl export", source)
        for batch in merged(tables, *span_ns, None, 0, rows_at_once(log, tables), raw=raw):
            rows = [
                zip(message.payloads(own), table.stamp_ns[own].tolist(), strict=True)
                for table, message, own in zip(tables, messages, batch.rows, strict=True)
            ]
            for owner in batch.order.tolist():
                payload, stamp_ns = next(rows[owner])
                early += stamp_ns < 0
                logs[owner](payload, min(max(stamp_ns, 0), _LATEST_NS))
            rows_written += len(batch.order)
            file.flush_if_due()
    finally:
        file.close()
    return rows_written, early


def _topic(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
