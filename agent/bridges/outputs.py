"""What another autopilot puts out for its motors, as commands in [-1, 1]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from agent.wire import dialect
from agent.wire.codec import Message

CHANNELS_OF_A_MESSAGE = 16
MOTORS_ON_WIRE = 8


@dataclass(frozen=True)
class Outputs:
    """Which channels drive the motors, 1 the lowest, in the order of the motors.

    A command is (pulse - trim_us) / span_us, limited to [-1, 1]; a pulse of 0 is no output, which commands 0.
    """

    channels: tuple[int, ...] = (1, 3)
    trim_us: float = 1500.0
    span_us: float = 400.0

    def of_pulses(self, pulses_us: Sequence[int]) -> tuple[float, ...]:
        """Commands of pulse widths by channel, from channel 1 on; a channel that is not among them commands 0."""
        trim_us, span_us, known = self.trim_us, self.span_us, len(pulses_us)
        commands = []
        for channel in self.channels:
            pulse_us = pulses_us[channel - 1] if channel <= known else 0
            commands.append(max(-1.0, min(1.0, (pulse_us - trim_us) / span_us)) if pulse_us else 0.0)
        return tuple(commands)

    def of_values(self, values: Sequence[float]) -> tuple[float, ...]:
        """The same channels of outputs that are normalised already."""
        known = len(values)
        return tuple(max(-1.0, min(1.0, values[n - 1])) if n <= known else 0.0 for n in self.channels)


def pulses_of(message: Message, before: Sequence[int]) -> tuple[int, ...]:
    """Pulse widths of all channels, in us, after a SERVO_OUTPUT_RAW: one set of 16 of them is new."""
    new = tuple(getattr(message, f"servo{number}_raw") for number in range(1, CHANNELS_OF_A_MESSAGE + 1))
    start = message.port * CHANNELS_OF_A_MESSAGE
    if start == 0:
        return new + tuple(before[CHANNELS_OF_A_MESSAGE:])
    if start > CHANNELS_OF_A_MESSAGE:
        return tuple(before)
    return (*before[:start], *(0,) * (start - len(before)), *new)


def actuators(
    commands: Sequence[float], armed: bool, imu_stamp_us: int, imu_received_us: int, now_ns: int, count: int
) -> Message:
    """XITL_ACTUATORS of these commands; `count` is the tick that it answers, or counts up."""
    flags = dialect.XITL_ACTUATOR_FLAGS_ARMED if armed else 0
    motors = list(commands[:MOTORS_ON_WIRE])
    padded = motors + [0.0] * (MOTORS_ON_WIRE - len(motors))
    message: Message = dialect.MAVLink_xitl_actuators_message(
        now_ns // 1000, imu_stamp_us, imu_received_us, count, padded, len(motors), flags
    )
    return message
