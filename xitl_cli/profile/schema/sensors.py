"""`sensors`: rates, latencies and noise of the simulated sensors: four that every autopilot has, and others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Group, NonNegative, Positive, RateHz, Vector
from xitl_cli.profile.schema.perception import Lidar, Sonar


class Imu(Group):
    """Gyroscope and accelerometer."""

    rate_hz: RateHz
    latency_s: NonNegative = 0.0
    gyro_noise_density_radpsprthz: NonNegative
    gyro_bias_instability_radps: NonNegative
    gyro_bias_correlation_s: Positive
    gyro_turn_on_bias_radps: NonNegative
    gyro_resolution_radps: NonNegative
    gyro_range_radps: Positive | None = None
    accel_noise_density_mps2prthz: NonNegative
    accel_bias_instability_mps2: NonNegative
    accel_bias_correlation_s: Positive
    accel_turn_on_bias_mps2: NonNegative
    accel_resolution_mps2: NonNegative
    accel_range_mps2: Positive | None = None
    position_frd_m: Vector = (0.0, 0.0, 0.0)


class Gnss(Group):
    """Satellite receiver: position and velocity."""

    rate_hz: RateHz
    latency_s: NonNegative = 0.0
    horizontal_noise_m: NonNegative
    vertical_noise_m: NonNegative
    horizontal_drift_m: NonNegative
    vertical_drift_m: NonNegative
    drift_correlation_s: Positive
    velocity_noise_mps: NonNegative
    satellites: Annotated[int, Field(ge=0, le=64)]
    antenna_frd_m: Vector = (0.0, 0.0, 0.0)


class Magnetometer(Group):
    """Three-axis magnetometer."""

    rate_hz: RateHz
    latency_s: NonNegative = 0.0
    noise_density_gaussprthz: NonNegative
    bias_instability_gauss: NonNegative
    bias_correlation_s: Positive
    hard_iron_frd_gauss: Vector = (0.0, 0.0, 0.0)
    resolution_gauss: NonNegative


class Barometer(Group):
    """Static pressure."""

    rate_hz: RateHz
    latency_s: NonNegative = 0.0
    noise_pa: NonNegative
    drift_pa: NonNegative
    drift_correlation_s: Positive
    resolution_pa: NonNegative


class Rangefinder(Group):
    """One that looks along `direction_frd`, as DISTANCE_SENSOR with its place in the list for a number.

    Through `water` it meets the bed, through `air` the still surface, and obstacles of the `world` through both.
    """

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    through: Literal["water", "air"] = "water"
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    direction_frd: Vector = (0.0, 0.0, 1.0)
    min_range_m: Annotated[float, Field(ge=0, le=600)] = 0.3
    max_range_m: Annotated[float, Field(gt=0, le=600)] = 100.0
    beam_deg: Annotated[float, Field(ge=0, le=120)] = 0.0
    noise_m: NonNegative = 0.0
    noise_share: NonNegative = 0.0
    resolution_m: NonNegative = 0.0


class WindVane(Group):
    """Vane and anemometer at the mast: the apparent wind."""

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    response_s: NonNegative = 0.0
    speed_noise_mps: NonNegative = 0.0
    direction_noise_deg: NonNegative = 0.0
    speed_resolution_mps: NonNegative = 0.0
    direction_resolution_deg: NonNegative = 0.0
    max_speed_mps: Positive = 60.0


class GpsInput(Gnss):
    """Another satellite receiver, whose fixes go out as GPS_INPUT."""

    gps_id: Annotated[int, Field(ge=0, le=3)] = 0


class ObstacleScanner(Group):
    """Ranges all round in plan to the obstacles of the `world`, as OBSTACLE_DISTANCE of 72 sectors from the bow."""

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    min_range_m: Annotated[float, Field(ge=0, le=600)] = 0.5
    max_range_m: Annotated[float, Field(gt=0, le=600)] = 100.0
    noise_m: NonNegative = 0.0


class Odometry(Group):
    """Pose and velocity from an estimator that starts at zero and wanders off, as ODOMETRY."""

    rate_hz: RateHz = 20.0
    latency_s: NonNegative = 0.0
    position_noise_m: NonNegative = 0.0
    velocity_noise_mps: NonNegative = 0.0
    attitude_noise_deg: NonNegative = 0.0
    rate_noise_radps: NonNegative = 0.0
    drift_mprts: NonNegative = 0.0
    yaw_drift_degprts: NonNegative = 0.0


class Messages(Group):
    """Standard messages beside our own, for an autopilot behind a bridge or a companion; null sends none."""

    gps_input: GpsInput | None = None
    obstacle_distance: ObstacleScanner | None = None
    odometry: Odometry | None = None


class Sensors(Group):
    """The sensors of the vessel.

    A `wind_vane` reaches an autopilot whose world is served (autopilot.bridge.world), `lidar` and `sonar` a companion.
    """

    imu: Imu
    gnss: Gnss
    magnetometer: Magnetometer
    barometer: Barometer
    rangefinders: Annotated[tuple[Rangefinder, ...], Field(max_length=6)] = ()
    wind_vane: WindVane | None = None
    lidar: Lidar | None = None
    sonar: Sonar | None = None
    messages: Messages = Messages()


def sensors_of(sensors: Sensors) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Every sensor there is, with the path of its key."""
    for name in ("imu", "gnss", "magnetometer", "barometer"):
        yield ("sensors", name), getattr(sensors, name)
    for number, rangefinder in enumerate(sensors.rangefinders):
        yield ("sensors", "rangefinders", number), rangefinder
    if sensors.wind_vane is not None:
        yield ("sensors", "wind_vane"), sensors.wind_vane
    for name in type(sensors.messages).model_fields:
        if (message := getattr(sensors.messages, name)) is not None:
            yield ("sensors", "messages", name), message
