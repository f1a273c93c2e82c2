"""The estimator against motion that is known exactly, with the noise of consumer sensors and without any."""

from __future__ import annotations

import math

import pytest
from boat import DECLINATION_RAD, LAT_DEG, LON_DEG, SILENT, STEP_NS, Boat, Noise, Sensors
from python39 import strict_zip

from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.autopilot import Autopilot
from agent.navigation.measurements import GnssMeasurement, ImuMeasurement


def disarmed() -> Autopilot:
    return Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD}))


def errors(boat: Boat, autopilot: Autopilot) -> tuple[float, float, float, float, float]:
    """Roll, pitch and heading error in degrees, horizontal position error in metres, velocity error in m/s."""
    estimate = autopilot.estimator.estimate()
    roll, pitch, _, _ = boat.roll_pitch()
    frame = autopilot.estimator.frame
    assert frame is not None
    north, east = frame.to_local(LAT_DEG, LON_DEG)
    return (
        math.degrees(estimate.roll_rad - roll),
        math.degrees(estimate.pitch_rad - pitch),
        math.degrees(math.remainder(estimate.yaw_rad - boat.yaw_rad, 2.0 * math.pi)),
        math.hypot(estimate.pos_ned_m[0] - north - boat.north_m, estimate.pos_ned_m[1] - east - boat.east_m),
        math.hypot(estimate.vel_ned_mps[0] - boat.vel_ne_mps[0], estimate.vel_ned_mps[1] - boat.vel_ne_mps[1]),
    )


def advance(boat: Boat, sensors: Sensors, autopilot: Autopilot, seconds: float, command=(0.0, 0.0), **feed) -> None:
    """Sail with a fixed command; sensors as `Sensors.feed` takes them."""
    for _ in range(round(seconds * 1e9 / STEP_NS)):
        sensors.feed(boat, autopilot.estimator, **feed)
        boat.step(command)


def read(boat: Boat, sensors: Sensors, autopilot: Autopilot) -> tuple[float, float, float, float, float]:
    """Errors at this instant: the samples of it first, since the boat has already moved on."""
    sensors.feed(boat, autopilot.estimator)
    return errors(boat, autopilot)


@pytest.mark.parametrize("latency_s", [0.0, 0.12, 0.24, 0.5])
def test_a_late_fix_is_fused_where_it_was_taken(latency_s: float) -> None:
    """Straight ahead at 3 m/s, perfect sensors: uncompensated, 0.12 s would be 0.36 m."""
    boat = Boat(yaw_rad=0.5, surge_mps=3.0)
    sensors = Sensors(1, SILENT, latency_ns=round(latency_s * 1e9))
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 20.0, (0.77, 0.77))
    roll, pitch, yaw, position_m, velocity_mps = read(boat, sensors, autopilot)
    assert position_m < 0.02
    assert velocity_mps < 0.02
    assert max(abs(roll), abs(pitch), abs(yaw)) < 0.1


@pytest.mark.medium
@pytest.mark.parametrize("latency_s", [0.12, 0.6])
def test_a_circle_does_not_tilt_the_estimate(latency_s: float) -> None:
    """u r = 0.5 m/s² of centripetal acceleration would look like 3 degrees of heel to an accelerometer alone.

    Taken for current, a fix would be wrong by 0.5 m/s per second of latency, and position by 2 m.
    """
    boat = Boat()
    sensors = Sensors(1, SILENT, latency_ns=round(latency_s * 1e9))
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 40.0, (0.785, 0.392))
    assert abs(boat.yaw_rate_radps * math.hypot(*boat.vel_ne_mps)) > 0.4
    worst = [0.0] * 5
    for _ in range(200):
        advance(boat, sensors, autopilot, 0.1, (0.785, 0.392))
        worst = [max(a, abs(b)) for a, b in strict_zip(worst, read(boat, sensors, autopilot))]
    assert max(worst[:2]) < 0.3
    assert worst[2] < 0.3
    assert worst[3] < 0.05
    assert worst[4] < 0.02 + 0.1 * latency_s


@pytest.mark.medium
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_consumer_sensors_in_waves(seed: int) -> None:
    """A drifting, rolling, heaving boat. Limits: what the autopilot is specified for, not the filter's covariance."""
    noise = Noise()
    boat = Boat(yaw_rad=1.0, current_ne_mps=(0.4, -0.3), roll_amplitude_rad=math.radians(6.0), heave_amplitude_m=0.15)
    sensors = Sensors(seed, noise)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 12.0)
    assert autopilot.estimator.problems() == ()
    advance(boat, sensors, autopilot, 18.0, (0.7, 0.6))
    squares = [0.0] * 5
    drift2 = 0.0
    for _ in range(300):
        advance(boat, sensors, autopilot, 0.1, (0.7, 0.6))
        squares = [a + b * b / 300 for a, b in strict_zip(squares, read(boat, sensors, autopilot))]
        drift2 += (sensors.drift[0] ** 2 + sensors.drift[1] ** 2) / 300
    roll, pitch, yaw, position_m, velocity_mps = (math.sqrt(value) for value in squares)
    assert max(roll, pitch) < 0.5
    assert yaw < 1.0
    assert velocity_mps < 0.1
    assert position_m < math.sqrt(drift2) + 0.15  # the slow drift cannot be told from motion; the white noise can
    for estimated, true in strict_zip(autopilot.estimator.gyro_bias_frd_radps, noise.gyro_bias):
        assert abs(estimated - true) < math.radians(0.05)  # a tenth of the turn-on bias


def test_hard_iron_is_taken_off_by_the_compass_offsets() -> None:
    boat = Boat(yaw_rad=0.8)
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    autopilot.parameters.set("COMPASS_OFS_Y", -50.0)
    honest = sensors.magnetometer

    def magnetised(boat: Boat):
        x, y, z = honest(boat).field_frd_gauss
        return honest(boat)._replace(field_frd_gauss=(x, y + 0.05, z))

    sensors.magnetometer = magnetised  # type: ignore[method-assign]
    autopilot.control(0)
    advance(boat, sensors, autopilot, 12.0)
    assert abs(read(boat, sensors, autopilot)[2]) < 0.1


@pytest.mark.medium
def test_lever_arms_are_taken_off() -> None:
    """IMU forward of and antenna above a rolling, turning boat: position and velocity are those of the origin."""
    arm, imu_arm = (-0.5, 0.2, -1.2), (0.6, 0.0, 0.0)
    boat = Boat(roll_amplitude_rad=math.radians(8.0))
    sensors = Sensors(1, SILENT)
    names = {f"GPS1_POS_{axis}": value for axis, value in strict_zip("XYZ", arm)} | {"INS_POS1_X": imu_arm[0]}
    autopilot = Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD, **names}))
    fix_of_origin, imu_of_origin = sensors.gnss, sensors.imu

    def to_ned(boat: Boat, v):
        rows = [boat.to_body(axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
        return tuple(sum(r * x for r, x in strict_zip(row, v)) for row in rows)

    def cross(a, b):
        return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])

    def gnss(boat: Boat) -> GnssMeasurement:
        from boat import EAST_M_PER_DEG, NORTH_M_PER_DEG

        fix = fix_of_origin(boat)
        n, e, d = to_ned(boat, arm)
        swing = to_ned(boat, cross(boat.gyro(), arm))
        return fix._replace(
            lat_deg=fix.lat_deg + n / NORTH_M_PER_DEG,
            lon_deg=fix.lon_deg + e / EAST_M_PER_DEG,
            alt_m=fix.alt_m - d,
            vel_ned_mps=tuple(v + s for v, s in strict_zip(fix.vel_ned_mps, swing)),
        )

    before = [(0.0, 0.0, 0.0)]

    def imu(boat: Boat) -> ImuMeasurement:
        sample, gyro = imu_of_origin(boat), boat.gyro()
        angular_acc = tuple((w - w0) / (STEP_NS * 1e-9) for w, w0 in strict_zip(gyro, before[0]))
        before[0] = gyro
        extra = (a + b for a, b in strict_zip(cross(angular_acc, imu_arm), cross(gyro, cross(gyro, imu_arm))))
        return sample._replace(accel_frd_mps2=tuple(f + a for f, a in strict_zip(sample.accel_frd_mps2, extra)))

    sensors.gnss, sensors.imu = gnss, imu  # type: ignore[method-assign]
    advance(boat, sensors, autopilot, 30.0, (0.8, 0.5))
    worst = [0.0] * 5
    for _ in range(40):
        advance(boat, sensors, autopilot, 0.1, (0.8, 0.5))
        worst = [max(a, abs(b)) for a, b in strict_zip(worst, read(boat, sensors, autopilot))]
    assert worst[3] < 0.1  # the arms together are 1.4 m
    assert worst[4] < 0.1  # the antenna swings with 0.46 m/s


@pytest.mark.medium
def test_height_follows_the_heave() -> None:
    boat = Boat(heave_amplitude_m=0.3)
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 40.0)
    seen = []
    for _ in range(60):
        advance(boat, sensors, autopilot, 0.1)
        read(boat, sensors, autopilot)
        frame = autopilot.estimator.frame
        assert frame is not None
        seen.append(frame.alt_m - autopilot.estimator.estimate().pos_ned_m[2] - 50.0 + boat.down()[0])
    assert max(map(abs, seen)) < 0.05


@pytest.mark.medium
def test_an_outlier_is_gated_and_a_lasting_one_believed() -> None:
    boat = Boat(surge_mps=2.0)
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 15.0, (0.5, 0.5))
    honest = sensors.gnss
    offset_deg = [100.0 / 111_000.0]
    sensors.gnss = lambda boat: honest(boat)._replace(lat_deg=honest(boat).lat_deg + offset_deg[0])  # type: ignore
    advance(boat, sensors, autopilot, 3.0, (0.5, 0.5))
    assert autopilot.estimator.ratios.position > 1.0
    assert [problem.check for problem in autopilot.estimator.problems()] == ["EKF"]
    assert errors(boat, autopilot)[3] < 0.2
    advance(boat, sensors, autopilot, 4.0, (0.5, 0.5))
    assert errors(boat, autopilot)[3] == pytest.approx(99.6, abs=1.0)
    offset_deg[0] = 0.0
    advance(boat, sensors, autopilot, 8.0, (0.5, 0.5))
    assert errors(boat, autopilot)[3] < 0.2


@pytest.mark.medium
def test_one_velocity_outlier_does_not_tilt_the_attitude() -> None:
    boat = Boat()
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 15.0)
    honest = sensors.gnss
    sensors.gnss = lambda boat: honest(boat)._replace(vel_ned_mps=(20.0, -20.0, 0.0))  # type: ignore[method-assign]
    advance(boat, sensors, autopilot, 0.2)
    sensors.gnss = honest  # type: ignore[method-assign]
    advance(boat, sensors, autopilot, 1.0)
    roll, pitch, _, _, velocity_mps = read(boat, sensors, autopilot)
    assert max(abs(roll), abs(pitch)) < 0.05
    assert velocity_mps < 0.05


@pytest.mark.medium
def test_position_is_believed_for_five_seconds_without_fixes() -> None:
    boat = Boat(surge_mps=2.0)
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 15.0, (0.5, 0.5))
    advance(boat, sensors, autopilot, 4.5, (0.5, 0.5), gnss=False)
    assert autopilot.estimator.position_valid()
    assert errors(boat, autopilot)[3] < 0.5
    advance(boat, sensors, autopilot, 1.0, (0.5, 0.5), gnss=False)
    assert not autopilot.estimator.position_valid()
    advance(boat, sensors, autopilot, 10.0, (0.5, 0.5))
    assert autopilot.estimator.position_valid()
    assert errors(boat, autopilot)[3] < 0.1


BAD = [math.nan, math.inf, -math.inf, 1e30, -1e300]


@pytest.mark.parametrize("value", BAD)
def test_impossible_samples_are_refused_and_change_nothing(value: float) -> None:
    boat = Boat(surge_mps=1.0)
    sensors = Sensors(1, Noise())
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 12.0)
    before = autopilot.estimator.estimate()
    refused = dict(autopilot.estimator.refused)
    imu, fix = sensors.imu(boat), sensors.gnss(boat)
    field, air = sensors.magnetometer(boat), sensors.barometer(boat)
    for i in range(3):
        spoilt = tuple(value if i == j else 0.0 for j in range(3))
        assert not autopilot.estimator.on_imu(imu._replace(gyro_frd_radps=spoilt))
        assert not autopilot.estimator.on_imu(imu._replace(accel_frd_mps2=spoilt))
        assert not autopilot.estimator.on_gnss(fix._replace(vel_ned_mps=spoilt))
        assert not autopilot.estimator.on_magnetometer(field._replace(field_frd_gauss=spoilt))
    for name in ("lat_deg", "lon_deg", "alt_m", "horizontal_accuracy_m", "vertical_accuracy_m", "speed_accuracy_mps"):
        assert not autopilot.estimator.on_gnss(fix._replace(**{name: value}))
    assert not autopilot.estimator.on_barometer(air._replace(pressure_pa=value))
    assert autopilot.estimator.estimate() == before
    counted = {name: count - refused[name] for name, count in autopilot.estimator.refused.items()}
    assert counted == {"imu": 6, "gnss": 9, "magnetometer": 3, "barometer": 1}


def test_repeated_and_older_samples_are_refused() -> None:
    boat = Boat()
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 12.0)
    sample = sensors.imu(boat)
    assert autopilot.estimator.on_imu(sample)
    assert not autopilot.estimator.on_imu(sample)
    assert not autopilot.estimator.on_imu(sample._replace(stamp_ns=sample.stamp_ns - 1))
    fix = sensors.gnss(boat)
    assert not autopilot.estimator.on_gnss(fix._replace(stamp_ns=fix.stamp_ns + 10**12))
    assert autopilot.estimator.on_gnss(fix)
    assert not autopilot.estimator.on_gnss(fix)


@pytest.mark.medium
def test_a_gap_in_the_imu_is_bridged() -> None:
    boat = Boat(yaw_rad=0.3, surge_mps=2.0)
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    advance(boat, sensors, autopilot, 15.0, (0.5, 0.5))
    advance(boat, sensors, autopilot, 2.0, (0.5, 0.5), imu=False, gnss=False)
    advance(boat, sensors, autopilot, 10.0, (0.5, 0.5))
    roll, pitch, yaw, position_m, velocity_mps = read(boat, sensors, autopilot)
    assert position_m < 0.2
    assert velocity_mps < 0.1
    assert max(abs(roll), abs(pitch), abs(yaw)) < 0.5


def test_a_clock_that_was_set_back_starts_the_estimate_again() -> None:
    boat = Boat()
    sensors = Sensors(1, SILENT)
    autopilot = disarmed()
    boat.time_ns = 10**12
    advance(boat, sensors, autopilot, 12.0)
    boat.time_ns = 0
    advance(boat, sensors, autopilot, 15.0)
    assert autopilot.estimator.restarts == 1
    assert autopilot.estimator.problems() == ()


def test_without_a_heading_the_compass_is_named() -> None:
    autopilot = disarmed()
    assert [problem.text for problem in autopilot.estimator.problems()] == ["AHRS: EKF3 not started"]
    boat, sensors = Boat(), Sensors(1, SILENT)
    for _ in range(2400):
        autopilot.estimator.on_imu(sensors.imu(boat))
        boat.step((0.0, 0.0))
    texts = {problem.text for problem in autopilot.estimator.problems()}
    assert texts == {"Compass not healthy", "GPS 1: Bad fix", "Baro: not healthy"}
    assert not autopilot.estimator.estimate().attitude_valid
