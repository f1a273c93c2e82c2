"""Debris that is to meet the vessel: it is where it should be when the vessel gets there."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.environment.spec import Water
from sim_core.world.debris import BodyKind, Launch, make_body
from sim_core.world.plan import Capsules
from sim_core.world.river import FlatBed
from sim_core.world.waterway import Waterway
from xitl_cli.profile.schema.world import EncountersSpec as Keys
from xitl_cli.run.world.encounters import DebrisEncounter, DebrisEncounters, MissionLegs, draw_encounters

PLACES = ((0.0, 0.0), (100.0, 0.0), (100.0, 80.0))
SPEED_MPS, STEP_S, LATE_S = 2.5, 0.02, 40.0
OPEN = Waterway(Capsules.joined(()))
WATER = Water(level_m=0.0)


def current(north_mps: float, east_mps: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda places: np.array([[north_mps, east_mps, 0.0]])


def sailed(encounters: DebrisEncounters, legs: MissionLegs, begun_s: float = 0.0) -> list[tuple[float, Launch]]:
    """Along the legs at the mission's speed: how far, and what is launched there."""
    launches = []
    for number in range(int(legs.length_m / SPEED_MPS / STEP_S)):
        along_m = number * STEP_S * SPEED_MPS
        now_ns = round((begun_s + number * STEP_S) * 1e9)
        north, east = legs.place(along_m, 0.0).tolist()
        for launch in encounters.due(now_ns, (north, east), 0 if along_m < 100.0 else 1):
            launches.append((along_m, launch))
    return launches


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (0.4, 0.6), (-0.8, 0.1)])
def test_it_drifts_onto_the_leg_as_the_vessel_gets_there(velocity: tuple[float, float]) -> None:
    legs = MissionLegs(PLACES)
    wanted = draw_encounters(Keys(count=6, off_m=0.5), legs.length_m, default_rng(3))
    launches = sailed(DebrisEncounters(wanted, legs, SPEED_MPS, current(*velocity), OPEN, WATER), legs)
    assert len(launches) == 6
    for encounter, (along_m, launch) in zip(wanted, launches, strict=True):
        left_s = (encounter.along_m - along_m) / SPEED_MPS
        swim = make_body(launch.kind).swim_mps * np.array([math.cos(launch.heading_rad), math.sin(launch.heading_rad)])
        there = np.array([launch.north_m, launch.east_m]) + left_s * (np.array(velocity) + swim)
        met = legs.place(encounter.along_m, 0.0)
        assert np.hypot(*(there - met)) == pytest.approx(abs(encounter.right_m), abs=1e-6)
        assert abs(encounter.right_m) <= 0.5
        assert 39.9 <= encounter.along_m - along_m <= 60.0


def test_the_seed_alone_draws_them() -> None:
    keys = Keys(count=20)
    assert draw_encounters(keys, 400.0, default_rng(1)) == draw_encounters(keys, 400.0, default_rng(1))
    assert draw_encounters(keys, 400.0, default_rng(1)) != draw_encounters(keys, 400.0, default_rng(2))


def test_they_are_spread_over_the_way() -> None:
    along = np.array([each.along_m for each in draw_encounters(Keys(count=20), 400.0, default_rng(5))])
    share_m = (400.0 - 60.0) / 20
    assert np.diff(along).min() >= 0.4 * share_m - 1e-9
    assert along[0] >= 60.0
    assert along[-1] <= 400.0


def test_it_is_launched_nearer_where_something_stands_in_its_way() -> None:
    """The current comes from a boom 6 m off: what would start beyond it starts on this side."""
    wall = Capsules(np.array([[-50.0, -6.0]]), np.array([[200.0, -6.0]]), np.array([0.4]), ("log boom",))
    legs = MissionLegs(PLACES)
    one = DebrisEncounter(50.0, 50.0, 0.0, BodyKind.ANIMAL, 1.2, 0.0)
    met = DebrisEncounters([one], legs, SPEED_MPS, current(0.0, 0.5), Waterway(wall), WATER)
    (launch,) = met.due(0, (0.0, 0.0), 0)
    assert -5.0 < launch.east_m < -3.0  # clear of it by half a metre and the animal's own size
    assert met.no_room == 0


def test_it_is_left_out_where_there_is_no_room() -> None:
    wall = Capsules(np.array([[50.0, -20.0]]), np.array([[50.0, 20.0]]), np.array([2.0]), ("dam",))
    met = DebrisEncounters(
        [DebrisEncounter(50.0, 50.0, 0.0, BodyKind.TRUNK, 5.0, 0.0)],
        MissionLegs(PLACES),
        SPEED_MPS,
        current(0.0, 0.0),
        Waterway(wall),
        WATER,
    )
    assert met.due(0, (0.0, 0.0), 0) == []
    assert met.no_room == 1


def test_a_low_tide_leaves_no_room() -> None:
    """A trunk that floats above a bed at 1.5 m does not at 1.2 m below the mean level."""
    trunk = DebrisEncounter(50.0, 50.0, 0.0, BodyKind.TRUNK, 5.0, 0.0)
    river = Waterway(Capsules.joined(()), FlatBed(1.5))
    for height_m, count in ((0.0, 1), (-1.2, 0)):
        met = DebrisEncounters(
            [trunk], MissionLegs(PLACES), SPEED_MPS, current(0.0, 0.0), river, WATER, lambda height_m=height_m: height_m
        )
        assert len(met.due(0, (0.0, 0.0), 0)) == count
        assert met.afloat(0.0, 0.0)


def test_nothing_comes_while_the_vessel_heads_nowhere_or_there_is_none() -> None:
    legs = MissionLegs(PLACES)
    met = DebrisEncounters(
        draw_encounters(Keys(count=3), legs.length_m, default_rng(1)), legs, SPEED_MPS, current(0.0, 0.0), OPEN, WATER
    )
    assert met.due(0, (99.0, 0.0), None) == []
    assert DebrisEncounters((), legs, SPEED_MPS, current(0.0, 0.0), OPEN, WATER).due(0, (99.0, 0.0), 0) == []


@pytest.mark.medium
def test_a_vessel_that_is_late_meets_the_same() -> None:
    legs = MissionLegs(PLACES)
    wanted = draw_encounters(Keys(count=5), legs.length_m, default_rng(9))
    punctual, late = (
        sailed(DebrisEncounters(wanted, legs, SPEED_MPS, current(0.3, 0.0), OPEN, WATER), legs, begun_s)
        for begun_s in (0.0, LATE_S)
    )
    assert len(punctual) == 5
    for (along_m, one), (late_along_m, other) in zip(punctual, late, strict=True):
        assert (late_along_m, replace(other, at_ns=one.at_ns)) == (along_m, one)
        assert other.at_ns - one.at_ns == LATE_S * 1e9
