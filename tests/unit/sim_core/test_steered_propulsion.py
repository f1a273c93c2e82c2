"""Steered propellers against the lever rule, and the unsteered ones as they were."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from vessels import FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.propulsion import Propulsion, SteeredPropulsion, make_propulsion
from sim_core.vessel.spec import Propeller, SteeringGear

DT_S = 0.0025
GEAR = SteeringGear(max_angle_deg=30.0, rate_degps=60.0)
POD = Propeller((-0.9, 0.0, -0.55), 500.0, 300.0, 0.4, 0.6, GEAR)
STEERED = replace(FULL, propellers=(POD,))
STILL = (np.zeros((1, 6)), np.zeros((1, 3)))
PROPULSION = SteeredPropulsion.from_spec(STEERED, Water(), DT_S)


def wrench(speed: float, share: float) -> np.ndarray:
    return (np.concatenate(PROPULSION.terms(np.array([[speed, share]]), *STILL), axis=1) @ PROPULSION.wrench)[0]


@pytest.mark.parametrize(("speed", "thrust_n"), [(1.0, 500.0), (0.5, 125.0), (-1.0, -300.0)])
@pytest.mark.parametrize("share", [0.0, 0.4, -1.0])
def test_the_force_turns_with_the_gear(speed: float, thrust_n: float, share: float) -> None:
    """F = T (cos d, -sin d, 0) at (x, 0, z): N = -x T sin d, K = z T sin d, M = z T cos d."""
    delta = share * math.radians(30.0)
    force = wrench(speed, share)
    along, aside = thrust_n * math.cos(delta), -thrust_n * math.sin(delta)
    expected = [along, aside, 0.0, 0.55 * aside, -0.55 * along, -0.9 * aside]
    np.testing.assert_allclose(force, expected, atol=1e-9)


def test_the_gear_turns_at_its_rate_and_stops_at_its_stop() -> None:
    """30 degrees at 60 degrees a second: half a second."""
    drives = np.zeros((1, 2))
    for _ in range(100):
        drives = PROPULSION.spin(drives, np.array([[0.0, 1.0]]))
    assert drives[0, 1] == pytest.approx(0.5)
    for _ in range(200):
        drives = PROPULSION.spin(drives, np.array([[0.0, 7.0]]))
    assert drives[0, 1] == 1.0


def test_a_steering_command_to_starboard_turns_the_bow_there() -> None:
    simulation = Simulation.from_spec(STEERED, Environment(), DT_S)
    rng = np.random.default_rng(1)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    for _ in range(800):
        state = step(simulation, state, np.array([[0.5, 0.5]]), rng)
    assert state.vessel.motion.gyro_frd_radps[0, 2] > 0.1
    assert state.vessel.rotor_speed.shape == (1, 2)


def test_a_gear_held_amidships_changes_nothing() -> None:
    """Two propellers with gears at zero go like the two without: the same run to rounding."""
    geared = replace(FULL, propellers=tuple(replace(p, steering=GEAR) for p in FULL.propellers))
    places = []
    for model, command in ((FULL, [[0.6, 0.2]]), (geared, [[0.6, 0.2, 0.0, 0.0]])):
        simulation = Simulation.from_spec(model, Environment(), DT_S)
        rng = np.random.default_rng(1)
        state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
        for _ in range(400):
            state = step(simulation, state, np.array(command), rng)
        places.append(state.vessel.motion.pos_ned_m)
    np.testing.assert_allclose(places[0], places[1], rtol=1e-12)


def test_only_steered_vessels_pay_for_it() -> None:
    assert isinstance(make_propulsion(FULL, Water(), DT_S), Propulsion)
    assert isinstance(make_propulsion(STEERED, Water(), DT_S), SteeredPropulsion)
    mixed = replace(FULL, propellers=(FULL.propellers[0], replace(FULL.propellers[1], steering=GEAR)))
    assert (FULL.commands, STEERED.commands, mixed.commands) == (2, 2, 3)


def test_in_a_mixed_pair_only_the_one_with_a_gear_turns() -> None:
    mixed = replace(FULL, propellers=(FULL.propellers[0], replace(FULL.propellers[1], steering=GEAR)))
    propulsion = SteeredPropulsion.from_spec(mixed, Water(), DT_S)
    force = (np.concatenate(propulsion.terms(np.array([[1.0, 1.0, 1.0]]), *STILL), axis=1) @ propulsion.wrench)[0]
    assert force[0] == pytest.approx(250.0 + 250.0 * math.cos(math.radians(30.0)))
    assert force[1] == pytest.approx(-125.0)


@pytest.mark.parametrize(
    ("angle", "rate", "said"), [(0.0, 60.0, "max_angle_deg = 0.0"), (200.0, 60.0, "200.0 is too large")]
)
def test_a_gear_that_cannot_be_is_refused(angle: float, rate: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        SteeringGear(angle, rate)
