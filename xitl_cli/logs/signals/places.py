"""Where the vessel was."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame, ardupilot_ned
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.geodetic import HIGHEST_M, geodetic, on_earth
from xitl_cli.logs.signals.motion import odometries
from xitl_cli.logs.signals.series import Of, Series, Way, first, series, vectors, whole
from xitl_cli.logs.signals.simulated_world import is_of_its_world, simulators_own

_POSITION = tuple(f"pose.pose.position.{axis}" for axis in "xyz")


@dataclass(frozen=True, slots=True)
class Position:
    """north, east, down (m) about `origin` (latitude and longitude in deg, altitude in m): `path.values` is (N, 3).

    origin None: local axes whose place on the Earth the log does not tell.
    """

    path: Series
    origin: tuple[float, float, float] | None


def position_geodetic(log: Log, of: Of = "estimate") -> Series | None:
    """(N, 3) latitude and longitude (deg) and altitude (m)."""
    ways: tuple[Way, ...]
    if of == "truth":
        ways = (
            lambda log: simulators_own(log, geodetic(log, "SIM", ("Lat", "Lng", "Alt"))),
            partial(geodetic, table="/truth/fix", names=("latitude", "longitude", "altitude")),
        )
    else:
        ways = (
            partial(geodetic, table="POS", names=("Lat", "Lng", "Alt")),
            partial(geodetic, table="GPS", names=("Lat", "Lng", "Alt")),
            _estimated_geodetic,
            partial(_radio_geodetic, message="GLOBAL_POSITION_INT"),
            partial(_radio_geodetic, message="GPS_RAW_INT"),
            _any_fix,
        )
    return first(log, *ways)


def position_ned(log: Log, of: Of = "estimate", origin: tuple[float, float, float] | None = None) -> Position | None:
    """About `origin`; without one about the origin of the log's own local frame, or its first position."""
    local = _local(log, "/truth/odometry" if of == "truth" else "/estimate/odometry")
    if local is None and of == "estimate":
        local = next((found for name in odometries(log) if (found := _local(log, name))), None)
    own = _site(log)
    if local is not None and (origin is None or own is not None):
        if origin is None or origin == own:
            return Position(local, own)
        moved = LocalFrame(*origin).ned(*LocalFrame(*own).geodetic(local.values)) if own is not None else local.values
        return Position(Series(local.stamp_ns, moved, "m", local.source, dropped=local.dropped), origin)
    geodetic = position_geodetic(log, of)
    if geodetic is None:
        return None
    about = origin or _estimator_origin(log) or own or _first_place(geodetic)
    path = _metres(log, geodetic, of, about)
    found = Series(geodetic.stamp_ns, path, "m", geodetic.source, dropped=geodetic.dropped)
    return Position(found, about)


def _simulated(log: Log) -> Series | None:
    """Where ArduPilot's own simulator says the vehicle is; without a height from telemetry."""
    if (found := geodetic(log, "SIM", ("Lat", "Lng", "Alt"))) is not None:
        return found
    table = whole(log, "SIMSTATE")
    if table is None or (place := vectors(table, ("lat", "lng"))) is None:
        return None
    return on_earth(table.stamp_ns, np.column_stack([place, np.zeros(len(place))]), "SIMSTATE")


def _first_place(geodetic: Series) -> tuple[float, float, float]:
    """Its first row, fit to be an origin."""
    latitude, longitude, altitude = map(float, geodetic.values[0])
    return latitude, longitude, altitude if abs(altitude) <= HIGHEST_M else 0.0


def _metres(log: Log, geodetic: Series, of: Of, about: tuple[float, float, float]) -> NDArray[np.float64]:
    """(N, 3) north, east, down about a place, by the metres of the world that the log is of."""
    simulated = _simulated(log)
    frame = LocalFrame(*about)
    if simulated is None or not (of == "truth" or is_of_its_world(geodetic, simulated)):
        return frame.ned(*geodetic.values.T)
    own = _estimator_origin(log) or _first_place(simulated)
    flat = ardupilot_ned(own, geodetic.values)
    return flat if about == own else frame.ned(*LocalFrame(*own).geodetic(flat))


def _local(log: Log, topic: str) -> Series | None:
    table = whole(log, topic)
    if table is None or (enu := vectors(table, _POSITION)) is None:
        return None
    ned = np.stack([enu[:, 1], enu[:, 0], -enu[:, 2]], axis=1)
    return series(table.stamp_ns, ned, "m", f"{topic}.pose.pose.position")


def _radio_geodetic(log: Log, message: str) -> Series | None:
    for name in (message, f"/link/agent/rx:{message}"):
        if (found := geodetic(log, name, ("lat", "lon", "alt"))) is not None:
            return found
    return None


def _any_fix(log: Log) -> Series | None:
    if log.format != "mcap":
        return None
    names = ("latitude", "longitude", "altitude")
    topics = [
        name
        for name, table in log.tables.items()
        if all(field in table.columns for field in names) and not name.startswith("/truth")
    ]
    return next((found for topic in topics if (found := geodetic(log, topic, names)) is not None), None)


def _estimated_geodetic(log: Log) -> Series | None:
    local, site = _local(log, "/estimate/odometry"), _site(log)
    if local is None or site is None:
        return None
    geodetic = np.stack(LocalFrame(*site).geodetic(local.values), axis=1)
    return Series(local.stamp_ns, geodetic, "deg, deg, m", local.source, dropped=local.dropped)


def _site(log: Log) -> tuple[float, float, float] | None:
    """The local origin of a recording of ours: back from a true fix by the true position of that instant."""
    if log.format != "mcap":
        return None
    fix = geodetic(log, "/truth/fix", ("latitude", "longitude", "altitude"))
    truth = _local(log, "/truth/odometry")
    if fix is None or truth is None:
        return None
    known = np.isfinite(at := truth.at(fix.stamp_ns)).all(axis=1)
    if not known.any():
        return None
    nearest = int(np.argmin(np.where(known, np.hypot(at[:, 0], at[:, 1]), np.inf)))
    here = LocalFrame(*map(float, fix.values[nearest]))
    latitude, longitude, altitude = here.geodetic(-at[nearest : nearest + 1])
    return float(latitude[0]), float(longitude[0]), float(altitude[0])


def _estimator_origin(log: Log) -> tuple[float, float, float] | None:
    """Of the last ORGN of type 0, ArduPilot's EKF origin."""
    table = log.tables.get("ORGN")
    if table is None or (place := vectors(table, ("Type", "Lat", "Lng", "Alt"))) is None:
        return None
    rows = place[(place[:, 0] == 0.0) & np.isfinite(place).all(axis=1) & (np.abs(place[:, 1]) <= 90.0)]
    rows = rows[(np.abs(rows[:, 2]) <= 180.0) & (np.abs(rows[:, 3]) <= HIGHEST_M)]
    return None if not len(rows) else (float(rows[-1, 1]), float(rows[-1, 2]), float(rows[-1, 3]))
