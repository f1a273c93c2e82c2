"""When an agent sent a frame, by its own clock, from the raw bytes of the frame."""

from __future__ import annotations

from agent.wire import dialect

_HEAD = 10  # bytes of a MAVLink 2 frame before its payload
_US, _MS = 1_000, 1_000_000

# Where the stamp stands in the payload, its size in bytes, and its unit in nanoseconds.
_STAMPS: dict[int, tuple[int, int, int]] = {
    dialect.MAVLINK_MSG_ID_XITL_ACTUATORS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_TASK_STATS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_NODE_INFO: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_BRIDGE_STATUS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_TIMESYNC: (16, 8, 1),
    dialect.MAVLINK_MSG_ID_ATTITUDE: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (0, 4, _MS),
}


def sent_ns(frame: bytes) -> int | None:
    """The agent's clock when it sent the frame, None for a message without such a stamp."""
    stamp = _STAMPS.get(frame[7] | frame[8] << 8 | frame[9] << 16)
    if stamp is None:
        return None
    start, size, unit_ns = stamp
    end = min(start + size, frame[1])  # zeros at the end of a payload are not sent
    return int.from_bytes(frame[_HEAD + start : _HEAD + max(end, start)], "little") * unit_ns
