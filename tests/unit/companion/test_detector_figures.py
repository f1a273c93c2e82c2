"""Detection with exact figures: which points are kept and where, the range of the water's returns, and clusters."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion.detection import DetectionFrame, ObstacleDetector, find_clusters, merged_cluster
from agent.companion.pose_history import VehiclePose
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix

MS, S = 1_000_000, 1_000_000_000
HERE = np.zeros(2)
WATERLINE_M = 0.15


def level(stamp_ns: int) -> VehiclePose:
    return VehiclePose(np.zeros(3), np.eye(3), np.zeros(3))


class Sight:
    """A detector, and clouds at instants: points (n, 3) in body axes, here level with the water at 0.15 m."""

    def __init__(self, pose_at: Callable[[int], VehiclePose | None] = level) -> None:
        self.detector = ObstacleDetector(60.0, WATERLINE_M)
        self.history: Any = SimpleNamespace(pose_at=pose_at)

    def add(self, stamp_ns: int, points: Any, offset_s: Any = 0.0, intensity: Any = 1) -> DetectionFrame:
        points = np.asarray(points, dtype=np.float32).reshape(-1, 3)
        offset = np.broadcast_to(np.asarray(offset_s, dtype=np.float32), len(points))
        shine = np.broadcast_to(np.asarray(intensity, dtype=np.uint8), len(points))
        assert self.detector.add_cloud(self.history, stamp_ns, points, offset, shine)
        return self.detector.frames[-1]


def rows(frame: DetectionFrame) -> list[tuple[float, ...]]:
    columns = zip(
        frame.points_ne_m.tolist(), frame.top_m.tolist(), frame.hits.tolist(), frame.bright.tolist(), strict=True
    )
    return sorted((*point, top_m, hits, bright) for point, top_m, hits, bright in columns)


def test_points_of_one_cell_are_one_mean_with_its_highest_point() -> None:
    """Cells of 0.5 m from the origin on. Heights are above the water, which is 0.15 m below the body's origin."""
    points = [
        (30.1, 0.1, -0.35),
        (30.3, 0.4, 0.05),
        (30.2, 0.1, -0.05),
        (30.5, 0.1, 0.05),
        (30.4, -0.1, 0.0),
        (-30.1, 3.1, 0.1),
    ]
    frame = Sight().add(5 * S, points)
    assert frame.stamp_ns == 5 * S
    expected = [(-30.1, 3.1, 0.05, 1, 0), (30.2, 0.2, 0.5, 3, 0), (30.4, -0.1, 0.15, 1, 0), (30.5, 0.1, 0.1, 1, 0)]
    np.testing.assert_allclose(rows(frame), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("point", "is_kept"),
    [
        ((30.0, 0.0, 1.34), True),  # 1.19 m under water: pitch
        ((30.0, 0.0, 1.36), False),
        ((30.0, 0.0, -2.34), True),  # 2.49 m above the water
        ((30.0, 0.0, -2.36), False),
        ((15.0, 0.0, -0.10), False),  # among the water's returns
        ((15.0, 0.0, -0.20), True),  # higher than 0.2 m and 2.5 spreads of 0.05 m
        ((15.0, 0.0, -0.16), False),
        ((0.0, 19.9, 0.0), False),
        ((0.0, 20.1, 0.0), True),
        ((0.0, 59.9, 0.0), True),
        ((0.0, -60.1, 0.0), False),
        ((-2.0, -1.6, -0.5), True),
        ((-2.0, -1.4, -0.5), False),
    ],
)
def test_points_are_kept_by_range_and_height(point: tuple[float, float, float], is_kept: bool) -> None:
    assert len(Sight().add(0, [point]).cells) == is_kept


def test_points_are_placed_by_the_pose_at_their_own_instants() -> None:
    """The vessel turns by 40° and rolls during the cloud, which five poses describe; points are between them."""

    def pose_at(stamp_ns: int) -> VehiclePose:
        time_s = (stamp_ns - S) * 1e-9
        turn = rotation_matrix(quaternion_from_euler(0.5 * time_s, -0.3 * time_s, 0.3 + 7.0 * time_s))
        return VehiclePose(np.array((100.0 + 30.0 * time_s, -40.0, 0.2)), turn, np.zeros(3))

    sight, offset_s = Sight(pose_at), np.array([0.0, 0.01, 0.025, 0.04, 0.05, 0.0725, 0.075, 0.1])
    points = np.column_stack([np.linspace(25.0, 32.0, 8), np.linspace(-8.0, 8.0, 8), np.full(8, -0.6)])
    frame = sight.add(S, points, offset_s)
    expected = []
    for point, after_s in zip(points, offset_s, strict=True):
        first = min(int(after_s / 0.025 + 1e-6), 3)
        share = after_s / 0.025 - first
        ends = [pose_at(S + round((first + step) * 25 * MS)) for step in (0, 1)]
        before, after = (end.rot_ned_frd @ point + end.pos_ned_m for end in ends)
        place = before + share * (after - before)
        expected.append((*place[:2], 0.2 + WATERLINE_M - place[2], 1, 0))
    np.testing.assert_allclose(rows(frame), sorted(expected), atol=1e-4)


def test_the_height_of_the_floating_vessel_is_a_mean_of_fifteen_seconds_near_the_present() -> None:
    down_m = {0: 0.3, 1: 0.1, 2: 0.5, 4: -0.2, 12: -0.2, 13: -1.0, 40: 0.05}

    def pose_at(stamp_ns: int) -> VehiclePose:
        return VehiclePose(np.array((0.0, 0.0, down_m[round(stamp_ns * 1e-9 - 7.0)])), np.eye(3), np.zeros(3))

    sight = Sight(pose_at)
    mean_m, before_s = down_m[0], 0
    for after_s, present_m in down_m.items():
        frame = sight.add((7 + after_s) * S, [(30.0, 0.0, 0.0)])
        mean_m += min((after_s - before_s) / 15.0, 1.0) * (present_m - mean_m)
        mean_m = min(max(mean_m, present_m - 0.4), present_m + 0.4)
        before_s = after_s
        assert frame.top_m == pytest.approx([mean_m + WATERLINE_M - present_m])


def test_near_water_is_the_level_if_there_are_enough_points() -> None:
    """Fifty points within 9 m and 0.35 m of the expected level."""
    for count, height_m in ((49, 0.30), (50, 0.10)):
        water = [(8.5, 0.01 * number, WATERLINE_M - 0.2) for number in range(count)]
        far = [(9.5, 0.01 * number, WATERLINE_M - 0.3) for number in range(60)]
        high = [(5.0, 0.01 * number, WATERLINE_M - 0.36) for number in range(60)]
        frame = Sight().add(0, [*water, *far, *high, (30.0, 0.0, WATERLINE_M - 0.3)])
        assert frame.top_m[np.argmax(frame.points_ne_m[:, 0])] == pytest.approx(height_m, abs=1e-6)


@pytest.mark.parametrize(
    ("range_m", "intensity", "count", "is_kept"),
    [
        (9.0, 5, 30, True),
        (9.0, 4, 30, False),
        (7.9, 9, 30, False),
        (8.1, 9, 30, True),
        (9.0, 9, 29, False),
        (19.5, 5, 30, True),
    ],
)
def test_what_is_three_steps_brighter_than_water_is_kept(
    range_m: float, intensity: int, count: int, is_kept: bool
) -> None:
    """The water's median is 2, of at least thirty points, with this one. Closer than 8 m, water glints."""
    water = [(12.0, 0.1 * number, WATERLINE_M) for number in range(count - 1)]
    dry = [(25.0, 0.1 * number, WATERLINE_M + 1.3) for number in range(50)]
    shine = [*([2] * (count - 1)), *([90] * 50), intensity]
    frame = Sight().add(0, [*water, *dry, (-range_m, 0.0, WATERLINE_M)], intensity=shine)
    np.testing.assert_allclose(rows(frame), [(-range_m, 0.0, 0.0, 1, 1)] * is_kept, atol=1e-6)


def test_points_of_the_last_0_8_seconds_are_kept() -> None:
    sight = Sight()
    for after_ms in (0, 100, 800, 900, 901):
        sight.add(after_ms * MS, [(30.0, 0.0, 0.0)])
    assert [frame.stamp_ns // MS for frame in sight.detector.frames] == [800, 900, 901]
    sight = Sight()
    for after_ms in (0, 100, 900):
        sight.add(after_ms * MS, [(30.0, 0.0, 0.0)])
    assert [frame.stamp_ns // MS for frame in sight.detector.frames] == [100, 900]


def test_clouds_without_a_pose_are_counted_and_those_before_the_first_pose_apart() -> None:
    known: list[bool] = [False]
    sight = Sight(lambda stamp_ns: level(stamp_ns) if known[0] and stamp_ns < 3 * S else None)
    points, offset_s = np.zeros((1, 3), dtype=np.float32) + 30.0, np.full(1, 0.1, dtype=np.float32)
    outcomes = []
    for stamp_ns in (S, S, 2 * S, 3 * S - 1, 3 * S):
        outcomes.append(sight.detector.add_cloud(sight.history, stamp_ns, points, offset_s, np.ones(1, dtype=np.uint8)))
        known[0] = stamp_ns != S or len(outcomes) == 2
    assert outcomes == [False, False, True, False, False]
    assert (sight.detector.unplaced, sight.detector.early) == (4, 2)


# -- the range at which water returns light


def ring(number: int, sectors: Any = range(-7, 7), height_m: float = 0.0) -> list[tuple[float, float, float]]:
    """A point in the middle of each sector of 5° of a ring of 1 m."""
    bearings = [math.radians(5.0 * sector + 2.5) for sector in sectors]
    return [((number + 0.5) * math.cos(b), (number + 0.5) * math.sin(b), WATERLINE_M - height_m) for b in bearings]


def reach_after(points: list[tuple[float, float, float]], clouds: int = 1) -> float:
    sight = Sight()
    for number in range(clouds):
        sight.add(number * 100 * MS, points)
    return sight.detector.water_reach_m


def rings(*numbers: int, sectors: Any = range(-7, 7), height_m: float = 0.0) -> list[tuple[float, float, float]]:
    return [point for number in numbers for point in ring(number, sectors, height_m)]


@pytest.mark.parametrize(
    ("wet", "grows"),
    [
        (rings(*range(3, 18)), False),  # to 18 m, and 2 m more
        (rings(*range(3, 19)), True),
        (rings(*range(5, 19)), True),
        (rings(*range(6, 19)), False),  # three dry rings end the water
        (rings(*range(3, 16), 18), True),
        (rings(*range(3, 15), 18), False),
        (rings(*range(3, 18), *range(19, 24), sectors=range(7)), True),  # seven of fourteen sectors
        (rings(*range(3, 24), sectors=range(6)), False),
        (rings(*range(3, 24), sectors=[*range(-9, -7), *range(1, 7), *range(7, 10)]), False),  # out of view
        (rings(*range(3, 24), sectors=[-7, *range(0, 6)]), True),
        (rings(*range(3, 24), sectors=range(7), height_m=0.34), True),
        (rings(*range(3, 24), sectors=range(7), height_m=0.36), False),
        (rings(*range(3, 24), sectors=range(7), height_m=-0.36), False),
    ],
)
def test_rings_with_low_points_in_most_directions_are_water(wet: list[tuple[float, float, float]], grows: bool) -> None:
    """It begins at 20 m and grows by 5 cm a cloud."""
    assert reach_after(wet) == pytest.approx(20.05 if grows else 20.0)


@pytest.mark.medium
def test_the_range_of_the_water_follows_slowly() -> None:
    """Water up to 21 m: 23 m after 60 clouds. Up to 15 m or none: by 3 cm a cloud after 20 clouds."""
    far, near = rings(*range(3, 21)), rings(*range(3, 15))
    assert reach_after(far, 59) == pytest.approx(22.95)
    assert reach_after(far, 70) == pytest.approx(23.0)
    assert reach_after(near, 20) == pytest.approx(20.0)
    assert reach_after(near, 27) == pytest.approx(20.0 - 0.03 * 7)
    assert reach_after([], 530) == pytest.approx(5.0)
    assert reach_after(near, 130) == pytest.approx(17.0)


def test_a_ring_stays_water_for_three_clouds() -> None:
    """A count loses a tenth a cloud, and more than 0.8 is wet: 1, 0.9 and 0.81 are."""
    sight, reach_m = Sight(), []
    for number in range(6):
        sight.add(number * 100 * MS, rings(*range(3, 24)) if not number else [])
        reach_m.append(sight.detector.water_reach_m)
    assert reach_m == pytest.approx([20.05, 20.1, 20.15, 20.12, 20.09, 20.06])


def test_the_height_that_stands_out_follows_the_spread_of_the_waves() -> None:
    """The standard deviation is 1.4826 median deviations, with a weight of 1/20 a cloud, of more than thirty points."""
    for count, spreads in ((30, False), (32, True)):
        waves = [(11.0, 0.1 * number, WATERLINE_M + (0.1 if number % 2 else -0.1)) for number in range(count)]
        sight = Sight()
        for number in range(10):
            sight.add(number * 100 * MS, waves)
        spread_m = 0.14826 + (0.05 - 0.14826) * 0.95**10 if spreads else 0.05
        assert sight.detector.stands_out_m == pytest.approx(0.2 + 2.5 * spread_m)


# -- clusters


def frame(stamp_ns: int, points: Any, hits: Any = 1, top_m: Any = 0.2, bright: Any = 0) -> DetectionFrame:
    points = np.array(points, dtype=float).reshape(-1, 2)
    cells = (np.floor(points / 0.5) @ (1 << 20, 1)).astype(np.int64)
    columns = [np.broadcast_to(np.asarray(column), len(points)) for column in (top_m, hits, bright)]
    return DetectionFrame(stamp_ns, cells, points, columns[0].astype(float), columns[1], columns[2])


def test_a_cluster_is_the_box_of_its_points_and_the_mean_of_its_frames() -> None:
    """Two rows 2 m apart along a heading, of unequal lengths: the box is theirs, not centred on the mean."""
    heading_rad = math.radians(25.0)
    local = np.array(
        [
            *((along, -1.0) for along in np.arange(0.0, 10.1, 0.5)),
            *((along, 1.0) for along in np.arange(0.0, 10.1, 0.5)),
            (12.0, 0.0),
            (11.2, 0.0),
        ]
    )
    turn = np.array([(math.cos(heading_rad), math.sin(heading_rad)), (-math.sin(heading_rad), math.cos(heading_rad))])
    points = np.array((30.0, -9.0)) + local @ turn
    frames = [
        frame(S, points, 1, 0.2, 1),
        frame(S + 300 * MS, points, 3, 0.45, 0),
        frame(S + 400 * MS, points, 2, 0.3, 2),
    ]
    (found,) = find_clusters(frames, HERE, 0.0)
    assert found.length_m == pytest.approx(12.0, abs=1e-6)
    assert found.width_m == pytest.approx(2.0, abs=1e-6)
    assert found.heading_rad == pytest.approx(heading_rad, abs=1e-6)
    np.testing.assert_allclose(found.middle_ne_m, np.array((30.0, -9.0)) + np.array((6.0, 0.0)) @ turn, atol=1e-6)
    count = len(points)
    assert found.stamp_ns == pytest.approx(S + (300 * MS * 3 + 400 * MS * 2) / 6, abs=1)
    assert (found.height_m, found.points, found.bright) == (0.45, 2 * count, 3 * count)
    cells = {tuple(cell) for cell in np.floor(points / 0.5).tolist()}
    assert len(found.points_ne_m) == len(cells)


@pytest.mark.parametrize("points", [[(20.2, 3.2)], [(20.2, 3.2), (20.3, 3.2)]])
def test_a_small_cluster_has_a_size_of_half_a_cell(points: list[tuple[float, float]]) -> None:
    (found,) = find_clusters([frame(number, points, 2, -0.5) for number in range(3)], HERE, 0.0)
    assert (found.length_m, found.width_m, found.height_m) == (0.25, 0.25, 0.05)


@pytest.mark.parametrize(
    ("hits", "frames", "doubtful_m", "is_seen"),
    [
        ([1, 1, 1], 3, 0.0, True),
        ([1, 1, 0], 3, 0.0, False),  # two points
        ([2, 1, 0], 3, 0.0, True),
        ([9, 0, 0], 3, 0.0, False),  # in one frame
        ([9], 1, 0.0, True),
        ([2, 2, 2], 3, 25.1, False),  # doubtful: five points a metre, of 1.25 m
        ([2, 2, 2], 3, 24.9, True),
        ([2, 2, 3], 3, 25.1, True),
    ],
)
def test_clusters_need_points_and_frames(hits: list[int], frames: int, doubtful_m: float, is_seen: bool) -> None:
    seen = [frame(number, [(15.1, 20.1)] if count else [], count) for number, count in enumerate(hits)]
    assert len(find_clusters(seen, np.array((0.1, 0.1)), doubtful_m)) == is_seen
    assert len(seen) == frames


@pytest.mark.parametrize(
    ("off", "clusters"),
    [((1.0, 0.0), 1), ((1.0, 1.0), 1), ((-1.0, 1.0), 1), ((2.0, 0.0), 2), ((0.0, -2.0), 2), ((-2.0, 2.0), 2)],
)
def test_adjacent_cells_of_a_metre_are_one_cluster(off: tuple[float, float], clusters: int) -> None:
    for place in ((20.5, 3.5), (-20.5, -3.5)):
        both = [place, (place[0] + off[0], place[1] + off[1])]
        assert len(find_clusters([frame(number, both, 3) for number in range(3)], HERE, 0.0)) == clusters


def test_parts_merge_into_one_cluster_by_their_cells() -> None:
    first, second = (
        find_clusters([frame(stamp_ns, points, 3, top_m, 1) for stamp_ns in (start_ns, start_ns + 200)], HERE, 0.0)[0]
        for start_ns, points, top_m in ((0, [(20.0, 0.0), (20.0, 0.5), (20.0, 1.0)], 0.4), (4000, [(20.0, 9.0)], 0.9))
    )
    whole = merged_cluster([first, second])
    assert (whole.length_m, whole.width_m, whole.heading_rad) == pytest.approx((9.0, 0.25, math.pi / 2))
    assert whole.middle_ne_m.tolist() == pytest.approx([20.0, 4.5])
    assert (whole.stamp_ns, whole.height_m) == (100 + 1000, 0.9)
    assert (whole.points, whole.bright) == (9 + 3, 6 + 2)
    assert cast(Any, whole.points_ne_m).shape == (4, 2)
