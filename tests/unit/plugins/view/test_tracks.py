"""What a vessel's log gives to the view: values, clouds, missions and obstacles at any instant."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest

from sim_core.frames import euler_to_quat, quat_to_matrix
from tests.unit.logs.made_log import MadeLog, MadeTable
from xitl_cli.plugins.view import tracks
from xitl_cli.plugins.view.tracks import (
    CloudTrack,
    HeldValues,
    MapPlace,
    MissionChange,
    ObstacleSightings,
    PoseTrack,
    State,
    VesselTrack,
    continuous,
    forward,
    heading_deg,
    mission_at,
    packed_points,
    state_at,
)

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
NORTH = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
"""The bow, from FLU to ENU."""
S = 1_000_000_000


def seconds(stamp_ns: np.ndarray) -> np.ndarray:
    return np.asarray(stamp_ns) * 1e-9


def eastward(turn: np.ndarray = LEVEL) -> PoseTrack:
    """From (0, 0) at 0 s to (10, 20) at 10 s."""
    at_s = np.array([0.0, 10.0])
    return PoseTrack(at_s, np.array([[0.0, 0.0, 0.0], [10.0, 20.0, 0.0]]), at_s, np.stack([turn, turn]))


def test_a_value_holds_until_the_next_and_as_long_as_it_lasts() -> None:
    held = HeldValues(np.array([1.0, 2.0]), np.array([5.0, 7.0]), lasting_s=3.0)
    assert [held.at(time_s) for time_s in (0.99, 1.0, 1.99, 2.0, 5.0, 5.01)] == [None, 5.0, 5.0, 7.0, 7.0, None]


def test_of_overlapping_states_the_later_one_is_shown_with_both_its_ends() -> None:
    states = (State(1.0, 4.0, "AUTO"), State(3.0, 6.0, "HOLD"))
    shown = [state_at(states, time_s) for time_s in (0.9, 1.0, 2.9, 3.0, 6.0, 6.1)]
    assert shown == [None, "AUTO", "AUTO", "HOLD", "HOLD", None]


def test_a_mission_holds_from_its_time_on_and_the_first_one_before() -> None:
    first, second = (MissionChange(at_s, np.full((2, 3), at_s)) for at_s in (5.0, 8.0))
    shown = [mission_at((first, second), time_s).from_s for time_s in (0.0, 5.0, 7.9, 8.0, 99.0)]
    assert shown == [5.0, 5.0, 5.0, 8.0, 8.0]
    assert len(mission_at((), 1.0).places_enu_m) == 0


@pytest.mark.parametrize(("yaw_deg", "heading"), [(0.0, 0.0), (30.0, 30.0), (180.0, 180.0), (-90.0, 270.0)])
def test_the_heading_is_clockwise_from_north(yaw_deg: float, heading: float) -> None:
    east_of_north = math.radians(90.0 - yaw_deg)
    turn = np.array([math.cos(east_of_north / 2.0), 0.0, 0.0, math.sin(east_of_north / 2.0)])
    assert heading_deg(turn) == pytest.approx(heading, abs=1e-9)


def test_times_that_step_back_are_left_out() -> None:
    at_s, rows = forward(np.array([0.0, 1.0, 0.5, 1.0, 1.5, 1.2, 3.0]))
    assert at_s.tolist() == [0.0, 1.0, 1.5, 3.0]
    assert rows.tolist() == [0, 1, 4, 6]


def test_neighbouring_quaternions_have_the_same_sign() -> None:
    yaw = np.radians([0.0, 100.0, 200.0, 300.0, 400.0])
    turns = euler_to_quat(np.column_stack([np.zeros(5), np.zeros(5), yaw]))
    signs = np.array([1.0, -1.0, -1.0, 1.0, -1.0])
    smooth = continuous(turns * signs[:, None])
    assert (np.sum(smooth[1:] * smooth[:-1], axis=1) > 0.0).all()
    np.testing.assert_allclose(quat_to_matrix(smooth), quat_to_matrix(turns), atol=1e-12)
    assert smooth[0, 0] > 0.0


FIELDS = (("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("t", 12, 7))


def cloud_table(*clouds: list[tuple[float, ...]], fields: tuple[tuple[str, int, int], ...] = FIELDS) -> Any:
    """One a second. Points have so many float32."""
    stride = 4 * len(fields)
    data = np.empty(len(clouds), dtype=object)
    data[:] = [b"".join(struct.pack(f"<{len(fields)}f", *point) for point in cloud) for cloud in clouds]
    columns: dict[str, Any] = {"data": data, "point_stride": np.full(len(clouds), stride)}
    for number, field in enumerate(fields):
        for part, value in zip(("name", "offset", "type"), field, strict=True):
            columns[f"fields[{number}].{part}"] = np.array([value] * len(clouds))
    return MadeTable("/lidar/points", [n * S for n in range(len(clouds))], columns)


def test_each_point_of_a_cloud_is_placed_with_the_pose_at_its_own_time() -> None:
    table = cloud_table([(1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.5)], [(0.0, 3.0, 2.0, -0.25)])
    track = CloudTrack(table, seconds, eastward(NORTH), 0.4)
    first, second = track.at(0.2), track.at(1.2)
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first, [[0.0, 1.0, 0.0], [0.5, 2.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(second, [[0.75 - 3.0, 1.5, 2.0]], atol=1e-6)


def test_points_without_times_have_the_time_of_their_cloud() -> None:
    table = cloud_table([(9.0, 9.0, 9.0)], [(1.0, 0.0, 0.0)], fields=FIELDS[:3])
    points = CloudTrack(table, seconds, eastward(), 0.4).at(1.0)
    assert points is not None
    np.testing.assert_allclose(points, [[2.0, 2.0, 0.0]], atol=1e-6)


def test_clouds_are_joined_for_the_time_that_they_are_drawn() -> None:
    table = cloud_table(*[[(float(n), 0.0, 0.0, 0.0)] for n in range(4)])
    at_rest = PoseTrack(np.array([0.0]), np.zeros((1, 3)), np.array([0.0]), LEVEL[None])
    track = CloudTrack(table, seconds, at_rest, 1.0)
    shown = []
    for time_s in (-0.1, 0.0, 0.9, 1.0, 2.0, 2.5, 4.0, 4.1):
        points = track.at(time_s)
        shown.append([] if points is None else points[:, 0].tolist())
    assert shown == [[], [0.0], [0.0], [0.0, 1.0], [1.0, 2.0], [2.0], [3.0], []]
    assert track.at(2.0) is track.at(2.0)


def test_a_cloud_of_a_damaged_row_has_no_points() -> None:
    table = cloud_table([(1.0, 2.0, 3.0, 0.0)])
    assert packed_points(table, 0)["y"].tolist() == [2.0]
    table._values["point_stride"][:] = 0
    assert len(packed_points(table, 0)) == 0


def test_the_bytes_of_an_incomplete_point_are_left_out() -> None:
    table = cloud_table([(1.0, 2.0, 3.0, 0.0), (4.0, 5.0, 6.0, 0.0)])
    table._values["data"][0] = table._values["data"][0][:31]
    assert packed_points(table, 0)["x"].tolist() == [1.0]


def make_track(**keys: Any) -> VesselTrack:
    empty: dict[str, Any] = {
        "pose": eastward(),
        "estimate": None,
        "modes": (),
        "armed": (),
        "motors": None,
        "missions": (),
        "reached_s": np.empty(0),
        "numbers": {},
        "clouds": {},
        "obstacles": None,
    }
    return VesselTrack(**{**empty, **keys})


def test_the_estimate_begins_at_its_first_value_and_its_error_is_horizontal() -> None:
    at_s = np.array([4.0, 10.0])
    estimate = PoseTrack(at_s, np.array([[7.0, 12.0, 9.0], [13.0, 24.0, 9.0]]), at_s, np.stack([LEVEL, LEVEL]))
    track = make_track(estimate=estimate)
    before, at_first = track.at(3.9), track.at(4.0)
    assert before.estimate_position_enu_m is None
    assert before.estimate_attitude_wxyz is None
    assert "estimate off m" not in before.numbers
    assert at_first.estimate_position_enu_m is not None
    assert at_first.estimate_position_enu_m.tolist() == [7.0, 12.0, 9.0]
    assert at_first.numbers["estimate off m"] == pytest.approx(5.0)  # 3 and 4 m


def test_waypoints_of_a_mission_are_counted_from_its_start() -> None:
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    missions = MissionChange(1.0, places), MissionChange(6.0, places[:2] + np.array([0.0, 5.0, 0.0]))
    track = make_track(
        missions=missions, armed=(State(0.0, 8.0, "armed"),), reached_s=np.array([2.0, 4.0, 5.0, 7.0]),
        modes=(State(0.0, 99.0, "AUTO"),),
    )  # fmt: skip
    shown = {time_s: track.at(time_s) for time_s in (0.0, 1.5, 2.0, 4.0, 5.5, 6.5, 7.5, 9.0)}
    counts = {time_s: (each.waypoints_reached, each.waypoints_total) for time_s, each in shown.items()}
    assert counts == {
        0.0: (0, 2), 1.5: (0, 2), 2.0: (1, 2), 4.0: (2, 2), 5.5: (2, 2), 6.5: (0, 1), 7.5: (1, 1), 9.0: (1, 1)
    }  # fmt: skip
    targets = {at: None if one.target_enu_m is None else one.target_enu_m.tolist() for at, one in shown.items()}
    assert targets == {
        0.0: [1.0, 0.0, 0.0], 1.5: [1.0, 0.0, 0.0], 2.0: [2.0, 0.0, 0.0], 4.0: None, 5.5: None,
        6.5: [1.0, 5.0, 0.0], 7.5: None, 9.0: None,
    }  # fmt: skip
    assert shown[9.0].mode == "AUTO"
    assert [shown[at].armed for at in (7.5, 9.0)] == [True, False]


def test_a_disarmed_vessel_heads_for_no_waypoint() -> None:
    mission = MissionChange(0.0, np.zeros((3, 3)))
    assert make_track(missions=(mission,)).at(1.0).target_enu_m is None


def test_unknown_motor_commands_are_zero_and_clouds_can_be_left_out() -> None:
    motors = HeldValues(np.array([0.0]), np.array([[0.5, math.nan]]))
    table = cloud_table([(1.0, 0.0, 0.0, 0.0)])
    track = make_track(motors=motors, clouds={"lidar": CloudTrack(table, seconds, eastward(), 0.4)})
    assert track.at(0.0).motors == (0.5, 0.0)
    assert list(track.at(0.0).clouds) == ["lidar"]
    assert track.at(0.0, seen=False).clouds == {}
    assert track.at(1.0).clouds == {}


def test_the_newest_report_of_each_obstacle_is_shown_for_a_while() -> None:
    sightings = ObstacleSightings(
        np.array([0.0, 1.0, 1.0, 2.0]), np.array([7, 7, 8, 7]), np.arange(12.0).reshape(4, 3),
        np.array([1.0, 2.0, 3.0, 4.0]), np.array(["", "", "buoy", ""]), np.array([0.0, 0.0, 0.4, 0.0]),
    )  # fmt: skip
    shown = {}
    for time_s in (-0.1, 0.0, 1.0, 2.4, 2.5, 3.4, 3.5):
        centres, radii, classes = sightings.at(time_s)
        shown[time_s] = radii.tolist(), classes
        assert centres.tolist() == [[3.0 * (radius - 1.0) + axis for axis in range(3)] for radius in radii]
    assert shown == {
        -0.1: ([], ()), 0.0: ([1.0], ("",)), 1.0: ([2.0, 3.0], ("", "buoy 40 %")),
        2.4: ([4.0, 3.0], ("", "buoy 40 %")), 2.5: ([4.0], ("",)), 3.4: ([4.0], ("",)), 3.5: ([], ()),
    }  # fmt: skip


def obstacle_log(**keys: Any) -> MadeLog:
    columns = {
        "id": [4, 5],
        "position_ned_m": [[10.0, 20.0, 0.5], [30.0, 40.0, 0.0]],
        "size_m": [[3.0, 4.0, 9.0], [0.0, 2.0, 9.0]],
        **keys,
    }
    return MadeLog(MadeTable("/companion/obstacles", [1 * S, 2 * S], columns), kind="mcap", base="simulation")


def test_obstacles_are_circles_around_their_boxes_in_the_map_of_the_scene() -> None:
    place = MapPlace(None, (100.0, 200.0, 0.0))
    read = tracks._obstacles(obstacle_log(), seconds, place)
    assert read is not None
    assert read.seconds.tolist() == [1.0, 2.0]
    assert read.number.tolist() == [4, 5]
    assert read.centre_enu_m.tolist() == [[120.0, 210.0, -0.5], [140.0, 230.0, 0.0]]
    assert read.radius_m.tolist() == [2.5, 1.0]
    assert read.at(2.0)[2] == ("", "")  # a recording of an earlier version
    read = tracks._obstacles(obstacle_log(label=["buoy", ""], label_share=[0.5, 0.0]), seconds, place)
    assert read is not None
    assert read.at(2.0)[2] == ("buoy 50 %", "")
    assert tracks._obstacles(MadeLog(), seconds, place) is None


def test_the_odometry_begins_where_the_vessel_was_at_its_first_row() -> None:
    """Its first row is not zero: then the map of the scene is where this row and the vessel's pose agree."""
    half = math.sqrt(0.5)
    columns = {f"pose.pose.position.{axis}": [value, 9.0] for axis, value in zip("xyz", (2.0, 1.0, 0.5), strict=True)}
    columns |= {
        f"pose.pose.orientation.{axis}": [value, 9.0]
        for axis, value in zip("wxyz", (half, 0.0, 0.0, half), strict=True)
    }
    table = MadeTable("/companion/odometry", [5 * S, 6 * S], columns)
    begin = tracks._odometry_frame(table, seconds, eastward(NORTH))
    assert begin is not None
    place, turn = begin
    # The vessel is at (5, 10), its bow to the north. Its odometry says: turned left by 90°, so it began eastward.
    np.testing.assert_allclose(np.abs(turn), LEVEL, atol=1e-12)
    np.testing.assert_allclose(place, [5.0 - 2.0, 10.0 - 1.0, -0.5], atol=1e-12)
    del columns["pose.pose.position.z"]
    assert (
        tracks._odometry_frame(MadeTable("/companion/odometry", [5 * S, 6 * S], columns), seconds, eastward()) is None
    )


def test_clouds_of_a_run_are_its_sensors_and_the_companions_map() -> None:
    odometry = {f"pose.pose.position.{axis}": [0.0] for axis in "xyz"}
    odometry |= {f"pose.pose.orientation.{axis}": [float(axis == "w")] for axis in "wxyz"}
    tables = [cloud_table([(1.0, 0.0, 0.0, 0.0)]) for _ in range(3)]
    for table, name in zip(tables, ("/lidar/points", "/sonar/points", "/companion/map"), strict=True):
        table.name = name
    tables.append(MadeTable("/companion/odometry", [0], odometry))
    run = MadeLog(*tables, kind="mcap", base="simulation")
    clouds = dict(tracks._clouds(run, seconds, eastward()))
    assert list(clouds) == ["lidar", "sonar", "map"]
    durations = {}
    for name, track in clouds.items():
        durations[name] = [time_s for time_s in (0.0, 0.4, 0.5, 12.0, 12.1) if track.at(time_s) is not None]
    assert durations == {"lidar": [0.0, 0.4], "sonar": [0.0, 0.4, 0.5, 12.0], "map": [0.0, 0.4, 0.5, 12.0, 12.1]}
    assert list(dict(tracks._clouds(MadeLog(*tables[:1], *tables[2:3], kind="mcap", base="simulation"), seconds,
                                    eastward()))) == ["lidar"]  # fmt: skip
    assert list(tracks._clouds(MadeLog(*tables), seconds, eastward())) == []


def test_counts_of_groups_are_added_and_start_again_with_a_group() -> None:
    table = MadeTable(
        "/tasks",
        [0, 1 * S, 2 * S, 3 * S, 4 * S],
        {"node": ["a", "b", "a", "b", "a"], "task": ["x", "x", "x", "x", "y"], "missed": [2, 5, 3, -1, 7]},
    )
    total = tracks._total(table, "missed", ("node", "task"), seconds)
    assert total is not None
    assert total.values.tolist() == [2.0, 7.0, 8.0, 3.0, 10.0]
    assert total.seconds.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert tracks._total(table, "lost", ("node",), seconds) is None
    assert tracks._total(None, "missed", ("node",), seconds) is None


def test_the_speed_through_the_water_is_relative_to_the_latest_current() -> None:
    state = MadeTable("/truth/state", [0, 1 * S, 2 * S], {"velocity_ned_mps": [[3.0, 4.0, 1.0]] * 3})
    environment = MadeTable("/environment", [1 * S, 2 * S], {"current_ned_mps": [[0.0, 4.0, 0.0], [3.0, 0.0, 0.0]]})
    speed = tracks._speed_through_water(MadeLog(state, environment))
    assert speed is not None
    assert speed.values.tolist() == [3.0, 3.0, 4.0]  # before the first current, the first one
    assert speed.unit == "m/s"
    assert tracks._speed_through_water(MadeLog(state)) is None
    assert tracks._speed_through_water(MadeLog(environment)) is None
    empty = MadeTable("/environment", [], {"current_ned_mps": np.empty((0, 3))})
    assert tracks._speed_through_water(MadeLog(state, empty)) is None


def numbers_at(time_s: float, *tables: MadeTable, kind: Any = "dataflash", truth: bool = False) -> dict[str, float]:
    values = dict(tracks._numbers(MadeLog(*tables, kind=kind), seconds, truth))
    return {name: float(held.at(time_s)) for name, held in values.items() if held.at(time_s) is not None}  # type: ignore[arg-type]


def test_the_panel_shows_battery_and_cross_track_of_any_log() -> None:
    dataflash = numbers_at(
        1.0,
        MadeTable("BAT", [0], {"Volt": [12.5], "CurrTot": [250.0]}),
        MadeTable("NTUN", [0], {"XTrack": [1.5]}),
    )
    assert dataflash == {"battery V": 12.5, "battery used Ah": 0.25, "cross-track m": 1.5}
    telemetry = numbers_at(
        1.0,
        MadeTable("SYS_STATUS", [0], {"voltage_battery": [12600]}),
        MadeTable("NAV_CONTROLLER_OUTPUT", [0], {"xtrack_error": [-2.0]}),
        kind="tlog",
    )
    assert telemetry == {"battery V": 12.6, "cross-track m": -2.0}
    run = numbers_at(
        1.0,
        MadeTable("/battery", [0], {"voltage_v": [24.0], "used_ah": [3.0]}),
        MadeTable("/link/agent/rx:NAV_CONTROLLER_OUTPUT", [0], {"xtrack_error": [0.5]}),
        kind="mcap",
    )
    assert run == {"battery V": 24.0, "battery used Ah": 3.0, "cross-track m": 0.5}


def test_a_voltage_that_is_not_known_is_left_out() -> None:
    table = MadeTable("SYS_STATUS", [0, 1 * S], {"voltage_battery": [65535, 12000]})
    assert "battery V" not in numbers_at(0.0, table, kind="tlog")
    assert numbers_at(1.0, table, kind="tlog")["battery V"] == 12.0


def test_losses_misses_and_the_clock_of_the_board_are_shown() -> None:
    links = MadeTable("/links", [0, 0, 1 * S], {"name": ["agent", "companion", "agent"], "lost": [1, 2, 4]})
    tasks = MadeTable("/tasks", [0], {"node": ["a"], "task": ["b"], "missed": [6]})
    clocks = MadeTable("/clocks", [0, 0, 0], {"node": ["PS1", "agent", "PSU"], "offset_s": [9.0, 0.002, 8.0]})
    shown = numbers_at(1.0, links, tasks, clocks, kind="mcap")
    assert shown == {"links lost": 6.0, "deadline misses": 6.0, "clock offset ms": 2.0}
    assert "clock offset ms" not in numbers_at(1.0, MadeTable("/clocks", [0], {"node": ["PS1"], "offset_s": [9.0]}))


def test_motor_commands_need_an_array() -> None:
    held = tracks._motors(MadeLog(MadeTable("/actuators", [1 * S], {"command": [[0.5, -0.5]]})), seconds)
    assert held is not None
    assert np.asarray(held.at(1.0)).tolist() == [0.5, -0.5]
    assert tracks._motors(MadeLog(MadeTable("/actuators", [1 * S], {"command": [0.5]})), seconds) is None
    assert tracks._motors(MadeLog(MadeTable("/actuators", [1 * S], {"pwm": [0.5]})), seconds) is None
    assert tracks._motors(MadeLog(), seconds) is None


def test_a_waypoint_that_is_told_twice_is_reached_once() -> None:
    texts = ["Reached waypoint #1", "reached waypoint 1", "armed", "Reached waypoint #2 dist 1m", "Reached waypoint #1"]
    table = MadeTable("MSG", [n * S for n in range(5)], {"Message": texts})
    assert tracks._reached(MadeLog(table), seconds).tolist() == [0.0, 3.0, 4.0]
