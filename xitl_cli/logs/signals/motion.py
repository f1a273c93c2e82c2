"""Position, attitude, speed and turn rate of the vessel, estimated or true."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from weakref import WeakKeyDictionary

import numpy as np

import xitl_cli.logs.signals.px4 as px4
from sim_core.frames import flu_to_frd, quat_ned_frd_to_enu_flu, quat_to_euler
from sim_core.geodesy import LocalFrame, ardupilot_ned
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table
from xitl_cli.logs.signals.series import (
    Series,
    SeriesReader,
    SignalSource,
    column_series,
    first_instance,
    first_series,
    make_series,
    stacked_columns,
)
from xitl_cli.logs.signals.spans import runs
from xitl_cli.logs.signals.states import rows_in_use

HIGHEST_M = 10e3  # beyond it, a local frame has no meaning


def geodetic_series(log: Log, table: str, names: tuple[str, str, str]) -> Series | None:
    found = first_instance(log, table)
    if found is None or (values := stacked_columns(found, names)) is None:
        return None
    return fixed_on_earth(found.stamp_ns, values, table)


def fixed_on_earth(stamp_ns: Stamps, values: Floats, source: str) -> Series | None:
    """A geodetic series without the zeros of a receiver that has no fix yet."""
    with np.errstate(invalid="ignore"):
        fixed = (np.abs(values[:, 0]) <= 90.0) & (np.abs(values[:, 1]) <= 180.0)
        fixed &= (values[:, 0] != 0.0) | (values[:, 1] != 0.0)
        fixed &= np.abs(values[:, 2]) <= HIGHEST_M
    return make_series(stamp_ns[fixed], values[fixed], "deg, deg, m", source)


_STILL_M = 5.0
_NEAR_SHARE = 0.02
_APART_M = 20.0  # between a receiver and its own position
_UNLIKE = 0.5  # share of the speed
_MOVING_MPS = 0.5
_HALF_NS = 500_000_000

_stray_by_log: WeakKeyDictionary[Log, float | None] = WeakKeyDictionary()


def unless_stray(log: Log, found: Series | None) -> Series | None:
    """The series from SIM; None if SIM is of another vehicle."""
    return None if found is None or stray_truth_m(log) is not None else found


def stray_truth_m(log: Log) -> float | None:
    """Largest distance between the positions of SIM and of the receiver, if their motions differ.

    None if SIM is the truth, or is not logged. A receiver with an offset, for example from a fault, still moves with
    the vehicle.
    """
    if log not in _stray_by_log:
        _stray_by_log[log] = _measure_stray_m(log)
    return _stray_by_log[log]


def _measure_stray_m(log: Log) -> float | None:
    truth, table = geodetic_series(log, "SIM", ("Lat", "Lng", "Alt")), log.tables.get("GPS")
    if truth is None or table is None or not {"Lat", "Lng", "Status", "Spd", "GCrs"} <= set(table.columns):
        return None
    rows = np.flatnonzero(np.asarray(table.values("Status", raw=True)) >= 3)
    stamps = table.stamp_ns[rows]
    there, before, after = (truth.interpolated(stamps + shift_ns) for shift_ns in (0, -_HALF_NS, _HALF_NS))
    course_deg, speed_mps = (np.asarray(table.values(name, rows), dtype=np.float64) for name in ("GCrs", "Spd"))
    known = np.isfinite(there + before + after).all(axis=1) & np.isfinite(course_deg)
    known &= np.isfinite(speed_mps) & (speed_mps > _MOVING_MPS)
    if not known.any():
        return None
    frame, level_m = LocalFrame(*map(float, truth.values[0])), np.zeros(int(known.sum()))
    at, behind, ahead = (frame.ned(deg[known, 0], deg[known, 1], level_m)[:, :2] for deg in (there, before, after))
    fixes = frame.ned(table.values("Lat", rows[known]), table.values("Lng", rows[known]), level_m)[:, :2]
    true_mps = (ahead - behind) / (2e-9 * _HALF_NS)
    course = np.radians(course_deg[known])
    fast_mps = speed_mps[known, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
    unlike = np.median(np.linalg.norm(fast_mps - true_mps, axis=1) / speed_mps[known])
    apart_m = float(np.linalg.norm(fixes - at, axis=1).max())
    return apart_m if unlike > _UNLIKE and apart_m > _APART_M else None


def follows_simulator(logged: Series, simulated: Series) -> bool:
    """Whether the logged position follows that of the simulator (SIM), approximately.

    If the sensors come from elsewhere, the simulated vehicle is at rest, or the same outputs drive it to another
    position.
    """
    latitude, longitude, altitude = map(float, simulated.values[0])
    origin = (latitude, longitude, altitude)
    true_m = ardupilot_ned(origin, simulated.values)[:, :2]
    extent_m = float(np.hypot(*np.ptp(true_m, axis=0)))
    if extent_m < _STILL_M:
        return False
    at = simulated.interpolated(logged.stamp_ns)
    known = np.isfinite(at).all(axis=1)
    if not known.any():
        return False
    apart = ardupilot_ned(origin, logged.values[known]) - ardupilot_ned(origin, at[known])
    return float(np.median(np.hypot(apart[:, 0], apart[:, 1]))) < _NEAR_SHARE * extent_m


_GEODETIC = ("latitude", "longitude", "altitude")
_LINEAR = tuple(f"twist.twist.linear.{axis}" for axis in "xyz")
_ANGLES = {"roll": 0, "pitch": 1, "yaw": 2}
_DEG = 180.0 / np.pi


def roll(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Roll (deg), positive to starboard."""
    return _angle(log, "roll", "Roll", of)


def pitch(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Pitch (deg), positive bow up."""
    return _angle(log, "pitch", "Pitch", of)


def yaw(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Yaw (deg) from north, clockwise, 0 to 360."""
    return _angle(log, "yaw", "Yaw", of)


def yaw_desired(log: Log) -> Series | None:
    """Yaw setpoint (deg); None without a setpoint.

    Rover always writes 0 into ATT.DesYaw, and also into NTUN.DesYaw while it steers by turn rate.
    """
    return first_series(
        log,
        lambda log: _demanded(column_series(log, "ATT", "DesYaw", "deg", turns=True)),
        lambda log: _demanded(column_series(log, "NTUN", "DesYaw", "deg", turns=True)),
        lambda log: _demanded(_telemetry(log, "NAV_CONTROLLER_OUTPUT", "nav_bearing", "deg", turns=True)),
    )


_FLAT_ROWS = 10


def _demanded(found: Series | None) -> Series | None:
    """The series without runs of 0, which mean that there is no setpoint."""
    if found is None:
        return None
    flat = np.zeros(len(found.values), dtype=np.bool_)
    for first, after in runs(found.values == 0.0):
        flat[first:after] = after - first >= min(_FLAT_ROWS, len(flat))
    return make_series(found.stamp_ns[~flat], np.mod(found.values[~flat], 360.0), "deg", found.source, turns=True)


def yaw_rate(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Yaw rate (deg/s), clockwise from above."""
    if of == "truth":
        return first_series(
            log, partial(px4.yaw_rate, of="truth"), _true_yaw_rate, partial(_foreign_yaw_rate, of="truth")
        )
    return first_series(
        log,
        lambda log: column_series(log, "IMU", "GyrZ", "deg/s", factor=_DEG),
        px4.yaw_rate,
        lambda log: _telemetry(log, "ATTITUDE", "yawspeed", "deg/s", factor=_DEG),
        lambda log: _odometry_yaw_rate(log, "/estimate/odometry"),
        _any_imu_yaw_rate,
    )


def ground_speed(log: Log, of: SignalSource = "estimate") -> Series | None:
    """Speed over ground (m/s). DataFlash: from the estimator's core in use, else from the receiver (GPS.Spd)."""
    if of == "truth":
        return first_series(
            log,
            _true_ground_speed,
            lambda log: unless_stray(log, _estimated_ground_speed(log, "SIM2")),
            partial(px4.ground_speed, of="truth"),
            partial(_foreign_speed, of="truth"),
        )
    return first_series(
        log,
        px4.ground_speed,
        lambda log: _estimated_ground_speed(log, "XKF1"),
        lambda log: _estimated_ground_speed(log, "NKF1"),
        lambda log: _estimated_ground_speed(log, "EKF1"),
        lambda log: column_series(log, "GPS", "Spd", "m/s"),
        lambda log: _odometry_speed(log, "/estimate/odometry"),
        lambda log: _telemetry(log, "VFR_HUD", "groundspeed", "m/s"),
        _foreign_speed,
    )


def _angle(log: Log, name: str, logged: str, of: SignalSource) -> Series | None:
    turns = name == "yaw"
    if of == "truth":
        return first_series(
            log,
            lambda log: unless_stray(log, column_series(log, "SIM", logged, "deg", turns=turns)),
            lambda log: _own_angle(log, "/truth/odometry", name),
            partial(px4.angle, name=name, of="truth"),
            partial(_foreign_angle, name=name, of="truth"),
        )
    return first_series(
        log,
        partial(px4.angle, name=name),
        lambda log: column_series(log, "ATT", logged, "deg", turns=turns),
        lambda log: _own_angle(log, "/estimate/odometry", name),
        lambda log: _turned(_telemetry(log, "ATTITUDE", name, "deg", factor=_DEG, turns=turns)),
        partial(_foreign_angle, name=name),
        lambda log: _any_imu_angle(log, name),
    )


def _turned(found: Series | None) -> Series | None:
    """Yaw of ±180 degrees as 0 to 360."""
    if found is None or not found.turns:
        return found
    return Series(found.stamp_ns, np.mod(found.values, 360.0), "deg", found.source, True, found.dropped)


def _own_angle(log: Log, topic: str, name: str) -> Series | None:
    table = first_instance(log, topic)
    return None if table is None else PoseTopic(table, *_ODOMETRY).angle(name)


def _telemetry(
    log: Log, message: str, field: str, unit: str, *, factor: float = 1.0, turns: bool = False
) -> Series | None:
    """A series from telemetry: of a .tlog, or of the autopilot's frames in an xitl recording."""
    return first_series(
        log,
        lambda log: column_series(log, message, field, unit, factor=factor, turns=turns),
        lambda log: column_series(log, f"/link/agent/rx:{message}", field, unit, factor=factor, turns=turns),
    )


@dataclass(frozen=True, slots=True)
class PoseTopic:
    """Poses of a topic, in ENU with a FLU body (REP 103)."""

    table: Table
    place: str
    """Beginning of the names of its position columns."""
    turn: str
    """Beginning of the names of its attitude columns."""

    def places(self, stamp_ns: Stamps | None = None) -> Series | None:
        """North, east, down (m) about the origin of its frame. stamp_ns: (N,) of its rows, instead of the table's."""
        enu = stacked_columns(self.table, tuple(f"{self.place}.{axis}" for axis in "xyz"))
        if enu is None:
            return None
        ned = np.stack([enu[:, 1], enu[:, 0], -enu[:, 2]], axis=1)
        stamps = self.table.stamp_ns if stamp_ns is None else stamp_ns
        return make_series(stamps, ned, "m", f"{self.table.name}.{self.place}")

    def angle(self, name: str) -> Series | None:
        """Roll, pitch or yaw (deg)."""
        quaternion = stacked_columns(self.table, tuple(f"{self.turn}.{axis}" for axis in "wxyz"))
        if quaternion is None:
            return None
        # The same product of quaternions converts ENU and FLU back to NED and FRD.
        with np.errstate(invalid="ignore", divide="ignore"):
            euler = quat_to_euler(quat_ned_frd_to_enu_flu(quaternion))
        angle = euler[:, _ANGLES[name]] * _DEG
        turns = name == "yaw"
        source = f"{self.table.name}.{self.turn}"
        return make_series(self.table.stamp_ns, np.mod(angle, 360.0) if turns else angle, "deg", source, turns=turns)


_ODOMETRY = ("pose.pose.position", "pose.pose.orientation")
_POSES = (
    _ODOMETRY,  # nav_msgs/Odometry, geometry_msgs/PoseWithCovarianceStamped
    ("pose.position", "pose.orientation"),  # geometry_msgs/PoseStamped, foxglove.PoseInFrame
    ("position", "orientation"),  # geometry_msgs/Pose
    ("transform.translation", "transform.rotation"),  # geometry_msgs/TransformStamped
    ("translation", "rotation"),  # foxglove.FrameTransform
    ("transforms[0].transform.translation", "transforms[0].transform.rotation"),  # tf2_msgs/TFMessage
    ("transforms[0].translation", "transforms[0].rotation"),  # foxglove.FrameTransforms
)
"""Columns of poses, those most likely of the vessel first."""


def foreign_poses(log: Log, of: SignalSource = "estimate") -> Iterator[PoseTopic]:
    """Topics with poses, those most likely of the vessel first. None for an xitl recording, which has known topics."""
    if not log.of_topics or log.base == "simulation":
        return
    for fields in _POSES:
        for name, table in log.tables.items():
            if topic_source(name) == of and (found := _pose_topic(table, *fields)) is not None:
                yield found


def topic_source(topic: str) -> SignalSource:
    """Source of a topic. Only simulators name a topic ground_truth or truth."""
    return "truth" if "truth" in topic.lower() else "estimate"


def _pose_topic(table: Table, place: str, turn: str) -> PoseTopic | None:
    if f"{place}.x" not in table.columns or f"{turn}.w" not in table.columns:
        return None
    if place.endswith("translation"):  # one topic of transforms may have several child frames
        frame = place.removesuffix("translation").removesuffix("transform.") + "child_frame_id"
        if frame in table.columns:
            table = _farthest_travelled(table, frame, place)
    return PoseTopic(table, place, turn)


def _farthest_travelled(table: Table, column: str, place: str) -> Table:
    """Rows of the frame that moves most: sensors are fixed on a vessel, and the frame of an odometry hardly drifts."""
    names = np.asarray(table.values(column)).astype(str)
    ways = {}
    for name in dict.fromkeys(names.tolist()):
        rows = Selection(table, np.flatnonzero(names == name))
        way = stacked_columns(rows, tuple(f"{place}.{axis}" for axis in "xyz"))
        ways[name] = float(np.nansum(np.linalg.norm(np.diff(way, axis=0), axis=1))) if way is not None else 0.0
    return Selection(table, np.flatnonzero(names == max(ways, key=lambda name: ways[name]))) if ways else table


def _odometry_speed(log: Log, topic: str) -> Series | None:
    table = first_instance(log, topic)
    if table is None or (linear := stacked_columns(table, _LINEAR)) is None:
        return None
    return make_series(table.stamp_ns, np.hypot(linear[:, 0], linear[:, 1]), "m/s", f"{topic}.twist.twist.linear")


def _foreign_speed(log: Log, of: SignalSource = "estimate") -> Series | None:
    speeds = (_odometry_speed(log, pose.table.name) for pose in foreign_poses(log, of))
    return next((speed for speed in speeds if speed is not None), None)


def _foreign_angle(log: Log, name: str, of: SignalSource = "estimate") -> Series | None:
    angles = (pose.angle(name) for pose in foreign_poses(log, of))
    return next((angle for angle in angles if angle is not None), None)


def _foreign_yaw_rate(log: Log, of: SignalSource) -> Series | None:
    rates = (_odometry_yaw_rate(log, pose.table.name) for pose in foreign_poses(log, of))
    return next((rate for rate in rates if rate is not None), None)


def _odometry_yaw_rate(log: Log, topic: str) -> Series | None:
    table = first_instance(log, topic)
    if table is None:
        return None
    angular = stacked_columns(table, tuple(f"twist.twist.angular.{axis}" for axis in "xyz"))
    if angular is None:
        return None
    return make_series(table.stamp_ns, flu_to_frd(angular)[:, 2] * _DEG, "deg/s", f"{topic}.twist.twist.angular.z")


def _any_imu_yaw_rate(log: Log) -> Series | None:
    """Yaw rate of a sensor_msgs/Imu topic, FLU."""
    if not log.of_topics:
        return None
    name = next((name for name, table in log.tables.items() if "angular_velocity.z" in table.columns), None)
    return None if name is None else column_series(log, name, "angular_velocity.z", "deg/s", factor=-_DEG)


def _any_imu_angle(log: Log, name: str) -> Series | None:
    """Angle of a sensor_msgs/Imu topic with an attitude. A covariance of -1 means that it has none."""
    for table in log.tables.values() if log.of_topics and log.base != "simulation" else ():
        if {"orientation.w", "angular_velocity.z"} <= set(table.columns):
            covariance = stacked_columns(table, ("orientation_covariance",)) if len(table) else None
            if covariance is None or covariance.ravel()[0] >= 0.0:
                return PoseTopic(table, "", "orientation").angle(name)
    return None


def _true_yaw_rate(log: Log) -> Series | None:
    table = log.tables.get("/truth/state")
    if table is None or "angular_velocity_frd_radps" not in table.columns:
        return None
    rates = table.values("angular_velocity_frd_radps")
    return make_series(table.stamp_ns, rates[:, 2] * _DEG, "deg/s", "/truth/state.angular_velocity_frd_radps[2]")


def _true_ground_speed(log: Log) -> Series | None:
    table = log.tables.get("/truth/state")
    if table is None or "velocity_ned_mps" not in table.columns:
        return None
    values = table.values("velocity_ned_mps")
    return make_series(table.stamp_ns, np.hypot(values[:, 0], values[:, 1]), "m/s", "/truth/state.velocity_ned_mps")


def _estimated_ground_speed(log: Log, name: str) -> Series | None:
    table = rows_in_use(log, name)
    if table is None or (parts := stacked_columns(table, ("VN", "VE"))) is None:
        return None
    return make_series(table.stamp_ns, np.hypot(parts[:, 0], parts[:, 1]), "m/s", f"{name}.VN, VE")


@dataclass(frozen=True, slots=True)
class LocalPosition:
    """Path in local axes."""

    path: Series
    """`path.values` is (N, 3): north, east, down (m) about `origin`."""
    origin: tuple[float, float, float] | None
    """Latitude and longitude (deg) and altitude (m). None if the position of the axes on the Earth is unknown."""


def position_geodetic(log: Log, of: SignalSource = "estimate") -> Series | None:
    """(N, 3) latitude and longitude (deg) and altitude (m)."""
    ways: tuple[SeriesReader, ...]
    if of == "truth":
        ways = (
            lambda log: unless_stray(log, geodetic_series(log, "SIM", ("Lat", "Lng", "Alt"))),
            partial(geodetic_series, table="/truth/fix", names=_GEODETIC),
            partial(_px4_geodetic, of="truth"),
            partial(_any_fix, of="truth"),
        )
    else:
        ways = (
            _px4_geodetic,
            partial(geodetic_series, table="POS", names=("Lat", "Lng", "Alt")),
            partial(geodetic_series, table="GPS", names=("Lat", "Lng", "Alt")),
            _estimated_geodetic,
            partial(_telemetry_geodetic, message="GLOBAL_POSITION_INT"),
            partial(_telemetry_geodetic, message="GPS_RAW_INT"),
            _any_fix,
        )
    return first_series(log, *ways)


def position_ned(
    log: Log, of: SignalSource = "estimate", origin: tuple[float, float, float] | None = None
) -> LocalPosition | None:
    """Position about `origin`. Without it, about the origin of the log's own local frame, or its first position."""
    local = _local_odometry(log, "/truth/odometry" if of == "truth" else "/estimate/odometry")
    if local is None:
        local = next((found for each in foreign_poses(log, of) if (found := each.places()) is not None), None)
    own = _run_origin(log)
    if local is not None and (origin is None or own is not None):
        if origin is None or origin == own:
            return LocalPosition(local, own)
        moved = LocalFrame(*origin).ned(*LocalFrame(*own).geodetic(local.values)) if own is not None else local.values
        return LocalPosition(Series(local.stamp_ns, moved, "m", local.source, dropped=local.dropped), origin)
    geodetic = position_geodetic(log, of)
    if geodetic is None:
        return None
    about = origin or _estimator_origin(log) or own or _first_place(geodetic)
    # (N, 3) north, east, down about a position, in the metres of the world that the log uses.
    simulated = _simulated(log)
    frame = LocalFrame(*about)
    if simulated is None or not (of == "truth" or follows_simulator(geodetic, simulated)):
        path = frame.ned(*geodetic.values.T)
    else:
        own = _estimator_origin(log) or _first_place(simulated)
        flat = ardupilot_ned(own, geodetic.values)
        path = flat if about == own else frame.ned(*LocalFrame(*own).geodetic(flat))
    return LocalPosition(Series(geodetic.stamp_ns, path, "m", geodetic.source, dropped=geodetic.dropped), about)


def _simulated(log: Log) -> Series | None:
    """Position by ArduPilot's own simulator; from telemetry, it has no height."""
    if (found := geodetic_series(log, "SIM", ("Lat", "Lng", "Alt"))) is not None:
        return found
    table = first_instance(log, "SIMSTATE")
    if table is None or (place := stacked_columns(table, ("lat", "lng"))) is None:
        return None
    return fixed_on_earth(table.stamp_ns, np.column_stack([place, np.zeros(len(place))]), "SIMSTATE")


def _first_place(geodetic: Series) -> tuple[float, float, float]:
    """First row, for use as an origin."""
    latitude, longitude, altitude = map(float, geodetic.values[0])
    return latitude, longitude, altitude if abs(altitude) <= HIGHEST_M else 0.0


def _px4_geodetic(log: Log, of: SignalSource = "estimate") -> Series | None:
    found = px4.geodetic(log, of)
    return None if found is None else fixed_on_earth(*found)


def _local_odometry(log: Log, topic: str) -> Series | None:
    table = first_instance(log, topic)
    return None if table is None else PoseTopic(table, *_ODOMETRY).places()


def _telemetry_geodetic(log: Log, message: str) -> Series | None:
    for name in (message, f"/link/agent/rx:{message}"):
        if (found := geodetic_series(log, name, ("lat", "lon", "alt"))) is not None:
            return found
    return None


def _any_fix(log: Log, of: SignalSource = "estimate") -> Series | None:
    if not log.of_topics:
        return None
    topics = [
        name
        for name, table in log.tables.items()
        if topic_source(name) == of and all(field in table.columns for field in _GEODETIC)
    ]
    return next((found for topic in topics if (found := geodetic_series(log, topic, _GEODETIC)) is not None), None)


def _estimated_geodetic(log: Log) -> Series | None:
    local, site = _local_odometry(log, "/estimate/odometry"), _run_origin(log)
    if local is None or site is None:
        return None
    geodetic = np.stack(LocalFrame(*site).geodetic(local.values), axis=1)
    return Series(local.stamp_ns, geodetic, "deg, deg, m", local.source, dropped=local.dropped)


def _run_origin(log: Log) -> tuple[float, float, float] | None:
    """Local origin of a run of xitl: from a true fix, minus the true position at that instant."""
    if not log.of_topics:
        return None
    if log.base == "simulation":
        fixes, poses = log.tables.get("/truth/fix"), log.tables.get("/truth/odometry")
    else:
        fixes, poses = _topic_ending(log, "/ground_truth/fix"), _topic_ending(log, "/ground_truth/odom")
    if fixes is None or poses is None or (geodetic := stacked_columns(fixes, _GEODETIC)) is None:
        return None
    fix = fixed_on_earth(_made_ns(fixes), geodetic, fixes.name)
    truth = PoseTopic(poses, *_ODOMETRY).places(_made_ns(poses))
    if fix is None or truth is None:
        return None
    known = np.isfinite(at := truth.interpolated(fix.stamp_ns)).all(axis=1)
    if not known.any():
        return None
    nearest = int(np.argmin(np.where(known, np.hypot(at[:, 0], at[:, 1]), np.inf)))
    here = LocalFrame(*map(float, fix.values[nearest]))
    latitude, longitude, altitude = here.geodetic(-at[nearest : nearest + 1])
    return float(latitude[0]), float(longitude[0]), float(altitude[0])


def _topic_ending(log: Log, ending: str) -> Table | None:
    return next((table for name, table in log.tables.items() if name.endswith(ending)), None)


def _made_ns(table: Table) -> Stamps:
    """Creation times of a topic's messages if they have them, else their recording times."""
    if "header.stamp" not in table.columns:
        return table.stamp_ns
    made: Stamps = np.asarray(table.values("header.stamp")).astype(np.int64)
    return made


def _estimator_origin(log: Log) -> tuple[float, float, float] | None:
    """Last ORGN of type 0, ArduPilot's EKF origin."""
    table = log.tables.get("ORGN")
    if table is None or (place := stacked_columns(table, ("Type", "Lat", "Lng", "Alt"))) is None:
        return None
    rows = place[(place[:, 0] == 0.0) & np.isfinite(place).all(axis=1) & (np.abs(place[:, 1]) <= 90.0)]
    rows = rows[(np.abs(rows[:, 2]) <= 180.0) & (np.abs(rows[:, 3]) <= HIGHEST_M)]
    return None if not len(rows) else (float(rows[-1, 1]), float(rows[-1, 2]), float(rows[-1, 3]))
