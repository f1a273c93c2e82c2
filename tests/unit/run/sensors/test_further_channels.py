"""Sensors beside the usual four as they go out: decoded by pymavlink, against closed forms, others unchanged."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from agent.wire import dialect
from sim_core.kinematics import Kinematics
from xitl_cli.profile import load_profile
from xitl_cli.profile.load import ProfileError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds

STILL_AIR = np.zeros((1, 3))
TRUTH_ID = dialect.MAVLINK_MSG_ID_XITL_TRUTH


def ready(*overrides: str, profile: str = "sitl") -> RunProfile:
    return load_profile(profile, overrides).runnable()


def at(
    north_m: float, east_m: float, heading_deg: float, vel_ned_mps: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> Kinematics:
    half = math.radians(heading_deg) / 2
    c, s = math.cos(2 * half), math.sin(2 * half)
    zero = np.zeros((1, 3))
    return Kinematics(
        np.array([[north_m, east_m, -0.14]]),
        np.array([vel_ned_mps]),
        zero,
        np.array([[math.cos(half), 0.0, 0.0, math.sin(half)]]),
        np.array([[[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]]),
        np.array([[0.0, 0.0, 0.1]]),
        zero,
    )


def sensed(profile: RunProfile, motion: Kinematics, seconds: float, air: np.ndarray = STILL_AIR) -> list[Any]:
    sensing, physics_hz = make_sensing(profile, Seeds(3)), round(profile.clock.physics_rate_hz)
    messages = []
    for step in range(1, round(seconds * physics_hz) + 1):
        messages += sensing.due(step, step * 1_000_000_000 // physics_hz, motion, air)
    return messages


def decoded(messages: list[Any], name: str) -> list[Any]:
    """Those of this name, written by our codec and read by pymavlink's."""
    writer, reader = dialect.MAVLink(None, 1, 1), common.MAVLink(None)
    found = []
    for message in messages:
        if message.get_msgId() >= dialect.MAVLINK_MSG_ID_XITL_RUN:
            continue
        for one in reader.parse_buffer(bytearray(message.pack(writer))) or []:
            if one.get_type() == name:
                found.append(one)
    return found


def test_what_is_not_asked_for_is_not_sent() -> None:
    kinds = {message.get_msgId() for message in sensed(ready(), at(0, 0, 0), 1.0)}
    assert kinds == {54002, 54003, 54004, 54005}


def test_others_do_not_change_the_usual_four() -> None:
    more = ("sensors.rangefinders=[{noise_m: 0.1}]", "sensors.messages.odometry={drift_mprts: 0.1}")
    plain = sensed(ready(), at(0, 0, 30), 1.0)
    mixed = [m for m in sensed(ready(*more), at(0, 0, 30), 1.0) if m.get_msgId() >= 54000]
    assert [m.to_dict() for m in plain] == [m.to_dict() for m in mixed]


def test_an_echo_sounder_tells_the_depth_and_stays_within_its_limits() -> None:
    """Bed 20 m below the surface, which is 1 cm below the origin; the unit 0.2 m below the centre, itself at -0.14."""
    sounder = "{rate_hz: 5, position_frd_m: [0.0, 0.0, 0.2], beam_deg: 10}"
    radar = "{rate_hz: 5, through: air, direction_frd: [1.0, 0.0, 0.0], max_range_m: 30}"
    profile = ready(f"sensors.rangefinders=[{sounder}, {radar}]", "world=null")
    down, ahead = decoded(sensed(profile, at(0, 0, 0), 0.2), "DISTANCE_SENSOR")
    assert (down.id, down.orientation, down.type) == (0, 25, 1)
    assert down.current_distance == round((20.01 + 0.14 - 0.2) * 100)
    assert down.horizontal_fov == pytest.approx(math.radians(10.0))
    assert (ahead.id, ahead.orientation, ahead.type) == (1, 0, 0)
    assert (ahead.current_distance, ahead.max_distance) == (3001, 3000)
    close = ready("sensors.rangefinders=[{min_range_m: 25, max_range_m: 50}]")
    assert decoded(sensed(close, at(0, 0, 0), 0.1), "DISTANCE_SENSOR")[0].current_distance == 2499


def test_the_variance_of_a_range_is_in_square_centimetres_and_at_most_254() -> None:
    profile = ready("sensors.rangefinders=[{noise_m: 0.05}, {noise_m: 3.0}]")
    messages = decoded(sensed(profile, at(0, 0, 0), 0.1), "DISTANCE_SENSOR")
    assert [message.covariance for message in messages] == [25, 254]


def test_a_slanted_beam_goes_as_custom_with_the_turn_from_the_bow() -> None:
    profile = ready("sensors.rangefinders=[{direction_frd: [1.0, 1.0, 0.0]}]")
    (message,) = decoded(sensed(profile, at(0, 0, 0), 0.1), "DISTANCE_SENSOR")
    assert message.orientation == 100
    expected = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))
    assert tuple(message.quaternion) == pytest.approx(expected, abs=1e-6)


def test_a_second_receiver_sends_fixes_with_its_number_latency_and_gps_time() -> None:
    gnss = dataclasses.asdict(load_profile("sitl").sensors.gnss)  # type: ignore[union-attr]
    gnss |= {"horizontal_noise_m": 0.0, "horizontal_drift_m": 0.0, "velocity_noise_mps": 0.0, "gps_id": 1}
    gnss["antenna_frd_m"] = list(gnss["antenna_frd_m"])
    profile = ready(f"sensors.messages.gps_input={gnss}")
    fixes = decoded(sensed(profile, at(50, 20, 0, (2.0, -1.0, 0.0)), 1.0), "GPS_INPUT")
    assert [fix.time_usec for fix in fixes] == [
        200_000,
        400_000,
        600_000,
        800_000,
    ]  # 0.12 s late: the fifth comes later
    fix = fixes[0]
    lat, lon, _ = local_frame(profile.site).geodetic(np.array([[50.0, 20.0, 0.0]]))
    assert (fix.lat / 1e7, fix.lon / 1e7) == pytest.approx((lat[0], lon[0]), abs=2e-7)
    assert (fix.vn, fix.ve, fix.gps_id, fix.fix_type, fix.satellites_visible) == (2.0, -1.0, 1, 3, 14)
    week_ms = 7 * 86_400_000
    passed = [one.time_week * week_ms + one.time_week_ms for one in fixes]
    assert [later - passed[0] for later in passed] == [0, 200, 400, 600]


def test_the_scan_shows_the_log_boom_where_it_is() -> None:
    """On the boom's course of 36.87 degrees, 8 m upstream of its axis: 7.6 m to starboard, nothing to port."""
    profile = ready("sensors.messages.obstacle_distance={rate_hz: 2, max_range_m: 60}")
    place = (75.2 - 8.0 * math.sin(math.radians(36.87)) * -1, 66.4 - 8.0 * math.cos(math.radians(36.87)))
    (scan,) = decoded(sensed(profile, at(*place, 36.87), 0.5), "OBSTACLE_DISTANCE")
    assert (scan.frame, scan.increment_f, scan.angle_offset, scan.increment) == (12, 5.0, 0.0, 5)
    assert scan.distances[18] == pytest.approx(760, abs=2)
    assert set(scan.distances[40:68]) == {6001}


def test_the_vane_stands_in_the_wind_of_its_own_height() -> None:
    """A mast 2 m above the origin, which floats 0.13 m above the water, sees more than the hull's areas at 0.28 m."""
    vane = "sensors.wind_vane={rate_hz: 10, position_frd_m: [0, 0, -2]}"
    wind = "environment.wind={mean_mps: 4, profile: logarithmic, roughness_m: 0.001}"
    air = np.array([[0.0, -4.0, 0.0]])
    told = [
        message
        for message in sensed(ready(vane, wind, profile="sitl-ardupilot"), at(5, 6, 0), 0.5, air)
        if message.get_msgId() == TRUTH_ID
    ]
    areas_m = 0.5 * 1.3 / 2.3
    mast_m = 2.0 + 0.14 + 0.01
    assert told[-1].wind_speed == pytest.approx(4.0 * math.log(mast_m / 0.001) / math.log(areas_m / 0.001), rel=1e-5)


def test_the_dam_stands_across_its_heading() -> None:
    """60 m long toward east and 4 m wide, centred 100 m to the north: its near side is 98 m ahead."""
    dam = "{centre_ned_m: [100.0, 0.0, 0.0], size_m: [60.0, 4.0, 10.0], heading_deg: 90}"
    profile = ready(f"world={{dam: {dam}}}", "sensors.messages.obstacle_distance={rate_hz: 2, max_range_m: 200}")
    (scan,) = decoded(sensed(profile, at(0, 0, 0), 0.5), "OBSTACLE_DISTANCE")
    assert scan.distances[0] == 9800
    assert scan.distances[3] == pytest.approx(9800 / math.cos(math.radians(13.0)), abs=1)  # the nearest of its rays
    assert scan.distances[4] == 20001  # past its end, 17 degrees off


def test_odometry_starts_at_zero_in_local_axes() -> None:
    profile = ready("sensors.messages.odometry={rate_hz: 10, position_noise_m: 0.1, rate_noise_radps: 0.02}")
    first, second = decoded(sensed(profile, at(40, -10, 90, (0.0, 3.0, 0.0)), 0.2), "ODOMETRY")
    assert (first.frame_id, first.child_frame_id) == (20, 12)  # MAV_FRAME_LOCAL_FRD, MAV_FRAME_BODY_FRD
    assert (first.vx, first.vy) == pytest.approx((3.0, 0.0), abs=1e-6)
    assert abs(first.x) < 0.6
    assert tuple(second.q) == pytest.approx((1.0, 0.0, 0.0, 0.0), abs=1e-6)
    assert [second.pose_covariance[i] for i in (0, 6, 11)] == pytest.approx([0.01] * 3)
    assert [second.velocity_covariance[i] for i in (15, 18, 20)] == pytest.approx([0.0004] * 3)


def test_the_truth_goes_with_every_exchange_where_a_world_is_served() -> None:
    vane = "sensors.wind_vane={rate_hz: 10, latency_s: 0.1}"
    profile = ready(vane, "environment.wind={mean_mps: 4, profile: uniform}", profile="sitl-ardupilot")
    air = np.array([[0.0, -4.0, 0.0]])
    told = [m for m in sensed(profile, at(5, 6, 0, (3.0, 0.0, 0.0)), 0.5, air) if m.get_msgId() == TRUTH_ID]
    every_us = round(1e6 / profile.clock.exchange_rate_hz)
    assert [m.time_usec for m in told] == list(range(every_us, 500_001, every_us))
    assert tuple(told[0].pos_ned) == pytest.approx((5.0, 6.0, -0.14))
    assert tuple(told[0].vel_ned) == pytest.approx((3.0, 0.0, 0.0))
    assert tuple(told[0].gyro) == pytest.approx((0.0, 0.0, 0.1))
    assert told[0].wind_speed < 0.0  # none has come yet
    assert (told[-1].wind_speed, told[-1].wind_direction) == pytest.approx((5.0, math.atan2(4.0, 3.0)))
    before = [m.wind_speed for m in told if m.time_usec < 200_000]
    assert set(before) == {-1.0}


def test_an_autopilot_without_a_world_is_not_told_the_truth() -> None:
    kinds = {m.get_msgId() for m in sensed(ready(), at(0, 0, 0), 0.5)}
    assert TRUTH_ID not in kinds


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("sensors.rangefinders=[{rate_hz: 7}]", "sensors.rangefinders.0.rate_hz = 7 does not divide"),
        ("sensors.wind_vane={rate_hz: 3}", "sensors.wind_vane.rate_hz = 3 does not divide"),
        ("sensors.messages.odometry={rate_hz: 900}", "is above the physics rate"),
        ("sensors.rangefinders=[{min_range_m: 9, max_range_m: 3}]", "min_range_m = 9 is not below max_range_m"),
        ("sensors.rangefinders=[{direction_frd: [0.0, 0.0, 0.0]}]", "direction_frd = "),
        ("sensors.rangefinders=[{direction_frd: [1.0e-9, 0.0, 0.0]}]", "direction_frd = "),
        ("sensors.wind_vane={}", "sensors.wind_vane has no effect"),
    ],
)
def test_what_cannot_be_is_refused(override: str, said: str) -> None:
    with pytest.raises(ProfileError, match=said.replace("[", r"\[")):
        load_profile("sitl", [override])
