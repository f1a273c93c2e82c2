"""GPS time: the date of the sensors' clock from a receiver, and UTC."""

from __future__ import annotations

from typing import NamedTuple

SECOND_NS = 1_000_000_000
WEEK_S = 7 * 86_400
EPOCH_UNIX_S = 315_964_800  # 1980-01-06 00:00 UTC
LEAP_S = 18  # offset of GPS time from UTC since 2017
START_OF_RUNS_S = 2_371 * WEEK_S  # 2025-06-15 00:00 GPS time: the date of repeatable runs
_YEAR_S = 365.2425 * 86_400
_FIRST_YEAR = 1980.0 + 5.0 / 366.0


def unix_us(gps_ns: int) -> int:
    """Convert an instant since the GPS epoch to UTC in microseconds since 1970."""
    return gps_ns // 1000 + (EPOCH_UNIX_S - LEAP_S) * 1_000_000


class GpsTime(NamedTuple):
    """GPS time of the sensors' clock."""

    zero_ns: int
    """GPS time at the clock's zero, in nanoseconds since the GPS epoch."""

    def gps_ns(self, stamp_ns: int) -> int:
        """Nanoseconds since the GPS epoch."""
        return self.zero_ns + stamp_ns

    def week_and_ms(self, stamp_ns: int) -> tuple[int, int]:
        """GPS week, and milliseconds into it."""
        return divmod(self.gps_ns(stamp_ns) // 1_000_000, WEEK_S * 1000)

    def unix_us(self, stamp_ns: int) -> int:
        """UTC in microseconds since 1970."""
        return unix_us(self.gps_ns(stamp_ns))

    def year_at(self, stamp_ns: int) -> float:
        """Decimal year."""
        return _FIRST_YEAR + self.gps_ns(stamp_ns) / SECOND_NS / _YEAR_S

    @classmethod
    def fixed(cls) -> GpsTime:
        """GPS time with the same date in every run."""
        return cls(START_OF_RUNS_S * SECOND_NS)

    @classmethod
    def from_unix_time(cls, unix_s: float, stamp_ns: int) -> GpsTime:
        """GPS time with the date `unix_s` at `stamp_ns`. The fixed date on a board that does not know its date."""
        gps_s = unix_s - EPOCH_UNIX_S + LEAP_S
        if gps_s < START_OF_RUNS_S:
            return cls.fixed()
        return cls(round(gps_s * SECOND_NS) - stamp_ns)
