"""Sensors as data: rates, latencies, mounting, noise and limits.

Every sensor is measured once each 1 / rate_hz, a whole number of physics steps; a sample is delivered latency_s later.
Positions are from the body origin. Correlated errors are first-order Gauss-Markov processes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import (
    Bounds,
    Direction,
    NonNegative,
    Positive,
    RateHz,
    Required,
    Share,
    Specification,
    SpecificationError,
    Vector,
)

_SHORTEST_DIRECTION = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSpec(Specification):
    """Three gyroscopes and three accelerometers at one point of the body.

    A noise density is the Allan deviation at 1 s. A bias instability is the maximum of the Allan deviation of the
    drifting bias, at 1.89 times its correlation time. The turn-on bias is drawn once.
    """

    rate_hz: Annotated[RateHz, Required] = 200.0
    latency_s: NonNegative = 0.0
    gyro_noise_density_radpsprthz: Annotated[NonNegative, Required, "white noise"] = 0.0
    gyro_bias_instability_radps: Annotated[NonNegative, Required, "instability of the drifting bias"] = 0.0
    gyro_bias_correlation_s: Annotated[Positive, Required, "correlation time of the drifting bias"] = 100.0
    gyro_turn_on_bias_radps: Annotated[NonNegative, Required, "standard deviation of the constant bias"] = 0.0
    gyro_resolution_radps: Annotated[NonNegative, Required, "step of the output, 0 for none"] = 0.0
    gyro_range_radps: Annotated[Positive | None, "full scale, null for unlimited"] = None
    accel_noise_density_mps2prthz: Annotated[NonNegative, Required, "white noise"] = 0.0
    accel_bias_instability_mps2: Annotated[NonNegative, Required, "instability of the drifting bias"] = 0.0
    accel_bias_correlation_s: Annotated[Positive, Required, "correlation time of the drifting bias"] = 100.0
    accel_turn_on_bias_mps2: Annotated[NonNegative, Required, "standard deviation of the constant bias"] = 0.0
    accel_resolution_mps2: Annotated[NonNegative, Required, "step of the output, 0 for none"] = 0.0
    accel_range_mps2: Annotated[Positive | None, "full scale, null for unlimited"] = None
    position_frd_m: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssSpec(Specification):
    """A satellite receiver: position and velocity of its antenna, with standard deviations per axis."""

    rate_hz: Annotated[RateHz, Required] = 5.0
    latency_s: NonNegative = 0.0
    horizontal_noise_m: Annotated[NonNegative, Required, "white noise from one fix to the next"] = 0.0
    vertical_noise_m: Annotated[NonNegative, Required, "white noise from one fix to the next"] = 0.0
    horizontal_drift_m: Annotated[NonNegative, Required, "standard deviation of the correlated error"] = 0.0
    vertical_drift_m: Annotated[NonNegative, Required, "standard deviation of the correlated error"] = 0.0
    drift_correlation_s: Annotated[Positive, Required] = 60.0
    velocity_noise_mps: Annotated[NonNegative, Required, "white noise"] = 0.0
    satellites: Annotated[
        int, Bounds(at_least=0, at_most=64), Required, "number of satellites that the receiver reports"
    ] = 12
    antenna_frd_m: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetometerSpec(Specification):
    """Three axes in the uniform field of the site."""

    rate_hz: Annotated[RateHz, Required] = 50.0
    latency_s: NonNegative = 0.0
    noise_density_gaussprthz: Annotated[NonNegative, Required, "white noise: the Allan deviation at 1 s"] = 0.0
    bias_instability_gauss: Annotated[NonNegative, Required, "maximum of the Allan deviation of the drifting bias"] = (
        0.0
    )
    bias_correlation_s: Annotated[Positive, Required] = 600.0
    hard_iron_frd_gauss: Annotated[Vector, "constant field of the vessel itself"] = (0.0, 0.0, 0.0)
    resolution_gauss: Annotated[NonNegative, Required, "step of the output, 0 for none"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BarometerSpec(Specification):
    """Static pressure at the body origin."""

    rate_hz: Annotated[RateHz, Required] = 50.0
    latency_s: NonNegative = 0.0
    noise_pa: Annotated[NonNegative, Required, "white noise from one sample to the next"] = 0.0
    drift_pa: Annotated[NonNegative, Required, "standard deviation of the correlated error"] = 0.0
    drift_correlation_s: Annotated[Positive, Required] = 600.0
    resolution_pa: Annotated[NonNegative, Required, "step of the output, 0 for none"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RangefinderSpec(Specification):
    """An echo sounder, sonar, laser or radar along one direction, sent as DISTANCE_SENSOR.

    Its number is its position in the list.
    """

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    through: Annotated[
        Literal["water", "air"],
        "water: measures down to the bed at `environment.water.depth_m`; air: measures to the still surface; both "
        "also measure obstacles of the `world`",
    ] = "water"
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    direction_frd: Annotated[Vector, "direction of the beam, as a vector of any length; `[0, 0, 1]` is down"] = (
        0.0,
        0.0,
        1.0,
    )
    min_range_m: Annotated[float, Bounds(at_least=0, at_most=600)] = 0.3
    max_range_m: Annotated[float, Bounds(above=0, at_most=600)] = 100.0
    beam_deg: Annotated[
        float,
        Bounds(at_least=0, at_most=120),
        "width of the beam; the sensor reads the depth while the vessel leans by less than half of it",
    ] = 0.0
    noise_m: NonNegative = 0.0
    noise_share: Annotated[NonNegative, "noise in proportion to the range"] = 0.0
    resolution_m: Annotated[NonNegative, "step of the output, 0 for none"] = 0.0

    def check(self) -> None:
        check_limits(self.min_range_m, self.max_range_m)
        if math.hypot(*self.direction_frd) < _SHORTEST_DIRECTION:
            raise SpecificationError(
                ("direction_frd",),
                f"= [{', '.join(f'{part:g}' for part in self.direction_frd)}] has no direction; "
                "use [0, 0, 1] for down, [1, 0, 0] for ahead",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleScannerSpec(Specification):
    """Horizontal ranges to the obstacles of the `world`, sent as OBSTACLE_DISTANCE: 72 sectors from the bow."""

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    min_range_m: Annotated[float, Bounds(at_least=0, at_most=600)] = 0.5
    max_range_m: Annotated[float, Bounds(above=0, at_most=600)] = 100.0
    noise_m: NonNegative = 0.0

    def check(self) -> None:
        check_limits(self.min_range_m, self.max_range_m)


def check_limits(min_range_m: float, max_range_m: float) -> None:
    """Raises SpecificationError for a shortest range that is not the shorter one."""
    if min_range_m >= max_range_m:
        raise SpecificationError(
            ("min_range_m",),
            f"= {min_range_m:g} is not below max_range_m = {max_range_m:g}; lower it, or raise max_range_m",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WindVaneSpec(Specification):
    """Vane and anemometer at the mast: measures the apparent wind, for an autopilot with `autopilot.bridge.world`."""

    rate_hz: RateHz = 10.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (0.0, 0.0, 0.0)
    response_s: Annotated[NonNegative, "time constant of vane and cups; 0: none"] = 0.0
    speed_noise_mps: NonNegative = 0.0
    direction_noise_deg: NonNegative = 0.0
    speed_resolution_mps: NonNegative = 0.0
    direction_resolution_deg: NonNegative = 0.0
    max_speed_mps: Positive = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometrySpec(Specification):
    """Pose and velocity from an estimator such as a camera's, sent as ODOMETRY; it starts at zero and drifts.

    Position and heading drift as random walks, given by their deviation after one second. The rest is white noise.
    """

    rate_hz: RateHz = 20.0
    latency_s: NonNegative = 0.0
    position_noise_m: NonNegative = 0.0
    velocity_noise_mps: NonNegative = 0.0
    attitude_noise_deg: NonNegative = 0.0
    rate_noise_radps: NonNegative = 0.0
    drift_mprts: Annotated[NonNegative, "standard deviation of the position after one second"] = 0.0
    yaw_drift_degprts: Annotated[NonNegative, "standard deviation of the heading after one second"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarSpec(Specification):
    """A Livox Mid-70; roll, pitch and yaw turn its axis from straight ahead."""

    rate_hz: Annotated[float, Bounds(at_least=2, at_most=100), "frames per second"] = 10.0
    points_hz: Annotated[float, Bounds(at_least=1000, at_most=1_000_000)] = 100_000.0
    latency_s: NonNegative = 0.0
    position_frd_m: Vector = (1.0, 0.0, -0.8)
    roll_deg: Direction = 0.0
    pitch_deg: Annotated[Direction, "pitch angle, up positive"] = 0.0
    yaw_deg: Direction = 0.0
    range_noise_m: Annotated[NonNegative, "standard deviation of a range"] = 0.02
    min_range_m: NonNegative = 0.05
    max_range_m: Annotated[float, Bounds(above=0, at_most=320), "largest range, of the best reflector"] = 260.0
    range_at_10_percent_m: Annotated[
        Positive, "range of a diffuse 10 % reflector perpendicular to the beam; other ranges follow from it"
    ] = 90.0
    drop_share: Annotated[Share, "share of the returns that are lost at random"] = 0.0
    spray_share: Annotated[Share, "share of the points that droplets nearby return"] = 0.0

    def check(self) -> None:
        check_limits(self.min_range_m, self.max_range_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class SonarSpec(Specification):
    """A Ping360: one beam that scans a sector back and forth in steps of gradians (400 per turn)."""

    position_frd_m: Annotated[Vector, "position of the transducer"] = (0.5, 0.0, 0.5)
    heading_deg: Annotated[Direction, "direction of its zero angle, from the bow"] = 0.0
    sector_deg: Annotated[
        tuple[Direction, Direction],
        "start and end of the sector, clockwise, rounded to gradians; two numbers one turn apart are the whole circle",
    ] = (-90.0, 90.0)
    step_grad: Annotated[int, Bounds(at_least=1, at_most=10)] = 2
    range_m: Annotated[float, Bounds(at_least=0.75, at_most=50)] = 30.0
    samples: Annotated[int, Bounds(at_least=200, at_most=1200), "samples of an echo"] = 600
    gain: Annotated[int, Bounds(at_least=0, at_most=2)] = 1
    frequency_khz: Annotated[int, Bounds(at_least=500, at_most=1000)] = 750
    sound_speed_mps: Annotated[
        float, Bounds(at_least=1300, at_most=1700), "speed of sound that the sonar assumes for its ranges"
    ] = 1500.0
    water_temperature_c: Annotated[
        float, Bounds(at_least=0, at_most=40), "determines the true speed of sound and its absorption"
    ] = 27.0
    latency_s: NonNegative = 0.0
    serve: Annotated[
        str | None,
        "address that also serves the device's own protocol, `udp://127.0.0.1:9092` or `serial://pty`; null: none",
    ] = None

    def check(self) -> None:
        first_deg, last_deg = self.sector_deg
        if not 0.0 <= last_deg - first_deg <= 360.0:
            raise SpecificationError(
                ("sector_deg",),
                f"= [{first_deg:g}, {last_deg:g}] does not turn clockwise by at most 360 degrees; "
                "give the left end first, such as [-90, 90]",
            )
