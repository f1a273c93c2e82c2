"""Recorded payloads as messages of ROS, against scipy's rotations, pymap3d and the conventions of the REPs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from foxglove.messages import LocationFix
from scipy.spatial.transform import Rotation

from agent.wire import dialect
from agent.wire.codec import Message, Packer
from sim_core.frames import euler_to_quat
from xitl_cli.plugins.ros.conversion import ContinuousOdometry, RosConversion, RosMessage, rotated
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.outputs import OUTPUTS
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import TOPICS

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def profile() -> RunProfile:
    return load_profile("sitl-perception").runnable()


@pytest.fixture
def conversion(profile: RunProfile) -> RosConversion:
    return RosConversion([profile])


def sent(conversion: RosConversion, message: Message, stamp_ns: int = 0, link: str = "agent/tx") -> list[RosMessage]:
    frame = Packer(1, 1).pack(message)
    payload = TOPICS["/link/{link}/tx"].message_type().encode(stamp_ns, frame)
    return list(conversion.convert(f"/link/{link}", payload, stamp_ns))


def odometry(stamp_ns: int, position: list[float], xyzw: list[float], variance: float = 0.0) -> bytes:
    covariance = [variance if row == column and row < 3 else 0.0 for row in range(6) for column in range(6)]
    twist, nothing = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], [0.0] * 36
    encode = TOPICS["/estimate/odometry"].message_type().encode
    return encode(stamp_ns, "map", "base_link_estimate", position, xyzw, covariance, twist, nothing)


def read(messages: list[RosMessage], topic: str) -> Any:
    found = [message for message in messages if message.topic.full_name(message.vessel) == topic]
    assert len(found) == 1, [message.topic.name for message in messages]
    return deserialize(found[0].cdr, found[0].topic.type)


def test_imu_is_in_flu_with_gravity_upwards_and_no_orientation_before_an_estimate(conversion: RosConversion) -> None:
    message = dialect.MAVLink_xitl_imu_message(1_234_567, [0.1, 0.2, 0.3], [0.5, 0.25, -9.8], 20.0)
    imu = read(sent(conversion, message), "/imu/data")
    assert imu.header.frame_id == "imu_link"
    assert (imu.header.stamp.sec, imu.header.stamp.nanosec) == (1, 234_567_000)
    rates = imu.angular_velocity
    assert [rates.x, rates.y, rates.z] == pytest.approx([0.1, -0.2, -0.3])
    force = imu.linear_acceleration
    assert [force.x, force.y, force.z] == pytest.approx([0.5, -0.25, 9.8])
    assert imu.orientation_covariance[0] == -1.0


def test_orientation_of_the_imu_is_the_estimate_carried_on_by_the_gyroscope(conversion: RosConversion) -> None:
    """Against scipy: attitude in NED, three samples at a constant rate, one of them before the estimate's instant."""
    started = Rotation.from_euler("ZYX", [70.0, -5.0, 10.0], degrees=True)
    gyro = np.array([0.3, -0.2, 0.5])
    in_enu = Rotation.from_matrix(ENU_FROM_NED @ started.as_matrix() @ FLU_FROM_FRD)
    for at_us in (990_000, 1_010_000):
        sent(conversion, dialect.MAVLink_xitl_imu_message(at_us, gyro.tolist(), [0.0, 0.0, -9.8], 20.0))
    payload = odometry(1_000_000_000, [0.0, 0.0, 0.0], in_enu.as_quat().tolist())
    list(conversion.convert("/estimate/odometry", payload, 1_000_000_000))
    sample = dialect.MAVLink_xitl_imu_message(1_030_000, gyro.tolist(), [0.0, 0.0, -9.8], 20.0)
    imu = read(sent(conversion, sample), "/imu/data")
    after = started * Rotation.from_rotvec(0.030 * gyro)
    expected = Rotation.from_matrix(ENU_FROM_NED @ after.as_matrix() @ FLU_FROM_FRD)
    found = Rotation.from_quat([imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w])
    assert (found.inv() * expected).magnitude() < 1e-6  # the wire carries float32
    assert imu.orientation_covariance[0] > 0.0


def test_an_estimate_that_is_too_old_is_no_orientation(conversion: RosConversion) -> None:
    list(conversion.convert("/estimate/odometry", odometry(1_000_000_000, [0.0] * 3, [0.0, 0.0, 0.0, 1.0]), 10**9))
    sample = dialect.MAVLink_xitl_imu_message(2_100_000, [0.0] * 3, [0.0, 0.0, -9.8], 20.0)
    assert read(sent(conversion, sample), "/imu/data").orientation_covariance[0] == -1.0


def test_fix_has_the_place_and_the_receivers_accuracy(conversion: RosConversion) -> None:
    message = dialect.MAVLink_xitl_gnss_message(
        2_000_000, -87_994_686, -639_495_531, 70_822, [2.0, 1.0, 0.5], 1.4, 2.0, 0.1, 3, 12
    )
    found = sent(conversion, message)
    fix = read(found, "/fix")
    assert (fix.latitude, fix.longitude) == pytest.approx((-8.7994686, -63.9495531), abs=1e-9)
    assert fix.altitude == pytest.approx(70.822)
    assert (fix.status.status, fix.status.service) == (0, 1)
    assert fix.header.frame_id == "gnss_link"
    # Both horizontal axes together are 1.4 m, so that each is 1.4 m over the root of two.
    assert np.diag(fix.position_covariance.reshape(3, 3)) == pytest.approx([0.98, 0.98, 4.0], rel=1e-5)
    velocity = read(found, "/fix_velocity").twist.linear
    assert [velocity.x, velocity.y, velocity.z] == pytest.approx([1.0, 2.0, -0.5])


def test_sensors_have_the_variance_of_a_sample_of_their_white_noise(
    conversion: RosConversion, profile: RunProfile
) -> None:
    """A density d sampled at a rate f has the variance d^2 f."""
    sensors = profile.sensors
    imu = read(sent(conversion, dialect.MAVLink_xitl_imu_message(0, [0.0] * 3, [0.0] * 3, 20.0)), "/imu/data")
    gyro = sensors.imu.gyro_noise_density_radpsprthz**2 * sensors.imu.rate_hz
    accel = sensors.imu.accel_noise_density_mps2prthz**2 * sensors.imu.rate_hz
    assert imu.angular_velocity_covariance.reshape(3, 3) == pytest.approx(np.eye(3) * gyro, rel=1e-6, abs=0.0)
    assert imu.linear_acceleration_covariance.reshape(3, 3) == pytest.approx(np.eye(3) * accel, rel=1e-6, abs=0.0)
    compass = read(sent(conversion, dialect.MAVLink_xitl_magnetometer_message(0, [0.2, 0.0, 0.4])), "/magnetic_field")
    gauss2 = sensors.magnetometer.noise_density_gaussprthz**2 * sensors.magnetometer.rate_hz
    tesla2 = compass.magnetic_field_covariance.reshape(3, 3)
    assert tesla2 == pytest.approx(np.eye(3) * gauss2 * 1e-8, rel=1e-6, abs=0.0)
    barometer = read(sent(conversion, dialect.MAVLink_xitl_barometer_message(0, 101_325.0, 20.0)), "/fluid_pressure")
    assert barometer.variance == pytest.approx(sensors.barometer.noise_pa**2)


def test_a_receiver_without_a_fix_says_so(conversion: RosConversion) -> None:
    message = dialect.MAVLink_xitl_gnss_message(2_000_000, 0, 0, 0, [0.0] * 3, 1.0, 1.0, 1.0, 0, 0)
    found = sent(conversion, message)
    assert read(found, "/fix").status.status == -1
    assert [message.topic.name for message in found] == ["fix"]


def test_magnetic_field_is_in_tesla_and_pressure_in_pascal(conversion: RosConversion) -> None:
    message = dialect.MAVLink_xitl_magnetometer_message(1_000_000, [0.2, 0.05, 0.4])
    field = read(sent(conversion, message), "/magnetic_field").magnetic_field
    assert [field.x, field.y, field.z] == pytest.approx([2e-5, -5e-6, -4e-5])
    pressure = read(sent(conversion, dialect.MAVLink_xitl_barometer_message(0, 101_325.0, 15.0)), "/fluid_pressure")
    assert pressure.fluid_pressure == pytest.approx(101_325.0)


@pytest.mark.parametrize("unstated_m2", [0.0, 1e6])
def test_a_position_whose_variance_the_autopilot_does_not_state_has_the_documented_one(
    conversion: RosConversion, unstated_m2: float
) -> None:
    payload = odometry(1, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], unstated_m2)
    message = read(list(conversion.convert("/estimate/odometry", payload, 1)), "/odometry")
    assert np.diag(message.pose.covariance.reshape(6, 6))[:3].tolist() == [1.0] * 3


def test_estimate_is_odom_to_base_link_with_a_covariance_that_is_nowhere_zero(conversion: RosConversion) -> None:
    xyzw = Rotation.from_euler("ZYX", [30.0, 2.0, -3.0], degrees=True).as_quat().tolist()
    payload = odometry(1_500_000_000, [10.0, 20.0, 0.5], xyzw, variance=0.09)
    found = list(conversion.convert("/estimate/odometry", payload, 1_500_000_000))
    message = read(found, "/odometry")
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    pose = np.diag(message.pose.covariance.reshape(6, 6))
    assert pose[:3] == pytest.approx([0.09] * 3)
    assert (pose > 0.0).all()
    assert (np.diag(message.twist.covariance.reshape(6, 6)) > 0.0).all()
    transform = read(found, "/tf").transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    place, turn = transform.transform.translation, transform.transform.rotation
    assert [place.x, place.y, place.z] == [10.0, 20.0, 0.5]
    assert [turn.x, turn.y, turn.z, turn.w] == pytest.approx(xyzw)
    assert list(conversion.convert("/estimate/odometry", payload, 1_500_000_000)) == []


def test_truth_goes_out_as_it_was_recorded(conversion: RosConversion) -> None:
    payload = odometry(1_000_000_000, [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])
    (message,) = conversion.convert("/truth/odometry", payload, 1_000_000_000)
    assert (message.topic.name, message.cdr) == ("ground_truth/odom", payload)


def test_the_true_place_on_the_earth_is_exact(conversion: RosConversion) -> None:
    place = LocationFix(frame_id="base_link", latitude=-8.7994686123, longitude=-63.9495531456, altitude=70.8225)
    found = list(conversion.convert("/truth/fix", place.encode(), 1_500_000_000))
    fix = read(found, "/ground_truth/fix")
    assert (fix.latitude, fix.longitude, fix.altitude) == (-8.7994686123, -63.9495531456, 70.8225)
    assert (fix.header.frame_id, fix.header.stamp.sec, fix.header.stamp.nanosec) == ("base_link", 1, 500_000_000)
    assert fix.status.status == 0
    assert (fix.position_covariance_type, fix.position_covariance.any()) == (3, False)


def test_without_an_autopilot_the_truth_moves_base_link() -> None:
    profile = load_profile("mitl").runnable()
    payload = odometry(1_000_000_000, [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])
    found = list(RosConversion([profile]).convert("/truth/odometry", payload, 1_000_000_000))
    transform = read(found, "/tf").transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")


def test_clock_is_the_runs_time_and_of_the_first_vessel_alone(profile: RunProfile) -> None:
    conversion = RosConversion([replace(profile, vessel="alpha"), replace(profile, vessel="bravo")])
    payload = TOPICS["/actuators"].message_type().encode(2_500_000_000, (0.0,), False, False, 0.0, "propeller 0")
    clock = read(list(conversion.convert("/alpha/actuators", payload, 2_500_000_000)), "/clock").clock
    assert (clock.sec, clock.nanosec) == (2, 500_000_000)
    assert list(conversion.convert("/bravo/actuators", payload, 2_500_000_000)) == []


def test_frames_and_topics_of_several_vessels_bear_their_names(profile: RunProfile) -> None:
    conversion = RosConversion([replace(profile, vessel="alpha"), replace(profile, vessel="bravo")])
    payload = odometry(1_000_000_000, [0.0] * 3, [0.0, 0.0, 0.0, 1.0])
    found = list(conversion.convert("/bravo/estimate/odometry", payload, 1_000_000_000))
    message = read(found, "/bravo/odometry")
    assert (message.header.frame_id, message.child_frame_id) == ("bravo/odom", "bravo/base_link")
    assert read(found, "/tf").transforms[0].child_frame_id == "bravo/base_link"
    assert read(found, "/tf").transforms[1].child_frame_id == "bravo/odom"
    names = {each.child_frame_id for each in read(list(conversion.static()), "/tf_static").transforms}
    assert {"alpha/lidar_link", "bravo/imu_link"} <= names
    assert conversion.wants("/alpha/lidar/points")
    assert not conversion.wants("/charlie/lidar/points")


def test_lidar_hangs_where_the_profile_has_it(profile: RunProfile) -> None:
    """Its x axis in the body against scipy's own Euler angles, in FRD."""
    assert profile.sensors is not None
    assert profile.sensors.lidar is not None
    lidar = replace(
        profile.sensors.lidar, position_frd_m=(1.0, 0.2, -0.8), roll_deg=10.0, pitch_deg=-15.0, yaw_deg=40.0
    )
    turned = replace(profile, sensors=replace(profile.sensors, lidar=lidar))
    static = read([next(iter(RosConversion([turned]).static()))], "/tf_static")
    found = next(each for each in static.transforms if each.child_frame_id == "lidar_link")
    assert found.header.frame_id == "base_link"
    place, turn = found.transform.translation, found.transform.rotation
    assert [place.x, place.y, place.z] == pytest.approx([1.0, -0.2, 0.8])
    in_frd = Rotation.from_euler("ZYX", [40.0, -15.0, 10.0], degrees=True).as_matrix()
    expected = FLU_FROM_FRD @ in_frd @ FLU_FROM_FRD
    assert Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix() == pytest.approx(expected, abs=1e-12)


def test_wind_is_where_the_air_goes_to_in_enu(conversion: RosConversion) -> None:
    encode = TOPICS["/environment"].message_type().encode
    found = list(conversion.convert("/environment", encode(0, [0.1, 0.2, 0.0], [3.0, -4.0, 0.0], 0.0), 0))
    wind, current = read(found, "/wind"), read(found, "/current")
    assert (wind.vector.x, wind.vector.y, wind.vector.z) == (-4.0, 3.0, 0.0)
    assert (current.vector.x, current.vector.y) == (0.2, 0.1)
    assert wind.header.frame_id == "map"


def test_attitudes_of_the_house_and_of_scipy_agree() -> None:
    """Of what the other tests stand on: w x y z here, x y z w there."""
    w, x, y, z = euler_to_quat(np.radians([10.0, -5.0, 70.0])).tolist()
    theirs = Rotation.from_euler("ZYX", [70.0, -5.0, 10.0], degrees=True).as_quat()
    assert [x, y, z, w] == pytest.approx(theirs.tolist())
    assert math.hypot(x, y, z, w) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("tf", "static", "moving"),
    [
        ("estimate", False, [("odom", "base_link"), ("map", "odom")]),
        ("truth", True, []),
        ("none", False, []),
    ],
)
def test_who_publishes_map_to_odom(profile: RunProfile, tf: str, static: bool, moving: list[tuple[str, str]]) -> None:
    conversion = RosConversion([replace(profile, ros=replace(profile.ros, tf=tf))])  # type: ignore[arg-type]
    fixed = read(list(conversion.static()), "/tf_static").transforms
    assert (("map", "odom") in [(one.header.frame_id, one.child_frame_id) for one in fixed]) == static
    payload = odometry(1_000_000_000, [0.0] * 3, [0.0, 0.0, 0.0, 1.0])
    found = [one for one in conversion.convert("/estimate/odometry", payload, 1_000_000_000) if one.topic.name == "/tf"]
    links = [(one.header.frame_id, one.child_frame_id) for one in read(found, "/tf").transforms] if found else []
    assert links == moving


def test_a_correction_of_the_estimate_moves_odom_in_map_alone(profile: RunProfile) -> None:
    conversion = RosConversion([profile])
    level = [0.0, 0.0, 0.0, 1.0]
    list(conversion.convert("/estimate/odometry", odometry(1_000_000_000, [10.0, 20.0, 0.0], level), 1_000_000_000))
    jumped = odometry(1_040_000_000, [10.0, 20.14, 0.0], level)
    found = list(conversion.convert("/estimate/odometry", jumped, 1_040_000_000))
    vessel, odom = (one.transform.translation for one in read(found, "/tf").transforms)
    place = read(found, "/odometry").pose.pose.position
    velocity = read(found, "/odometry").twist.twist.linear  # level, bow east: that of `map`
    expected = [10.0 + 0.04 * velocity.x, 20.0 + 0.04 * velocity.y]
    assert [place.x, place.y] == pytest.approx(expected)
    assert [vessel.x, vessel.y] == pytest.approx(expected)
    assert [vessel.x + odom.x, vessel.y + odom.y] == pytest.approx([10.0, 20.14])
    assert conversion.odom_in_map("") == pytest.approx((odom.x, odom.y))


def test_ais_that_a_vessel_hears_is_a_sentence_a_message() -> None:
    profiles = list(load_profile("fleet-convoy").run_profiles())
    name, conversion = profiles[1].vessel, RosConversion(profiles)
    assert (f"/{name}/ais/nmea", "std_msgs/msg/String") in {
        (topic.full_name(vessel), topic.type) for topic, vessel in conversion.topics()
    }
    lines = ["!AIVDM,2,1,1,A,5,0*00", "!AIVDM,2,2,1,A,8,2*00"]
    numbers = [math.nan] * 5
    encode = TOPICS["/ais"].message_type().encode
    payload = encode(7, 200_001_001, "class-a", "static", "\n".join(lines), *numbers, -1, "BARGE", "BRG1")
    found = list(conversion.convert(f"/{name}/ais", payload, 7))
    assert [(one.topic.full_name(one.vessel), deserialize(one.cdr, one.topic.type).data) for one in found] == [
        (f"/{name}/ais/nmea", line) for line in lines
    ]
    assert TOPICS["/ais"].name not in {topic.full_name() for topic in OUTPUTS.values()}  # a bag has both


PERIOD_NS = 40_000_000


def test_a_correction_moves_odom_and_not_the_vessel_in_it() -> None:
    """Ahead east at 1 m/s; GNSS moves the estimate by 0.14 m to the north after a second."""
    odometry, velocity = ContinuousOdometry(), np.array([1.0, 0.0, 0.0])
    places = []
    for number in range(51):
        true = np.array([10.0 + number * 0.04, -5.0, 0.0])
        correction = np.array([0.0, 0.14 if number >= 25 else 0.0, 0.0])
        places.append(odometry.update(number * PERIOD_NS, true + correction, velocity))
        assert places[-1] + odometry.origin_map_m == pytest.approx(true + correction)
    assert places[0] == pytest.approx([10.0, -5.0, 0.0])
    assert np.diff(places, axis=0) == pytest.approx(np.tile([0.04, 0.0, 0.0], (50, 1)))
    assert odometry.origin_map_m == pytest.approx([0.0, 0.14, 0.0])


def test_a_circle_closes() -> None:
    """Radius 10 m at 2 m/s, at 25 Hz: the trapezoid's error of a chord is below a millimetre."""
    odometry, rate = ContinuousOdometry(), 0.2
    for number in range(round(2.0 * math.pi / rate * 25) + 1):
        angle = rate * number * PERIOD_NS * 1e-9
        place = 10.0 * np.array([math.sin(angle), -math.cos(angle), 0.0])
        odometry.update(number * PERIOD_NS, place, 2.0 * np.array([math.cos(angle), math.sin(angle), 0.0]))
    assert np.abs(odometry.origin_map_m).max() < 1e-3


def test_an_estimate_that_is_not_finite_changes_nothing() -> None:
    odometry, still = ContinuousOdometry(), np.zeros(3)
    odometry.update(0, np.ones(3), still)
    assert odometry.update(PERIOD_NS, np.full(3, math.nan), still) == pytest.approx(np.ones(3))
    assert odometry.origin_map_m == pytest.approx(still)


def test_rotation_is_scipy_s() -> None:
    turn = Rotation.from_euler("ZYX", [130.0, 12.0, -33.0], degrees=True)
    x, y, z, w = turn.as_quat().tolist()
    vector = np.array([1.0, -2.0, 0.5])
    assert rotated((w, x, y, z), vector) == pytest.approx(turn.apply(vector))
