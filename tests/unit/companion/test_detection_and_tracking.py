"""The lookout's parts against closed forms: clusters, tracks, structure, courses, clearances, proximity."""

from __future__ import annotations

import math
import tracemalloc
from typing import Any

import numpy as np
import pytest

from agent.companion.avoidance import (
    STEP_S,
    Obstacles,
    PathLegs,
    clearance_m,
    leg_course_rad,
    obstacles_near,
    simulate_courses,
)
from agent.companion.detection import (
    Cluster,
    DetectionFrame,
    ObstacleDetector,
    cells_of,
    find_clusters,
    merged_cluster,
    neighbours,
)
from agent.companion.obstacle_avoidance import SECTORS, ObstacleAvoidance, make_proximity_messages
from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix
from agent.companion.tracking import CurrentEstimator, ObstacleTracker, StructureMap

HERE = np.zeros(2)
TENTH_NS = 100_000_000


def frame(stamp_ns: int, points: np.ndarray) -> DetectionFrame:
    cells, first, count = np.unique(cells_of(points), return_index=True, return_counts=True)
    return DetectionFrame(
        stamp_ns, cells, points[first], np.full(len(cells), 0.2), count, np.zeros(len(cells), dtype=np.int64)
    )


def thing(stamp_ns: int, middle: tuple[float, float], length_m: float = 3.0) -> Cluster:
    return Cluster(stamp_ns, np.array([middle]), np.array(middle), length_m, 0.5, 0.3, 0.0, 5)


def test_two_logs_are_two_clusters_and_one_drop_is_none() -> None:
    along = np.linspace(-2.5, 2.5, 60)
    heading = 0.6
    first = np.array((30.0, 3.0)) + np.outer(along, (math.cos(heading), math.sin(heading)))
    second = np.array((30.0, -8.0)) + np.outer(along, (1.0, 0.0))
    drop = np.array([[20.0, 0.0]])
    frames = [frame(n * TENTH_NS, np.concatenate([first, second] + [drop] * (n == 3))) for n in range(8)]
    found = sorted(find_clusters(frames, HERE, 0.0), key=lambda one: one.middle_ne_m[1])
    assert len(found) == 2
    for one, middle, turned in zip(found, [(30.0, -8.0), (30.0, 3.0)], [0.0, heading], strict=True):
        np.testing.assert_allclose(one.middle_ne_m, middle, atol=0.3)  # half a cell
        assert one.length_m == pytest.approx(5.0, abs=0.5)
        assert math.remainder(one.heading_rad - turned, math.pi) == pytest.approx(0.0, abs=0.1)
        assert one.stamp_ns == pytest.approx(3.5 * TENTH_NS, abs=1e6)


def test_a_crest_close_by_hides_no_log_farther_away() -> None:
    crest = np.array([[3.0, 0.0]])
    log = np.array((30.0, 3.0)) + np.outer(np.linspace(-2.5, 2.5, 60), (1.0, 0.0))
    frames = [frame(n * TENTH_NS, np.concatenate([log, *([crest] * (n < 4))])) for n in range(8)]
    near, far = sorted(find_clusters(frames, HERE, 0.0), key=lambda one: one.middle_ne_m[0])
    assert near.length_m < 0.5 < far.length_m
    (found,) = find_clusters(frames, HERE, 10.0)
    np.testing.assert_array_equal(found.middle_ne_m, far.middle_ne_m)


def test_neighbours_are_the_eight_cells_around() -> None:
    block = np.array([(north, east) for north in (6.7, 7.2, 7.7) for east in (-3.8, -3.3, -2.8)])
    cells = cells_of(block, 0.5).tolist()
    middle = cells.pop(4)
    assert sorted(neighbours(middle)) == sorted(cells)


def test_no_frames_and_empty_frames_are_nothing() -> None:
    assert find_clusters([], HERE, 0.0) == []
    assert find_clusters([frame(0, np.empty((0, 2)))], HERE, 0.0) == []


def drifted(
    tracks: ObstacleTracker, seconds: float, vel: tuple[float, float], noise_m: float, since_s: float = 0.0
) -> None:
    rng = np.random.default_rng(7)
    for tick in range(round(since_s * 5), round((since_s + seconds) * 5)):
        time_s = 0.2 * tick
        middle = (40.0 + vel[0] * time_s + noise_m * rng.normal(), vel[1] * time_s + noise_m * rng.normal())
        stamp_ns = round(time_s * 1e9)
        tracks.update(stamp_ns, [thing(stamp_ns, middle)], HERE, 0.0, 8.0, np.zeros(2))


def test_a_track_finds_the_velocity_and_keeps_its_name() -> None:
    """After 8 s with looks of 0.2 m noise the velocity is known to some 0.1 m/s; its prior was zero."""
    tracks = ObstacleTracker()
    drifted(tracks, 8.0, (-0.3, 0.7), 0.2)
    (track,) = tracks.confirmed
    np.testing.assert_allclose(track.state[2:], (-0.3, 0.7), atol=0.15)
    np.testing.assert_allclose(track.position_at(8_000_000_000), (40.0 - 2.4, 5.6), atol=0.4)
    assert (track.number, tracks.total) == (1, 1)


def test_a_track_out_of_view_is_carried_on_and_in_view_is_lost() -> None:
    for bow_rad, kept in ((math.pi / 2, True), (0.0, False)):
        tracks = ObstacleTracker()
        drifted(tracks, 6.0, (0.0, 0.0), 0.05)
        tracks.update(13_000_000_000, [], HERE, bow_rad, 8.0, np.zeros(2))
        assert bool(tracks.confirmed) is kept
    tracks.update(40_000_000_000, [], HERE, math.pi / 2, 8.0, np.zeros(2))
    assert not tracks.confirmed


def test_time_out_of_view_does_not_count_as_looked_for_in_vain() -> None:
    """Turned away for 4 s and back for less than a second: it would have been forgotten after 5 s of looking."""
    tracks = ObstacleTracker()
    drifted(tracks, 4.0, (0.0, 0.0), 0.05)
    for tick in range(21, 46):
        away = math.pi / 2 if tick < 41 else 0.0
        tracks.update(tick * 200_000_000, [], HERE, away, 8.0, np.zeros(2))
    assert tracks.confirmed


def test_crests_among_water_are_no_thing_and_what_stays_is() -> None:
    """Seen at every third look, or at every one, 15 m off where water returns up to 12 m."""
    for every, counts in ((3, False), (1, True)):
        tracks = ObstacleTracker()
        for tick in range(0, 120):
            stamp_ns = tick * 200_000_000
            found = [thing(stamp_ns, (15.0, 0.0), 1.0)] if tick % every == 0 else []
            tracks.update(stamp_ns, found, HERE, 0.0, 12.0, np.zeros(2))
        assert bool(tracks.confirmed) is counts


def test_what_is_long_is_structure_and_remembered_behind() -> None:
    tracks = ObstacleTracker()
    wall = np.column_stack([np.full(60, 30.0), np.linspace(-15.0, 15.0, 60)])
    for tick in range(15):
        stamp_ns = tick * 200_000_000
        long = Cluster(stamp_ns, wall, wall.mean(axis=0), 30.0, 0.5, 1.0, math.pi / 2, 50)
        tracks.update(stamp_ns, [long], HERE, 0.0, 8.0, np.zeros(2))
    assert not tracks.confirmed
    assert tracks.structure.covers(np.array((30.0, 4.0)), 0.6)
    assert not tracks.structure.covers(np.array((30.0, 17.0)), 0.6)
    tracks.update(12_000_000_000, [], HERE, math.pi, 8.0, np.zeros(2))
    assert len(tracks.structure.within(HERE, 50.0)) > 50


def test_a_cell_that_was_hit_once_is_no_structure() -> None:
    structure, cell = StructureMap(), np.array([[10.0, 0.0]])
    structure.add_hits(0, cell, HERE, 5.0)
    assert not len(structure.points_ne_m)
    structure.prune(4_000_000_000, HERE, math.pi, (5.0, 30.0))
    structure.add_hits(4_000_000_000, cell, HERE, 5.0)
    assert not len(structure.points_ne_m)


def test_crests_close_by_take_longer_to_be_structure() -> None:
    cell = np.array([[10.0, 0.0]])
    for reach_m, counts in ((5.0, True), (20.0, False)):
        structure = StructureMap()
        for look_number in range(12):
            structure.add_hits(look_number * 200_000_000, cell, HERE, reach_m)
        assert bool(len(structure.points_ne_m)) is counts


def test_among_water_what_stands_is_hit_at_every_look() -> None:
    cell = np.array([[10.0, 0.0]])
    for every, counts in ((1, True), (2, False)):
        structure = StructureMap()
        for look_number in range(0, 200, every):
            structure.add_hits(look_number * 200_000_000, cell, HERE, 20.0)
        assert bool(len(structure.points_ne_m)) is counts


def test_the_current_is_found_from_two_headings() -> None:
    guess, current, rng = CurrentEstimator(), np.array((-0.4, 0.6)), np.random.default_rng(2)
    for tick in range(300):
        heading = 0.3 if tick < 150 else 1.6
        vel = 3.0 * np.array((math.cos(heading), math.sin(heading))) + current + 0.05 * rng.normal(size=2)
        guess.update(tick * 200_000_000, np.append(vel, 0.0), heading, 0.0)
    np.testing.assert_allclose(guess.current_ne_mps, current, atol=0.1)


def test_sailing_ahead_keeps_to_the_legs_around_a_corner() -> None:
    legs = PathLegs(np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 60.0)]))
    sailed = simulate_courses(legs, HERE, np.array((3.0, 0.0)), 0.0, np.zeros(1), np.zeros(1), np.array((3.0,)), 16.0)
    end = sailed.pos_ne_m[0, -1]
    assert end[0] == pytest.approx(20.0, abs=1.5)
    assert sailed.progress_m[0] == pytest.approx(48.0, abs=8.0)  # less what the corner takes
    assert leg_course_rad(legs, np.array((5.0, 6.0))) == (pytest.approx(-math.pi / 4), pytest.approx(6.0))


def test_clearance_is_that_of_a_box_that_drifts() -> None:
    """A boat that stays, a box 4 m by 2 m, headed east, that comes at 1 m/s: its side is 1 m before its middle."""
    steps = 10
    sailed = np.zeros((1, steps, 2))
    around = Obstacles(
        np.array([[20.0, 0.0]]), np.array([[-1.0, 0.0]]), np.array([2.0]), np.array([1.0]), np.array([math.pi / 2]),
        np.array([[0.0, -15.0]]),
    )  # fmt: skip
    clear = clearance_m(sailed, around, 1.4)[0]
    after_s = STEP_S * np.arange(1, steps + 1)
    np.testing.assert_allclose(clear, np.minimum(20.0 - 1.0 - after_s, 15.0) - 1.4, atol=0.06 * after_s[-1] + 1e-9)


def test_clearance_of_many_points_is_that_of_the_nearest_and_needs_little_memory() -> None:
    draw = np.random.default_rng(7)
    sailed, points = draw.uniform(-50.0, 50.0, (80, 60, 2)), draw.uniform(-60.0, 60.0, (301, 2))
    none = np.zeros(0)
    around = Obstacles(np.zeros((0, 2)), np.zeros((0, 2)), none, none, none, points)
    tracemalloc.start()
    try:
        clear = clearance_m(sailed, around, 1.4)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    nearest = np.min([np.hypot(*(sailed - point).transpose(2, 0, 1)) for point in points], axis=0)
    np.testing.assert_allclose(clear, nearest - 1.4, atol=1e-9)
    assert peak_bytes < 10 * sailed.nbytes  # all distances at once are 150 times the positions


def pose(yaw_rad: float, pos: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> VehiclePose:
    return VehiclePose(np.array(pos), rotation_matrix(quaternion_from_euler(0.0, 0.0, yaw_rad)), np.zeros(3))


def test_proximity_counts_sectors_from_the_bow_clockwise() -> None:
    yaw = 0.4
    right_abeam = np.array((5.0 * math.cos(yaw + math.pi / 2), 5.0 * math.sin(yaw + math.pi / 2)))
    ahead = np.array((12.0 * math.cos(yaw), 12.0 * math.sin(yaw)))
    distance, sensor = make_proximity_messages(np.array([right_abeam, ahead]), pose(yaw), 1_000_000_000, 1.15, 60.0)
    assert len(distance.distances) == SECTORS
    assert (distance.distances[0], distance.distances[18]) == (1200, 500)
    assert distance.distances[2] == 6001, "in view and empty"
    assert distance.distances[36] == 65535, "astern and not known"
    assert (distance.increment, distance.frame, distance.max_distance) == (5, 12, 6000)
    assert (sensor.current_distance, sensor.orientation) == (1085, 0)


def still(history: PoseHistory, ticks: range = range(40)) -> None:
    for tick in ticks:
        history.add_attitude(tick * TENTH_NS, quaternion_from_euler(0.0, 0.0, 0.0), np.zeros(3))
        history.add_position(tick * TENTH_NS, np.zeros(3), np.zeros(3))


def look(
    sighting: ObstacleDetector, history: PoseHistory, tick: int, points: np.ndarray, intensity: np.ndarray | None = None
) -> Any:
    offset_s = np.linspace(0.0, 0.099, len(points)).astype(np.float32)
    shine = np.ones(len(points)) if intensity is None else intensity
    return sighting.add_cloud(history, tick * TENTH_NS, points.astype(np.float32), offset_s, shine.astype(np.uint8))


def test_water_close_by_is_learnt_and_a_low_trunk_beyond_it_is_seen() -> None:
    """Water returns up to 10 m, at all bearings in view; 30 m off something stands a hand out of it."""
    history, sighting, rng = PoseHistory(), ObstacleDetector(60.0, 0.15), np.random.default_rng(4)
    still(history)
    for tick in range(50):
        still(history, range(tick + 1, tick + 3))
        range_m, bearing = rng.uniform(2.6, 10.0, 600), rng.uniform(-0.6, 0.6, 600)
        heave = 0.05 * rng.normal(size=600)
        water = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), 0.15 + heave])
        trunk = np.column_stack([np.full(9, 30.0), np.linspace(-2.0, 2.0, 9), np.full(9, 0.05)])
        assert look(sighting, history, tick, np.concatenate([water, trunk]))
    assert 10.0 < sighting.water_reach_m < 20.5
    (found,) = find_clusters(sighting.frames, HERE, 0.0)
    np.testing.assert_allclose(found.middle_ne_m, (30.0, 0.0), atol=0.3)


@pytest.mark.medium
@pytest.mark.parametrize(("reflects", "is_seen"), [(1, False), (8, True)])
def test_what_lies_awash_is_told_from_water_by_what_it_reflects(reflects: int, is_seen: bool) -> None:
    """A trunk at 12 m whose top is no higher than the waves, where water returns out to 16 m; 8 of 150 is wet wood."""
    history, sighting, tracks = PoseHistory(), ObstacleDetector(60.0, 0.15), ObstacleTracker()
    still(history)
    rng = np.random.default_rng(7)
    for tick in range(60):
        still(history, range(tick + 1, tick + 3))
        range_m, bearing = rng.uniform(2.6, 16.0, 1500), rng.uniform(-0.6, 0.6, 1500)
        heave = 0.05 * rng.normal(size=1500)
        water = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), 0.15 + heave])
        trunk = np.column_stack([np.full(9, 12.0), np.linspace(-1.0, 1.0, 9), np.full(9, 0.1)])
        glint = rng.integers(0, 7, 1500) * (range_m < 6.0)  # close by, water glints
        shine = np.concatenate([rng.integers(0, 3, 1500) + glint, np.full(9, reflects)])
        assert look(sighting, history, tick, np.concatenate([water, trunk]), shine)
        found = find_clusters(sighting.frames, HERE, 1.6 * sighting.water_reach_m)
        tracks.update(tick * TENTH_NS, found, HERE, 0.0, sighting.water_reach_m, np.zeros(2))
    assert [track.position_at(60 * TENTH_NS)[0] for track in tracks.confirmed] == (
        [pytest.approx(12.0, abs=0.5)] * is_seen
    )


@pytest.mark.medium
@pytest.mark.parametrize("wander_m", [-0.3, 0.3])
def test_a_height_that_wanders_makes_no_obstacle_of_the_water_and_hides_none(wander_m: float) -> None:
    """The autopilot's height goes off by 0.3 m within two seconds; 0.4 m stand out of the water 9 m ahead."""
    history, sighting, rng = PoseHistory(), ObstacleDetector(60.0, 0.15), np.random.default_rng(6)
    for tick in range(92):
        off_m = wander_m * min(max((tick - 60) / 20.0, 0.0), 1.0)
        history.add_attitude(tick * TENTH_NS, np.array((1.0, 0.0, 0.0, 0.0)), np.zeros(3))
        history.add_position(tick * TENTH_NS, np.array((0.0, 0.0, off_m)), np.zeros(3))
        if tick < 2:
            continue
        range_m, bearing = rng.uniform(2.6, 12.0, 1200), rng.uniform(-0.6, 0.6, 1200)
        heave = 0.05 * rng.normal(size=1200)
        water = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), 0.15 + heave])
        branch = np.column_stack([np.full(20, 9.0), np.linspace(-0.5, 0.5, 20), np.full(20, 0.15 - 0.4)])
        assert look(sighting, history, tick - 2, np.concatenate([water, branch]))
        (found,) = find_clusters(sighting.frames, HERE, 0.0)
        np.testing.assert_allclose(found.middle_ne_m, (9.0, 0.0), atol=0.3)
        assert found.length_m < 2.0


@pytest.mark.medium
def test_a_wall_across_the_view_is_no_water_at_once() -> None:
    """Low all over the view, 12 to 25 m off for 3 s, as a boom is to a vessel that turns: water reaches no farther."""
    history, sighting, rng = PoseHistory(), ObstacleDetector(60.0, 0.15), np.random.default_rng(5)
    still(history)
    reach = []
    for tick in range(330):
        still(history, range(tick + 1, tick + 3))
        far_m = 25.0 if tick >= 300 else 10.0
        range_m, bearing = rng.uniform(2.6, far_m, 1200), rng.uniform(-0.6, 0.6, 1200)
        low = np.column_stack([range_m * np.cos(bearing), range_m * np.sin(bearing), np.full(1200, 0.15)])
        assert look(sighting, history, tick, low)
        reach.append(sighting.water_reach_m)
    assert reach[-1] < reach[299] + 2.0


def test_a_cloud_with_what_is_no_number_is_used_and_counted() -> None:
    history, sighting = PoseHistory(), ObstacleDetector(60.0, 0.15)
    still(history)
    points = np.array([[30.0, 0.0, 0.0], [math.nan, 0.0, 0.0], [0.0, math.inf, 0.0]])
    assert look(sighting, history, 3, points)
    assert sighting.refused == 2
    assert look(sighting, history, 4, np.empty((0, 3)))
    assert not look(sighting, history, 400, points)
    assert sighting.unplaced == 1


def test_a_lookout_that_has_heard_nothing_says_nothing() -> None:
    watch = ObstacleAvoidance()
    watch.add_cloud(0, np.zeros((3, 3), dtype=np.float32), np.zeros(3, dtype=np.float32), np.zeros(3, dtype=np.uint8))
    assert watch.plan(0) == watch.proximity_messages(0) == watch.obstacle_messages(0) == []
    assert (watch.tracker.total, watch.commands.detours, watch.commands.stops, watch.commands.manoeuvre) == (0, 0, 0, 0)


def outline_cluster(stamp_ns: int, points: np.ndarray) -> Cluster:
    points = np.unique(np.round(points * 2.0) / 2.0, axis=0)
    return merged_cluster([Cluster(stamp_ns, points, points.mean(axis=0), 1.0, 1.0, 1.0, 0.0, len(points))])


def in_view(points: np.ndarray, pos: np.ndarray, range_m: float = 60.0) -> np.ndarray:
    """What a lidar with 70 degrees ahead sees of them from a place, headed north."""
    off = points - pos
    return points[(np.abs(np.arctan2(off[:, 1], off[:, 0])) < math.radians(35.0)) & (np.hypot(*off.T) < range_m)]


@pytest.mark.parametrize("length_m", [12.0, 24.0, 40.0])
def test_a_long_thing_that_moves_is_a_vessel(length_m: float) -> None:
    """It crosses from starboard at 1 m/s, on a course to be met at 2 m/s; its stern is out of sight if it is long."""
    tracks = ObstacleTracker(vessels=True)
    side = np.arange(0.0, length_m, 0.4)
    hull = np.concatenate([np.column_stack([np.full_like(side, lateral), side]) for lateral in (-2.0, 2.0)])
    for tick in range(60):
        time_s, pos = 0.2 * tick, np.array((0.4 * tick, 0.0))
        seen = in_view(hull + np.array((52.0, 24.0 - time_s)), pos)
        if len(seen) > 5:
            stamp_ns = round(time_s * 1e9)
            tracks.update(stamp_ns, [outline_cluster(stamp_ns, seen)], pos, 0.0, 8.0, np.zeros(2))
    (track,) = tracks.confirmed
    assert track.is_vessel
    np.testing.assert_allclose(track.state[2:], (0.0, -1.0), atol=0.25)
    bow_m = track.position_at(11_800_000_000)[1] - 0.5 * track.length_m
    assert bow_m == pytest.approx(24.0 - 11.8, abs=1.5)
    assert not len(tracks.structure.points_ne_m)


@pytest.mark.parametrize("reach_m", [30.0, 45.0])
def test_a_boom_of_which_more_and_more_comes_into_sight_is_no_vessel(reach_m: float) -> None:
    """Along a boom 9 m abeam at 3 m/s: its far end is wherever sight ends, its near one where the view does."""
    tracks = ObstacleTracker(vessels=True)
    boom = np.column_stack([np.arange(0.0, 200.0, 0.4), np.full(500, 9.0)])
    for tick in range(100):
        pos, stamp_ns = np.array((0.6 * tick, 0.0)), tick * 200_000_000
        tracks.update(stamp_ns, [outline_cluster(stamp_ns, in_view(boom, pos, reach_m))], pos, 0.0, 8.0, np.zeros(2))
    assert not tracks.confirmed
    assert len(tracks.structure.points_ne_m) > 100


def test_a_vessel_seen_from_ahead_may_be_longer_than_its_bow() -> None:
    """A flat bow 8 m wide comes on at 2 m/s: what is planned around reaches 32 m astern of it, and not ahead."""
    tracks = ObstacleTracker(vessels=True)
    bow = np.column_stack([np.zeros(21), np.linspace(-4.0, 4.0, 21)])
    for tick in range(40):
        stamp_ns = tick * 200_000_000
        cluster = outline_cluster(stamp_ns, bow + np.array((50.0 - 0.4 * tick, 0.0)))
        tracks.update(stamp_ns, [cluster], HERE, 0.0, 8.0, np.zeros(2))
    (track,) = tracks.confirmed
    around = obstacles_near(8_000_000_000, [track], np.empty((0, 2)), HERE)
    front_m = around.middle_ne_m[0, 0] - around.half_length_m[0]
    assert front_m == pytest.approx(50.0 - 16.0, abs=2.0)
    assert 2.0 * around.half_length_m[0] == pytest.approx(32.0, abs=3.0)
