"""Position, attitude, speed and turn rate by made logs of each kind, against known poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from scipy.spatial.transform import Rotation

import xitl_cli.logs.signals as signals
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.signals.motion import (
    fixed_on_earth,
    follows_simulator,
    foreign_poses,
    geodetic_series,
    position_geodetic,
    position_ned,
    stray_truth_m,
)
from xitl_cli.logs.signals.series import Series

S = 1_000_000_000


def table(name: str, at_s: Any = None, /, *, instance: str | None = None, **columns: Any) -> MadeTable:
    rows = len(next(iter(columns.values())))
    at_ns = np.round(np.asarray(range(rows) if at_s is None else at_s) * float(S)).astype(np.int64)
    return MadeTable(name, at_ns, columns, instance=instance)


def log_of(*tables: MadeTable, kind: Any = "dataflash", base: Any = "boot") -> MadeLog:
    return MadeLog(*tables, kind=kind, base=base)


def values(series: Series | None) -> list[Any]:
    assert series is not None
    return series.values.round(9).tolist()


def source(series: Series | None) -> str:
    assert series is not None
    return series.source


# Poses in ROS axes


def enu_quaternion(yaw_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """x, y, z, w of a FLU body in ENU, from NED angles, by rotation matrices."""
    ned_frd = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    ned_to_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return Rotation.from_matrix(ned_to_enu @ ned_frd @ np.diag([1.0, -1.0, -1.0])).as_quat()


def poses(name: str, place: str, turn: str, north: Any = (1.0, 2.0), **more: Any) -> MadeTable:
    north = np.asarray(north)
    quaternions = np.stack([enu_quaternion(100.0 + 10.0 * row, 5.0, -3.0) for row in range(len(north))])
    columns = {f"{place}.x": 7.0 + 0.0 * north, f"{place}.y": north, f"{place}.z": -0.5 + 0.0 * north}
    columns |= {f"{turn}.{axis}": quaternions[:, at] for at, axis in enumerate("xyzw")}
    return table(name, **(columns | more))


ODOMETRY = ("pose.pose.position", "pose.pose.orientation")


@pytest.mark.parametrize(
    "fields",
    [
        ODOMETRY,
        ("pose.position", "pose.orientation"),
        ("position", "orientation"),
        ("transform.translation", "transform.rotation"),
        ("translation", "rotation"),
        ("transforms[0].transform.translation", "transforms[0].transform.rotation"),
        ("transforms[0].translation", "transforms[0].rotation"),
    ],
)
def test_poses_of_each_type_are_turned_to_north_east_down(fields: tuple[str, str]) -> None:
    log = log_of(poses("/boat/pose", *fields), kind="mcap", base="utc")
    (pose,) = foreign_poses(log)
    places = pose.places()
    assert places is not None
    np.testing.assert_allclose(places.values, [[1.0, 7.0, 0.5], [2.0, 7.0, 0.5]])
    for read, expected in ((signals.yaw, [100.0, 110.0]), (signals.pitch, [5.0, 5.0]), (signals.roll, [-3.0, -3.0])):
        series = read(log)
        assert series is not None
        np.testing.assert_allclose(series.values, expected)
        assert series.turns is (read is signals.yaw)
    path = position_ned(log)
    assert path is not None
    assert (path.origin, path.path.source) == (None, f"/boat/pose.{fields[0]}")
    assert list(foreign_poses(log, "truth")) == []
    assert list(foreign_poses(log_of(poses("/boat/pose", *fields), kind="mcap", base="simulation"))) == []


def test_of_several_frames_the_one_that_travels_is_the_vessel() -> None:
    transforms = poses(
        "/tf", "transform.translation", "transform.rotation", [0.0, 5.0, 0.1, 9.0, 0.2, 3.0],
        child_frame_id=["lidar", "base", "odom", "base", "odom", "lidar"],
    )  # fmt: skip
    (pose,) = foreign_poses(log_of(transforms, kind="mcap", base="utc"))
    places = pose.places()
    assert places is not None
    assert places.values[:, 0].tolist() == [5.0, 9.0]


def twist(name: str, **more: Any) -> MadeTable:
    linear = {
        "twist.twist.linear.x": [3.0, 6.0],
        "twist.twist.linear.y": [4.0, 8.0],
        "twist.twist.linear.z": [9.0, 9.0],
    }
    angular = {f"twist.twist.angular.{axis}": np.radians([1.0, 2.0]) for axis in "xy"}
    angular["twist.twist.angular.z"] = np.radians([-3.0, 4.0])
    return poses(name, *ODOMETRY, **linear, **angular, **more)


def test_speeds_and_turn_rates_of_an_odometry() -> None:
    own = log_of(twist("/estimate/odometry"), kind="mcap", base="simulation")
    assert values(signals.ground_speed(own)) == [5.0, 10.0]
    assert values(signals.yaw_rate(own)) == [3.0, -4.0]  # FLU turns the other way
    assert source(signals.yaw(own)) == "/estimate/odometry.pose.pose.orientation"
    foreign = log_of(twist("/boat/ground_truth/odom"), kind="mcap", base="utc")
    assert values(signals.ground_speed(foreign, "truth")) == [5.0, 10.0]
    assert values(signals.yaw_rate(foreign, "truth")) == [3.0, -4.0]
    assert values(signals.yaw(foreign, "truth")) == [100.0, 110.0]
    assert signals.ground_speed(foreign) is None
    truth = log_of(twist("/truth/odometry"), kind="mcap", base="simulation")
    assert values(signals.pitch(truth, "truth")) == [5.0, 5.0]


def test_the_truth_of_a_run() -> None:
    state = table(
        "/truth/state", angular_velocity_frd_radps=np.radians([[1.0, 2.0, 3.0]]), velocity_ned_mps=[[3.0, -4.0, 12.0]]
    )
    log = log_of(state, kind="mcap", base="simulation")
    assert values(signals.yaw_rate(log, "truth")) == [3.0]
    assert values(signals.ground_speed(log, "truth")) == [5.0]
    assert signals.yaw_rate(log_of(table("/truth/state", a=[1])), "truth") is None


def test_an_inertial_unit_of_ros() -> None:
    imu = {
        "angular_velocity.z": np.radians([5.0]),
        **{
            f"orientation.{axis}": [value] for axis, value in zip("xyzw", enu_quaternion(100.0, 5.0, -3.0), strict=True)
        },
    }
    known = log_of(table("/imu", **imu, orientation_covariance=[[0.1] * 9]), kind="rosbag1", base="utc")
    assert values(signals.yaw_rate(known)) == [-5.0]
    assert values(signals.yaw(known)) == [100.0]
    unknown = log_of(table("/imu", **imu, orientation_covariance=[[-1.0] * 9]), kind="rosbag1", base="utc")
    assert signals.yaw(unknown) is None
    bare = log_of(table("/imu", **imu), kind="rosbag1", base="utc")
    assert values(signals.roll(bare)) == [-3.0]
    assert signals.yaw_rate(log_of(table("/imu", **imu))) is None


# Logs and telemetry of ArduPilot


def test_attitude_and_rates_of_ardupilot() -> None:
    log = log_of(table("ATT", Roll=[1.0], Pitch=[2.0], Yaw=[350.0]), table("IMU", GyrZ=np.radians([6.0])))
    assert (values(signals.roll(log)), values(signals.pitch(log)), values(signals.yaw(log))) == ([1.0], [2.0], [350.0])
    assert values(signals.yaw_rate(log)) == [6.0]
    tlog = log_of(
        table(
            "ATTITUDE", yaw=np.radians([-10.0, 170.0]), roll=np.radians([-4.0, 4.0]), yawspeed=np.radians([6.0, 7.0])
        ),
        kind="tlog",
    )
    assert values(signals.yaw(tlog)) == [350.0, 170.0]
    assert values(signals.roll(tlog)) == [-4.0, 4.0]
    assert values(signals.yaw_rate(tlog)) == [6.0, 7.0]


def test_speed_by_the_best_source() -> None:
    sources = {
        "XKF1": table("XKF1", VN=[3.0], VE=[4.0]), "NKF1": table("NKF1", VN=[6.0], VE=[8.0]),
        "EKF1": table("EKF1", VN=[5.0], VE=[12.0]), "GPS": table("GPS", Spd=[7.0]),
        "VFR_HUD": table("VFR_HUD", groundspeed=[8.0]),
    }  # fmt: skip
    expected = {"XKF1": 5.0, "NKF1": 10.0, "EKF1": 13.0, "GPS": 7.0, "VFR_HUD": 8.0}
    while sources:
        assert values(signals.ground_speed(log_of(*sources.values()))) == [expected[next(iter(sources))]]
        del sources[next(iter(sources))]
    assert signals.ground_speed(log_of(table("XKF1", VN=[3.0]))) is None


def test_a_heading_of_0_for_ten_rows_is_no_demand() -> None:
    flat = np.concatenate((np.zeros(10), [90.0, 0.0, 0.0], np.full(3, -90.0)))
    series = signals.yaw_desired(log_of(table("ATT", DesYaw=flat)))
    assert values(series) == [90.0, 0.0, 0.0, 270.0, 270.0, 270.0]
    nine = np.concatenate((np.zeros(9), [90.0]))
    assert len(values(signals.yaw_desired(log_of(table("ATT", DesYaw=nine))))) == 10
    assert signals.yaw_desired(log_of(table("ATT", DesYaw=np.zeros(3)))) is None
    both = log_of(table("ATT", DesYaw=np.zeros(12)), table("NTUN", DesYaw=[45.0]))
    assert source(signals.yaw_desired(both)) == "NTUN.DesYaw"


# Places


@pytest.mark.parametrize(
    ("place", "fixed"),
    [
        ((47.0, 8.0, 400.0), True),
        ((0.0, 0.0, 0.0), False),
        ((0.0, 8.0, 0.0), True),
        ((47.0, 0.0, 0.0), True),
        ((90.0, -180.0, 10_000.0), True),
        ((90.1, 8.0, 0.0), False),
        ((47.0, -180.1, 0.0), False),
        ((47.0, 8.0, -10_001.0), False),
        ((np.nan, 8.0, 0.0), False),
    ],
)
def test_a_place_on_the_earth(place: tuple[float, float, float], fixed: bool) -> None:
    assert (fixed_on_earth(np.array([5]), np.array([place]), "X") is not None) is fixed


def test_geodetic_places_by_the_best_source() -> None:
    def at(name: str, number: float, lat: str = "Lat", lon: str = "Lng", alt: str = "Alt") -> MadeTable:
        return table(name, **{lat: [47.0 + number], lon: [8.0], alt: [400.0]})

    sources = [
        at("POS", 0.1), at("GPS", 0.2), at("GLOBAL_POSITION_INT", 0.3, "lat", "lon", "alt"),
        at("GPS_RAW_INT", 0.4, "lat", "lon", "alt"),
    ]  # fmt: skip
    while sources:
        series = position_geodetic(log_of(*sources))
        assert series is not None
        assert series.source == sources[0].name
        del sources[0]
    assert geodetic_series(log_of(table("POS", Lat=[1.0])), "POS", ("Lat", "Lng", "Alt")) is None
    fix = at("/gps/fix", 0.5, "latitude", "longitude", "altitude")
    true = at("/ground_truth/fix", 0.6, "latitude", "longitude", "altitude")
    log = log_of(fix, true, kind="mcap", base="utc")
    assert source(position_geodetic(log)) == "/gps/fix"
    assert source(position_geodetic(log, "truth")) == "/ground_truth/fix"
    assert position_geodetic(log_of(fix)) is None


PLACE = (47.0, 8.0, 400.0)
OFF_M = np.array([[0.0, 0.0, 0.0], [30.0, -40.0, 5.0], [60.0, -80.0, 10.0]])


def geodetic(offsets_m: Any = OFF_M, about: tuple[float, float, float] = PLACE) -> dict[str, Any]:
    latitude, longitude, altitude = LocalFrame(*about).geodetic(np.asarray(offsets_m))
    return {"Lat": latitude, "Lng": longitude, "Alt": altitude}


def test_a_path_is_about_the_first_place_or_the_estimators_origin_or_a_given_one() -> None:
    log = log_of(table("POS", **geodetic()))
    path = position_ned(log)
    assert path is not None
    assert path.origin == pytest.approx(PLACE)
    np.testing.assert_allclose(path.path.values, OFF_M, atol=1e-6)
    latitude, longitude, altitude = (
        float(each[0]) for each in LocalFrame(*PLACE).geodetic(np.array([[10.0, 0.0, 0.0]]))
    )
    origins = table(
        "ORGN",
        Type=[0, 0, 1, 0],
        Lat=[1.0, latitude, 2.0, 91.0],
        Lng=[1.0, longitude, 2.0, 8.0],
        Alt=[0.0, altitude, 0.0, 0.0],
    )
    path = position_ned(log_of(table("POS", **geodetic()), origins))
    assert path is not None
    assert path.origin == (latitude, longitude, altitude)
    np.testing.assert_allclose(path.path.values, OFF_M - [10.0, 0.0, 0.0], atol=1e-3)
    path = position_ned(log, origin=(latitude, longitude, altitude))
    assert path is not None
    np.testing.assert_allclose(path.path.values, OFF_M - [10.0, 0.0, 0.0], atol=1e-3)
    assert position_ned(log_of(table("ATT", Yaw=[1.0]))) is None


def test_a_run_has_its_origin_from_its_true_fix() -> None:
    """The fix at 1 s is where the true odometry is nearest to its origin."""
    truth = poses("/truth/odometry", *ODOMETRY, [-90.0, 30.0, 100.0])
    truth._values["pose.pose.position.x"] = np.array([0.0, -40.0, 100.0])
    truth._values["pose.pose.position.z"] = np.array([0.0, -5.0, 3.0])
    latitude, longitude, altitude = LocalFrame(*PLACE).geodetic(
        np.array([[-90.0, 0.0, 0.0], [30.0, -40.0, 5.0], [100.0, 100.0, -3.0]])
    )
    fix = table("/truth/fix", latitude=latitude, longitude=longitude, altitude=altitude)
    estimate = poses("/estimate/odometry", *ODOMETRY, [1.0, 2.0, 3.0])
    log = log_of(truth, fix, estimate, kind="mcap", base="simulation")
    path = position_ned(log)
    assert path is not None
    assert path.origin is not None
    assert path.origin[:2] == pytest.approx(PLACE[:2], abs=1e-8)
    assert path.origin[2] == pytest.approx(PLACE[2], abs=1e-3)  # the Earth falls by 0.2 mm over 50 m
    np.testing.assert_allclose(path.path.values, [[1.0, 7.0, 0.5], [2.0, 7.0, 0.5], [3.0, 7.0, 0.5]])
    series = position_geodetic(log)
    assert series is not None
    np.testing.assert_allclose(LocalFrame(*path.origin).ned(*series.values.T), path.path.values, atol=1e-6)
    north = tuple(float(each[0]) for each in LocalFrame(*PLACE).geodetic(np.array([[100.0, 0.0, 0.0]])))
    moved = position_ned(log, origin=north)  # type: ignore[arg-type]
    assert moved is not None
    np.testing.assert_allclose(moved.path.values[:, 0], [-99.0, -98.0, -97.0], atol=1e-2)
    alone = position_ned(log_of(estimate, kind="mcap", base="simulation"))
    assert alone is not None
    assert alone.origin is None
    assert position_ned(log_of(estimate, kind="mcap", base="simulation"), origin=PLACE) is None


# The simulator of ArduPilot


def simulated(offsets_m: Any, receiver_m: Any, speed_mps: Any, course_deg: Any, status: int = 3) -> MadeLog:
    many = len(np.asarray(offsets_m))
    gps = geodetic(receiver_m)
    return log_of(
        table("SIM", **geodetic(offsets_m), Yaw=np.zeros(many)),
        table("GPS", Status=[status] * many, Spd=np.broadcast_to(speed_mps, many),
        GCrs=np.broadcast_to(course_deg, many), **gps),
    )  # fmt: skip


def path(many: int = 60, north_mps: float = 2.0, north_m: float = 0.0) -> np.ndarray:
    return np.stack([north_m + north_mps * np.arange(many), np.zeros(many), np.zeros(many)], axis=1)


def test_the_simulator_is_the_truth_if_the_receiver_moves_as_it_does() -> None:
    same = simulated(path(), path(), 2.0, 0.0)
    assert stray_truth_m(same) is None
    assert signals.yaw(same, "truth") is not None
    offset = simulated(path(), path(north_m=500.0), 2.0, 0.0)  # an offset of the receiver is a fault of it
    assert stray_truth_m(offset) is None


def test_the_simulator_of_another_vehicle_is_no_truth() -> None:
    stray = simulated(np.zeros((60, 3)), path(), 2.0, 0.0)
    assert stray_truth_m(stray) == pytest.approx(116.0, abs=0.5)  # at 58 s, the last with a speed on both sides
    assert signals.yaw(stray, "truth") is None
    assert position_geodetic(stray, "truth") is None
    across = simulated(path(), path(), 2.0, 90.0)  # the same place, so nothing is apart
    assert stray_truth_m(across) is None
    assert stray_truth_m(simulated(np.zeros((60, 3)), path(), 2.0, 0.0, status=2)) is None  # no fix
    assert stray_truth_m(simulated(np.zeros((60, 3)), path(), 0.5, 0.0)) is None  # at rest
    assert stray_truth_m(simulated(np.zeros((9, 3)), path(9), 2.0, 0.0)) is None  # within 20 m


@pytest.mark.parametrize(
    ("logged_m", "simulated_m", "follows"),
    [
        (path(), path(), True),
        (path(north_m=2.3), path(), True),  # 2 % of 118 m
        (path(north_m=2.4), path(), False),
        (path(north_mps=0.08), path(north_mps=0.08), False),  # less than 5 m
        (path(north_mps=0.09), path(north_mps=0.09), True),
    ],
)
def test_whether_a_position_follows_the_simulator(logged_m: Any, simulated_m: Any, follows: bool) -> None:
    def series(offsets_m: Any) -> Series:
        found = geodetic_series(log_of(table("X", **geodetic(offsets_m))), "X", ("Lat", "Lng", "Alt"))
        assert found is not None
        return found

    assert follows_simulator(series(logged_m), series(simulated_m)) is follows


def test_a_simulated_path_is_in_the_metres_of_its_sphere() -> None:
    """At 47 degrees, a degree of latitude is 111 175 m on WGS84 and 111 319 m there: 0.13 % more."""
    log = log_of(table("POS", **geodetic(path())), table("SIM", **geodetic(path())))
    found = position_ned(log)
    assert found is not None
    assert found.path.values[-1, 0] / 118.0 == pytest.approx(111_319.49 / 111_174.7, abs=1e-4)
    plain = position_ned(log_of(table("POS", **geodetic(path()))))
    assert plain is not None
    assert plain.path.values[-1, 0] == pytest.approx(118.0, abs=1e-4)
