"""Sensor measurements as ROS messages, from the frames sent to the agent: axes FLU and ENU, SI units."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Quaternion as Quaternion,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Twist as Twist,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__TwistStamped as TwistStamped,
)
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Vector3 as Vector3,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__BatteryState as BatteryState,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__FluidPressure as FluidPressure,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__Imu as RosImu,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__MagneticField as MagneticField,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__NavSatFix as NavSatFix,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__NavSatStatus as NavSatStatus,
)
from rosbags.typesys.stores.ros2_jazzy import (
    sensor_msgs__msg__Range as Range,
)
from rosbags.typesys.stores.ros2_jazzy import (
    std_msgs__msg__Header as Header,
)

from agent.wire import dialect
from sim_core.noise import white_deviation
from xitl_cli.plugins.ros import clouds
from xitl_cli.plugins.ros.frames import GNSS_FRAME, IMU_FRAME, rangefinder_frame
from xitl_cli.profile.schema.sensors import SensorsSpec
from xitl_cli.record.topics import MAP_FRAME, VESSEL_FRAME

RANGE = "range/{rangefinder}"
TESLA_PER_GAUSS = 1e-4
ATTITUDE_DEVIATION_RAD = math.radians(0.5), math.radians(0.5), math.radians(2.0)
"""Deviation of an autopilot's roll, pitch and yaw, which it does not report: the shipped runs stay below it (0.5° RMS).
"""
_FIX_STATUS = {4: NavSatStatus.STATUS_GBAS_FIX, 5: NavSatStatus.STATUS_GBAS_FIX, 6: NavSatStatus.STATUS_GBAS_FIX}
_UNKNOWN_MILLIVOLTS = 0, 0xFFFF

Measured = tuple[str, str, Any, int]
"""Topic of OUTPUTS, the part in its braces if any, the message, and its instant."""


class Attitude(Protocol):
    """Source of the vessel's attitude."""

    def at_sample(self) -> tuple[float, float, float, float] | None:
        """Return w x y z at the newest IMU sample, from FLU to ENU; None if it is unknown."""


class Instruments:
    """Sensors of one vessel. framed: adds the vessel's name to a frame's name.

    kinds: MAVLink messages that it converts. topics: resulting topics of OUTPUTS. rangefinders: parts of RANGE.
    """

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
        self.topics = ["imu/data", "fix", "fix_velocity", "magnetic_field", "fluid_pressure"]
        if dialect.MAVLINK_MSG_ID_OBSTACLE_DISTANCE in self._makers:
            self.topics.append("scan")
        self.rangefinders = [f"rangefinder_{number}" for number in range(len(sensors.rangefinders))]

    def messages(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert a message of one of `kinds`."""
        return self._makers[message.get_msgId()](message, attitude)

    def _imu(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        turn = attitude.at_sample()
        w, x, y, z = (1.0, 0.0, 0.0, 0.0) if turn is None else turn
        imu = RosImu(
            header=self._header(stamp_ns, IMU_FRAME),
            orientation=Quaternion(x, y, z, w),
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
        there = message.fix_type >= 2
        status = _FIX_STATUS.get(message.fix_type, NavSatStatus.STATUS_FIX) if there else NavSatStatus.STATUS_NO_FIX
        axis_m2 = 0.5 * message.h_acc**2
        fix = NavSatFix(
            header=self._header(stamp_ns, GNSS_FRAME),
            status=NavSatStatus(status=status, service=NavSatStatus.SERVICE_GPS),  # type: ignore[arg-type]  # as in Dashing
            latitude=message.lat * 1e-7,
            longitude=message.lon * 1e-7,
            altitude=message.alt * 1e-3,
            position_covariance=np.diag([axis_m2, axis_m2, message.v_acc**2]).reshape(9),
            position_covariance_type=NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN,
        )
        yield "fix", "", fix, stamp_ns
        if there:
            north_mps, east_mps, down_mps = message.velocity
            twist = Twist(linear=Vector3(east_mps, north_mps, -down_mps), angular=Vector3(0.0, 0.0, 0.0))
            yield "fix_velocity", "", TwistStamped(header=self._header(stamp_ns, MAP_FRAME), twist=twist), stamp_ns

    def _magnetometer(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        field = MagneticField(
            header=self._header(stamp_ns, VESSEL_FRAME),
            magnetic_field=_flu([component * TESLA_PER_GAUSS for component in message.field]),
            magnetic_field_covariance=self._field_covariance,
        )
        yield "magnetic_field", "", field, stamp_ns

    def _barometer(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        stamp_ns = message.time_usec * 1000
        header, variance = self._header(stamp_ns, VESSEL_FRAME), self._sensors.barometer.noise_pa**2
        yield "fluid_pressure", "", FluidPressure(header, message.pressure, variance), stamp_ns

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
        found = Range(
            header=self._header(stamp_ns, rangefinder_frame(number)),
            radiation_type=Range.ULTRASOUND if unit.through == "water" else Range.INFRARED,
            field_of_view=math.radians(unit.beam_deg),
            min_range=unit.min_range_m,
            max_range=unit.max_range_m,
            range=-math.inf if range_cm < low_cm else math.inf if range_cm > high_cm else range_cm * 0.01,
            variance=unit.noise_m**2,
        )
        yield RANGE, self.rangefinders[number], found, stamp_ns

    def _sectors(self, message: Any, attitude: Attitude) -> Iterator[Measured]:
        """Convert OBSTACLE_DISTANCE: clockwise from the bow."""
        stamp_ns = message.time_usec * 1000
        scanner = self._sensors.messages.obstacle_distance
        assert scanner is not None
        distance_m = np.array(message.distances[:72], dtype=np.float32) * np.float32(0.01)
        ranges_m = np.where(distance_m > scanner.max_range_m, np.float32(np.inf), distance_m)[::-1].copy()
        header, limits_m = self._header(stamp_ns, VESSEL_FRAME), (scanner.min_range_m, scanner.max_range_m)
        first_rad = -math.tau * 71 / 72
        yield "scan", "", clouds.laser_scan(header, ranges_m, first_rad, limits_m, 1.0 / scanner.rate_hz), stamp_ns

    def _header(self, stamp_ns: int, frame: str) -> Any:
        return Header(stamp=Time(*divmod(stamp_ns, 1_000_000_000)), frame_id=self._framed(frame))


def battery(message: Any, header: Any) -> Any:
    """Return a BatteryState from SYS_STATUS; None if the autopilot has no battery."""
    if message.voltage_battery in _UNKNOWN_MILLIVOLTS:
        return None
    current, remaining = message.current_battery, message.battery_remaining
    return BatteryState(
        header=header,
        voltage=message.voltage_battery * 1e-3,
        temperature=math.nan,
        current=math.nan if current < 0 else -current * 1e-2,  # discharge is negative
        charge=math.nan,
        capacity=math.nan,
        design_capacity=math.nan,
        percentage=math.nan if remaining < 0 else remaining * 1e-2,
        power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING,
        power_supply_health=BatteryState.POWER_SUPPLY_HEALTH_UNKNOWN,
        power_supply_technology=BatteryState.POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
        present=True,
        cell_voltage=np.zeros(0, dtype=np.float32),
        cell_temperature=np.zeros(0, dtype=np.float32),
        location="",
        serial_number="",
    )


def _flu(vector_frd: Any) -> Any:
    forward, right, down = vector_frd
    return Vector3(forward, -right, -down)


def _diagonal(variance: float) -> NDArray[np.float64]:
    """Return (9,) for three equal axes."""
    return (np.eye(3) * variance).reshape(9)
