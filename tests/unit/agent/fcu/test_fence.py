"""The fence: distances against closed forms, refusals, and what a breach does."""

from __future__ import annotations

import math

import pytest
from boat import LAT_DEG, LON_DEG, Boat, degrees
from hypothesis import given
from hypothesis import strategies as st
from steered_boat import SteeredBoat

from agent.fcu.fence import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, RETURN_POINT, Fence, FenceError, FenceItem
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.navigation.geodetic import Home, LocalProjection

FRAME = LocalProjection(LAT_DEG, LON_DEG, 0.0)
HOME = Home(LAT_DEG, LON_DEG, 0.0)


def polygon(command: int, *corners: tuple[float, float]) -> list[FenceItem]:
    return [FenceItem(command, *FRAME.to_geodetic(*corner), vertex_count=len(corners)) for corner in corners]


def circle(command: int, north_m: float, east_m: float, radius_m: float) -> FenceItem:
    return FenceItem(command, *FRAME.to_geodetic(north_m, east_m), radius_m=radius_m)


def clearance_m(items: list[FenceItem], north_m: float, east_m: float, **parameters: float) -> float:
    fence = Fence(Parameters({"FENCE_ENABLE": 1, "FENCE_TYPE": 4, **parameters}))
    fence.replace(items)
    return fence.clearance_m(FRAME, HOME, *FRAME.to_geodetic(north_m, east_m))


SQUARE = [(0.0, 0.0), (0.0, 100.0), (100.0, 100.0), (100.0, 0.0)]
# A horseshoe, open to the north: the place between its arms is outside.
HORSESHOE = [(0.0, 0.0), (0.0, 90.0), (90.0, 90.0), (90.0, 60.0), (30.0, 60.0), (30.0, 30.0), (90.0, 30.0), (90.0, 0.0)]


@pytest.mark.parametrize(
    ("items", "place", "expected"),
    [
        (polygon(POLYGON_IN, *SQUARE), (50.0, 50.0), 50.0),
        (polygon(POLYGON_IN, *SQUARE), (90.0, 50.0), 10.0),
        (polygon(POLYGON_IN, *SQUARE), (-3.0, -4.0), -5.0),
        (polygon(POLYGON_OUT, *SQUARE), (50.0, 120.0), 20.0),
        (polygon(POLYGON_OUT, *SQUARE), (50.0, 99.0), -1.0),
        (polygon(POLYGON_IN, *HORSESHOE), (60.0, 45.0), -15.0),
        (polygon(POLYGON_IN, *HORSESHOE), (15.0, 45.0), 15.0),
        ([circle(CIRCLE_IN, 10.0, 0.0, 30.0)], (10.0, 10.0), 20.0),
        ([circle(CIRCLE_OUT, 10.0, 0.0, 30.0)], (10.0, 10.0), -20.0),
        ([*polygon(POLYGON_IN, *SQUARE), circle(CIRCLE_OUT, 50.0, 50.0, 10.0)], (50.0, 70.0), 10.0),
        ([FenceItem(RETURN_POINT, *HOME)], (1e4, 0.0), math.inf),
        ([], (0.0, 0.0), math.inf),
    ],
)
def test_distances(items: list[FenceItem], place: tuple[float, float], expected: float) -> None:
    assert clearance_m(items, *place) == pytest.approx(expected, abs=1e-3)


def test_the_circle_around_home_is_centred_on_home() -> None:
    """Home lies 40 m north and 10 m east of the frame's origin. The place is 30 m north and 40 m east of home."""
    lat_deg, lon_deg = FRAME.to_geodetic(40.0, 10.0)
    fence = Fence(Parameters({"FENCE_ENABLE": 1, "FENCE_TYPE": 2, "FENCE_RADIUS": 80.0}))
    place = FRAME.to_geodetic(70.0, 50.0)
    assert fence.clearance_m(FRAME, Home(lat_deg, lon_deg, 0.0), *place) == pytest.approx(80.0 - 50.0, abs=1e-2)


def test_the_circle_around_home_and_its_bit() -> None:
    assert clearance_m([], 80.0, 0.0, FENCE_TYPE=2, FENCE_RADIUS=100.0) == pytest.approx(20.0, abs=1e-3)
    assert clearance_m([circle(CIRCLE_IN, 0.0, 0.0, 90.0)], 80.0, 0.0, FENCE_TYPE=6, FENCE_RADIUS=100.0) == (
        pytest.approx(10.0, abs=1e-3)
    )
    assert clearance_m([circle(CIRCLE_IN, 0.0, 0.0, 1.0)], 80.0, 0.0, FENCE_TYPE=0) == math.inf


@pytest.mark.medium
@given(st.floats(-300, 300), st.floats(-300, 300), st.integers(3, 12), st.floats(5.0, 200.0))
def test_a_regular_polygon_lies_between_its_circles(
    north_m: float, east_m: float, corners: int, radius_m: float
) -> None:
    ring = [
        (radius_m * math.cos(2.0 * math.pi * n / corners), radius_m * math.sin(2.0 * math.pi * n / corners))
        for n in range(corners)
    ]
    found = clearance_m(polygon(POLYGON_IN, *ring), north_m, east_m)
    off_m = math.hypot(north_m, east_m)
    assert radius_m * math.cos(math.pi / corners) - off_m - 1e-6 <= found <= radius_m - off_m + 1e-6 or found > 0.0
    assert (found > 0.0) or off_m >= radius_m * math.cos(math.pi / corners) - 1e-6
    assert (found < 0.0) or off_m <= radius_m + 1e-6


@pytest.mark.parametrize(
    ("items", "words"),
    [
        ([FenceItem(16, 1.0, 1.0)], "fence item 0: command 16 is not supported"),
        ([FenceItem(CIRCLE_IN, 1.0, 1.0)], "fence item 0: radius 0 m"),
        ([FenceItem(CIRCLE_IN, 1.0, 1.0, math.nan)], "radius nan"),
        ([FenceItem(CIRCLE_IN, math.nan, 1.0, 5.0)], "not on Earth"),
        ([FenceItem(POLYGON_IN, 1.0, 1.0, vertex_count=2)] * 2, "a polygon of 2 corners; use at least 3"),
        ([FenceItem(POLYGON_IN, 1.0, 1.0, vertex_count=3)] * 2, "fence item 1: a polygon of 3 corners ends early"),
        (
            [*[FenceItem(POLYGON_IN, 1.0, 1.0, vertex_count=3)] * 2, FenceItem(POLYGON_OUT, 1.0, 1.0, vertex_count=3)],
            "fence item 2: a polygon of 3 corners ends early",
        ),
        ([FenceItem(RETURN_POINT, 1.0, 1.0)] * 201, "at most 200"),
    ],
)
def test_what_is_no_fence_is_refused_and_the_old_one_kept(items: list[FenceItem], words: str) -> None:
    ship = SteeredBoat()
    old = [circle(CIRCLE_IN, 0.0, 0.0, 50.0)]
    assert ship.autopilot.commands.set_fence(old) == ""
    assert words in ship.autopilot.commands.set_fence(items)
    assert ship.autopilot.fence.items == tuple(old)
    with pytest.raises(FenceError, match=words.split(":")[0][:8]):
        Fence(Parameters()).replace(items)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("action", "mode", "said"),
    [(0, "ACRO", "Fence breached"), (1, "RTL", "Fence breached, RTL"), (2, "HOLD", "Fence breached, HOLD")],
)
def test_a_breach_acts_says_so_once_and_is_over_inside(action: int, mode: str, said: str) -> None:
    ship = SteeredBoat(FENCE_ENABLE=1, FENCE_TYPE=2, FENCE_RADIUS=25.0, FENCE_ACTION=action, RC3_DZ=0.0).set_out(
        modes.ACRO
    )
    ship.hold_sticks(14.5, 0, 600)
    assert ship.boat.north_m > 25.0
    assert ship.mode == mode
    breach = ship.autopilot.fence.breach
    assert (breach.outside, breach.count, breach.kind) == (True, 1, 3)
    assert ship.autopilot.failsafes.active == ("Fence",)
    ship.sail(40.0)
    if action == 1:
        assert ship.distance_m(0.0, 0.0) < 3.0
        assert not ship.autopilot.fence.breach.outside
        assert ship.said.count("Fence breach over") == 1
    assert ship.said.count(said) == 1


@pytest.mark.medium
def test_who_takes_over_outside_is_told_again_only_further_out() -> None:
    ship = SteeredBoat(FENCE_ENABLE=1, FENCE_TYPE=2, FENCE_RADIUS=15.0, FENCE_ACTION=2).set_out(modes.ACRO)
    ship.hold_sticks(12.0, 0, 600)
    assert ship.mode == "HOLD"
    out_m = ship.boat.north_m
    ship.autopilot.set_mode(modes.ACRO)
    ship.hold_sticks(5.0, 0, 600)
    assert ship.mode == "ACRO"
    ship.hold_sticks(10.0, 0, 600)
    assert ship.mode == "HOLD"
    assert ship.boat.north_m - out_m > 15.0
    assert ship.autopilot.fence.breach.count == 1


def test_arming_outside_is_refused() -> None:
    ship = SteeredBoat()
    ship.sail(12.0)
    assert ship.autopilot.commands.set_fence([circle(CIRCLE_IN, 200.0, 0.0, 50.0)]) == ""
    assert ship.autopilot.commands.enable_fence(True) == ""
    assert ship.autopilot.arm() == ("Vehicle breaching Circle and Polygon fences",)
    assert ship.autopilot.commands.enable_fence(False) == ""
    assert ship.autopilot.arm() == ()
    early = SteeredBoat(FENCE_ENABLE=1)
    early.sail(1.0)
    assert "Fence requires position" in early.autopilot.arm()


def test_guided_keeps_its_margin() -> None:
    ship = SteeredBoat(Boat(), FENCE_ENABLE=1, FENCE_TYPE=2, FENCE_RADIUS=50.0, FENCE_MARGIN=5.0).set_out(modes.GUIDED)
    assert "inside the fence" in ship.autopilot.commands.go_to(*degrees(47.0, 0.0))
    assert ship.autopilot.commands.go_to(*degrees(43.0, 0.0)) == ""
    assert "inside the fence" in ship.autopilot.commands.go_to_local(0.0, 60.0)
