"""Contact: geometry by brute force, impact by Schwager and Poeschel, momentum, and a hull that runs into things."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from asv import ASV

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, Water
from sim_core.simulation import Simulation, SimulationState, initial, launch, step
from sim_core.world import contact
from sim_core.world.contact import (
    DAMPING_RATIO,
    FRICTION,
    STIFFNESS_NPM,
    Outline,
    pressed_n,
    wrench_frd,
)
from sim_core.world.debris import BodyKind, Launch, launched, make_body, no_debris
from sim_core.world.plan import Capsules, box_capsules, touches
from sim_core.world.river import FlatBed
from sim_core.world.waterway import OPEN_WATER, Waterway

BOOM_AT_M = 12.0
BOOM = Capsules(
    np.array([[-18.0, BOOM_AT_M], [-5.95, BOOM_AT_M], [6.05, BOOM_AT_M]]),
    np.array([[-6.05, BOOM_AT_M], [5.95, BOOM_AT_M], [18.0, BOOM_AT_M]]),
    np.full(3, 0.4),
    ("log boom",) * 3,
)
EASTWARD = math.pi / 2


def sailed(
    simulation: Simulation,
    seconds: float,
    throttle: float,
    heading_rad: float = EASTWARD,
    launches: tuple[Launch, ...] = (),
) -> list[SimulationState]:
    rng = np.random.default_rng(1)
    state = initial(simulation, np.zeros((1, 2)), np.array([heading_rad]), rng)
    for each in launches:
        state = launch(simulation, state, each)
    command = np.full((1, 2), throttle)
    states = [state]
    for _ in range(round(seconds / simulation.dt_s)):
        states.append(step(simulation, states[-1], command, rng))
    return states


def simulation_in(waterway: Waterway, current_mps: float = 0.0, dt_s: float = 0.0025) -> Simulation:
    environment = Environment(current=UniformCurrent(CurrentSpec(current_mps, 90.0)))
    return Simulation.from_spec(ASV, environment, dt_s, waterway)


@pytest.mark.medium
def test_capsules_touch_where_their_axes_come_nearest() -> None:
    """Against the least distance between points sampled densely along both axes."""
    rng = np.random.default_rng(4)
    share = np.linspace(0.0, 1.0, 401)[:, None]
    for _ in range(60):
        a0, a1, b0, b1 = rng.uniform(-2.0, 2.0, (4, 1, 2))
        a, b = Capsules(a0, a1, np.array([0.4]), ("",)), Capsules(b0, b1, np.array([0.3]), ("",))
        on_a, on_b = a0 + share * (a1 - a0), b0 + share * (b1 - b0)
        apart = np.linalg.norm(on_a[:, None] - on_b[None], axis=-1).min()
        found = touches(a, b, np.array([0]), np.array([0]))
        if apart < 0.05:
            continue  # axes that cross: deeper in each other than springs ever let them
        if apart > 0.7:
            assert not len(found.first)
        else:
            assert found.depth_m.max() == pytest.approx(0.7 - apart, abs=0.02)  # of the sampling
            deepest = int(found.depth_m.argmax())
            away = on_a[:, None] - found.place_ne_m[deepest]
            assert np.linalg.norm(found.normal_ne[deepest]) == pytest.approx(1.0)
            assert np.linalg.norm(away, axis=-1).min() <= 0.4 + 1e-6


def test_the_sides_of_a_box_are_where_they_should_be() -> None:
    sides = box_capsules("dam", (10.0, 20.0), (40.0, 6.0), math.radians(30.0))
    ahead, right = np.array([math.cos(math.pi / 6), 0.5]), np.array([-0.5, math.cos(math.pi / 6)])
    middle = np.array([10.0, 20.0])
    points = np.array([middle + 5.0 * right, middle + 22.0 * ahead, middle + 7.0 * ahead - 3.0 * right])
    assert sides.distance_m(points).min(axis=1) == pytest.approx([2.0, 2.0, 0.0])


@pytest.mark.medium
def test_the_rebound_is_that_of_a_spring_and_a_damper() -> None:
    """Two masses meet at 2 m/s. Restitution when only pressing counts: Schwager and Poeschel 2007, eq 21."""
    masses, dt_s = np.array([113.0, 60.0]), 1e-5
    reduced = np.array([masses.prod() / masses.sum()])
    place, velocity = np.array([-0.001, 0.0]), np.array([2.0, 0.0])
    while (place[0] < place[1] and velocity[0] > velocity[1]) or place[0] > place[1]:
        depth = np.array([place[0] - place[1]])
        force = 0.0
        if depth[0] > 0.0:
            force = float(
                pressed_n(np.array([[-1.0, 0.0]]), depth, np.array([[velocity[0] - velocity[1], 0.0]]), reduced, dt_s)[
                    0, 0
                ]
            )
        velocity = velocity + dt_s * np.array([force, -force]) / masses
        place = place + dt_s * velocity
    own = math.sqrt(STIFFNESS_NPM / reduced[0])
    beta = DAMPING_RATIO * own
    omega = math.sqrt(own**2 - beta**2)
    restitution = math.exp(-beta / omega * (math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)))
    assert (velocity[1] - velocity[0]) / 2.0 == pytest.approx(restitution, rel=0.01)  # first-order steps
    assert float(masses @ velocity) == pytest.approx(113.0 * 2.0, rel=1e-12)


def test_a_coarse_step_adds_no_energy() -> None:
    """Whatever the step: 20 ms, and from a twig to a great trunk."""
    for mass in (0.05, 5.0, 700.0, 5000.0):
        place, velocity, dt_s = -0.05, 1.5, 0.02
        for _ in range(500):
            force = 0.0
            if place > 0.0:
                force = float(
                    pressed_n(
                        np.array([[-1.0, 0.0]]), np.array([place]), np.array([[velocity, 0.0]]), np.array([mass]), dt_s
                    )[0, 0]
                )
            velocity += dt_s * force / mass
            place += dt_s * velocity
        assert -1.0 < velocity < -0.3


def test_friction_is_coulombs_and_never_turns_the_sliding_round() -> None:
    normal, depth, mass = np.array([[0.0, 1.0]]), np.array([0.02]), np.array([100.0])
    force = pressed_n(normal, depth, np.array([[2.0, 0.0]]), mass, 0.0025)[0]
    assert force[1] == pytest.approx(STIFFNESS_NPM * 0.02)
    assert -force[0] == pytest.approx(FRICTION * force[1], rel=0.03)  # 0.05 m/s of 2
    slow = pressed_n(normal, depth, np.array([[1e-4, 0.0]]), mass, 0.0025)[0]
    assert 0.0 < -slow[0] * 0.0025 / mass[0] < 1e-4


def test_nothing_pulls() -> None:
    away = pressed_n(np.array([[0.0, 1.0]]), np.array([0.001]), np.array([[0.0, 3.0]]), np.array([100.0]), 0.0025)
    assert away == pytest.approx(0.0)


def test_what_presses_on_the_hull_presses_back_on_the_body() -> None:
    simulation = simulation_in(Waterway(Capsules.joined(())))
    state = initial(simulation, np.zeros((1, 2)), np.array([0.4]), np.random.default_rng(1))
    state = launch(simulation, state, Launch(0, BodyKind.TRUNK, 1.2, 0.9, 1.0))
    motion, debris = state.vessel.motion, state.debris
    near = contact.find_near(Capsules.joined(()), None, simulation.outline, motion, debris)
    contacts, wrench, push = contact.compute_contacts(
        Capsules.joined(()), None, simulation.outline, motion, debris, near, 0.0025
    )
    assert len(contacts)
    assert push is not None
    assert wrench is not None
    assert contacts.force_ned_n[:, :2].sum(axis=0) == pytest.approx(-push.force_ne_n[0])
    place, force = contacts.place_ned_m, contacts.force_ned_n
    moment = float((place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0]).sum())
    north, east = debris.pos_ned_m[0, :2]
    back = push.moment_nm[0] + north * push.force_ne_n[0, 1] - east * push.force_ne_n[0, 0]
    assert moment == pytest.approx(-back)
    assert wrench[0, :3] == pytest.approx(motion.rot_ned_frd[0].T @ contacts.force_ned_n.sum(axis=0))


def test_what_gives_way_is_damped_by_the_mass_of_both() -> None:
    """An animal across the bow of a demi-hull: 2 m/s more press by 2 zeta sqrt(k m) 2, m = m1 m2 / (m1 + m2)."""
    simulation = simulation_in(OPEN_WATER)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), np.random.default_rng(1))
    bow_m, aside_m = 0.5 * ASV.hull.length_m, ASV.hull.centreline_m
    animal = make_body(BodyKind.ANIMAL)
    place = Launch(0, BodyKind.ANIMAL, bow_m + animal.radius_m - 0.02, aside_m, EASTWARD)
    debris = launched(no_debris(), place, np.zeros(3), 0.0)

    def pressed(speed_mps: float) -> float:
        motion = replace(state.vessel.motion, vel_ned_mps=np.array([[speed_mps, 0.0, 0.0]]))
        everything = Capsules.joined(()), None, simulation.outline, motion, debris
        contacts, _, _ = contact.compute_contacts(*everything, contact.find_near(*everything), 0.0025)
        assert contacts.what == ("animal 0",)
        return float(contacts.force_ned_n[0, 0])

    both_kg = ASV.mass_kg * animal.mass_kg / (ASV.mass_kg + animal.mass_kg)
    damping = 2.0 * DAMPING_RATIO * math.sqrt(STIFFNESS_NPM * both_kg)
    assert pressed(3.0) - pressed(1.0) == pytest.approx(-2.0 * damping, rel=1e-6)


def test_a_wrench_accelerates_as_the_mass_matrix_says() -> None:
    outline = Outline.from_spec(ASV)
    simulation = simulation_in(OPEN_WATER)
    state = initial(simulation, np.zeros((1, 2)), np.array([0.7]), np.random.default_rng(1))
    motion = state.vessel.motion
    place = motion.pos_ned_m + motion.rot_ned_frd[0] @ np.array([1.0, 0.5, 0.0])
    wrench = wrench_frd(motion, np.array([0]), place, (motion.rot_ned_frd[0] @ np.array([0.0, 10.0, 0.0]))[None])
    assert wrench[0] == pytest.approx([0.0, 10.0, 0.0, 0.0, 0.0, 10.0])
    assert outline.mass_kg == ASV.mass_kg


@pytest.mark.medium
def test_the_boom_stops_a_vessel_and_holds_it() -> None:
    states = sailed(simulation_in(Waterway(BOOM)), 9.0, 0.6)
    bow_m = np.array([state.vessel.motion.pos_ned_m[0, 1] for state in states]) + 0.5 * ASV.hull.length_m
    # Energy: 1/2 m v^2 = 1/2 k x^2 on two demi-hulls, with the added mass of surge and the thrust on top.
    thrust_n, speed = 0.6**2 * 500.0, max(float(state.vessel.motion.vel_ned_mps[0, 1]) for state in states)
    spring = 2.0 * STIFFNESS_NPM
    deepest = math.sqrt((ASV.mass_kg + ASV.added_mass.surge_kg) / spring) * speed + thrust_n / spring
    assert speed > 2.0
    assert 0.3 * deepest < bow_m.max() - (BOOM_AT_M - 0.4) <= deepest
    assert abs(float(states[-1].vessel.motion.vel_ned_mps[0, 1])) < 0.1
    first = next(state for state in states if len(state.contacts))
    assert set(first.contacts.what) == {"log boom"}
    assert first.contacts.closing_mps.max() == pytest.approx(speed, rel=0.02)


@pytest.mark.medium
def test_at_rest_on_the_boom_the_springs_carry_the_thrust() -> None:
    final = sailed(simulation_in(Waterway(BOOM), dt_s=0.005), 14.0, 0.6)[-1]
    thrust_n = 0.6**2 * 500.0  # as the square of the propellers' speed
    assert final.contacts.force_ned_n[:, 1].sum() == pytest.approx(-thrust_n, rel=0.02)


@pytest.mark.medium
def test_a_trunk_that_is_hit_takes_what_the_vessel_loses() -> None:
    hit = simulation_in(Waterway(Capsules.joined(())))
    states = sailed(hit, 6.0, 0.6, launches=(Launch(0, BodyKind.TRUNK, 0.0, 6.0, 0.0),))
    touched = [number for number, state in enumerate(states) if len(state.contacts)]
    before, after = states[touched[0] - 1], states[touched[0] + 40]
    impulse = sum(
        float(state.contacts.force_ned_n[:, 1].sum()) * hit.dt_s for state in states[touched[0] : touched[0] + 40]
    )
    masses = after.debris.figures.masses_kg[0]
    gained = float(masses[1] * (after.debris.vel_ned_mps[0, 1] - before.debris.vel_ned_mps[0, 1]))
    assert states[touched[0]].contacts.what[0] == "trunk 0"
    assert gained == pytest.approx(-impulse, rel=0.06)  # the water's drag in 0.1 s


@pytest.mark.medium
def test_a_vessel_runs_aground_and_is_carried() -> None:
    class Beach:
        def bed_down_m(self, north_east_m: np.ndarray) -> np.ndarray:
            return 2.0 - 0.25 * north_east_m[..., 1]

        def gradient(self, north_east_m: np.ndarray) -> np.ndarray:
            return np.broadcast_to([0.0, -0.25], north_east_m.shape)

    states = sailed(simulation_in(Waterway(Capsules.joined(()), Beach())), 10.0, 0.5)
    final = states[-1]
    assert set(final.contacts.what) == {"bank"}
    assert abs(float(final.vessel.motion.vel_ned_mps[0, 1])) < 0.05
    assert final.contacts.force_ned_n[:, 2].sum() < 0.0
    keel_m = ASV.hull.keel_below_cg_m
    assert final.vessel.motion.pos_ned_m[0, 2] + keel_m < 2.0 - 0.25 * float(final.vessel.motion.pos_ned_m[0, 1]) + 0.1


def test_where_there_is_nothing_to_touch_not_a_bit_differs() -> None:
    far = Waterway(BOOM, FlatBed(20.0))
    for one, other in zip(
        sailed(simulation_in(OPEN_WATER), 2.0, 0.5), sailed(simulation_in(far), 2.0, 0.5), strict=True
    ):
        assert one.vessel.motion.pos_ned_m.tobytes() == other.vessel.motion.pos_ned_m.tobytes()
        assert one.vessel.motion.quat_ned_frd.tobytes() == other.vessel.motion.quat_ned_frd.tobytes()


@pytest.mark.medium
def test_half_as_many_steps_end_in_the_same_place() -> None:
    """With a trunk between hull and boom; a first-order step of 5 ms at 3 m/s is 15 mm."""
    trunk = (Launch(0, BodyKind.TRUNK, 0.0, 10.5, 0.0),)
    fine, coarse = (
        sailed(simulation_in(Waterway(BOOM), dt_s=dt_s), 7.0, 0.6, launches=trunk)[-1] for dt_s in (0.0025, 0.005)
    )
    assert coarse.vessel.motion.pos_ned_m[0, :2] == pytest.approx(fine.vessel.motion.pos_ned_m[0, :2], abs=0.03)
    assert coarse.debris.pos_ned_m[0, :2] == pytest.approx(fine.debris.pos_ned_m[0, :2], abs=0.03)
    assert fine.debris.pos_ned_m[0, 1] < BOOM_AT_M - 0.4  # held before the boom


@pytest.mark.medium
def test_without_contact_a_vessel_passes_what_debris_does_not() -> None:
    seen = Waterway(BOOM, launches=(Launch(0, BodyKind.ANIMAL, 5.0, 11.0, EASTWARD),), contact=False)
    final = sailed(simulation_in(seen, 0.5), 8.0, 0.8)[-1]
    assert final.vessel.motion.pos_ned_m[0, 1] > BOOM_AT_M + 2.0
    assert final.debris.pos_ned_m[0, 1] < BOOM_AT_M


@pytest.mark.medium
def test_the_same_twice() -> None:
    runs = [
        sailed(simulation_in(Waterway(BOOM), 0.4, 0.005), 6.0, 0.6, 1.2, (Launch(0, BodyKind.BRANCH, 2.0, 6.0, 1.0),))
        for _ in "ab"
    ]
    assert runs[0][-1].vessel.motion.pos_ned_m.tobytes() == runs[1][-1].vessel.motion.pos_ned_m.tobytes()
    assert runs[0][-1].debris.pos_ned_m.tobytes() == runs[1][-1].debris.pos_ned_m.tobytes()


@pytest.mark.medium
def test_each_vessel_of_several_feels_its_own() -> None:
    simulation = simulation_in(Waterway(BOOM))
    rng = np.random.default_rng(1)
    places, headings = np.array([[0.0, 9.0], [0.0, -40.0], [3.0, 9.5]]), np.full(3, EASTWARD)
    state = initial(simulation, places, headings, rng)
    touched = set()
    for _ in range(1200):
        state = step(simulation, state, np.full((1, 2), 0.6), rng)
        touched |= set(state.contacts.vessel.tolist())
    assert touched == {0, 2}
    alone = initial(simulation, places[:1], headings[:1], rng)
    for _ in range(1200):
        alone = step(simulation, alone, np.full((1, 2), 0.6), rng)
    assert state.vessel.motion.pos_ned_m[0] == pytest.approx(alone.vessel.motion.pos_ned_m[0], abs=1e-9)


def test_what_drifts_floats_in_the_water_of_the_vessel() -> None:
    brackish = Environment(water=Water(density_kgpm3=1010.0))
    trunk = Launch(0, BodyKind.TRUNK, 30.0, 0.0)
    waterway = Waterway(Capsules.joined(()), launches=(trunk,))
    simulation, rng = Simulation.from_spec(ASV, brackish, 0.0025, waterway), np.random.default_rng(0)
    state = step(simulation, initial(simulation, np.zeros((1, 2)), np.zeros(1), rng), np.zeros((1, 2)), rng)
    state = launch(simulation, state, trunk)
    assert state.debris.bodies == (make_body(BodyKind.TRUNK, None, 1010.0),) * 2
