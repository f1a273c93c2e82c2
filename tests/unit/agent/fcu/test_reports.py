"""Units and signs of the messages that report the state, by the public MAVLink definitions."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from agent.fcu.mavlink import reports
from agent.navigation.geodetic import Home, LocalProjection
from agent.navigation.inertial import quaternion
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    StateEstimate,
)

NOW_NS = 12_345_678_901
ORIGIN = LocalProjection(-8.75, -63.9, 70.0)
ANGLES_RAD = (0.1, -0.2, math.radians(-90.0))
ESTIMATE = StateEstimate(
    0, quaternion(*ANGLES_RAD), *ANGLES_RAD, (0.01, -0.02, 0.03), (100.0, -50.0, -2.5), (3.0, -4.0, 0.5), True, True
)


@pytest.fixture
def hub() -> Any:
    return SimpleNamespace(
        gnss=GnssMeasurement(0, -8.7654321, -63.9012345, 70.822, (-3.0, -4.0, 0.5), 1.4, 2.5, 0.3, 4, 12),
        imu=ImuMeasurement(0, (0.1, -0.2, 0.3), (0.980665, -1.96133, -9.80665), 25.5),
        magnetometer=MagnetometerMeasurement(0, (0.2, -0.05, 0.4)),
        barometer=BarometerMeasurement(0, 101_325.0, 15.25),
        actuators=SimpleNamespace(command=(0.5, 0.25, -1.0)),
        autopilot=SimpleNamespace(
            allocator=SimpleNamespace(mixer=SimpleNamespace(throttles=2)),
            estimator=SimpleNamespace(
                frame=ORIGIN,
                ratios=SimpleNamespace(velocity=0.25, position=0.04, height=-1.0, heading=0.09),
                variances=lambda: SimpleNamespace(horizontal_m2=0.5, vertical_m2=4.0, heading_rad2=0.01),
            ),
            navigator=SimpleNamespace(
                home=Home(*ORIGIN.to_geodetic(20.0, 30.0), 68.0),
                output=SimpleNamespace(
                    heading_rad=math.radians(-100.0),
                    bearing_rad=math.radians(45.0),
                    distance_m=70_000.0,
                    cross_track_m=-1.5,
                ),
            ),
            state=SimpleNamespace(estimate=ESTIMATE, speed_error_mps=0.75),
        ),
    )


def test_the_position_is_in_tenths_of_a_microdegree_millimetres_and_centimetres_per_second(hub: Any) -> None:
    message = reports.global_position(hub, NOW_NS)
    lat_deg, lon_deg = ORIGIN.to_geodetic(100.0, -50.0)
    assert (message.lat, message.lon) == pytest.approx((lat_deg * 1e7, lon_deg * 1e7), abs=0.51)
    assert (message.time_boot_ms, message.alt, message.relative_alt) == (12_345, 72_500, 4_500)
    assert (message.vx, message.vy, message.vz, message.hdg) == (300, -400, 50, 27_000)
    hub.autopilot.navigator.home = None
    assert reports.global_position(hub, NOW_NS).relative_alt == 2_500
    hub.autopilot.state.estimate = ESTIMATE._replace(position_valid=False)
    assert reports.global_position(hub, NOW_NS) is None


def test_home_is_at_its_place_in_the_local_frame(hub: Any) -> None:
    message = reports.home_position(hub, NOW_NS)
    lat_deg, lon_deg = ORIGIN.to_geodetic(20.0, 30.0)
    assert (message.latitude, message.longitude) == pytest.approx((lat_deg * 1e7, lon_deg * 1e7), abs=0.51)
    assert (message.altitude, message.time_usec) == (68_000, 12_345_678)
    assert (message.x, message.y, message.z) == pytest.approx((20.0, 30.0, 2.0))
    origin = reports.origin(hub, NOW_NS)
    assert (origin.latitude, origin.longitude, origin.altitude) == (-87_500_000, -639_000_000, 70_000)


def test_the_instruments_show_speed_heading_throttle_and_climb(hub: Any) -> None:
    message = reports.vfr_hud(hub, NOW_NS)
    assert (message.groundspeed, message.airspeed, message.climb) == (5.0, 5.0, -0.5)
    assert (message.heading, message.throttle, message.alt) == (270, 38, 72.5)  # mean of the two throttles


def test_a_fix_is_in_the_receivers_units(hub: Any) -> None:
    message = reports.gps_raw(hub, NOW_NS)
    assert (message.time_usec, message.fix_type, message.satellites_visible) == (12_345_678, 4, 12)
    assert (message.lat, message.lon, message.alt) == (-87_654_321, -639_012_345, 70_822)
    assert (message.vel, message.cog) == (500, 23_313)  # course 180 + atan(4 / 3) degrees
    assert (message.h_acc, message.v_acc, message.vel_acc) == (1_400, 2_500, 300)
    assert (message.eph, message.epv) == (65_535, 65_535)
    hub.gnss = None
    missing = reports.gps_raw(hub, NOW_NS)
    assert (missing.fix_type, missing.vel, missing.cog, missing.satellites_visible) == (0, 65_535, 65_535, 255)


def test_samples_are_in_thousandths_and_hectopascals(hub: Any) -> None:
    message = reports.raw_imu(hub, NOW_NS)
    assert (message.xacc, message.yacc, message.zacc) == (100, -200, -1_000)
    assert (message.xgyro, message.ygyro, message.zgyro) == (100, -200, 300)
    assert (message.xmag, message.ymag, message.zmag) == (200, -50, 400)
    assert (message.time_usec, message.temperature) == (12_345_678, 2_550)
    pressure = reports.scaled_pressure(hub, NOW_NS)
    assert (pressure.press_abs, pressure.temperature, pressure.time_boot_ms) == (1_013.25, 1_525, 12_345)
    hub.imu = hub.imu._replace(temperature_degc=math.nan)
    assert reports.raw_imu(hub, NOW_NS).temperature == 0


def test_accuracies_are_standard_deviations_and_ratios_are_roots(hub: Any) -> None:
    message = reports.estimator_status(hub, NOW_NS)
    assert (message.pos_horiz_accuracy, message.pos_vert_accuracy) == (1.0, 2.0)
    assert (message.vel_ratio, message.pos_horiz_ratio, message.pos_vert_ratio) == (0.5, 0.2, 0.0)
    assert message.mag_ratio == pytest.approx(0.3)
    assert reports.heading_accuracy(hub, NOW_NS).value == pytest.approx(0.1)
    assert (message.flags, message.time_usec) == (831, 12_345_678)
    hub.autopilot.state.estimate = ESTIMATE._replace(position_valid=False)
    assert reports.ekf_status(hub, NOW_NS).flags == 1
    hub.autopilot.state.estimate = ESTIMATE._replace(position_valid=False, attitude_valid=False)
    assert reports.ekf_status(hub, NOW_NS).flags == 1024


def test_guidance_is_in_degrees_and_metres(hub: Any) -> None:
    message = reports.nav_controller_output(hub, NOW_NS)
    assert (message.nav_bearing, message.target_bearing, message.wp_dist) == (-100, 45, 65_535)
    assert (message.aspd_error, message.xtrack_error) == (0.75, -1.5)
