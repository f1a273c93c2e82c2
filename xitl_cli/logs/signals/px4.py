"""Quantities of a ULog, from PX4's own topics. None, or empty, for a log of another format.

States and numbers: msg/versioned/VehicleStatus.msg of PX4 1.16; older versions use the same numbers for fewer states.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.frames import quat_to_euler
from xitl_cli.logs.model.codes import VehicleKind, kind_from_mav_type
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Flags, Floats, Selection, Stamps, Table
from xitl_cli.logs.signals.series import (
    Series,
    SignalSource,
    channel_series,
    first_instance,
    make_series,
    numbers,
    stacked,
)

NAV_STATES: Mapping[int, str] = {
    0: "Manual", 1: "Altitude", 2: "Position", 3: "Mission", 4: "Hold", 5: "Return", 6: "Position slow",
    8: "Altitude cruise", 10: "Acro", 12: "Descend", 13: "Termination", 14: "Offboard", 15: "Stabilized",
    17: "Takeoff", 18: "Land", 19: "Follow target", 20: "Precision land", 21: "Orbit", 22: "VTOL takeoff",
    **{number: f"External {number - 22}" for number in range(23, 31)},
}  # fmt: skip
_ARMED = 2
_ANGLES = {"roll": 0, "pitch": 1, "yaw": 2}
_KINDS: Mapping[int, VehicleKind] = {1: "copter", 2: "plane", 3: "rover"}
_TRUTH = "_groundtruth"


def topic(log: Log, name: str) -> Table | None:
    """First instance of a topic; None if the log is no ULog or lacks the topic."""
    return first_instance(log, name) if log.format == "ulog" else None


def angle(log: Log, name: str, of: SignalSource = "estimate") -> Series | None:
    """Roll, pitch or yaw (deg) by the quaternion of vehicle_attitude, from NED to FRD."""
    source = "vehicle_attitude" + (_TRUTH if of == "truth" else "")
    table = topic(log, source)
    quaternion = None if table is None else numbers(table, "q")
    if table is None or quaternion is None or quaternion.ndim != 2 or quaternion.shape[1] != 4:
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        angles = np.degrees(quat_to_euler(quaternion)[:, _ANGLES[name]])
    turns = name == "yaw"
    return make_series(table.stamp_ns, np.mod(angles, 360.0) if turns else angles, "deg", f"{source}.q", turns=turns)


def ground_speed(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Speed over ground (m/s) by vehicle_local_position."""
    source = "vehicle_local_position" + (_TRUTH if of == "truth" else "")
    table = topic(log, source)
    parts = None if table is None else stacked(table, ("vx", "vy"))
    if table is None or parts is None:
        return None
    valid = numbers(table, "v_xy_valid")
    known = np.ones(len(parts), np.bool_) if valid is None or of == "truth" else valid > 0.0
    return make_series(table.stamp_ns[known], np.hypot(*parts[known].T), "m/s", f"{source}.vx, vy")


def yaw_rate(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Yaw rate (deg/s), clockwise from above."""
    source = "vehicle_angular_velocity" + (_TRUTH if of == "truth" else "")
    table = topic(log, source)
    rates = None if table is None else numbers(table, "xyz")
    if table is None or rates is None or rates.ndim != 2:
        return None
    return make_series(table.stamp_ns, np.degrees(rates[:, 2]), "deg/s", f"{source}.xyz[2]")


def geodetic(log: Log, of: SignalSource = "estimate") -> tuple[Stamps, Floats, str] | None:
    """Stamps, latitude and longitude (deg) and altitude (m), and the topic: from the estimate, else from the
    receiver."""
    truth = _TRUTH if of == "truth" else ""
    ways = [(f"vehicle_global_position{truth}", ("lat", "lon", "alt"))]
    if of == "estimate":
        for name in ("vehicle_gps_position", "sensor_gps"):
            ways += [(name, ("latitude_deg", "longitude_deg", "altitude_msl_m")), (name, ("lat", "lon", "alt"))]
    for name, fields in ways:
        table = topic(log, name)
        place = None if table is None else stacked(table, fields)
        if table is not None and place is not None and np.isfinite(place).all(axis=1).any():
            return table.stamp_ns, place, name
    return None


def arm_states(log: Log) -> tuple[Stamps, Flags, str] | None:
    table = topic(log, "vehicle_status")
    if table is None or "arming_state" not in table.columns:
        return None
    return table.stamp_ns, table.values("arming_state") == _ARMED, "vehicle_status.arming_state"


def nav_states(log: Log) -> tuple[Stamps, Stamps, str] | None:
    table = topic(log, "vehicle_status")
    if table is None or "nav_state" not in table.columns:
        return None
    return table.stamp_ns, table.values("nav_state").astype(np.int64), "vehicle_status.nav_state"


def vehicle_kind(log: Log) -> VehicleKind:
    table = topic(log, "vehicle_status")
    kind: VehicleKind = "unknown"
    if table is not None and "vehicle_type" in table.columns and len(table):
        kind = _KINDS.get(int(table.values("vehicle_type")[-1]), "unknown")
    if kind == "unknown" and table is not None and "system_type" in table.columns and len(table):
        kind = kind_from_mav_type(int(table.values("system_type")[-1]))
    return kind


def release(log: Log) -> tuple[str | None, str | None, str | None]:
    """Version, commit and board from the log's information."""
    facts = log.facts if log.format == "ulog" else {}
    packed = facts.get("ver_sw_release", "")
    number = int(packed) if packed.isdigit() else 0
    version = f"{number >> 24 & 255}.{number >> 16 & 255}.{number >> 8 & 255}" if number else None
    return version, facts.get("ver_sw", "")[:8] or None, facts.get("ver_hw")


def outputs(log: Log) -> dict[int, Series]:
    """Outputs by channel from 1: pulse widths (us) of actuator_outputs, for outputs in use."""
    table = topic(log, "actuator_outputs")
    values = None if table is None else numbers(table, "output")
    if table is None or values is None or values.ndim != 2:
        return {}
    used = values.shape[1]
    count = numbers(table, "noutputs")
    if count is not None and len(count):
        used = int(np.clip(np.nanmax(count), 0, used))
    return channel_series(table, values[:, :used], "us", "output", used_only=True)


def utc(log: Log) -> tuple[Stamps, Stamps] | None:
    """Stamps, and UTC (ns) as reported by the receiver at each; 0 if unknown."""
    for name in ("vehicle_gps_position", "sensor_gps"):
        table = topic(log, name)
        if table is not None and {"time_utc_usec", "fix_type"} <= set(table.columns):
            fixed = Selection(table, table.values("fix_type") >= 3)
            if len(fixed):
                utc_ns = np.minimum(fixed.values("time_utc_usec"), 1 << 52).astype(np.int64) * 1_000
                return fixed.stamp_ns, utc_ns
    return None
