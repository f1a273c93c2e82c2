"""Which points are water or crests, at each limit, and the plane of the water against a least-squares solver."""

from __future__ import annotations

import numpy as np
import pytest

from agent.companion.water_plane import WaterPlane

LEVEL = np.array([0.0, 0.0, 1.0])
NO_RATE = np.zeros(3)


def pond(count: int = 60, slope: tuple[float, float] = (0.0, 0.0), down_m: float = 0.5) -> np.ndarray:
    """Points of a plane, 3 to 8 m ahead."""
    rng = np.random.default_rng(1)
    sides = np.column_stack([rng.uniform(3.0, 8.0, count), rng.uniform(-3.0, 3.0, count)])
    return np.column_stack([sides, sides @ slope + down_m])


def masks(plane: WaterPlane, *points: np.ndarray) -> np.ndarray:
    """(n,) whether these points are water, of one cloud."""
    every = np.concatenate(points).astype(np.float32)
    return plane.water_mask(every, np.zeros(len(every), dtype=np.float32))


@pytest.mark.parametrize(
    ("point", "is_wet"),
    [
        ((5.0, 0.0, 0.5), True),
        ((5.0, 0.0, 3.0), True),  # below the water
        ((5.0, 0.0, 0.26), True),  # a wave of 0.24 m
        ((5.0, 0.0, 0.24), False),
        ((-5.0, 10.8, 0.5), True),  # 11.9 m
        ((-5.0, 11.0, 0.5), False),  # 12.1 m
        ((11.9, 0.0, 2.0), False),
        ((11.8, 0.0, 2.0), True),
    ],
)
def test_water_is_what_is_near_and_no_higher_than_waves(point: tuple[float, float, float], is_wet: bool) -> None:
    wet = masks(WaterPlane(), pond(), np.array([point]))
    assert wet[:-1].all()
    assert wet[-1] == is_wet


def test_a_plane_needs_fifty_points_and_is_kept_for_clouds_without() -> None:
    plane = WaterPlane()
    assert not masks(plane, pond(49)).any()
    assert plane.level is None
    assert masks(plane, pond(50)).all()
    assert plane.level is not None
    assert plane.level.down_m == pytest.approx(0.5)
    assert masks(plane, pond(5), pond(1) - (0.0, 0.0, 0.4)).tolist() == [True] * 5 + [False]
    assert plane.level is None, "this cloud showed no water"


def test_points_too_far_or_too_high_do_not_make_the_plane() -> None:
    """9 m in any direction, and 1.5 m from the body's height."""
    far = pond() * (0.0, 0.0, 1.0) + (0.0, 9.1, 0.0)
    high = pond() * (1.0, 1.0, 0.0) + (0.0, 0.0, -1.51)
    for other in (far, high, -high):
        plane = WaterPlane()
        masks(plane, pond(49), other)
        assert plane.level is None
    for other in (far - (0.0, 0.2, 0.0), high - (0.0, 0.0, -0.02)):
        plane = WaterPlane()
        masks(plane, other)
        assert plane.level is not None


@pytest.mark.parametrize("slope", [(0.0, 0.02), (0.05, 0.19), (0.0, -0.09)])
def test_the_plane_is_that_of_a_solver(slope: tuple[float, float]) -> None:
    """Noise and waves within a cloud that turns: rates of the plane's parameters, by numpy's least squares."""
    rng = np.random.default_rng(2)
    points = pond(400, slope, 0.3)
    lag_s = rng.uniform(-0.1, 0.0, 400)
    points[:, 2] += lag_s * (points[:, :2] @ (0.2, -0.3) + 0.1) + rng.normal(0.0, 0.01, 400)
    plane = WaterPlane()
    plane.water_mask(points.astype(np.float32), lag_s.astype(np.float32))
    sides = np.column_stack([points[:, :2], np.ones(400)])
    solved = np.linalg.lstsq(np.column_stack([sides, lag_s[:, None] * sides]), points[:, 2], rcond=None)[0]
    assert plane.level is not None
    normal = np.array([-solved[0], -solved[1], 1.0])
    np.testing.assert_allclose(plane.level.normal_frd, normal / np.linalg.norm(normal), atol=2e-3)
    assert plane.level.down_m == pytest.approx(solved[2] / np.linalg.norm(normal), abs=5e-3)
    # The normal of a level that rests turns in the body against the body's rotation: its rate is normal x turn.
    rate = np.cross(plane.level.normal_frd, plane.level.turn_frd_radps)
    after = np.array([-solved[0] - 1e-4 * solved[3], -solved[1] - 1e-4 * solved[4], 1.0])
    expected = (after / np.linalg.norm(after) - normal / np.linalg.norm(normal)) / 1e-4
    np.testing.assert_allclose(rate, expected, atol=0.05)
    assert abs(plane.level.normal_frd @ plane.level.turn_frd_radps) < 1e-9


@pytest.mark.parametrize(("slope", "is_water"), [((0.39, 0.0), True), ((0.41, 0.0), False), ((0.0, -0.41), False)])
def test_a_steep_plane_is_not_water(slope: tuple[float, float], is_water: bool) -> None:
    plane = WaterPlane()
    points = pond(200, slope, 0.0)
    masks(plane, points - (0.0, 0.0, float(points[:, 2].mean())))
    assert (plane.level is not None) is is_water


@pytest.mark.parametrize("off_m", [0.45, 0.6])
def test_points_off_the_plane_are_trimmed(off_m: float) -> None:
    """One in six points stands off the water: the plane ends up at the others."""
    points = pond(300)
    points[::6, 2] -= off_m
    plane = WaterPlane()
    masks(plane, points)
    assert plane.level is not None
    assert plane.level.down_m == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_allclose(plane.level.normal_frd, LEVEL, atol=1e-3)


@pytest.mark.parametrize(
    ("point", "is_crest"),
    [
        ((15.0, 0.0, 0.21), True),  # 0.29 m over the water
        ((15.0, 0.0, 0.19), False),
        ((15.0, 0.0, 3.0), True),
        ((11.9, 0.0, 0.4), False),
        ((12.1, 0.0, 0.4), True),
        ((12.0, 15.9, 0.4), True),  # 19.9 m
        ((12.0, 16.1, 0.4), False),
    ],
)
def test_crests_are_low_points_between_twelve_and_twenty_metres(
    point: tuple[float, float, float], is_crest: bool
) -> None:
    plane, one, lag_s = WaterPlane(), np.array([point], dtype=np.float32), np.zeros(1, dtype=np.float32)
    assert not plane.crest_mask(one, lag_s, LEVEL, NO_RATE)[0], "the water's height is unknown"
    masks(plane, pond())
    assert plane.crest_mask(one, lag_s, LEVEL, NO_RATE).tolist() == [is_crest]


def test_the_height_for_crests_follows_by_a_tenth_a_cloud() -> None:
    plane, lag_s = WaterPlane(), np.zeros(2, dtype=np.float32)
    height_m = 0.5
    for number, down_m in enumerate((0.5, 1.0, 1.0, 0.2)):
        masks(plane, pond(down_m=down_m))
        height_m += 0.1 * (down_m - height_m) * (number > 0)
        edge = np.array([(15.0, 0.0, height_m - 0.29), (15.0, 0.0, height_m - 0.31)], dtype=np.float32)
        assert plane.crest_mask(edge, lag_s, LEVEL, NO_RATE).tolist() == [True, False]
    masks(plane, pond(5))
    assert plane.crest_mask(edge, lag_s, LEVEL, NO_RATE).tolist() == [True, False], "a cloud without water keeps it"


def test_down_is_that_of_the_instant_of_each_point() -> None:
    """The body rolls to starboard by 0.5 rad/s: 0.1 s before the end, down was 0.05 rad farther to starboard."""
    plane = WaterPlane()
    masks(plane, pond())
    rate = np.array([0.5, 0.0, 0.0])
    for lag_s in (-0.1, 0.0):
        # `down` turns in the body by down x rate
        down = LEVEL + lag_s * np.cross(LEVEL, rate)
        for off_m, is_crest in ((0.29, True), (0.31, False)):
            flat = np.array([10.0, 10.0, 0.0])
            point = flat + (0.5 - off_m - flat @ down) * LEVEL / down[2]
            found = plane.crest_mask(point[None].astype(np.float32), np.full(1, lag_s, dtype=np.float32), LEVEL, rate)
            assert found.tolist() == [is_crest]
