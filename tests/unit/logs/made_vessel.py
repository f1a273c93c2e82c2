"""The DataFlash log of a vessel whose motion is a formula."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from made_log import MadeLog, MadeTable
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame

Array = NDArray[np.float64]
Formula = Callable[[Array], Array]

HARBOUR = LocalFrame(-8.8, -63.95, 55.0)
RATE_HZ = 10.0
MANUAL, AUTO = 0, 10  # of a rover


def still(t_s: Array) -> Array:
    return np.zeros_like(t_s)


def vessel(
    name: str,
    *,
    north_m: Formula = still,
    east_m: Formula = still,
    speed_mps: Formula = still,
    yaw_deg: Formula = still,
    roll_deg: Formula = still,
    pitch_deg: Formula = still,
    until_s: float = 60.0,
    boot_s: float = 5.0,
    armed_s: float | None = None,
    auto_s: float | None = None,
    further: tuple[MadeTable, ...] = (),
) -> MadeLog:
    """Formulas are of the seconds since the log began, which is `boot_s` after boot."""
    t_s = np.arange(0.0, until_s + 0.5 / RATE_HZ, 1.0 / RATE_HZ)
    stamp_ns = np.round((t_s + boot_s) * 1e9).astype(np.int64)
    place = np.stack([north_m(t_s), east_m(t_s), np.zeros_like(t_s)], axis=1)
    latitude, longitude, altitude = HARBOUR.geodetic(place)
    tables = [
        MadeTable("POS", stamp_ns, {"Lat": latitude, "Lng": longitude, "Alt": altitude}),
        MadeTable("ATT", stamp_ns, {"Roll": roll_deg(t_s), "Pitch": pitch_deg(t_s), "Yaw": yaw_deg(t_s) % 360.0}),
        MadeTable("XKF1", stamp_ns, {"VN": speed_mps(t_s), "VE": np.zeros_like(t_s)}),
        MadeTable("MSG", stamp_ns[:1], {"Message": ["ArduRover V4.7.0 (12345678)"]}),
        *further,
    ]

    def at(second: float) -> int:
        return round((second + boot_s) * 1e9)

    if armed_s is not None:
        tables.append(MadeTable("ARM", [at(armed_s)], {"ArmState": [1]}))
    if auto_s is not None:
        tables.append(MadeTable("MODE", [at(0.0), at(auto_s)], {"ModeNum": [MANUAL, AUTO], "Mode": [MANUAL, AUTO]}))
    return MadeLog(*tables, path=str(Path("/made") / f"{name}.bin"))
