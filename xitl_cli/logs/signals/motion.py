"""Attitude, speed and place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import flu_to_frd, quat_ned_frd_to_enu_flu, quat_to_euler
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.flat_earth import flat_ned, is_of_its_world
from xitl_cli.logs.signals.series import Of, Series, Way, column, first, series, vectors, whole

_QUATERNION = tuple(f"pose.pose.orientation.{axis}" for axis in "wxyz")
_POSITION = tuple(f"pose.pose.position.{axis}" for axis in "xyz")
_LINEAR = tuple(f"twist.twist.linear.{axis}" for axis in "xyz")
_ANGLES = {"roll": 0, "pitch": 1, "yaw": 2}
_DEG = 180.0 / np.pi
_HIGHEST_M = 10e3
_HIGHEST_M = 10e3  # beyond it a local frame has no meaning


@dataclass(frozen=True, slots=True)
class Position:
    """north, east, down (m) about `origin` (latitude and longitude in deg, altitude in m): `path.values` is (N, 3).

    origin None: local axes whose place on the Earth the log does not tell.
    """

    path: Series
    origin: tuple[float, float, float] | None


def roll(log: Log, of: Of = "estimate") -> Series | None:
    """Degrees, positive to starboard."""
    return _angle(log, "roll", "Roll", of)


def pitch(log: Log, of: Of = "estimate") -> Series | None:
    """Degrees, positive bow up."""
    return _angle(log, "pitch", "Pitch", of)


def yaw(log: Log, of: Of = "estimate") -> Series | None:
    """Degrees from north, clockwise, 0 to 360."""
    return _angle(log, "yaw", "Yaw", of)


def yaw_desired(log: Log) -> Series | None:
    """Degrees, what the control aims at."""
    return first(
        log,
        lambda log: column(log, "ATT", "DesYaw", "deg", turns=True),
        lambda log: _radio(log, "NAV_CONTROLLER_OUTPUT", "nav_bearing", "deg", turns=True),
    )


def yaw_rate(log: Log, of: Of = "estimate") -> Series | None:
    """Degrees a second, clockwise from above."""
    if of == "truth":
        return _true_yaw_rate(log)
    return first(
        log,
        lambda log: column(log, "IMU", "GyrZ", "deg/s", factor=_DEG),
        lambda log: _radio(log, "ATTITUDE", "yawspeed", "deg/s", factor=_DEG),
        lambda log: _odometry_yaw_rate(log, "/estimate/odometry"),
        _any_imu_yaw_rate,
    )


def ground_speed(log: Log, of: Of = "estimate") -> Series | None:
    """Metres a second over ground. DataFlash: the estimator's (XKF1), else the receiver's (GPS.Spd)."""
    if of == "truth":
        return first(
            log,
            lambda log: _norm(log, "/truth/state", "velocity_ned_mps"),
            lambda log: _hypot(log, "SIM2", "VN", "VE"),
        )
    return first(
        log,
        lambda log: _hypot(log, "XKF1", "VN", "VE"),
        lambda log: _hypot(log, "NKF1", "VN", "VE"),
        lambda log: column(log, "GPS", "Spd", "m/s"),
        lambda log: _odometry_speed(log, "/estimate/odometry"),
        lambda log: _radio(log, "VFR_HUD", "groundspeed", "m/s"),
        lambda log: next((found for name in _odometries(log) if (found := _odometry_speed(log, name))), None),
    )


def position_geodetic(log: Log, of: Of = "estimate") -> Series | None:
    """(N, 3) latitude and longitude (deg) and altitude (m)."""
    ways: tuple[Way, ...]
    if of == "truth":
        ways = (
            partial(_geodetic, table="SIM", names=("Lat", "Lng", "Alt")),
            partial(_geodetic, table="/truth/fix", names=("latitude", "longitude", "altitude")),
        )
    else:
        ways = (
            partial(_geodetic, table="POS", names=("Lat", "Lng", "Alt")),
            partial(_geodetic, table="GPS", names=("Lat", "Lng", "Alt")),
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
        local = next((found for name in _odometries(log) if (found := _local(log, name))), None)
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
    if (found := _geodetic(log, "SIM", ("Lat", "Lng", "Alt"))) is not None:
        return found
    table = whole(log, "SIMSTATE")
    if table is None or (place := vectors(table, ("lat", "lng"))) is None:
        return None
    return _on_earth(table.stamp_ns, np.column_stack([place, np.zeros(len(place))]), "SIMSTATE")


def _first_place(geodetic: Series) -> tuple[float, float, float]:
    """Its first row, fit to be an origin."""
    latitude, longitude, altitude = map(float, geodetic.values[0])
    return latitude, longitude, altitude if abs(altitude) <= _HIGHEST_M else 0.0


def _metres(log: Log, geodetic: Series, of: Of, about: tuple[float, float, float]) -> NDArray[np.float64]:
    """(N, 3) north, east, down about a place, by the metres of the world that the log is of."""
    simulated = _simulated(log)
    frame = LocalFrame(*about)
    if simulated is None or not (of == "truth" or is_of_its_world(geodetic, simulated)):
        return frame.ned(*geodetic.values.T)
    own = _estimator_origin(log) or _first_place(simulated)
    flat = flat_ned(own, geodetic.values)
    return flat if about == own else frame.ned(*LocalFrame(*own).geodetic(flat))


def _angle(log: Log, name: str, logged: str, of: Of) -> Series | None:
    turns = name == "yaw"
    if of == "truth":
        return first(
            log,
            lambda log: column(log, "SIM", logged, "deg", turns=turns),
            lambda log: _odometry_angle(log, "/truth/odometry", name),
        )
    return first(
        log,
        lambda log: column(log, "ATT", logged, "deg", turns=turns),
        lambda log: _odometry_angle(log, "/estimate/odometry", name),
        lambda log: _turned(_radio(log, "ATTITUDE", name, "deg", factor=_DEG, turns=turns)),
        lambda log: next((found for each in _odometries(log) if (found := _odometry_angle(log, each, name))), None),
    )


def _turned(found: Series | None) -> Series | None:
    """Yaw of ±180 degrees as 0 to 360."""
    if found is None or not found.turns:
        return found
    return Series(found.stamp_ns, np.mod(found.values, 360.0), "deg", found.source, True, found.dropped)


def _radio(log: Log, message: str, field: str, unit: str, *, factor: float = 1.0, turns: bool = False) -> Series | None:
    """From telemetry: of a .tlog, or of the autopilot's frames in a recording of ours."""
    return first(
        log,
        lambda log: column(log, message, field, unit, factor=factor, turns=turns),
        lambda log: column(log, f"/link/agent/rx:{message}", field, unit, factor=factor, turns=turns),
    )


def _odometries(log: Log) -> list[str]:
    """Topics that carry nav_msgs/Odometry and are not ours."""
    if log.format != "mcap":
        return []
    ours = {"/truth/odometry", "/estimate/odometry"}
    return [name for name, table in log.tables.items() if name not in ours and _QUATERNION[0] in table.columns]


def _local(log: Log, topic: str) -> Series | None:
    table = whole(log, topic)
    if table is None or (enu := vectors(table, _POSITION)) is None:
        return None
    ned = np.stack([enu[:, 1], enu[:, 0], -enu[:, 2]], axis=1)
    return series(table.stamp_ns, ned, "m", f"{topic}.pose.pose.position")


def _odometry_angle(log: Log, topic: str, name: str) -> Series | None:
    table = whole(log, topic)
    if table is None or (quaternion := vectors(table, _QUATERNION)) is None:
        return None
    # The same product of quaternions leads from ENU and FLU back to NED and FRD.
    with np.errstate(invalid="ignore", divide="ignore"):
        euler = quat_to_euler(quat_ned_frd_to_enu_flu(quaternion))
    angle = euler[:, _ANGLES[name]] * _DEG
    turns = name == "yaw"
    return series(
        table.stamp_ns, np.mod(angle, 360.0) if turns else angle, "deg", f"{topic}.pose.pose.orientation", turns=turns
    )


def _odometry_speed(log: Log, topic: str) -> Series | None:
    table = whole(log, topic)
    if table is None or (linear := vectors(table, _LINEAR)) is None:
        return None
    return series(table.stamp_ns, np.hypot(linear[:, 0], linear[:, 1]), "m/s", f"{topic}.twist.twist.linear")


def _odometry_yaw_rate(log: Log, topic: str) -> Series | None:
    table = whole(log, topic)
    if table is None or (angular := vectors(table, tuple(f"twist.twist.angular.{axis}" for axis in "xyz"))) is None:
        return None
    return series(table.stamp_ns, flu_to_frd(angular)[:, 2] * _DEG, "deg/s", f"{topic}.twist.twist.angular.z")


def _any_imu_yaw_rate(log: Log) -> Series | None:
    """Of a sensor_msgs/Imu topic, FLU."""
    if log.format != "mcap":
        return None
    name = next((name for name, table in log.tables.items() if "angular_velocity.z" in table.columns), None)
    return None if name is None else column(log, name, "angular_velocity.z", "deg/s", factor=-_DEG)


def _true_yaw_rate(log: Log) -> Series | None:
    table = log.tables.get("/truth/state")
    if table is None or "angular_velocity_frd_radps" not in table.columns:
        return None
    rates = table.values("angular_velocity_frd_radps")
    return series(table.stamp_ns, rates[:, 2] * _DEG, "deg/s", "/truth/state.angular_velocity_frd_radps[2]")


def _norm(log: Log, name: str, field: str) -> Series | None:
    table = log.tables.get(name)
    if table is None or field not in table.columns:
        return None
    values = table.values(field)
    return series(table.stamp_ns, np.hypot(values[:, 0], values[:, 1]), "m/s", f"{name}.{field}")


def _hypot(log: Log, name: str, north: str, east: str) -> Series | None:
    table = whole(log, name)
    if table is None or (parts := vectors(table, (north, east))) is None:
        return None
    return series(table.stamp_ns, np.hypot(parts[:, 0], parts[:, 1]), "m/s", f"{name}.{north}, {east}")


def _geodetic(log: Log, table: str, names: tuple[str, str, str]) -> Series | None:
    found = whole(log, table)
    if found is None or (values := vectors(found, names)) is None:
        return None
    return _on_earth(found.stamp_ns, values, table)


def _on_earth(stamp_ns: NDArray[np.int64], values: NDArray[np.float64], source: str) -> Series | None:
    """Without the zeros of a receiver that has no fix yet."""
    with np.errstate(invalid="ignore"):
        fixed = (np.abs(values[:, 0]) <= 90.0) & (np.abs(values[:, 1]) <= 180.0)
        fixed &= (values[:, 0] != 0.0) | (values[:, 1] != 0.0)
        fixed &= np.abs(values[:, 2]) <= _HIGHEST_M
    return series(stamp_ns[fixed], values[fixed], "deg, deg, m", source)


def _radio_geodetic(log: Log, message: str) -> Series | None:
    for name in (message, f"/link/agent/rx:{message}"):
        if (found := _geodetic(log, name, ("lat", "lon", "alt"))) is not None:
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
    return next((found for topic in topics if (found := _geodetic(log, topic, names)) is not None), None)


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
    fix = _geodetic(log, "/truth/fix", ("latitude", "longitude", "altitude"))
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
    rows = rows[(np.abs(rows[:, 2]) <= 180.0) & (np.abs(rows[:, 3]) <= _HIGHEST_M)]
    return None if not len(rows) else (float(rows[-1, 1]), float(rows[-1, 2]), float(rows[-1, 3]))
