"""A boat of our own for closing the loop without the simulator: planar dynamics, analytic bobbing, noisy sensors.

The figures are those of the full-size vessel. Attitude follows the horizontal motion's heading and two sines for roll
and pitch; heave is a sine. Rates and specific force are the exact derivatives of that motion.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import Actuators
from agent.navigation.estimator import Estimator
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    Vector3,
)

GRAVITY_MPS2 = 9.7814
DECLINATION_RAD = math.radians(-14.0)
FIELD_NED_GAUSS = (0.26 * math.cos(DECLINATION_RAD), 0.26 * math.sin(DECLINATION_RAD), -0.06)
LAT_DEG, LON_DEG, ALT_M = -8.80, -63.95, 50.0
# WGS 84 radii at that latitude, by hand: M = a(1-e²)/(1-e² sin²)^1.5, N cos(lat).
_W2 = 1.0 - 6.69437999014e-3 * math.sin(math.radians(LAT_DEG)) ** 2
NORTH_M_PER_DEG = math.radians(6378137.0 * (1.0 - 6.69437999014e-3) / _W2**1.5 + ALT_M)
EAST_M_PER_DEG = math.radians((6378137.0 / math.sqrt(_W2) + ALT_M) * math.cos(math.radians(LAT_DEG)))
STEP_NS = 5_000_000


@dataclass
class Noise:
    """Consumer sensors. `scale` 0 silences all of them."""

    gyro_density: float = math.radians(0.005)
    accel_density: float = 150e-6 * 9.8
    gyro_bias: Vector3 = (math.radians(0.4), math.radians(-0.3), math.radians(0.5))
    accel_bias: Vector3 = (0.02, -0.02, 0.03)
    gnss_m: float = 0.15
    gnss_drift_m: float = 0.6
    gnss_mps: float = 0.05
    field_gauss: float = 0.002
    pressure_pa: float = 3.0


@dataclass(frozen=True)
class Hull:
    """Mass, drag (linear, quadratic), full thrust ahead and astern of one propeller, its arm and lag."""

    mass_kg: float = 113.0
    inertia_kgm2: float = 64.0
    surge: tuple[float, float] = (15.0, 20.0)
    sway: tuple[float, float] = (250.0, 150.0)
    yaw: tuple[float, float] = (150.0, 200.0)
    thrust_n: tuple[float, float] = (250.0, 150.0)
    arm_m: float = 0.5
    lag_s: float = 0.3


THIRD = Hull(4.185, 0.2634, (0.962, 2.222), (16.04, 16.67), (1.069, 0.823), (9.26, 5.56), 0.167, 0.2)


@dataclass
class Boat:
    """State at `time_ns`; north and east of (LAT_DEG, LON_DEG), speeds in body axes over ground."""

    north_m: float = 0.0
    east_m: float = 0.0
    yaw_rad: float = 0.0
    surge_mps: float = 0.0
    sway_mps: float = 0.0
    yaw_rate_radps: float = 0.0
    thrust_n: list[float] = field(default_factory=lambda: [0.0, 0.0])
    current_ne_mps: tuple[float, float] = (0.0, 0.0)
    push_ne_n: Callable[[float], tuple[float, float]] = lambda _: (0.0, 0.0)
    roll_amplitude_rad: float = 0.0
    heave_amplitude_m: float = 0.0
    time_ns: int = 0
    acc_ne_mps2: tuple[float, float] = (0.0, 0.0)
    vel_ne_mps: tuple[float, float] = (0.0, 0.0)
    yaw_acc_radps2: float = 0.0
    hull: Hull = field(default_factory=Hull)

    def step(self, command: tuple[float, ...]) -> None:
        """5 ms of surge, sway and yaw relative to the water, by explicit Euler."""
        hull, dt = self.hull, STEP_NS * 1e-9
        for i in range(2):
            target = command[i] * abs(command[i]) * hull.thrust_n[0 if command[i] > 0.0 else 1]
            self.thrust_n[i] += (target - self.thrust_n[i]) * dt / hull.lag_s
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        push_n, push_e = self.push_ne_n(self.time_ns * 1e-9)
        water_u = self.current_ne_mps[0] * c + self.current_ne_mps[1] * s
        water_v = -self.current_ne_mps[0] * s + self.current_ne_mps[1] * c
        u, v, r = self.surge_mps - water_u, self.sway_mps - water_v, self.yaw_rate_radps
        force_x = sum(self.thrust_n) - _drag(hull.surge, u) + push_n * c + push_e * s
        force_y = -_drag(hull.sway, v) - push_n * s + push_e * c
        moment = hull.arm_m * (self.thrust_n[0] - self.thrust_n[1]) - _drag(hull.yaw, r)
        acc_x, acc_y = force_x / hull.mass_kg, force_y / hull.mass_kg
        self.yaw_acc_radps2 = moment / hull.inertia_kgm2
        self.acc_ne_mps2 = (acc_x * c - acc_y * s, acc_x * s + acc_y * c)
        self.vel_ne_mps = (
            self.surge_mps * c - self.sway_mps * s + self.acc_ne_mps2[0] * dt,
            self.surge_mps * s + self.sway_mps * c + self.acc_ne_mps2[1] * dt,
        )
        self.north_m += self.vel_ne_mps[0] * dt
        self.east_m += self.vel_ne_mps[1] * dt
        self.yaw_rad += r * dt
        self.yaw_rate_radps += self.yaw_acc_radps2 * dt
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        self.surge_mps = self.vel_ne_mps[0] * c + self.vel_ne_mps[1] * s
        self.sway_mps = -self.vel_ne_mps[0] * s + self.vel_ne_mps[1] * c
        self.time_ns += STEP_NS

    def roll_pitch(self) -> tuple[float, float, float, float]:
        """Roll, pitch and their rates."""
        a = self.roll_amplitude_rad
        if not a:
            return 0.0, 0.0, 0.0, 0.0
        t = self.time_ns * 1e-9
        w1, w2 = 2.0 * math.pi / 2.3, 2.0 * math.pi / 3.1
        return (
            a * math.sin(w1 * t),
            0.6 * a * math.sin(w2 * t + 1.0),
            a * w1 * math.cos(w1 * t),
            0.6 * a * w2 * math.cos(w2 * t + 1.0),
        )

    def down(self) -> tuple[float, float, float]:
        """Down, its rate and acceleration."""
        if not self.heave_amplitude_m:
            return 0.0, 0.0, 0.0
        t, w, a = self.time_ns * 1e-9, 2.0 * math.pi / 2.7, self.heave_amplitude_m
        return a * math.sin(w * t), a * w * math.cos(w * t), -a * w * w * math.sin(w * t)

    def gyro(self) -> Vector3:
        """Body rates of the Euler angle rates (z-y-x order)."""
        roll, pitch, roll_rate, pitch_rate = self.roll_pitch()
        return (
            roll_rate - self.yaw_rate_radps * math.sin(pitch),
            pitch_rate * math.cos(roll) + self.yaw_rate_radps * math.sin(roll) * math.cos(pitch),
            -pitch_rate * math.sin(roll) + self.yaw_rate_radps * math.cos(roll) * math.cos(pitch),
        )

    def to_body(self, v: Vector3) -> Vector3:
        """NED to FRD by three elementary turns."""
        cy, sy = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        x, y, z = v[0] * cy + v[1] * sy, -v[0] * sy + v[1] * cy, v[2]
        if not self.roll_amplitude_rad:
            return x, y, z
        roll, pitch, _, _ = self.roll_pitch()
        cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
        x, z = x * cp - z * sp, x * sp + z * cp
        return (x, y * cr + z * sr, -y * sr + z * cr)


def _drag(coefficients: tuple[float, float], speed: float) -> float:
    return coefficients[0] * speed + coefficients[1] * speed * abs(speed)


def _spoilt(true: Vector3, bias: Vector3, gauss: Callable[[float, float], float], deviation: float) -> Vector3:
    return (
        true[0] + bias[0] + gauss(0.0, deviation),
        true[1] + bias[1] + gauss(0.0, deviation),
        true[2] + bias[2] + gauss(0.0, deviation),
    )


class Sensors:
    """Samples of a boat, delivered with the GNSS's latency."""

    def __init__(self, seed: int, noise: Noise, latency_ns: int = 120_000_000) -> None:
        self.rng = random.Random(seed)
        self.noise = noise
        self.latency_ns = latency_ns
        self.drift = [self.rng.gauss(0.0, noise.gnss_drift_m) for _ in range(3)]
        self.late: list[GnssMeasurement] = []

    def feed(self, boat: Boat, estimator: Estimator, gnss: bool = True, imu: bool = True) -> None:
        """All samples of this instant: IMU 200 Hz, compass and barometer 50 Hz, GNSS 5 Hz."""
        if imu:
            estimator.on_imu(self.imu(boat))
        if boat.time_ns % 20_000_000 == 0:
            estimator.on_magnetometer(self.magnetometer(boat))
            estimator.on_barometer(self.barometer(boat))
        if boat.time_ns % 200_000_000 == 0 and gnss:
            self.late.append(self.gnss(boat))
        while self.late and boat.time_ns - self.late[0].stamp_ns >= self.latency_ns:
            estimator.on_gnss(self.late.pop(0))

    def imu(self, boat: Boat) -> ImuMeasurement:
        gauss, noise, root = self.rng.gauss, self.noise, math.sqrt(1e9 / STEP_NS)
        force = boat.to_body((boat.acc_ne_mps2[0], boat.acc_ne_mps2[1], boat.down()[2] - GRAVITY_MPS2))
        return ImuMeasurement(
            boat.time_ns,
            _spoilt(boat.gyro(), noise.gyro_bias, gauss, noise.gyro_density * root),
            _spoilt(force, noise.accel_bias, gauss, noise.accel_density * root),
        )

    def gnss(self, boat: Boat) -> GnssMeasurement:
        gauss, noise = self.rng.gauss, self.noise
        keep = math.exp(-0.2 / 60.0)
        spread = noise.gnss_drift_m * math.sqrt(1.0 - keep * keep)
        self.drift = [keep * d + gauss(0.0, spread) for d in self.drift]
        n, e, d = (drift + gauss(0.0, noise.gnss_m) for drift in self.drift)
        down, down_rate, _ = boat.down()
        return GnssMeasurement(
            boat.time_ns,
            LAT_DEG + (boat.north_m + n) / NORTH_M_PER_DEG,
            LON_DEG + (boat.east_m + e) / EAST_M_PER_DEG,
            ALT_M - down - d,
            tuple(v + gauss(0.0, noise.gnss_mps) for v in (*boat.vel_ne_mps, down_rate)),
            horizontal_accuracy_m=0.6,
            vertical_accuracy_m=0.9,
            speed_accuracy_mps=0.1,
        )

    def magnetometer(self, boat: Boat) -> MagnetometerMeasurement:
        field_frd_gauss = boat.to_body(FIELD_NED_GAUSS)
        return MagnetometerMeasurement(
            boat.time_ns, _spoilt(field_frd_gauss, (0.0, 0.0, 0.0), self.rng.gauss, self.noise.field_gauss)
        )

    def barometer(self, boat: Boat) -> BarometerMeasurement:
        height_m = ALT_M - boat.down()[0]
        pressure = 101_325.0 * (1.0 - height_m / 44_330.769) ** 5.25588 + self.rng.gauss(0.0, self.noise.pressure_pa)
        return BarometerMeasurement(boat.time_ns, pressure)


SILENT = Noise(0.0, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0)


def degrees(north_m: float, east_m: float) -> tuple[float, float]:
    """Latitude and longitude of a point."""
    return LAT_DEG + north_m / NORTH_M_PER_DEG, LON_DEG + east_m / EAST_M_PER_DEG


def sail(
    boat: Boat, sensors: Sensors, autopilot: Autopilot, duration_s: float, look: Callable[[Actuators], bool]
) -> None:
    """Close the loop for so long, or until `look`, called at 50 Hz, says so."""
    command: tuple[float, ...] = (0.0, 0.0)
    end_ns = boat.time_ns + round(duration_s * 1e9)
    while boat.time_ns < end_ns:
        sensors.feed(boat, autopilot.estimator)
        if boat.time_ns % 20_000_000 == 0:
            actuators = autopilot.control(boat.time_ns)
            command = actuators.command
            if look(actuators):
                return
        boat.step(command)
