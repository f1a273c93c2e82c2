"""How the vessel lay and how it moved."""

from __future__ import annotations

import numpy as np

from sim_core.frames import flu_to_frd, quat_ned_frd_to_enu_flu, quat_to_euler
from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.series import Of, Series, column, first, series, vectors, whole
from xitl_cli.logs.signals.simulated_world import simulators_own

_QUATERNION = tuple(f"pose.pose.orientation.{axis}" for axis in "wxyz")
_LINEAR = tuple(f"twist.twist.linear.{axis}" for axis in "xyz")
_ANGLES = {"roll": 0, "pitch": 1, "yaw": 2}
_DEG = 180.0 / np.pi


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
            lambda log: simulators_own(log, _hypot(log, "SIM2", "VN", "VE")),
        )
    return first(
        log,
        lambda log: _hypot(log, "XKF1", "VN", "VE"),
        lambda log: _hypot(log, "NKF1", "VN", "VE"),
        lambda log: column(log, "GPS", "Spd", "m/s"),
        lambda log: _odometry_speed(log, "/estimate/odometry"),
        lambda log: _radio(log, "VFR_HUD", "groundspeed", "m/s"),
        lambda log: next((found for name in odometries(log) if (found := _odometry_speed(log, name))), None),
    )


def _angle(log: Log, name: str, logged: str, of: Of) -> Series | None:
    turns = name == "yaw"
    if of == "truth":
        return first(
            log,
            lambda log: simulators_own(log, column(log, "SIM", logged, "deg", turns=turns)),
            lambda log: _odometry_angle(log, "/truth/odometry", name),
        )
    return first(
        log,
        lambda log: column(log, "ATT", logged, "deg", turns=turns),
        lambda log: _odometry_angle(log, "/estimate/odometry", name),
        lambda log: _turned(_radio(log, "ATTITUDE", name, "deg", factor=_DEG, turns=turns)),
        lambda log: next((found for each in odometries(log) if (found := _odometry_angle(log, each, name))), None),
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


def odometries(log: Log) -> list[str]:
    """Topics that carry nav_msgs/Odometry and are not ours."""
    if log.format != "mcap":
        return []
    ours = {"/truth/odometry", "/estimate/odometry"}
    return [name for name, table in log.tables.items() if name not in ours and _QUATERNION[0] in table.columns]


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
