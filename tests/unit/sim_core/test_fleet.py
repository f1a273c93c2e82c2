"""Vessels of several models in one water: collisions in closed form, momentum, order, seeds, a fleet of one."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from vessels import FULL, froude_scaled

from sim_core import fleet as fleets
from sim_core import simulation as simulations
from sim_core.environment.current import ChannelCurrent, UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.fleet import Fleet, FleetState
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation
from sim_core.vessel.spec import AddedMass, Damping, DemiHull, HullSection, VesselSpec, Windage
from sim_core.world.contact import DAMPING_RATIO, STIFFNESS_NPM
from sim_core.world.hull_contact import close_pairs

WATER = Water()
SMALL = froude_scaled(FULL, 0.5)
RADIUS_M = 0.5
# Nothing of the water holds it back, and its axis goes through its centre of mass.
SLIDING = replace(
    FULL,
    name="sliding",
    hull=None,
    hulls=(
        DemiHull(length_m=2.3, keel_frd_m=(0.0, 0.0, RADIUS_M), section=HullSection(width_m=2 * RADIUS_M, depth_m=0.8)),
    ),
    added_mass=AddedMass(),
    damping_linear=Damping(),
    damping_quadratic=Damping(),
    wind=Windage(),
)
HEAVY = replace(SLIDING, name="heavy", mass_kg=226.0, inertia_kgm2=(46.0, 70.0, 112.0))


def weather(seed: int = 5) -> Environment:
    rng = np.random.default_rng(seed)
    return Environment(
        WATER,
        UniformCurrent(CurrentSpec(0.5, 90.0, 0.05, 60.0)),
        realise_waves(WaveSpec("jonswap", 0.2, 2.5, 90.0, spreading=10.0), WATER, rng),
        Wind(WindSpec(5.0, 270.0, 10.0, 120.0, GustSpec("ornstein-uhlenbeck", 1.5, 8.0))),
    )


def bytes_of(motion: Kinematics) -> bytes:
    return b"".join(getattr(motion, field.name).tobytes() for field in fields(motion))


def at_rest(fleet: Fleet, places: list[list[float]]) -> FleetState:
    return fleets.initial(fleet, np.array(places), np.zeros(len(places)), np.random.default_rng(1))


def under_way(fleet: Fleet, places: list[list[float]], yaws: list[float], speeds: list[float]) -> FleetState:
    """In still water, each going ahead; one batch a model, in the order of models."""
    state = fleets.initial(fleet, np.array(places), np.array(yaws), np.random.default_rng(1))
    batches = []
    for one, members in zip(state.batches, fleet.members, strict=True):
        yaw, speed = np.array(yaws)[members], np.array(speeds)[members]
        velocity = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(len(yaw))])
        motion = replace(one.vessel.motion, vel_ned_mps=velocity)
        batches.append(replace(one, vessel=replace(one.vessel, motion=motion)))
    return replace(state, batches=tuple(batches))


def sailed(fleet: Fleet, state: FleetState, seconds: float, throttle: float = 0.0) -> list[FleetState]:
    commands, rng = fleet.by_model([[throttle, throttle]] * len(fleet.names)), np.random.default_rng(1)
    states = [state]
    for _ in range(round(seconds / fleet.dt_s)):
        states.append(fleets.step(fleet, states[-1], commands, rng))
    return states


def momentum(fleet: Fleet, state: FleetState) -> np.ndarray:
    """North, east, and its moment about the local origin."""
    total = np.zeros(3)
    for number in range(len(fleet.names)):
        model, motion = fleet.of(number).vessel.model, fleets.kinematics_of(fleet, state, number)
        (north, east, _), (u, v, _) = motion.pos_ned_m[0], motion.vel_ned_mps[0]
        spin = model.inertia_kgm2[2] * motion.gyro_frd_radps[0, 2]
        total += [model.mass_kg * u, model.mass_kg * v, model.mass_kg * (north * v - east * u) + spin]
    return total


def energy_j(fleet: Fleet, state: FleetState) -> float:
    total = 0.0
    for number in range(len(fleet.names)):
        model, motion = fleet.of(number).vessel.model, fleets.kinematics_of(fleet, state, number)
        velocity, rate = motion.vel_ned_mps[0], motion.gyro_frd_radps[0]
        total += 0.5 * model.mass_kg * float(velocity @ velocity)
        total += 0.5 * float(np.array(model.inertia_kgm2) @ rate**2)
    return total


@pytest.mark.medium
def test_two_that_meet_head_on_part_as_a_spring_and_a_damper_let_them() -> None:
    """Impulse and restitution in closed form: Schwager and Poeschel 2007, eq 21."""
    fleet = Fleet.from_spec([SLIDING, HEAVY], Environment(), 5e-4, names=("light", "heavy"))
    states = sailed(fleet, under_way(fleet, [[0.0, 0.0], [2.32, 0.0]], [0.0, math.pi], [1.2, 0.8]), 0.2)
    masses = np.array([SLIDING.mass_kg, HEAVY.mass_kg])
    reduced = float(masses.prod() / masses.sum())
    own = math.sqrt(STIFFNESS_NPM / reduced)
    beta = DAMPING_RATIO * own
    omega = math.sqrt(own**2 - beta**2)
    restitution = math.exp(-beta / omega * (math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)))
    impulse = (1.0 + restitution) * reduced * 2.0
    after = [float(fleets.kinematics_of(fleet, states[-1], number).vel_ned_mps[0, 0]) for number in (0, 1)]
    assert after[1] - after[0] == pytest.approx(restitution * 2.0, rel=0.02)  # steps of first order
    assert after[0] == pytest.approx(1.2 - impulse / masses[0], rel=0.02)
    told = [
        sum(float(fleets.state_of(fleet, state, number).contacts.impulse_ns.sum()) for state in states)
        for number in (0, 1)
    ]
    assert told == pytest.approx([impulse, impulse], rel=0.01)
    touched = [state for state in states if len(fleets.state_of(fleet, state, 0).contacts)]
    first = fleets.state_of(fleet, touched[0], 0).contacts
    assert first.closing_mps == pytest.approx([2.0], rel=1e-3)
    assert first.what == ("heavy",)
    assert fleets.state_of(fleet, touched[0], 1).contacts.what == ("light",)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("places", "yaws", "speeds"),
    [
        ([[0.0, 0.0], [1.9, 0.9]], [0.0, -math.pi / 2], [2.0, 1.0]),  # from the side
        ([[0.0, 0.0], [0.2, 1.4]], [0.2, -0.2], [1.5, 1.5]),  # side by side, closing
        ([[0.0, 0.0], [2.6, 0.3]], [0.0, 2.6], [2.5, 2.5]),  # a glancing blow
    ],
)
def test_momentum_and_its_moment_stay_and_energy_does_not_grow(places, yaws, speeds) -> None:
    fleet = Fleet.from_spec([SLIDING, HEAVY], Environment(), 0.0025)
    states = sailed(fleet, under_way(fleet, places, yaws, speeds), 0.6)
    assert any(len(fleets.state_of(fleet, state, 0).contacts) for state in states)
    before = momentum(fleet, states[0])
    for state in states[1::10]:
        np.testing.assert_allclose(momentum(fleet, state), before, atol=1e-3 * np.abs(before).max())
    # What the springs hold is given back: only the end counts.
    assert not len(fleets.state_of(fleet, states[-1], 0).contacts)
    assert energy_j(fleet, states[-1]) < energy_j(fleet, states[0])


@pytest.mark.medium
def test_a_hull_does_not_get_in_between_two_others() -> None:
    """Catamarans bow to bow, shifted so that a hull of each is before the gap of the other."""
    fleet = Fleet.from_spec([FULL, FULL], Environment(), 0.0025)
    states = sailed(fleet, under_way(fleet, [[0.0, 0.0], [2.5, 0.6]], [0.0, math.pi], [1.0, 1.0]), 0.8)
    apart = [
        float(np.subtract(*(fleets.kinematics_of(fleet, state, number).pos_ned_m[0, 0] for number in (1, 0))))
        for state in states
    ]
    tips_m = 2.0 * 1.5 * 0.2  # by which they may overlap until tip meets beam, and what the springs give
    assert FULL.hull.length_m - tips_m - 0.1 < min(apart) < FULL.hull.length_m
    assert apart[-1] > min(apart)


@pytest.mark.medium
def test_what_two_feel_of_each_other_is_equal_and_opposite() -> None:
    fleet = Fleet.from_spec([FULL, SMALL, FULL], weather(), 0.0025, names=("a", "b", "c"))
    state = fleets.initial(
        fleet, np.array([[0.0, 0.0], [1.5, 0.8], [40.0, 0.0]]), np.zeros(3), np.random.default_rng(1)
    )
    state = sailed(fleet, state, 0.0025)[-1]
    one, other, third = (fleets.state_of(fleet, state, number).contacts for number in range(3))
    assert len(one) == len(other) > 0
    assert len(third) == 0
    np.testing.assert_array_equal(one.force_ned_n, -other.force_ned_n)
    np.testing.assert_array_equal(one.place_ned_m, other.place_ned_m)
    assert set(one.what) == {"b"}
    assert set(other.what) == {"a"}
    assert set(one.vessel.tolist()) == set(other.vessel.tolist()) == {0}


@pytest.mark.medium
def test_a_fleet_of_one_moves_exactly_like_the_vessel_alone() -> None:
    simulation = Simulation.from_spec(FULL, weather(), 0.0025)
    fleet = Fleet.from_spec([FULL], weather(), 0.0025)
    ours, theirs = np.random.default_rng(3), np.random.default_rng(3)
    alone = simulations.initial(simulation, np.array([[1.0, 2.0]]), np.array([0.3]), ours)
    together = fleets.initial(fleet, np.array([[1.0, 2.0]]), np.array([0.3]), theirs)
    for _ in range(200):
        alone = simulations.step(simulation, alone, np.array([[0.8, 0.6]]), ours)
        together = fleets.step(fleet, together, fleet.by_model([[0.8, 0.6]]), theirs)
    view = fleets.state_of(fleet, together, 0)
    assert bytes_of(view.vessel.motion) == bytes_of(alone.vessel.motion)
    assert view.wind_ned_mps.tobytes() == alone.wind_ned_mps.tobytes()
    assert view.time_ns == together.time_ns == alone.time_ns


PLACES = {"a": [0.0, 0.0], "b": [1.3, 0.9], "c": [8.0, 0.0], "d": [9.0, 0.8], "e": [9.5, -1.0], "f": [90.0, 5.0]}
MODELS = {"a": FULL, "b": SMALL, "c": FULL, "d": SMALL, "e": SLIDING, "f": FULL}


def fleet_of(names: str, steps: int = 60) -> dict[str, bytes]:
    """Where each is after a while in waves and gusts, some of them in a brawl."""
    fleet = Fleet.from_spec([MODELS[name] for name in names], weather(), 0.0025, names=tuple(names))
    rng = np.random.default_rng(2)
    state = fleets.initial(fleet, np.array([PLACES[name] for name in names]), np.zeros(len(names)), rng)
    commands = fleet.by_model([[0.5, 0.1 * ord(name) - 9.7] for name in names])
    for _ in range(steps):
        state = fleets.step(fleet, state, commands, rng)
    return {name: bytes_of(fleets.kinematics_of(fleet, state, number)) for number, name in enumerate(names)}


@pytest.mark.medium
def test_the_order_of_the_models_makes_no_difference_and_a_seed_repeats_a_fleet() -> None:
    first = fleet_of("abcdef")
    assert fleet_of("abcdef") == first
    for names in ("bdacef", "ebadcf"):
        assert fleet_of(names) == first


@pytest.mark.medium
def test_steps_at_once_end_early_where_hulls_touch() -> None:
    fleet = Fleet.from_spec([FULL, FULL], weather(), 0.0025)
    alone = together = at_rest(fleet, [[0.0, 0.0], [3.2, 0.0]])
    commands, ours, theirs = fleet.by_model([[0.6, 0.6], [0.0, 0.0]]), *(np.random.default_rng(3) for _ in range(2))
    lengths, touches = set(), 0
    while together.time_ns < 4_000_000_000:
        before_ns = together.time_ns
        together = fleets.step(fleet, together, commands, ours, max_steps=8)
        lengths.add((together.time_ns - before_ns) // fleet.dt_ns)
        while alone.time_ns < together.time_ns:
            alone = fleets.step(fleet, alone, commands, theirs)
            touched = sum(len(batch.contacts) for batch in alone.batches)
            assert not touched or alone.time_ns == together.time_ns
        touches += touched
        for number in range(2):
            of_alone = fleets.kinematics_of(fleet, alone, number)
            assert bytes_of(fleets.kinematics_of(fleet, together, number)) == bytes_of(of_alone)
        assert sum(len(batch.contacts) for batch in together.batches) == touched
    assert lengths == {1, 8}
    assert touches > 10


@pytest.mark.medium
def test_all_have_one_weather_and_each_its_own_waves() -> None:
    environment = weather()
    fleet = Fleet.from_spec([FULL] * 3 + [SMALL], environment, 0.0025)
    state = at_rest(fleet, [[0.0, 0.0], [60.0, 0.0], [0.0, 60.0], [60.0, 60.0]])
    views = [fleets.state_of(fleet, sailed(fleet, state, 0.05)[-1], number) for number in range(4)]
    winds = [view.wind_ned_mps[0] / environment.wind.share(view_height(fleet, n)) for n, view in enumerate(views)]
    np.testing.assert_allclose(winds, np.broadcast_to(winds[0], (4, 3)), rtol=1e-12)
    assert len({view.surface.point_elevation_m[0, 0] for view in views}) == 4
    assert all(view.current_ned_mps.shape == view.wind_ned_mps.shape == (1, 3) for view in views)
    narrow = ChannelCurrent(UniformCurrent(CurrentSpec(1.0, 0.0, channel_width_m=100.0)))
    fleet = Fleet.from_spec([FULL] * 3, Environment(current=narrow), 0.0025)
    state = fleets.initial(
        fleet, np.array([[0.0, 0.0], [0.0, 40.0], [0.0, 49.0]]), np.zeros(3), np.random.default_rng(1)
    )
    speeds = [float(fleets.state_of(fleet, state, number).current_ned_mps[0, 0]) for number in range(3)]
    assert speeds[0] > speeds[1] > speeds[2]


def view_height(fleet: Fleet, number: int) -> float:
    return fleet.of(number).vessel.model.wind.centre_height_m


def test_pairs_are_those_that_all_against_all_finds() -> None:
    rng = np.random.default_rng(7)
    for count in (1, 2, 30, 64):
        places, reach = rng.uniform(0.0, 40.0, (count, 2)), rng.uniform(0.2, 4.0, count)
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
        expected = {(a, b) for a in range(count) for b in range(a + 1, count) if apart[a, b] < reach[a] + reach[b]}
        one, other = close_pairs(places, reach)
        assert {(min(pair), max(pair)) for pair in zip(one.tolist(), other.tolist(), strict=True)} == expected
        assert len(one) == len(expected)


def test_a_vessel_that_is_nowhere_meets_nobody_and_the_others_still_meet() -> None:
    """NaN after a blow that no step can follow: without a warning, and without cells as many as an integer holds."""
    places = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0], [np.inf, 3.0], [90.0, 0.0]])
    with np.errstate(all="raise"):
        one, other = close_pairs(places, np.full(5, 2.0))
        assert [sorted(pair) for pair in zip(one.tolist(), other.tolist(), strict=True)] == [[0, 2]]
        assert not len(close_pairs(places[[0, 1]], np.full(2, 2.0))[0])


@pytest.mark.medium
def test_a_vessel_that_is_held_stays_while_its_sisters_go_on() -> None:
    fleet = Fleet.from_spec([FULL, FULL, SMALL], weather(), 0.0025)
    state = fleets.initial(
        fleet, np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 0.0]]), np.zeros(3), np.random.default_rng(1)
    )
    commands, rng = fleet.by_model([[0.5, 0.5]] * 3), np.random.default_rng(1)
    start = [fleets.kinematics_of(fleet, state, number) for number in range(3)]
    for _ in range(40):
        state = fleets.held(fleet, fleets.step(fleet, state, commands, rng), state, [1, 2])
    now = [fleets.kinematics_of(fleet, state, number) for number in range(3)]
    assert bytes_of(now[1]) == bytes_of(start[1])
    assert bytes_of(now[2]) == bytes_of(start[2])
    assert bytes_of(now[0]) != bytes_of(start[0])


@pytest.mark.parametrize(
    ("models", "names", "problem"),
    [
        ([], (), "no vessels"),
        ([FULL, FULL], ("a", "a"), "a different name"),
        ([FULL], ("a", "b"), "a different name"),
    ],
)
def test_impossible_fleets_are_refused(models: list[VesselSpec], names: tuple[str, ...], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Fleet.from_spec(models, Environment(), 0.0025, names=names)
