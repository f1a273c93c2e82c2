"""Height from the barometer: averaged, and held beside that of the GNSS by a slow offset."""

from __future__ import annotations

from agent.fcu.samples import BarometerSample

PRESSURE_RANGE_PA = (30_000.0, 120_000.0)
_AVERAGE_NS = 100_000_000
_OFFSET_S = 60.0


class BarometerHeight:
    """Weather and the standard atmosphere's error go into the offset, which follows the GNSS over a minute."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        self._average_ns = 0
        self._sum_pa = 0.0
        self._count = 0
        self._height_m: float | None = None
        self._offset_m: float | None = None
        self._offset_ns = 0

    def add(self, sample: BarometerSample) -> float | None:
        """Altitude above mean sea level ten times a second, once there is an offset; None in between."""
        if self.stamp_ns is None:
            self._average_ns = sample.stamp_ns
        self.stamp_ns = sample.stamp_ns
        self._sum_pa += sample.pressure_pa
        self._count += 1
        if sample.stamp_ns - self._average_ns < _AVERAGE_NS:
            return None
        self._height_m = standard_height_m(self._sum_pa / self._count)
        self._sum_pa, self._count, self._average_ns = 0.0, 0, sample.stamp_ns
        return None if self._offset_m is None else self._height_m + self._offset_m

    def calibrate(self, alt_m: float, stamp_ns: int) -> None:
        """The GNSS says that the altitude is `alt_m`."""
        if self._height_m is None:
            return
        offset_m = alt_m - self._height_m
        if self._offset_m is None:
            self._offset_m = offset_m
        else:
            share = min(max((stamp_ns - self._offset_ns) * 1e-9, 0.0) / _OFFSET_S, 1.0)
            self._offset_m += share * (offset_m - self._offset_m)
        self._offset_ns = stamp_ns


def standard_height_m(pressure_pa: float) -> float:
    """Height in the ICAO standard atmosphere below 11 km."""
    return float(44_330.769 * (1.0 - (pressure_pa / 101_325.0) ** 0.190263))
