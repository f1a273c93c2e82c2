"""Stamps read from raw frames, against the messages they were packed from."""

from __future__ import annotations

from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer
from xitl_cli.run.links.inbox import sent_ns


def message(kind: Any, **values: int) -> Any:
    """With these values and nothing else in it."""
    fields = []
    for name, type_name, size in zip(kind.fieldnames, kind.fieldtypes, kind.array_lengths, strict=True):
        empty: Any = b"" if type_name == "char" else 0
        if size and type_name != "char":
            empty = [0] * size
        fields.append(values.get(name, empty))
    return kind(*fields)


@pytest.mark.parametrize(
    ("kind", "field", "unit_ns"),
    [
        (dialect.MAVLink_xitl_actuators_message, "time_usec", 1000),
        (dialect.MAVLink_xitl_task_stats_message, "time_usec", 1000),
        (dialect.MAVLink_xitl_node_status_message, "time_usec", 1000),
        (dialect.MAVLink_xitl_node_info_message, "time_usec", 1000),
        (dialect.MAVLink_xitl_bridge_status_message, "time_usec", 1000),
        (dialect.MAVLink_xitl_timesync_message, "t3_ns", 1),
        (dialect.MAVLink_attitude_message, "time_boot_ms", 1_000_000),
        (dialect.MAVLink_attitude_quaternion_message, "time_boot_ms", 1_000_000),
        (dialect.MAVLink_local_position_ned_message, "time_boot_ms", 1_000_000),
        (dialect.MAVLink_global_position_int_message, "time_boot_ms", 1_000_000),
    ],
)
@pytest.mark.parametrize("value", [0, 1, 255, 256, 65_536, 0x01020304])
def test_the_stamp_of_every_kind(kind: Any, field: str, unit_ns: int, value: int) -> None:
    """Also where the zeros at the end of a payload, which are not sent, cut into it."""
    frame = Packer(1, 1).pack(message(kind, **{field: value}))
    assert sent_ns(frame) == value * unit_ns


def test_a_message_without_a_stamp_has_none() -> None:
    assert sent_ns(Packer(1, 1).pack(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))) is None
