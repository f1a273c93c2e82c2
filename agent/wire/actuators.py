"""Motor commands in XITL_ACTUATORS: eight, and eight more in an extension that is omitted while unused."""

from __future__ import annotations

from collections.abc import Sequence

from agent.wire import dialect
from agent.wire.codec import Message

COMMANDS_ON_WIRE = 16
_FIRST = 8
EXTENSION_BYTES = 4 * (COMMANDS_ON_WIRE - _FIRST)


def actuators_message(
    commands: Sequence[float],
    armed: bool,
    imu_stamp_us: int,
    imu_received_us: int,
    now_ns: int,
    count: int,
    failsafe: bool = False,
) -> Message:
    """Return the message of at most 16 commands. count: the tick that it answers, or a counter."""
    sent = list(commands[:COMMANDS_ON_WIRE])
    flags = dialect.XITL_ACTUATOR_FLAGS_ARMED if armed else 0
    flags |= dialect.XITL_ACTUATOR_FLAGS_FAILSAFE if failsafe else 0
    padded = sent + [0.0] * (COMMANDS_ON_WIRE - len(sent))
    message: Message = dialect.MAVLink_xitl_actuators_message(
        now_ns // 1000, imu_stamp_us, imu_received_us, count, padded[:_FIRST], len(sent), flags, padded[_FIRST:]
    )
    return message


def commands_of(message: Message) -> tuple[float, ...]:
    """Return the commands in use."""
    return (*message.command, *message.more)[: message.count]
