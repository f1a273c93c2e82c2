"""Faults of actuators and battery against closed forms and against the healthy vessel under the equal command."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from vessels import FULL

from sim_core import fleet as fleets
from sim_core import simulation as simulations
from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, Water, WindSpec
from sim_core.environment.waves import FLAT_WATER
from sim_core.environment.wind import Wind
from sim_core.fleet import Fleet
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.condition import ActuatorFault, BatteryDamage, make_condition
from sim_core.vessel.spec import BatterySpec, Propeller, SteeringGear, VesselSpec

BATTERY = BatterySpec(
    cells=4, full_voltage_v=16.0, empty_voltage_v=12.0, capacity_ah=10.0, resistance_ohm=0.1, full_current_a=20.0
)
POWERED = replace(FULL, battery=BATTERY)
STEERED = replace(
    FULL, propellers=(Propeller((-1.1, 0.0, -0.55), 500.0, 300.0, 0.4, 0.6, steering=SteeringGear(45.0, 90.0)),)
)
DT_S = 0.005
RNG = np.random.default_rng(1)


def still() -> Environment:
    return Environment(Water(), UniformCurrent(CurrentSpec()), FLAT_WATER, Wind(WindSpec()))


def sailed(
    model: VesselSpec,
    command: list[float],
    steps: int,
    actuators: list[ActuatorFault] | None = None,
    batteries: list[BatteryDamage] | None = None,
) -> SimulationState:
    simulation = Simulation.from_spec(model, still(), DT_S)
    state = simulations.initial(simulation, np.zeros((1, 2)), np.zeros(1), RNG)
    condition = make_condition(model, actuators or [], batteries or [])
    state = simulations.with_condition(simulation, state, condition)
    for _ in range(steps):
        state = simulations.step(simulation, state, np.array([command]), RNG)
    return state


def bytes_of(motion: Kinematics) -> bytes:
    return b"".join(getattr(motion, field.name).tobytes() for field in fields(motion))


def test_a_propeller_that_lost_thrust_turns_as_told_and_pushes_by_the_share_that_is_left() -> None:
    weak = replace(FULL.propellers[0], max_thrust_n=150.0, max_reverse_thrust_n=90.0)
    expected = sailed(replace(FULL, propellers=(weak, FULL.propellers[1])), [0.8, 0.8], 400)
    state = sailed(FULL, [0.8, 0.8], 400, [ActuatorFault("propeller 0", thrust_loss=0.4)])
    assert state.vessel.rotor_speed == pytest.approx(expected.vessel.rotor_speed)
    assert state.vessel.motion.pos_ned_m == pytest.approx(expected.vessel.motion.pos_ned_m, abs=1e-9)
    assert state.vessel.motion.gyro_frd_radps[0, 2] < -0.01  # to port, where the thrust is missing


def test_a_reversed_propeller_is_a_healthy_one_under_the_opposite_command() -> None:
    state = sailed(FULL, [0.7, 0.3], 200, [ActuatorFault("propeller 1", reversed=True)])
    assert bytes_of(state.vessel.motion) == bytes_of(sailed(FULL, [0.7, -0.3], 200).vessel.motion)


def test_a_stuck_propeller_is_a_healthy_one_under_a_constant_command() -> None:
    state = sailed(FULL, [-1.0, 0.3], 200, [ActuatorFault("propeller 0", held_at=0.5)])
    assert bytes_of(state.vessel.motion) == bytes_of(sailed(FULL, [0.5, 0.3], 200).vessel.motion)


def test_a_gear_turns_to_where_it_jams_at_its_rate_and_stays() -> None:
    jam = [ActuatorFault("steering 0", held_at=0.5)]
    assert sailed(STEERED, [0.5, -1.0], 10, jam).vessel.rotor_speed[0, 1] == pytest.approx(10 * DT_S * 90.0 / 45.0)
    assert sailed(STEERED, [0.5, -1.0], 400, jam).vessel.rotor_speed[0, 1] == pytest.approx(0.5)


def test_an_actuator_that_the_vessel_does_not_have_is_refused() -> None:
    with pytest.raises(ValueError, match="asv-full has no 'rudder 0'; use propeller 0, propeller 1"):
        make_condition(FULL, [ActuatorFault("rudder 0")], [])


@pytest.mark.medium
def test_a_healthy_battery_changes_no_motion_and_obeys_ohm_s_law() -> None:
    state = sailed(POWERED, [1.0, 0.5], 2000)
    assert bytes_of(state.vessel.motion) == bytes_of(sailed(FULL, [1.0, 0.5], 2000).vessel.motion)
    battery = state.vessel.battery
    assert battery is not None
    current_a = 20.0 * (0.5 * 1.0**3 + 0.5 * 0.5**3)
    used_ah = float(battery.used_as[0]) / 3600.0
    assert float(battery.current_a[0]) == pytest.approx(current_a, rel=1e-6)
    assert used_ah == pytest.approx(current_a * 2000 * DT_S / 3600.0, rel=0.1)  # less while they speed up
    assert float(battery.voltage_v[0]) == pytest.approx(16.0 - 4.0 * used_ah / 10.0 - 0.1 * current_a, rel=1e-9)


@pytest.mark.parametrize(
    ("fault", "drop_v"),
    [
        (BatteryDamage(failed_cells=1), lambda current_a, open_v: open_v / 4.0),
        (BatteryDamage(voltage_drop_v=2.0), lambda current_a, open_v: 2.0),
        (BatteryDamage(added_resistance_ohm=0.2), lambda current_a, open_v: 0.2 * current_a),
    ],
)
def test_a_battery_fault_lowers_the_voltage_and_the_speed_in_proportion(fault: BatteryDamage, drop_v: object) -> None:
    state = sailed(POWERED, [1.0, 1.0], 1200, batteries=[fault])
    battery, speed = state.vessel.battery, float(state.vessel.rotor_speed[0, 0])
    assert battery is not None
    assert callable(drop_v)
    current_a = float(battery.current_a[0])
    open_v = 16.0 - 4.0 * float(battery.used_as[0]) / 36000.0
    healthy_v = open_v - 0.1 * current_a
    assert current_a == pytest.approx(20.0 * speed**3, rel=1e-4)
    assert float(battery.voltage_v[0]) == pytest.approx(healthy_v - drop_v(current_a, open_v), rel=1e-4)
    assert speed == pytest.approx(float(battery.voltage_v[0]) / healthy_v, rel=1e-3)


def test_the_fault_of_one_vessel_of_a_fleet_leaves_the_other_alone() -> None:
    fleet = Fleet.from_spec([POWERED, POWERED], still(), DT_S)
    places, command = np.array([[0.0, 0.0], [0.0, 100.0]]), fleet.by_model([[0.6, 0.4], [0.6, 0.4]])
    clean = faulty = fleets.initial(fleet, places, np.zeros(2), RNG)
    condition = make_condition(POWERED, [ActuatorFault("propeller 1", reversed=True)], [])
    faulty = fleets.with_condition(fleet, faulty, 0, condition)
    for _ in range(100):
        clean, faulty = (fleets.step(fleet, state, command, RNG) for state in (clean, faulty))
    first, second = (fleets.kinematics_of(fleet, faulty, number) for number in (0, 1))
    assert bytes_of(second) == bytes_of(fleets.kinematics_of(fleet, clean, 1))
    assert first.gyro_frd_radps[0, 2] > 2.0 * second.gyro_frd_radps[0, 2] > 0.0
    mended = fleets.with_condition(fleet, faulty, 0, None)
    after = fleets.step(fleet, mended, command, RNG)
    assert after.batches[0].vessel.rotor_speed[0, 1] > faulty.batches[0].vessel.rotor_speed[0, 1]
