"""Sensor measurements as ROS messages in FLU and ENU axes and SI units: frames sent to the agent, clouds, echoes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.wire import dialect
from sim_core.frames import euler_to_quat, quat_to_euler, quat_to_matrix
from sim_core.noise import white_deviation
from xitl_cli.plugins.ros import msg
from xitl_cli.plugins.ros.frames import GNSS_FRAME, IMU_FRAME, FixedFrame, rangefinder_frame
from xitl_cli.profile.schema.sensors import SensorsSpec
from xitl_cli.record.topics import LIDAR_POINT, MAP_FRAME, SONAR_POINT, VESSEL_FRAME

RANGE = "range/{rangefinder}"
TESLA_PER_GAUSS = 1e-4
ATTITUDE_DEVIATION_RAD = math.radians(0.5), math.radians(0.5), math.radians(2.0)
"""Deviation of an autopilot's roll, pitch and yaw, which it does not report: the shipped runs stay below it (0.5° RMS).
"""
_FIX_STATUS = {
    4: msg.NavSatStatus.STATUS_GBAS_FIX,
    5: msg.NavSatStatus.STATUS_GBAS_FIX,
    6: msg.NavSatStatus.STATUS_GBAS_FIX,
}
_UNKNOWN_MILLIVOLTS = 0, 0xFFFF

Measured = tuple[str, str, Any, int]
"""Topic of OUTPUTS, the part in its braces if any, the message, and its instant."""
Array = NDArray[np.float64]
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
TIMED_POINT = np.dtype([*POINT.descr, ("time", "<f4")])
"""time: seconds after the stamp, as in Velodyne's driver."""
_FLOAT32 = 7  # PointField
SCAN_BINS = 360
SCAN_HEIGHTS_M = 0.1, 3.0


class Attitude(Protocol):
    """Source of the vessel's attitude."""

    def at_sample(self) -> tuple[float, float, float, float] | None:
        """Return w x y z at the newest IMU sample, from FLU to ENU; None if it is unknown."""


class Instruments:
    """Sensors of one vessel. framed: adds the vessel's name to a frame's name."""

    def __init__(self, sensors: SensorsSpec, framed: Callable[[str], str]) -> None:
        self._sensors = sensors
        self._framed = framed
        imu, magnetometer = sensors.imu, sensors.magnetometer
        self._gyro_covariance = _diagonal(white_deviation(imu.gyro_noise_density_radpsprthz, imu.rate_hz) ** 2)
        self._accel_covariance = _diagonal(white_deviation(imu.accel_noise_density_mps2prthz, imu.rate_hz) ** 2)
        deviation_gauss = white_deviation(magnetometer.noise_density_gaussprthz, magnetometer.rate_hz)
        self._field_covariance = _diagonal((deviation_gauss * TESLA_PER_GAUSS) ** 2)
        self._attitude_covariance = np.diag(np.square(ATTITUDE_DEVIATION_RAD)).reshape(9)
        self._no_attitude = np.array([-1.0, *[0.0] * 8])
        self._makers: dict[int, Callable[[Any, Attitude], Iterator[Measured]]] = {
            dialect.MAVLINK_MSG_ID_XITL_IMU: self._imu,
            dialect.MAVLINK_MSG_ID_XITL_GNSS: self._gnss,
            dialect.MAVLINK_MSG_ID_XITL_MAGNETOMETER: self._magnetometer,
            dialect.MAVLINK_MSG_ID_XITL_BAROMETER: self._barometer,
        }
        if sensors.rangefinders:
            self._makers[dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR] = self._rangefinder
        if sensors.messages.obstacle_distance is not None and sensors.lidar is None:
            self._makers[dialect.MAVLINK_MSG_ID_OBSTACLE_DISTANCE] = self._sectors
        self.kinds = frozenset(self._makers)
        """MAVLink messages that it converts."""
        self.topics = ["imu/data", "fix", "fix_velocity", "magnetic_field", "fluid_pressure"]
        """Resulting topics of OUTPUTS."""
        if dialect.MAVLINK_MSG_ID_OBSTACLE_DISTANCE in self._makers:
            self.topics.append("scan")
        self.rangefinders = [f"rangefinder_{number}" for number in range(len(sensors.rangefinders))]
        """Parts of RANGE."""

    def messages(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert a message of one of `kinds`."""
        return self._makers[message.get_msgId()](message, attitude)

    def _imu(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        turn = attitude.at_sample()
        w, x, y, z = (1.0, 0.0, 0.0, 0.0) if turn is None else turn
        imu = msg.Imu(
            header=self._header(stamp_ns, IMU_FRAME),
            orientation=msg.Quaternion(x, y, z, w),
            orientation_covariance=self._no_attitude if turn is None else self._attitude_covariance,
            angular_velocity=_flu(message.gyro),
            angular_velocity_covariance=self._gyro_covariance,
            linear_acceleration=_flu(message.accel),
            linear_acceleration_covariance=self._accel_covariance,
        )
        yield "imu/data", "", imu, stamp_ns

    def _gnss(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert a fix. The receiver's horizontal accuracy covers both axes together."""
        stamp_ns = message.time_usec * 1000
        has_fix = message.fix_type >= 2
        status = (
            _FIX_STATUS.get(message.fix_type, msg.NavSatStatus.STATUS_FIX)
            if has_fix
            else msg.NavSatStatus.STATUS_NO_FIX
        )
        axis_m2 = 0.5 * message.h_acc**2
        fix = msg.NavSatFix(
            header=self._header(stamp_ns, GNSS_FRAME),
            status=msg.NavSatStatus(status=status, service=msg.NavSatStatus.SERVICE_GPS),  # type: ignore[arg-type]  # as in Dashing
            latitude=message.lat * 1e-7,
            longitude=message.lon * 1e-7,
            altitude=message.alt * 1e-3,
            position_covariance=np.diag([axis_m2, axis_m2, message.v_acc**2]).reshape(9),
            position_covariance_type=msg.NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN,
        )
        yield "fix", "", fix, stamp_ns
        if has_fix:
            north_mps, east_mps, down_mps = message.velocity
            twist = msg.Twist(linear=msg.Vector3(east_mps, north_mps, -down_mps), angular=msg.Vector3(0.0, 0.0, 0.0))
            yield "fix_velocity", "", msg.TwistStamped(header=self._header(stamp_ns, MAP_FRAME), twist=twist), stamp_ns

    def _magnetometer(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        field = msg.MagneticField(
            header=self._header(stamp_ns, VESSEL_FRAME),
            magnetic_field=_flu([component * TESLA_PER_GAUSS for component in message.field]),
            magnetic_field_covariance=self._field_covariance,
        )
        yield "magnetic_field", "", field, stamp_ns

    def _barometer(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        header, variance = self._header(stamp_ns, VESSEL_FRAME), self._sensors.barometer.noise_pa**2
        yield "fluid_pressure", "", msg.FluidPressure(header, message.pressure, variance), stamp_ns

    def _rangefinder(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert a range. A companion sends messages of the same kind and number, which have different limits."""
        number = message.id
        if number >= len(self._sensors.rangefinders):
            return
        unit = self._sensors.rangefinders[number]
        low_cm, high_cm = round(unit.min_range_m * 100), round(unit.max_range_m * 100)
        if (message.min_distance, message.max_distance) != (low_cm, high_cm):
            return
        range_cm, stamp_ns = message.current_distance, message.time_boot_ms * 1_000_000
        measured = msg.Range(
            header=self._header(stamp_ns, rangefinder_frame(number)),
            radiation_type=msg.Range.ULTRASOUND if unit.through == "water" else msg.Range.INFRARED,
            field_of_view=math.radians(unit.beam_deg),
            min_range=unit.min_range_m,
            max_range=unit.max_range_m,
            range=-math.inf if range_cm < low_cm else math.inf if range_cm > high_cm else range_cm * 0.01,
            variance=unit.noise_m**2,
        )
        yield RANGE, self.rangefinders[number], measured, stamp_ns

    def _sectors(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert OBSTACLE_DISTANCE: clockwise from the bow."""
        stamp_ns = message.time_usec * 1000
        scanner = self._sensors.messages.obstacle_distance
        assert scanner is not None
        distance_m = np.array(message.distances[:72], dtype=np.float32) * np.float32(0.01)
        ranges_m = np.where(distance_m > scanner.max_range_m, np.float32(np.inf), distance_m)[::-1].copy()
        header, limits_m = self._header(stamp_ns, VESSEL_FRAME), (scanner.min_range_m, scanner.max_range_m)
        first_rad = -math.tau * 71 / 72
        yield "scan", "", laser_scan(header, ranges_m, first_rad, limits_m, 1.0 / scanner.rate_hz), stamp_ns

    def _header(self, stamp_ns: int, frame: str) -> Any:
        return msg.header(stamp_ns, self._framed(frame))


def battery(message: Any, header: Any) -> Any:
    """Return a BatteryState from SYS_STATUS; None if the autopilot has no battery."""
    if message.voltage_battery in _UNKNOWN_MILLIVOLTS:
        return None
    current, remaining = message.current_battery, message.battery_remaining
    return msg.BatteryState(
        header=header,
        voltage=message.voltage_battery * 1e-3,
        temperature=math.nan,
        current=math.nan if current < 0 else -current * 1e-2,  # discharge is negative
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        percentage=math.nan if remaining < 0 else remaining * 1e-2,
        power_supply_status=msg.BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        power_supply_health=msg.BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN,
        power_supply_technology=msg.BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
        present=True,
        cell_voltage=np.zeros(0, dtype=np.float32),
        cell_temperature=np.zeros(0, dtype=np.float32),
        location="",
        serial_number="",
    )


def _flu(vector_frd: Any) -> Any:
    forward, right, down = vector_frd
    return msg.Vector3(forward, -right, -down)


def _diagonal(variance: float) -> NDArray[np.float64]:
    """Return (9,) for three equal axes."""
    return (np.eye(3) * variance).reshape(9)


class CloudFrame:
    """Points of `base_link` in a sensor's frame."""

    def __init__(self, frame: FixedFrame) -> None:
        x, y, z, w = frame.turn
        self.from_base = quat_to_matrix(np.array([w, x, y, z]))  # rows times it: the inverse rotation
        self.place_m = np.array(frame.position_m)

    def points(self, base_m: Array) -> Array:
        """Transform (n, 3) from `base_link` to the sensor's frame."""
        turned: Array = (base_m - self.place_m) @ self.from_base
        return turned


def recorded_points(data: bytes, timed: bool) -> tuple[Array, NDArray[np.void]]:
    """Return (n, 3) in `base_link` and the packed points of a cloud in the recorder's format."""
    packed = np.frombuffer(data, dtype=LIDAR_POINT if timed else SONAR_POINT)
    return np.column_stack([packed[axis] for axis in "xyz"]).astype(np.float64), packed


def point_cloud(header: Any, points_m: Array, intensity: NDArray[Any], time_s: NDArray[Any] | None = None) -> Any:
    """Return a PointCloud2 of points (n, 3) with intensities (n,), and optional instants (n,)."""
    packed = np.zeros(len(points_m), dtype=POINT if time_s is None else TIMED_POINT)
    for axis, name in enumerate("xyz"):
        packed[name] = points_m[:, axis]
    packed["intensity"] = intensity
    if time_s is not None:
        packed["time"] = time_s
    kinds = packed.dtype.fields
    assert kinds is not None
    return msg.PointCloud2(
        header=header,
        height=1,
        width=len(packed),
        fields=[msg.PointField(name=name, offset=kind[1], datatype=_FLOAT32, count=1) for name, kind in kinds.items()],
        is_bigendian=False,
        point_step=packed.dtype.itemsize,
        row_step=packed.dtype.itemsize * len(packed),
        data=packed.view(np.uint8).reshape(-1),
        is_dense=True,
    )


def echo_points(angle_rad: float, ranges_m: Array) -> Array:
    """Return (n, 3) along a beam; its angle is to starboard of the frame's x axis."""
    return np.column_stack([ranges_m * math.cos(angle_rad), -ranges_m * math.sin(angle_rad), np.zeros(len(ranges_m))])


def leveled(base_m: Array, attitude_wxyz: tuple[float, float, float, float] | None) -> Array:
    """Rotate (n, 3) of `base_link` to level axes with the same heading; attitude FLU to ENU, None if unknown."""
    if attitude_wxyz is None:
        return base_m
    roll_rad, pitch_rad, _ = quat_to_euler(np.array(attitude_wxyz))
    turned: Array = base_m @ quat_to_matrix(euler_to_quat(np.array([roll_rad, pitch_rad, 0.0]))).T
    return turned


def scan_of_cloud(header: Any, base_m: Array, water_up_m: float, limits_m: tuple[float, float], period_s: float) -> Any:
    """Return a LaserScan in `base_link` with the nearest point above the water in each bin of azimuth. base_m: (n, 3),
    leveled.

    water_up_m: water level at rest above the body's origin. limits_m: shortest and longest range of the lidar.
    """
    height_m = base_m[:, 2] - water_up_m
    above = base_m[(height_m >= SCAN_HEIGHTS_M[0]) & (height_m <= SCAN_HEIGHTS_M[1])]
    range_m = np.hypot(above[:, 0], above[:, 1])
    step_rad = math.tau / SCAN_BINS
    bins = np.floor((np.arctan2(above[:, 1], above[:, 0]) + math.pi) / step_rad).astype(np.intp) % SCAN_BINS
    nearest = np.full(SCAN_BINS, np.inf, dtype=np.float32)
    np.minimum.at(nearest, bins, range_m.astype(np.float32))
    return laser_scan(header, nearest, -math.pi + 0.5 * step_rad, limits_m, period_s)


def laser_scan(
    header: Any, ranges_m: NDArray[np.float32], first_rad: float, limits_m: tuple[float, float], period_s: float
) -> Any:
    """Return a LaserScan of ranges (n,), full circle, counter-clockwise from first_rad; inf for no object (REP 117)."""
    step_rad = math.tau / len(ranges_m)
    return msg.LaserScan(
        header=header,
        angle_min=first_rad,
        angle_max=first_rad + step_rad * (len(ranges_m) - 1),
        angle_increment=step_rad,
        time_increment=0.0,
        scan_time=period_s,
        range_min=limits_m[0],
        range_max=limits_m[1],
        ranges=ranges_m,
        intensities=np.zeros(0, dtype=np.float32),
    )
