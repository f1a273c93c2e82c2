"""Recorded pulse widths, wherever they were recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

NO_PULSE_US = 0.0
SHORTEST_US, LONGEST_US = 500.0, 2500.0
"""What a servo output can be when it is not off (0)."""


@dataclass(frozen=True, slots=True)
class PulseLog:
    """Pulse widths of output channels over time.

    source: the file, for people. at_s: rising instants on the recording's clock, (M,). pulses_us: by channel number,
    (M,) each; 0 is no pulse. armed_s: when the vehicle was armed, None where the recording does not tell.
    functions: what ArduPilot used each channel for (SERVOn_FUNCTION), empty where the recording does not tell.
    """

    source: str
    at_s: tuple[float, ...]
    pulses_us: Mapping[int, tuple[float, ...]]
    armed_s: float | None = None
    functions: Mapping[int, int] = field(default_factory=dict)


def is_pulse(pulse_us: float) -> bool:
    """Whether an output can have been so; refuses NaN."""
    return pulse_us == NO_PULSE_US or SHORTEST_US <= pulse_us <= LONGEST_US
