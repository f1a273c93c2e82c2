"""`sensors`: rates, latencies and noise of the four simulated sensors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from xitl_cli.profile.schema.group import Group, NonNegative, Positive, RateHz, Vector


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


class Sensors(Group):
    """The sensors of the vessel."""

    imu: Imu
    gnss: Gnss
    magnetometer: Magnetometer
    barometer: Barometer
