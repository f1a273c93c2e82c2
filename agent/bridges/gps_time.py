"""GPS time of the sensors' clock: what a simulated receiver says the date is."""

from __future__ import annotations

from typing import NamedTuple

SECOND_NS = 1_000_000_000
WEEK_S = 7 * 86_400
EPOCH_UNIX_S = 315_964_800  # 1980-01-06 00:00 UTC
LEAP_S = 18  # by which GPS time is ahead of UTC since 2017
START_OF_RUNS_S = 2_371 * WEEK_S  # 2025-06-15 00:00 GPS time: the date of runs that have to repeat themselves
_YEAR_S = 365.2425 * 86_400
_FIRST_YEAR = 1980.0 + 5.0 / 366.0


class GpsTime(NamedTuple):
    """`zero_ns`: GPS time at zero of the sensors' clock, in nanoseconds since the GPS epoch."""

    zero_ns: int

    def at(self, stamp_ns: int) -> int:
        """Nanoseconds since the GPS epoch."""
        return self.zero_ns + stamp_ns

    def year_at(self, stamp_ns: int) -> float:
        """Decimal year."""
        return _FIRST_YEAR + self.at(stamp_ns) / SECOND_NS / _YEAR_S


def fixed() -> GpsTime:
    """The same for every run."""
    return GpsTime(START_OF_RUNS_S * SECOND_NS)


def of_unix_time(unix_s: float, stamp_ns: int) -> GpsTime:
    """The date at `stamp_ns` is `unix_s`; the fixed one on a board that does not know its date."""
    gps_s = unix_s - EPOCH_UNIX_S + LEAP_S
    if gps_s < START_OF_RUNS_S:
        return fixed()
    return GpsTime(round(gps_s * SECOND_NS) - stamp_ns)
