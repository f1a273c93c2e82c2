"""The compiled step against the same step in numpy, for every shipped vessel."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel import needs_kernel

from sim_core.environment.environment import Environment
from sim_core.environment.spec import EnvironmentSpec, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.tide_spec import ConstituentSpec, TideSpec
from sim_core.environment.waves import realise_waves
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.motion import Influences, MotionStep, Moved, move
from sim_core.simulation import Simulation, SimulationState, initial, step
from sim_core.vessel.condition import ActuatorFault, BatteryDamage, make_condition
from sim_core.vessel.spec import SideForceAstern
from sim_core.vessel.vessel import VesselState, at_rest
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.catalogue import shipped_profiles

pytestmark = needs_kernel
VEHICLES = [name for name in shipped_profiles() if name.startswith("vehicles/")]
SEAS = {
    "flat": WaveSpec(),
    "regular": WaveSpec("regular", 0.3, 3.0, 40.0),
    "random": WaveSpec("jonswap", 0.25, 2.2, 200.0, spreading=8.0),
}
TOLERANCE = 1e-9


@cache
def simulation(vehicle: str, sea: str) -> Simulation:
    model, water = load_profile(vehicle).vehicle, Water()
    assert model is not None
    waves = realise_waves(SEAS[sea], water, np.random.default_rng(4))
    return Simulation.from_spec(model, Environment(water=water, waves=waves), 0.0025)


def any_state(simulated: Simulation, draw: np.random.Generator, vessels: int) -> VesselState:
    """Return vessels anywhere near the surface, with speeds beyond those of a mission."""
    vessel = simulated.vessel
    state = at_rest(vessel, draw.uniform(-500.0, 500.0, (vessels, 2)), np.zeros(vessels))
    motion = state.motion
    quat = euler_to_quat(draw.uniform((-0.6, -0.6, -3.1), (0.6, 0.6, 3.1), (vessels, 3)))
    motion = replace(
        motion,
        pos_ned_m=motion.pos_ned_m + draw.normal(0.0, 0.2, (vessels, 3)) * [0.0, 0.0, 1.0],
        vel_ned_mps=draw.normal(0.0, 2.0, (vessels, 3)),
        quat_ned_frd=quat,
        rot_ned_frd=quat_to_matrix(quat),
        gyro_frd_radps=draw.normal(0.0, 0.7, (vessels, 3)),
    )
    battery = state.battery
    if battery is not None:
        battery = replace(battery, used_as=draw.uniform(0.0, 3e5, vessels))
    commands = vessel.model.commands
    return VesselState(
        motion,
        draw.uniform(-1.0, 1.0, (vessels, commands)),
        draw.normal(0.0, 0.01, (vessels, 6)),
        None,
        battery,
    )


def any_influences(simulated: Simulation, draw: np.random.Generator, vessels: int) -> Influences:
    def sometimes(values: np.ndarray) -> np.ndarray | None:
        return values if draw.random() < 0.5 else None

    return Influences(
        time_s=draw.uniform(0.0, 20_000.0),
        tide_m=draw.uniform(-2.0, 2.0),
        current_ned_mps=draw.normal(0.0, 1.0, (vessels, 3)),
        wind_ned_mps=draw.normal(0.0, 10.0, (1, 3)),
        drift_frd_n=sometimes(draw.normal(0.0, 20.0, (vessels, 2))),
        command=draw.uniform(-1.5, 1.5, (vessels, simulated.vessel.model.commands)),
        wrench_frd=sometimes(draw.normal(0.0, 300.0, (vessels, 6))),
    )


def any_condition(simulated: Simulation, draw: np.random.Generator) -> Any:
    if draw.random() < 0.5:
        return None
    model = simulated.vessel.model
    name = str(draw.choice(model.command_names))
    held = None if draw.random() < 0.5 else float(draw.uniform(-1.0, 1.0))
    faults = [ActuatorFault(name, float(draw.random()), held, bool(draw.random() < 0.5))]
    return make_condition(model, faults, [BatteryDamage(0.05, 1, 2.0)])


def arrays_of(moved: Moved) -> dict[str, np.ndarray]:
    motion = moved.vessel.motion
    values = {field.name: getattr(motion, field.name) for field in fields(motion)}
    values |= {"rotor": moved.vessel.rotor_speed, "half_change": moved.vessel.half_change, "drift": moved.drift_frd_n}
    values |= {"elevation": moved.surface.point_elevation_m, "over_hull": moved.surface.over_hull}
    if moved.vessel.battery is not None:
        values |= {
            f"battery {field.name}": getattr(moved.vessel.battery, field.name) for field in fields(moved.vessel.battery)
        }
    return values


def assert_same(compiled: Moved, reference: Moved) -> None:
    wanted = arrays_of(reference)
    for name, values in arrays_of(compiled).items():
        scale = max(float(np.abs(wanted[name]).max(initial=0.0)), 1e-3)
        assert values.shape == wanted[name].shape, name
        assert np.abs(values - wanted[name]).max(initial=0.0) <= TOLERANCE * scale, name


@pytest.mark.medium
@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.parametrize("vehicle", VEHICLES)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), vessels=st.sampled_from([1, 2, 5]))
def test_a_compiled_step_is_the_step_of_numpy(vehicle: str, sea: str, seed: int, vessels: int) -> None:
    simulated, draw = simulation(vehicle, sea), np.random.default_rng(seed)
    state, influences = any_state(simulated, draw, vessels), any_influences(simulated, draw, vessels)
    if vessels == 1:
        state = replace(state, condition=any_condition(simulated, draw))
    compiled = simulated.motion.step(state, influences)
    assert simulated.motion.why_numpy is None
    assert compiled.vessel.packed is not None
    reference = move(simulated.vessel, simulated.hull_waves, state, influences)
    assert_same(compiled, reference)
    # The next step begins from the packed state
    assert_same(
        simulated.motion.step(compiled.vessel, influences),
        move(simulated.vessel, simulated.hull_waves, compiled.vessel, influences),
    )


@pytest.mark.medium
@pytest.mark.medium
def test_a_compiled_step_of_a_screw_astern() -> None:
    model = load_profile("vehicles/kvlcc2-l7").vehicle
    assert model is not None
    curve = model.propellers[0].open_water
    assert curve is not None
    table = replace(curve, reverse_share=1.0, astern_advance_ratio=(-0.3, 0.5), astern_thrust_coefficient=(0.3, 0.0))
    side = SideForceAstern(advance_ratio=(-0.8, -0.3, 0.0), coefficient=(0.0, -0.1, -0.02), position_x_m=-2.8)
    screw = replace(model.propellers[0], open_water=table, side_force_astern=side)
    simulated = Simulation.from_spec(replace(model, propellers=(screw,)), Environment(), 0.0025)
    draw = np.random.default_rng(3)
    for _ in range(20):
        state, influences = any_state(simulated, draw, 2), any_influences(simulated, draw, 2)
        state.rotor_speed[:, 0] = -np.abs(state.rotor_speed[:, 0])
        compiled = simulated.motion.step(state, influences)
        assert simulated.motion.why_numpy is None
        assert_same(compiled, move(simulated.vessel, simulated.hull_waves, state, influences))


def test_a_changed_part_of_a_packed_state_counts() -> None:
    simulated, draw = simulation("vehicles/otter", "random"), np.random.default_rng(5)
    influences = any_influences(simulated, draw, 1)
    state = simulated.motion.step(any_state(simulated, draw, 1), influences).vessel
    faster = replace(state.motion, vel_ned_mps=state.motion.vel_ned_mps + 1.0)
    changed = replace(state, motion=faster)
    assert_same(
        simulated.motion.step(changed, influences), move(simulated.vessel, simulated.hull_waves, changed, influences)
    )


@pytest.mark.medium
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda state: pickle.loads(pickle.dumps(state))])
def test_a_copy_of_a_state_goes_on_alone(copied: Callable[[VesselState], VesselState]) -> None:
    simulated, draw = simulation("vehicles/heron", "random"), np.random.default_rng(8)
    influences = any_influences(simulated, draw, 2)
    state = simulated.motion.step(any_state(simulated, draw, 2), influences).vessel
    twin = copied(state)
    assert twin.packed is None
    expected = arrays_of(simulated.motion.step(state, influences))
    state.packed.values[:] = np.nan
    for name, values in arrays_of(simulated.motion.step(twin, influences)).items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


@pytest.mark.medium
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda simulated: pickle.loads(pickle.dumps(simulated))])
def test_a_copy_of_a_simulation_computes_the_same(copied: Callable[[Simulation], Simulation]) -> None:
    simulated, draw = simulation("vehicles/wamv16", "random"), np.random.default_rng(9)
    state, influences = any_state(simulated, draw, 3), any_influences(simulated, draw, 3)
    expected = arrays_of(simulated.motion.step(state, influences))
    for name, values in arrays_of(copied(simulated).motion.step(state, influences)).items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


@pytest.mark.medium
def test_a_vessel_moves_the_same_alone_and_in_a_batch() -> None:
    simulated, draw = simulation("vehicles/blueboat", "random"), np.random.default_rng(6)
    state, influences = any_state(simulated, draw, 11), any_influences(simulated, draw, 11)
    together = arrays_of(simulated.motion.step(state, influences))
    for row in range(11):
        own = slice(row, row + 1)
        motion = type(state.motion)(*(getattr(state.motion, field.name)[own] for field in fields(state.motion)))
        alone = VesselState(motion, state.rotor_speed[own], state.half_change[own], None, state.battery)
        if state.battery is not None:
            parts = (getattr(state.battery, field.name)[own] for field in fields(state.battery))
            alone = replace(alone, battery=type(state.battery)(*parts))
        of_row = replace(
            influences,
            current_ned_mps=influences.current_ned_mps[own],
            drift_frd_n=None if influences.drift_frd_n is None else influences.drift_frd_n[own],
            command=influences.command[own],
            wrench_frd=None if influences.wrench_frd is None else influences.wrench_frd[own],
        )
        for name, values in arrays_of(simulated.motion.step(alone, of_row)).items():
            np.testing.assert_array_equal(values, together[name][own], err_msg=name)


class NumpyStep(MotionStep):
    """The step without its recording."""

    def __post_init__(self) -> None:
        self.why_numpy = "the test asks for it"


def sailed(
    simulated: Simulation, seconds: float, kind: type[MotionStep] = MotionStep, at_once: int = 1
) -> SimulationState:
    rng = np.random.default_rng(7)
    simulated = replace(simulated, motion=kind(simulated.vessel, simulated.hull_waves))
    state = initial(simulated, np.zeros((1, 2)), np.array([0.4]), rng)
    commands = np.array([[0.8, 0.65]])
    for _ in range(round(seconds / simulated.dt_s / at_once)):
        state = step(simulated, state, commands, rng, at_once)
    return state


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(("sea", "most_m"), [("flat", 1e-6), ("random", 1e-4)])
def test_a_long_way_ends_at_the_same_place(sea: str, most_m: float) -> None:
    """Rounding errors grow in waves: the force depends on the place, and the heading of a free boat drifts."""
    simulated = simulation("vehicles/asv-full", sea)
    compiled, reference = (sailed(simulated, 150.0, kind) for kind in (MotionStep, NumpyStep))
    apart_m = np.linalg.norm(compiled.vessel.motion.pos_ned_m - reference.vessel.motion.pos_ned_m)
    travelled_m = np.linalg.norm(reference.vessel.motion.pos_ned_m[0, :2])
    assert travelled_m > 20.0
    assert apart_m < most_m


@pytest.mark.medium
def test_a_run_repeats_bit_for_bit() -> None:
    simulated = simulation("vehicles/asv-full", "random")
    first, second = (sailed(simulated, 5.0).vessel.motion for _ in range(2))
    for field in fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name))


@pytest.mark.medium
@pytest.mark.parametrize("kind", [MotionStep, NumpyStep])
@pytest.mark.parametrize("at_once", [2, 5, 40])
def test_steps_at_once_are_the_steps_one_by_one(at_once: int, kind: type[MotionStep]) -> None:
    tide = TideSpec(constituents=(ConstituentSpec("own", 0.8, 30.0, speed_degph=20_000.0),))
    wind = WindSpec(6.0, 240.0, gust=GustSpec("ornstein-uhlenbeck", 1.5))
    environment = EnvironmentSpec(Water(tide=tide), waves=SEAS["random"], wind=wind)
    model = simulation("vehicles/asv-full", "flat").vessel.model
    simulated = Simulation.from_spec(model, Environment.from_spec(environment, np.random.default_rng(4)), 0.0025)
    alone, together = (sailed(simulated, 1.0, kind, steps) for steps in (1, at_once))
    assert together.time_ns == alone.time_ns == 1_000_000_000
    assert together.surface.tide_m == alone.surface.tide_m != 0.0
    expected = arrays_of(Moved(alone.vessel, alone.surface, alone.drift_frd_n))
    for name, values in arrays_of(Moved(together.vessel, together.surface, together.drift_frd_n)).items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)
    np.testing.assert_array_equal(together.wind_ned_mps, alone.wind_ned_mps)
