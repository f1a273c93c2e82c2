"""Rudders against Fujii's slope, momentum theory and the lever rule, ahead and astern."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from vessels import FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.propulsion import make_propulsion
from sim_core.vessel.spec import Propeller, Rudder, VesselSpec

Array = NDArray[np.float64]
WATER = Water()
DT_S = 0.0025
RUDDER = Rudder(position_frd_m=(-1.1, 0.0, 0.1), area_m2=0.03, aspect_ratio=1.5)
SCREW = Propeller((-0.9, 0.0, 0.1), 200.0, 120.0, medium="water", diameter_m=0.25)
FUJII = 6.13 * 1.5 / (1.5 + 2.25)


def vessel(*rudders: Rudder, screws: tuple[Propeller, ...] = (SCREW,)) -> VesselSpec:
    return replace(FULL, propellers=screws, rudders=rudders)


def rudder_wrench(model: VesselSpec, speed: float, share: float, nu: tuple[float, ...]) -> Array:
    """What the rudders add to the propellers."""
    propulsion = make_propulsion(model, WATER, DT_S)
    terms = propulsion.terms(
        np.array([[speed, *[share] * len(model.rudders)]]), np.array([nu], float), np.zeros((1, 3))
    )
    rudders = len(model.rudders)
    force: Array = (np.concatenate(terms[2:], axis=1) @ propulsion.wrench[-2 * rudders :])[0]
    return force


@pytest.mark.parametrize("angle_deg", [-20.0, -5.0, 5.0, 20.0])
def test_the_normal_force_has_fujiis_slope(angle_deg: float) -> None:
    """F_N = rho/2 A U^2 f sin(delta), lift its part across the flow, drag C_L^2 / (0.9 pi Lambda)."""
    force = rudder_wrench(vessel(RUDDER), 0.0, angle_deg / 35.0, (2.0, 0, 0, 0, 0, 0))
    pressure_n = 0.5 * WATER.density_kgpm3 * 0.03 * 4.0
    delta = math.radians(angle_deg)
    lift = FUJII * math.sin(delta) * math.cos(delta)
    assert force[1] == pytest.approx(-pressure_n * lift)
    assert force[0] == pytest.approx(-pressure_n * lift**2 / (0.9 * math.pi * 1.5))
    np.testing.assert_allclose(force[3:], np.cross(RUDDER.position_frd_m, force[:3]))
    assert np.sign(force[5]) == np.sign(angle_deg)


def test_astern_the_rudder_steers_the_other_way() -> None:
    ahead, astern = (rudder_wrench(vessel(RUDDER), 0.0, 0.4, (u, 0, 0, 0, 0, 0)) for u in (1.5, -1.5))
    np.testing.assert_allclose(astern[:2], -ahead[:2])


def test_drift_and_turning_meet_the_blade() -> None:
    """Amidships the angle of attack is the drift angle at the stock: v + x r over u."""
    nu = (2.0, 0.3, 0.0, 0.0, 0.0, 0.4)
    across = 0.3 - 1.1 * 0.4
    force = rudder_wrench(vessel(RUDDER), 0.0, 0.0, nu)
    normal_n = 0.5 * WATER.density_kgpm3 * 0.03 * math.hypot(2.0, across) * FUJII * across
    assert force[1] == pytest.approx(-normal_n, rel=0.01)  # C_N, but for the cosine of 4 degrees and the drag


def test_wake_slows_the_flow_outside_the_race() -> None:
    slow = rudder_wrench(vessel(replace(RUDDER, wake_fraction=0.4)), 0.0, 0.3, (2.0, 0, 0, 0, 0, 0))
    np.testing.assert_allclose(slow, rudder_wrench(vessel(RUDDER), 0.0, 0.3, (1.2, 0, 0, 0, 0, 0)))


@pytest.mark.parametrize("ahead_mps", [0.0, 1.0, 3.0])
def test_the_race_is_an_actuator_discs(ahead_mps: float) -> None:
    """Half of the speed is there at the disc; 0.2 m on, with a radius of 0.125, 0.5 (1 + 0.2 / 0.236) of it."""
    behind = replace(RUDDER, propeller=0)
    force = rudder_wrench(vessel(behind), 1.0, 0.2, (ahead_mps, 0, 0, 0, 0, 0))
    area_m2 = math.pi * 0.125**2
    far_mps = math.sqrt(ahead_mps**2 + 2 * 200.0 / (WATER.density_kgpm3 * area_m2)) - ahead_mps
    race_mps = ahead_mps + 0.5 * (1 + 0.2 / math.hypot(0.2, 0.125)) * far_mps
    np.testing.assert_allclose(force, rudder_wrench(vessel(RUDDER), 0.0, 0.2, (race_mps, 0, 0, 0, 0, 0)))


def test_a_rudder_far_behind_has_the_whole_race() -> None:
    """Momentum theory's limit: sqrt(V^2 + 2 T / (rho A))."""
    far = replace(RUDDER, position_frd_m=(-9.0, 0.0, 0.1))
    force = rudder_wrench(vessel(replace(far, propeller=0)), 1.0, 0.2, (1.0, 0, 0, 0, 0, 0))
    race_mps = math.sqrt(1.0 + 2 * 200.0 / (WATER.density_kgpm3 * math.pi * 0.125**2))
    np.testing.assert_allclose(force, rudder_wrench(vessel(far), 0.0, 0.2, (race_mps, 0, 0, 0, 0, 0)), rtol=1e-3)


def test_the_share_in_the_race() -> None:
    shares = [0.0, 0.6, 1.0]
    none, some, all_ = (
        rudder_wrench(vessel(replace(RUDDER, propeller=0, race_share=s)), 1.0, 0.2, (1.0, 0, 0, 0, 0, 0))
        for s in shares
    )
    np.testing.assert_allclose(none, rudder_wrench(vessel(RUDDER), 1.0, 0.2, (1.0, 0, 0, 0, 0, 0)))
    np.testing.assert_allclose(some, 0.4 * none + 0.6 * all_)


def test_a_propeller_going_astern_draws_the_water_past_its_rudder() -> None:
    """At rest the rudder then meets water from behind, and steers the other way, weakly."""
    behind = vessel(replace(RUDDER, propeller=0))
    ahead, astern = (rudder_wrench(behind, speed, 0.4, (0, 0, 0, 0, 0, 0)) for speed in (1.0, -1.0))
    assert ahead[5] > 0 > astern[5]
    assert abs(astern[5]) < 0.05 * ahead[5]


def test_a_stalled_rudder_is_a_plate() -> None:
    """At 60 degrees C_N = 1.2 (Hoerner 1965): 0.6 across and 1.04 along; attached it would be 1.83 sin(60)."""
    wide = replace(RUDDER, max_angle_deg=90.0, stall_deg=30.0)
    force = rudder_wrench(vessel(wide), 0.0, 60.0 / 90.0, (2.0, 0, 0, 0, 0, 0))
    pressure_n = 0.5 * WATER.density_kgpm3 * 0.03 * 4.0
    assert force[1] == pytest.approx(-pressure_n * 1.2 * math.cos(math.radians(60.0)))
    assert force[0] == pytest.approx(-pressure_n * 1.2 * math.sin(math.radians(60.0)))


def test_stall_comes_over_ten_degrees_without_a_step() -> None:
    propulsion = make_propulsion(vessel(replace(RUDDER, max_angle_deg=90.0, stall_deg=30.0)), WATER, DT_S)
    actuators = np.column_stack([np.zeros(361), np.linspace(0, 1, 361)])
    lift = -propulsion.terms(actuators, np.tile([2.0, 0, 0, 0, 0, 0], (361, 1)), np.zeros((361, 3)))[3][:, 0]
    assert 28.0 < 0.25 * int(lift.argmax()) < 33.0
    assert np.abs(np.diff(lift)).max() < 0.03 * lift.max()


def test_two_rudders_each_behind_its_own_screw() -> None:
    """One going ahead and one astern turn the vessel by the rudder of the first."""
    screws = tuple(replace(SCREW, position_frd_m=(-0.9, side, 0.1)) for side in (-0.4, 0.4))
    rudders = tuple(
        replace(RUDDER, position_frd_m=(-1.1, side, 0.1), propeller=number) for number, side in enumerate((-0.4, 0.4))
    )
    propulsion = make_propulsion(vessel(*rudders, screws=screws), WATER, DT_S)
    terms = propulsion.terms(np.array([[1.0, -1.0, 0.5, 0.5]]), np.zeros((1, 6)), np.zeros((1, 3)))
    aside_n = terms[3][0]
    assert -aside_n[0] > 20 * abs(aside_n[1])
    moment = (np.concatenate(terms[2:], axis=1) @ propulsion.wrench[4:])[0, 5]
    assert moment == pytest.approx(1.1 * -aside_n.sum() + 0.4 * (terms[2][0, 0] - terms[2][0, 1]))


def test_the_rudder_turns_at_its_rate_and_stops_at_its_stop() -> None:
    """35 degrees at 30 degrees a second take 1.17 s."""
    propulsion = make_propulsion(vessel(RUDDER), WATER, DT_S)
    actuators = np.zeros((1, 2))
    for _ in range(400):
        actuators = propulsion.spin(actuators, np.array([[0.0, -7.0]]))
    assert actuators[0, 1] == pytest.approx(-30.0 / 35.0)
    for _ in range(100):
        actuators = propulsion.spin(actuators, np.array([[0.0, -7.0]]))
    assert actuators[0, 1] == -1.0


@pytest.mark.parametrize(("throttle", "turns"), [(0.6, 1.0), (-0.6, -1.0)])
def test_a_vessel_answers_its_rudder_ahead_and_astern(throttle: float, turns: float) -> None:
    simulation = Simulation.from_spec(vessel(replace(RUDDER, propeller=0)), Environment(), 0.01)
    rng = np.random.default_rng(1)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    for _ in range(300):
        state = step(simulation, state, np.array([[throttle, 0.5]]), rng)
    assert turns * state.vessel.motion.gyro_frd_radps[0, 2] > 0.01
