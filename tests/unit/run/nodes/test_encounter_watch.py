"""Closest approach against the closed form of straight tracks, hulls against a dense sampling of their outlines."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_core.frames import Array
from xitl_cli.run.nodes.encounters import EncounterWatch, HullPlans, PairState

HULL = (np.array([[[-2.0, -0.8], [2.0, -0.8]], [[-2.0, 0.8], [2.0, 0.8]]]), np.array([0.2, 0.2]))
POINT = (np.zeros((1, 2, 2)), np.zeros(1))


def sail(
    places: Sequence[tuple[float, float]],
    velocities: Sequence[tuple[float, float]],
    seconds: float,
    too_close_m: float = 10.0,
    hull: tuple[Array, Array] = HULL,
) -> tuple[EncounterWatch, list[tuple[float, PairState]]]:
    """Straight on from places with velocities, bow ahead, looked at ten times a second."""
    start, rate = np.array(places), np.array(velocities)
    yaw = np.arctan2(rate[:, 1], rate[:, 0])
    names = [f"v{number}" for number in range(len(start))]
    watch = EncounterWatch(names, HullPlans.from_capsules([hull] * len(start)), too_close_m)
    said = []
    for step in range(round(seconds * 10) + 1):
        now_s = step / 10
        said += [(now_s, state) for state in watch.update(now_s, start + now_s * rate, rate, yaw)]
    return watch, said


@pytest.mark.medium
@settings(max_examples=8, deadline=None)
@given(
    place=st.tuples(st.floats(-80, 80), st.floats(-80, 80)),
    velocity=st.tuples(st.floats(-4, 4), st.floats(-4, 4)),
)
def test_closest_approach_is_the_closed_form(place: tuple[float, float], velocity: tuple[float, float]) -> None:
    """t* = -r.v / v.v, limited to the time that was sailed; d = |r + v t*|."""
    watch, _ = sail([(0.0, 0.0), place], [(3.0, 0.0), velocity], 30.0)
    r, v = np.array(place), np.array(velocity) - np.array([3.0, 0.0])
    at_s = min(max(-float(r @ v) / max(float(v @ v), 1e-12), 0.0), 30.0)
    found = watch.approach(0)
    assert found.distance_m == pytest.approx(float(np.hypot(*(r + v * at_s))), abs=1e-6)
    if np.hypot(*v) > 0.01:
        assert found.at_s == pytest.approx(at_s, abs=1e-3)


@pytest.mark.medium
def test_a_crossing_is_told_from_its_beginning_to_its_end() -> None:
    """Both are 90 m from the crossing; 1 comes from starboard of 0, which gives way, and is there 2 s later."""
    watch, said = sail([(-90.0, 0.0), (0.0, 96.0)], [(3.0, 0.0), (0.0, -3.0)], 60.0)
    events = [(now_s, state.event) for now_s, state in said if state.event is not None]
    assert [event for _, event in events] == ["begins", "too close", "passes"]
    assert events[0][0] == pytest.approx(3.0)  # plotted for 3 s from the first look on
    found = watch.approach(0)
    assert found.geometry is not None
    assert (found.geometry.geometry, found.gives_way, found.stands_on) == ("crossing", ("v0",), "v1")
    assert (found.too_close, found.detected_s) == (True, pytest.approx(3.0))
    assert found.distance_m == pytest.approx(6.0 / math.sqrt(2.0))
    assert found.at_s == pytest.approx(31.0)
    states = [state for now_s, state in said if abs(now_s - 11.0) < 0.01]
    assert [(round(one.predicted_m, 6), round(one.predicted_s, 6)) for one in states] == [
        (round(6.0 / math.sqrt(2.0), 6), 20.0)
    ]


@pytest.mark.medium
def test_hulls_are_nearer_to_each_other_than_places() -> None:
    """Meeting abreast, 5 m between the middles: the outer sides lie 0.8 + 0.2 m from them."""
    watch, _ = sail([(0.0, 0.0), (60.0, 5.0)], [(2.0, 0.0), (-2.0, 0.0)], 30.0)
    found = watch.approach(0)
    assert (found.distance_m, found.hull_distance_m) == (pytest.approx(5.0), pytest.approx(3.0))
    assert found.hull_at_s <= found.at_s == pytest.approx(15.0)  # bows come beside each other before the middles do


def test_hulls_that_touch_are_at_no_distance() -> None:
    watch, _ = sail([(0.0, 0.0), (60.0, 1.5)], [(2.0, 0.0), (-2.0, 0.0)], 30.0)
    assert watch.approach(0).hull_distance_m == 0.0


@pytest.mark.medium
@settings(max_examples=20, deadline=None)
@given(
    place=st.tuples(st.floats(-6, 6), st.floats(-6, 6)),
    yaws=st.tuples(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi)),
)
def test_hull_distance_against_points_along_the_axes(place: tuple[float, float], yaws: tuple[float, float]) -> None:
    """201 points on each axis, 0.02 m apart: their nearest two are at most that much farther than the axes."""
    plans = HullPlans.from_capsules([HULL, HULL])
    first, second = np.array([0]), np.array([1])
    found = float(
        plans.distance_m(
            first, second, (np.zeros((1, 2)), np.array([place])), (np.array(yaws[:1]), np.array(yaws[1:]))
        )[0]
    )
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    clouds = []
    for yaw, at in zip(yaws, ((0.0, 0.0), place), strict=True):
        turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
        points = np.concatenate([start + shares * (end - start) for start, end in HULL[0]])
        clouds.append(points @ turn.T + np.array(at))
    dense = float(np.min(np.linalg.norm(clouds[0][:, None] - clouds[1][None], axis=2)))
    expected = max(dense - 0.4, 0.0)
    assert expected - 0.0201 <= found <= expected + 1e-9


def test_those_who_keep_station_or_part_have_no_encounter() -> None:
    _, said = sail([(0.0, 0.0), (-15.0, 0.0), (0.0, 30.0)], [(3.0, 0.0), (3.0, 0.0), (0.0, 3.0)], 30.0)
    assert said == []


@pytest.mark.medium
def test_overtaking_stays_overtaking_when_she_is_abeam() -> None:
    """Rule 13 (d): what is abeam later has begun astern."""
    watch, said = sail([(0.0, 0.0), (-60.0, 8.0)], [(1.0, 0.0), (4.0, 0.0)], 40.0)
    found = watch.approach(0)
    assert found.geometry is not None
    assert (found.geometry.geometry, found.gives_way, found.stands_on) == ("overtaking", ("v1",), "v0")
    assert [state.event for _, state in said if state.event] == ["begins", "too close", "passes"]


def test_every_pair_of_many_is_told_by_its_names() -> None:
    places = [(0.0, 40.0 * number) for number in range(6)]
    watch, _ = sail(places, [(2.0, 0.0)] * 6, 1.0, hull=POINT)
    found = watch.approaches()
    assert len(found) == 15
    for one in found:
        apart = 40.0 * abs(int(one.second[1:]) - int(one.first[1:]))
        assert one.distance_m == one.hull_distance_m == pytest.approx(apart)


def test_hulls_of_different_number_stand_side_by_side() -> None:
    plans = HullPlans.from_capsules([HULL, POINT])
    assert plans.axes_frd_m.shape == (2, 2, 2, 2)
    assert plans.reach_m.tolist() == [pytest.approx(math.hypot(2.0, 0.8) + 0.2), 0.0]
