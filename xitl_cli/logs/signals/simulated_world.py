"""The world that ArduPilot's own simulator made (SIM): whether a log is of it.

What such a world calls a metre is found back only by its own count (`ardupilot_ned`); a receiver on the real
Earth is not concerned. Where the senses come from elsewhere (external AHRS, HIL) the simulated vehicle stands still, or
is driven by the same outputs to another place, and what SIM tells is true of nothing.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from sim_core.geodesy import LocalFrame, ardupilot_ned
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.geodetic import geodetic
from xitl_cli.logs.signals.series import Series

_STILL_M = 5.0
_NEAR_SHARE = 0.02
_APART_M = 20.0  # between a receiver and the place it is at
_UNLIKE = 0.5  # of the speed
_MOVING_MPS = 0.5
_HALF_NS = 500_000_000

_known: WeakKeyDictionary[Log, float | None] = WeakKeyDictionary()


def simulators_own(log: Log, found: Series | None) -> Series | None:
    """What SIM tells, unless it is of another vehicle."""
    return None if found is None or stray_truth_m(log) is not None else found


def stray_truth_m(log: Log) -> float | None:
    """Largest distance from where SIM says the vehicle was to where its receiver was, when they moved differently.

    None where SIM is the truth, or is not logged. A receiver that is only off, as a fault of it would be, still moves
    with the vehicle.
    """
    if log not in _known:
        _known[log] = _stray_m(log)
    return _known[log]


def _stray_m(log: Log) -> float | None:
    truth, table = geodetic(log, "SIM", ("Lat", "Lng", "Alt")), log.tables.get("GPS")
    if truth is None or table is None or not {"Lat", "Lng", "Status", "Spd", "GCrs"} <= set(table.columns):
        return None
    rows = np.flatnonzero(np.asarray(table.values("Status", raw=True)) >= 3)
    stamps = table.stamp_ns[rows]
    there, before, after = (truth.at(stamps + shift_ns) for shift_ns in (0, -_HALF_NS, _HALF_NS))
    course_deg, speed_mps = (np.asarray(table.values(name, rows), dtype=np.float64) for name in ("GCrs", "Spd"))
    known = np.isfinite(there + before + after).all(axis=1) & np.isfinite(course_deg)
    known &= np.isfinite(speed_mps) & (speed_mps > _MOVING_MPS)
    if not known.any():
        return None
    frame, level_m = LocalFrame(*map(float, truth.values[0])), np.zeros(int(known.sum()))
    at, behind, ahead = (frame.ned(each[known, 0], each[known, 1], level_m)[:, :2] for each in (there, before, after))
    fixes = frame.ned(table.values("Lat", rows[known]), table.values("Lng", rows[known]), level_m)[:, :2]
    true_mps = (ahead - behind) / (2e-9 * _HALF_NS)
    course = np.radians(course_deg[known])
    fast_mps = speed_mps[known, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
    unlike = np.median(np.linalg.norm(fast_mps - true_mps, axis=1) / speed_mps[known])
    apart_m = float(np.linalg.norm(fixes - at, axis=1).max())
    return apart_m if unlike > _UNLIKE and apart_m > _APART_M else None


def is_of_its_world(told: Series, simulated: Series) -> bool:
    """Whether the place that a log tells is the one its simulator moved (SIM), by and large.

    Where the senses come from elsewhere the simulated vehicle stands still, or is driven by the same outputs to another
    place.
    """
    latitude, longitude, altitude = map(float, simulated.values[0])
    origin = (latitude, longitude, altitude)
    true_m = ardupilot_ned(origin, simulated.values)[:, :2]
    extent_m = float(np.hypot(*np.ptp(true_m, axis=0)))
    if extent_m < _STILL_M:
        return False
    at = simulated.at(told.stamp_ns)
    known = np.isfinite(at).all(axis=1)
    if not known.any():
        return False
    apart = ardupilot_ned(origin, told.values[known]) - ardupilot_ned(origin, at[known])
    return float(np.median(np.hypot(apart[:, 0], apart[:, 1]))) < _NEAR_SHARE * extent_m
