"""Sensors as data: rates, latencies, mounting, noise and limits.

Every sensor is measured once each 1 / rate_hz, a whole number of physics steps; a sample is delivered latency_s later.
Positions are from the body origin. Correlated errors are first-order Gauss-Markov processes.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import (
    Bounds,
    Direction,
    Items,
    NonNegative,
    Place,
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


ReflectorKind = Literal["corner-reflector-buoy", "buoy", "channel-marker", "small-vessel", "radar-reflector"]
REFLECTOR_SECTIONS_M2 = {
    "corner-reflector-buoy": (10.0, 3.5),
    "buoy": (5.0, 3.5),
    "channel-marker": (1.0, 1.0),
    "small-vessel": (2.5, 2.0),
    "radar-reflector": (7.5, 4.0),
}
"""Cross section in m² at 9 GHz, and height above the water in m: IMO resolution MSC.192(79), table 2 and its notes."""
LIGHT_MPS = 299_792_458.0
SECTORS = 24
"""Sectors in which a radar sends a turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadarReflectorSpec(Specification):
    """A point with a constant cross section that only the radar sees, such as a buoy."""

    place_ne_m: Annotated[Place, Required] = (0.0, 0.0)
    kind: Annotated[ReflectorKind, "object of IMO MSC.192(79), table 2, with its cross section and height"] = "buoy"
    cross_section_m2: Annotated[
        Annotated[float, Bounds(above=0, at_most=1e8)] | None, "null: the cross section of the kind"
    ] = None
    height_m: Annotated[
        Annotated[float, Bounds(above=0, at_most=1000)] | None, "height above the water; null: the height of the kind"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MarineRadarSpec(Specification):
    """A small X-band marine radar with a turning antenna; the defaults are those of a 4 kW magnetron radar."""

    position_frd_m: Annotated[Vector, "position of the antenna"] = (0.0, 0.0, -3.0)
    frequency_mhz: Annotated[float, Bounds(at_least=9000, at_most=10_000)] = 9410.0
    polarisation: Literal["horizontal", "vertical"] = "horizontal"
    peak_power_w: Annotated[float, Bounds(above=0, at_most=1e6)] = 4000.0
    beam_deg: Annotated[float, Bounds(at_least=0.2, at_most=20), "width of the beam, one way at half power"] = 4.0
    beam_height_deg: Annotated[float, Bounds(at_least=1, at_most=60), "height of the beam, as its width"] = 25.0
    gain_dbi: Annotated[
        Annotated[float, Bounds(at_least=0, at_most=60)] | None,
        "gain of the antenna; null: 26000 / (width times height of the beam)",
    ] = None
    pulse_us: Annotated[float, Bounds(at_least=0.01, at_most=2), "length of the pulse"] = 0.08
    prf_hz: Annotated[float, Bounds(at_least=100, at_most=10_000), "pulses per second"] = 2100.0
    rpm: Annotated[float, Bounds(at_least=5, at_most=60), "turns of the antenna per minute"] = 24.0
    noise_figure_db: Annotated[float, Bounds(at_least=0, at_most=40)] = 6.0
    losses_db: Annotated[float, Bounds(at_least=0, at_most=40), "all losses, out and back"] = 4.0
    range_m: Annotated[float, Bounds(at_least=50, at_most=100_000)] = 750.0
    min_range_m: Annotated[NonNegative, "nearer echoes are lost in the transmitted pulse"] = 20.0
    bins: Annotated[int, Bounds(at_least=64, at_most=2048), "samples along a spoke"] = 512
    spokes: Annotated[int, Bounds(at_least=120, at_most=4320), "spokes per turn, a multiple of 24"] = 720
    sea_state: Annotated[
        Annotated[float, Bounds(at_least=0, at_most=6)] | None,
        "sea state of the clutter; null: from waves and wind, and no clutter without both",
    ] = None
    multipath: Annotated[bool, "lobes by the path over the water, for vessels, drifting bodies and reflectors"] = True
    stc_range_m: Annotated[
        float, Bounds(at_least=0, at_most=100_000), "range up to which the gain is reduced (STC); 0: not"
    ] = 0.0
    stc_exponent: Annotated[
        float, Bounds(at_least=0, at_most=5), "exponent of STC: the gain grows with this power of the range"
    ] = 3.0
    ftc_m: Annotated[
        float,
        Bounds(at_least=0, at_most=100_000),
        "length of the mean that is subtracted along the range (FTC); 0: none",
    ] = 0.0
    floor_db: Annotated[float, Bounds(at_least=-20, at_most=60), "level of intensity 0, above the noise"] = 0.0
    span_db: Annotated[float, Bounds(at_least=10, at_most=120), "levels from intensity 0 to 255"] = 80.0
    heading_noise_deg: Annotated[
        float, Bounds(at_least=0, at_most=180), "of the heading in the messages, for each sector"
    ] = 0.5
    false_alarm_rate: Annotated[
        float, Bounds(at_least=1e-8, at_most=0.1), "probability of a detection in a sample of noise or clutter alone"
    ] = 1e-4
    cfar: Annotated[
        Literal["noise", "clutter"],
        "echo that has the false-alarm rate: noise, new in each pulse, or Rayleigh clutter, which lasts for a spoke",
    ] = "clutter"
    cfar_cells: Annotated[int, Bounds(at_least=4, at_most=64), "cells that estimate the noise, half on each side"] = 16
    plot_spokes: Annotated[int, Bounds(at_least=1, at_most=100), "least number of spokes in a plot"] = 3
    picture_px: Annotated[
        Annotated[int, Bounds(at_least=64, at_most=2048)] | None,
        "width and height of a recorded picture of each turn; null: none",
    ] = None
    reflectors: Annotated[tuple[RadarReflectorSpec, ...], Items(0, 1000), "buoys and other points"] = ()

    def check(self) -> None:
        if self.min_range_m >= self.range_m:
            raise SpecificationError(
                ("min_range_m",),
                f"= {self.min_range_m:g} is not below range_m = {self.range_m:g}; lower it, or raise range_m",
            )
        if self.position_frd_m[2] >= 0.0:
            raise SpecificationError(
                ("position_frd_m",),
                f"= [{', '.join(f'{part:g}' for part in self.position_frd_m)}] is not above the water, where the "
                "body's origin floats; use a negative third number, such as -3",
            )
        longest_us = self.range_m / 8.0 / (0.5e-6 * LIGHT_MPS)
        if self.pulse_us > longest_us:
            raise SpecificationError(
                ("pulse_us",),
                f"= {self.pulse_us:g} is {0.5e-6 * LIGHT_MPS * self.pulse_us:.0f} m long, more than an eighth of "
                f"range_m; use {math.floor(longest_us * 1e3) / 1e3:g} or less, or raise range_m",
            )
        farthest_m = 0.5 * LIGHT_MPS / self.prf_hz
        if self.range_m > farthest_m:
            raise SpecificationError(
                ("range_m",),
                f"= {self.range_m:g} is beyond the {farthest_m:.0f} m that an echo travels before the next pulse; "
                f"lower it, or use prf_hz: {math.floor(0.5 * LIGHT_MPS / self.range_m)} or less",
            )
        if self.spokes % SECTORS:
            below = self.spokes // SECTORS * SECTORS
            raise SpecificationError(
                ("spokes",), f"= {self.spokes} is no multiple of {SECTORS}; use {below} or {below + SECTORS}"
            )
        most = int(self.prf_hz * 60.0 / self.rpm)
        if self.spokes > most:
            raise SpecificationError(
                ("spokes",),
                f"= {self.spokes} is more than the {most} pulses of a turn; lower it or rpm, or raise prf_hz",
            )
