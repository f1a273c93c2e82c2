"""Bits of internal errors: MON.IErr, WDOG.IErr, "Internal Errors 0x…" (libraries/AP_InternalError)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from xitl_cli.logs.words.estimator import bit_names

WATCHDOG_RESET = 1 << 11
MAIN_LOOP_STUCK = 1 << 15

INTERNAL_ERRORS: Mapping[int, str] = MappingProxyType(
    {
        0: "logger: mapping failed",
        1: "logger: structure missing",
        2: "logger: format missing",
        3: "logger: too many deletions",
        4: "logger: bad file name",
        5: "panic",
        6: "logger: flushed without the semaphore",
        7: "logger: bad block",
        8: "logger: block count",
        9: "logger: dequeue failed",
        10: "not a number constrained",
        11: "watchdog reset",
        12: "IOMCU reset",
        13: "IOMCU failed",
        14: "SPI failed",
        15: "main loop stuck",
        16: "mission protocol link",
        17: "bitmask range",
        18: "telemetry offset",
        19: "I2C interrupts",
        20: "flow of control",
        21: "full sector recursion",
        22: "bad rotation",
        23: "stack overflow",
        24: "IMU reset",
        25: "GPIO interrupts",
        26: "memory guard",
        27: "DMA failed",
        28: "parameters restored from backup",
        29: "invalid argument or result",
    }
)


def internal_error_names(mask: int) -> tuple[str, ...]:
    return bit_names(INTERNAL_ERRORS, mask)
