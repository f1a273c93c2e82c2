"""Pre-arm checks: names as ArduPilot says them, and the bits of ARMING_CHECK that switch them on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

_ALL = 1
_BITS = {
    "Baro": 2,
    "Compass": 4,
    "GPS": 8,
    "EKF": 8,
    "IMU": 16,
    "AHRS": 16,
    "RC": 64,
    "Mission": 16384,
}
_OF_POSITION = ("GPS", "EKF")


def in_force(problems: Iterable[str], checks: int, needs_position: bool) -> Iterator[str]:
    """Problems, each `Name: what`, that ARMING_CHECK looks for. A mode without a position does not need GNSS.

    Problems without a bit, such as those of the fence, count as long as anything is checked.
    """
    for problem in problems:
        name = problem.split(":", 1)[0]
        if name in _OF_POSITION and not needs_position:
            continue
        if checks & _ALL or checks & _BITS.get(name, checks):
            yield problem
