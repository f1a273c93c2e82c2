"""Satellite receivers of a log, in any format."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.model.log import Log, once_per_log
from xitl_cli.logs.model.table import Floats, Stamps, Table, by_instance, first_of
from xitl_cli.logs.signals.motion import topic_source
from xitl_cli.logs.signals.sensors import sample_times
from xitl_cli.logs.signals.series import bounded_stamps, instance_label, message_of, numbers, stacked, tables_of

FIX_3D = 3
FIX_NAMES = {
    0: "no receiver",
    1: "no fix",
    2: "2D fix",
    3: "3D fix",
    4: "3D fix with differential corrections",
    5: "RTK float",
    6: "RTK fixed",
    7: "static",
    8: "PPP",
}


@dataclass(frozen=True, slots=True)
class ReceiverAccuracy:
    """Accuracy reported by the receiver, in GPA or in the fix. stamp_ns (N,); each other array (N,) or None."""

    message: str
    stamp_ns: Stamps
    horizontal_m: Floats | None
    vertical_m: Floats | None
    speed_mps: Floats | None
    message_ms: Floats | None
    interval_ms: Floats | None


@dataclass(frozen=True, slots=True)
class GnssReceiver:
    """One receiver."""

    name: str
    message: str
    fields: dict[str, str]
    """The log's own names."""
    stamp_ns: Stamps
    sample_ns: Stamps
    """On the receiver's clock if that is logged."""
    fix: Stamps
    """(N,) as MAVLink's GPS_FIX_TYPE."""
    satellites: Floats | None
    hdop: Floats | None
    lat_deg: Floats
    """(N,) NaN without a fix."""
    lon_deg: Floats
    """(N,) NaN without a fix."""
    vel_ned_mps: Floats
    """(N, 3) NaN if not logged."""
    speed_mps: Floats | None
    week: Floats | None
    """GPS time."""
    accuracy: ReceiverAccuracy | None


_LAT = ("Lat", "latitude_deg", "lat", "latitude")
_LON = ("Lng", "longitude_deg", "lon", "longitude")
_FIX = ("Status", "fix_type", "status.status")
_SATELLITES = ("NSats", "satellites_visible", "satellites", "satellites_used")
_HDOP = ("HDop", "hdop", "eph")
_SPEED = ("Spd", "vel", "vel_m_s")
_COURSE = ("GCrs", "cog")
_DOWN = ("VZ",)
_KINDS = ("GPS", "GPS2", "GPS_RAW_INT", "GPS2_RAW", "XITL_GNSS", "sensor_gps")


_OLD_PX4 = "vehicle_gps_position"
"""The receivers of PX4 until 1.11; since then, PX4's combination of all receivers."""


@once_per_log
def gnss_receivers(log: Log) -> list[GnssReceiver]:
    """Every instance with at least three rows and at any time a fix or a satellite."""
    tables = [*(tables_of(log, _KINDS) or tables_of(log, (_OLD_PX4,)))]
    # Topics of sensor_msgs/NavSatFix, without a simulator's truth.
    for name, table in log.tables.items():
        if topic_source(name) == "estimate" and {"status.status", "latitude"} <= set(table.columns):
            tables.append(table)
    receivers: list[GnssReceiver] = []
    for table in tables:
        for number, rows in by_instance(table).items():
            receiver = _receiver(log, instance_label(table, number), rows, number) if len(rows) >= 3 else None
            if receiver is not None:
                receivers.append(receiver)
    return receivers


def injected_receivers(log: Log) -> list[GnssReceiver]:
    """Fixes that the autopilot received, from the frames of its link in an xitl recording."""
    names = [f"{name}:XITL_GNSS" for name in log.tables if name.endswith("/link/agent/tx")]
    receivers = [_receiver(log, "XITL_GNSS", log.tables[name], 0) for name in names if name in log.tables]
    return [receiver for receiver in receivers if receiver is not None and len(receiver.stamp_ns) >= 3]


def _receiver(log: Log, name: str, table: Table, number: int) -> GnssReceiver | None:
    fields = {
        key: column
        for key, names in (
            ("lat", _LAT), ("lon", _LON), ("fix", _FIX), ("satellites", _SATELLITES), ("hdop", _HDOP),
            ("speed", _SPEED), ("course", _COURSE), ("down", _DOWN),
        )
        if (column := first_of(table, names)) is not None
    }  # fmt: skip
    if any(key not in fields for key in ("lat", "lon", "fix")):
        return None
    columns = {key: numbers(table, column) for key, column in fields.items()}
    lat, lon, status = columns["lat"], columns["lon"], columns["fix"]
    if lat is None or lon is None or status is None:
        return None
    fix = np.nan_to_num(status).astype(np.int64)
    if "status.status" in table.columns:
        fix = np.where(fix < 0, 1, FIX_3D + np.minimum(fix, 1))  # STATUS_NO_FIX is -1, STATUS_FIX 0
    satellites = columns.get("satellites")
    if not (fix >= 2).any() and (satellites is None or not (satellites > 0).any()):
        return None
    blind = (fix < 2) | ((lat == 0.0) & (lon == 0.0)) | (np.abs(lat) > 90.0) | (np.abs(lon) > 180.0)
    speed = columns.get("speed")
    if speed is None or speed.ndim != 1:
        speed = None
    elif table.name != "GPS" and message_of(table.name).endswith(("_RAW", "_INT")):
        # MAVLink's 65535 means unknown.
        speed = np.where(np.asarray(table.values(fields["speed"], raw=True)) == 65535, np.nan, speed)
    velocity = _velocity(table, speed, columns.get("course"), columns.get("down"))
    if speed is None:
        logged = numbers(table, "velocity")
        speed = np.hypot(logged[:, 0], logged[:, 1]) if logged is not None and logged.ndim == 2 else None
    # Dilution of precision. MAVLink's eph is a dilution times 100, or 65535 for unknown.
    values = columns.get("hdop")
    if values is None or "eph" not in table.columns or "hdop" in table.columns:
        hdop = values
    else:
        raw = np.asarray(table.values("eph", raw=True), dtype=np.float64)
        hdop = np.where(raw == 65535, np.nan, raw * 0.01)
    return GnssReceiver(
        name=name,
        message=table.name,
        fields=fields,
        stamp_ns=bounded_stamps(table),
        sample_ns=sample_times(table).clock_ns,
        fix=fix,
        satellites=None if satellites is None else np.where(satellites >= 255, np.nan, satellites),
        hdop=hdop,
        lat_deg=np.where(blind, np.nan, lat),
        lon_deg=np.where(blind, np.nan, lon),
        vel_ned_mps=velocity,
        speed_mps=speed,
        week=numbers(table, first_of(table, ("GWk", "Week")) or ""),
        accuracy=_accuracy(log, table, number),
    )


def _velocity(table: Table, speed: Floats | None, course_deg: Floats | None, down: Floats | None) -> Floats:
    velocity = numbers(table, "velocity")
    if velocity is None:
        velocity = stacked(table, ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"))
    if velocity is not None and velocity.ndim == 2 and velocity.shape[1] >= 3:
        return velocity[:, :3]
    unknown = np.full(len(table), np.nan)
    if speed is None or course_deg is None:
        return np.stack([unknown, unknown, unknown if down is None else down], axis=1)
    course = np.radians(course_deg)
    return np.stack([speed * np.cos(course), speed * np.sin(course), unknown if down is None else down], axis=1)


def _accuracy(log: Log, table: Table, number: int) -> ReceiverAccuracy | None:
    names: tuple[str, ...] = ()
    if "h_acc" in table.columns:
        names = ("h_acc", "v_acc", first_of(table, ("s_acc", "vel_acc")) or "")
    elif "satellites_used" in table.columns and "eph" in table.columns:  # from PX4: metres
        names = ("eph", "epv", "s_variance_m_s")
    if names:
        horizontal, vertical, speed = (_known(numbers(table, name)) for name in names)
        return ReceiverAccuracy(table.name, bounded_stamps(table), horizontal, vertical, speed, None, None)
    covariance = numbers(table, "position_covariance")
    if covariance is not None and covariance.ndim == 2 and covariance.shape[1] == 9:
        east, north, up = (np.maximum(covariance[:, place], 0.0) for place in (0, 4, 8))
        horizontal, vertical = _known(np.sqrt(0.5 * (east + north))), _known(np.sqrt(up))
        return ReceiverAccuracy(table.name, bounded_stamps(table), horizontal, vertical, None, None, None)
    accuracies = log.tables.get({"GPS": "GPA", "GPS2": "GPA2"}.get(table.name, ""))
    rows = None if accuracies is None else by_instance(accuracies).get(number)
    if accuracies is None or rows is None:
        return None
    return ReceiverAccuracy(
        accuracies.name,
        bounded_stamps(rows),
        _known(numbers(rows, "HAcc")),
        _known(numbers(rows, "VAcc")),
        _known(numbers(rows, "SAcc")),
        numbers(rows, "SMS", raw=True),
        numbers(rows, "Delta", raw=True),
    )


def _known(values: Floats | None) -> Floats | None:
    """The values; None if all are 0 or not finite, because the receiver does not report them."""
    return values if values is not None and np.nan_to_num(values).any() else None
