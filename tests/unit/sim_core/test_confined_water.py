"""Shallow water: published factors, a panel code over a bottom, and nothing in deep water."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from kernel import needs_kernel

from sim_core import fleet as fleets
from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.tide import Tide
from sim_core.fleet import Fleet
from sim_core.frames import Array
from sim_core.motion import Influences, MotionStep, move
from sim_core.simulation import Simulation, SimulationState, initial, step
from sim_core.vessel.confined_water import added_mass_factor, aspect_factor, resistance_factor
from sim_core.vessel.spec import VesselSpec
from sim_core.world.plan import Capsules
from sim_core.world.river import Bed, FlatBed
from sim_core.world.waterway import Waterway
from xitl_cli.profile import load_profile
from xitl_cli.run.world.plant import Plant

DEEP_M = 1000.0
DT_S = 0.01


def shipped(name: str) -> VesselSpec:
    model = load_profile(f"vehicles/{name}").vehicle
    assert model is not None
    return model


def over_bottom(model: VesselSpec, depth_m: float) -> Simulation:
    return Simulation.from_spec(model, Environment(water=Water(level_m=0.0, depth_m=depth_m)), DT_S)


def sailed(simulation: Simulation, command: list[float], seconds: float) -> SimulationState:
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    return step(simulation, state, np.array([command]), rng, round(seconds / DT_S))


def hull_force(simulation: Simulation, velocity: list[float]) -> Array:
    hydrodynamics = simulation.vessel.hydrodynamics
    force: Array = (np.concatenate(hydrodynamics.terms(np.array([velocity])), axis=1) @ hydrodynamics.wrench)[0]
    return force


def test_resistance_grows_as_raven_published() -> None:
    """Raven 2016: 0.57 (T / h)^1.79 of the viscous resistance."""
    assert resistance_factor(2.0) == pytest.approx(1.165, abs=5e-4)
    assert resistance_factor(4.0) == pytest.approx(1.048, abs=5e-4)
    for name in ("asv-full", "kvlcc2-l7"):  # by axis, and by a table
        model = shipped(name)
        deep = over_bottom(model, DEEP_M)
        draft_m = deep.vessel.rest.draft_m
        shallow = over_bottom(model, 2.0 * draft_m)
        slow = [0.02 * math.sqrt(GRAVITY_MPS2 * draft_m), 0.0, 0.0, 0.0, 0.0, 0.0]  # too slow to sink
        assert hull_force(shallow, slow)[0] / hull_force(deep, slow)[0] == pytest.approx(1.165, abs=1e-3)


def test_added_mass_of_a_narrow_hull_is_that_of_a_panel_code() -> None:
    """Capytaine 2.3, 2.3 x 0.02 m, 0.1 m deep, 50 x 6 panels a side: sway at a wave number of 0.15 / h over that in
    deep water at frequency 0.
    """
    for ratio, panels in ((4.0, 1.029), (2.0, 1.154), (1.5, 1.356)):
        assert added_mass_factor(ratio) == pytest.approx(panels, rel=0.07)
    assert added_mass_factor(DEEP_M) == pytest.approx(1.0, abs=1e-6)


def test_added_mass_stays_symmetric_and_definite_and_changes_sway_and_yaw_alone() -> None:
    model = shipped("otter")
    deep = over_bottom(model, DEEP_M).vessel
    shallow = over_bottom(model, 1.5 * deep.rest.draft_m).vessel
    mass, before = shallow.hydrodynamics.added_mass, deep.hydrodynamics.added_mass
    assert mass == pytest.approx(mass.T, rel=1e-12)
    assert np.linalg.eigvalsh(mass).min() > -1e-9
    factor = added_mass_factor(1.5)
    assert np.diag(mass) == pytest.approx(np.diag(before) * [1.0, factor, 1.0, 1.0, 1.0, factor])


def test_derivatives_grow_as_the_effective_aspect_ratio_of_hirano() -> None:
    """Hirano et al. 1985: k / (T / 2 h + (pi T / 2 h cot(pi T / 2 h))^q); by hand, pi / 3 cot(pi / 3) = 0.6046."""
    assert aspect_factor(1.5, 2.3) == pytest.approx(1.0 / (1.0 / 3.0 + 0.3143), rel=1e-3)
    assert aspect_factor(2.0, 1.7) == pytest.approx(1.0 / (0.25 + 0.6632), rel=1e-3)
    model = shipped("kvlcc2-l7")
    deep = over_bottom(model, DEEP_M)
    shallow = over_bottom(model, 1.5 * deep.vessel.rest.draft_m)
    drifting = [1.0, 1e-5, 0.0, 0.0, 0.0, 0.0]
    tables = [next(part for part in s.vessel.hydrodynamics.parts if hasattr(part, "flow")) for s in (deep, shallow)]
    of_table = [(part.terms(np.array([drifting]))[0] @ part.wrench)[0] for part in tables]
    assert of_table[1][1] / of_table[0][1] == pytest.approx(aspect_factor(1.5, 2.3), rel=1e-6)
    assert of_table[1][5] / of_table[0][5] == pytest.approx(aspect_factor(1.5, 1.7), rel=1e-6)


@pytest.mark.medium
def test_a_ship_sinks_by_ravens_formula_and_less_than_barrass_allows() -> None:
    model = shipped("kvlcc2-l7")
    rest = over_bottom(model, DEEP_M).vessel.rest
    depth_m = 1.5 * rest.draft_m
    sunk = []
    for confined in (True, False):
        state = sailed(over_bottom(replace(model, confined_water=confined), depth_m), [0.4, 0.0], 200.0)
        sunk.append((float(state.vessel.motion.pos_ned_m[0, 2]), float(state.vessel.motion.vel_ned_mps[0, 0])))
    (with_bottom_m, speed_mps), (without_m, free_mps) = sunk
    assert speed_mps < free_mps
    here, deep = speed_mps**2 / (GRAVITY_MPS2 * depth_m), speed_mps**2 / (GRAVITY_MPS2 * 0.3 * model.length_m)
    formula_m = 1.46 * rest.displacement_m3 / 7.0**2 * (here / math.sqrt(1.0 - here) - deep / math.sqrt(1.0 - deep))
    assert with_bottom_m - without_m == pytest.approx(formula_m, rel=0.05)
    # Barrass: C_B V^2 / 100 m at most, V in knots of the ship of 320 m
    knots = speed_mps * math.sqrt(320.0 / 7.0) / 0.5144
    assert 0.2 < (320.0 / 7.0) * formula_m / (0.81 * knots**2 / 100.0) < 1.0


@pytest.mark.medium
def test_a_ship_turns_wider_in_shallower_water() -> None:
    model = shipped("kvlcc2-l7")
    draft_m = over_bottom(model, DEEP_M).vessel.rest.draft_m
    radii_m = []
    for ratio in (20.0, 2.0, 1.5, 1.2):
        motion = sailed(over_bottom(model, ratio * draft_m), [0.7, 1.0], 150.0).vessel.motion
        speed_mps = float(np.hypot(*motion.vel_ned_mps[0, :2]))
        radii_m.append(speed_mps / abs(float(motion.gyro_frd_radps[0, 2])))
    assert radii_m == sorted(radii_m)  # as tests of many ships have it: Nakamura, TransNav 11 (3), 2017
    assert radii_m[-1] > 1.2 * radii_m[0]


@pytest.mark.medium
@pytest.mark.parametrize("name", ["asv-full", "kvlcc2-l7", "otter"])
def test_deep_water_and_vessels_without_the_key_are_as_before_to_the_last_bit(name: str) -> None:
    model = shipped(name)
    command = [0.6] * len(model.propellers) + [0.5] * (model.commands - len(model.propellers))
    draft_m = over_bottom(model, DEEP_M).vessel.rest.draft_m
    off = replace(model, confined_water=False)
    runs = [(model, DEEP_M), (model, max(10.0 * draft_m, 0.3 * model.length_m)), (off, DEEP_M), (off, 1.3 * draft_m)]
    states = [sailed(over_bottom(*run), command, 20.0).vessel.motion.pos_ned_m.tobytes() for run in runs]
    assert len(set(states)) == 1
    assert sailed(over_bottom(model, 1.3 * draft_m), command, 20.0).vessel.motion.pos_ned_m.tobytes() != states[0]


@needs_kernel
@pytest.mark.parametrize("name", ["asv-full", "kvlcc2-l7", "mariner", "wamv16"])
def test_the_compiled_step_is_that_in_numpy(name: str) -> None:
    model = replace(shipped(name), confined_water=True)
    draft_m = over_bottom(model, DEEP_M).vessel.rest.draft_m
    simulation = over_bottom(model, 1.4 * draft_m)
    motion_step = MotionStep(simulation.vessel, simulation.hull_waves)
    command = np.full((1, model.commands), 0.5)
    state = sailed(simulation, command[0].tolist(), 5.0)
    influences = Influences(5.0, 0.0, np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)), command, None)
    compiled = motion_step.step(state.vessel, influences).vessel.motion
    in_numpy = move(simulation.vessel, simulation.hull_waves, state.vessel, influences).vessel.motion
    assert motion_step.why_numpy is None
    assert compiled.vel_ned_mps == pytest.approx(in_numpy.vel_ned_mps, abs=1e-9)
    assert compiled.gyro_frd_radps == pytest.approx(in_numpy.gyro_frd_radps, abs=1e-9)


class SlopingBed:
    """A bed that rises to the north, from 3 m below the origin by 0.3 m in a metre, to 0.4 m."""

    def bed_down_m(self, north_east_m: Array) -> Array:
        return np.maximum(3.0 - 0.3 * north_east_m[..., 0], 0.4)

    def gradient(self, north_east_m: Array) -> Array:
        return np.stack([np.full(north_east_m.shape[:-1], -0.3), np.zeros(north_east_m.shape[:-1])], axis=-1)


class ConstantLevel:
    """A tide that stays at one height."""

    def __init__(self, height_m: float) -> None:
        self.height_m = height_m
        self.bounds = (height_m, height_m)
        self.fastest = 0.0

    def value(self, time_s: float) -> float:
        return self.height_m

    def rate(self, time_s: float) -> float:
        return 0.0


def sailed_over(bed: Bed, seconds: float, depth_m: float = DEEP_M, tide_m: float = 0.0) -> Plant:
    """Sail an Otter ahead from the origin over a bed, in water that the environment calls deep."""
    simulation = over_bottom(shipped("otter"), depth_m)
    if tide_m:
        simulation = simulation.in_environment(replace(simulation.environment, tide=Tide(ConstantLevel(tide_m))))
    simulation = replace(simulation, waterway=Waterway(Capsules.joined(()), bed, contact=False))
    rng = np.random.default_rng(0)
    plant = Plant(simulation, initial(simulation, np.zeros((1, 2)), np.zeros(1), rng), rng)
    for _ in range(round(seconds / DT_S)):
        plant.advance([0.5, 0.5])
    return plant


@pytest.mark.medium
def test_a_vessel_feels_the_depth_below_it() -> None:
    draft_m = over_bottom(shipped("otter"), DEEP_M).vessel.rest.draft_m
    speed = {}
    for name, plant in (
        ("deep", sailed_over(FlatBed(50.0), 8.0)),
        ("flat", sailed_over(FlatBed(1.5 * draft_m), 8.0)),
        ("environment", sailed_over(FlatBed(1.5 * draft_m), 8.0, depth_m=1.5 * draft_m)),
    ):
        state, simulation = plant.state, plant.simulation
        assert isinstance(state, SimulationState)
        assert isinstance(simulation, Simulation)
        speed[name] = float(state.vessel.motion.vel_ned_mps[0, 0])
        assert simulation.depths_m(1)[0] == (DEEP_M if name == "deep" else pytest.approx(1.5 * draft_m))
    assert speed["flat"] == pytest.approx(speed["environment"], rel=1e-9)
    assert speed["flat"] < 0.97 * speed["deep"]


@pytest.mark.medium
def test_the_tide_is_part_of_the_depth() -> None:
    draft_m = over_bottom(shipped("otter"), DEEP_M).vessel.rest.draft_m
    low, high = (sailed_over(FlatBed(1.5 * draft_m), 1.0, tide_m=tide_m).simulation for tide_m in (0.0, draft_m))
    assert isinstance(low, Simulation)
    assert isinstance(high, Simulation)
    assert high.depths_m(1)[0] == pytest.approx(low.depths_m(1)[0] + draft_m, rel=0.02)


@pytest.mark.medium
def test_a_vessel_slows_down_over_a_rising_bed_and_recovers_where_it_is_deep() -> None:
    plant = sailed_over(SlopingBed(), 15.0)
    state, simulation = plant.state, plant.simulation
    assert isinstance(state, SimulationState)
    assert isinstance(simulation, Simulation)
    below_m = float(SlopingBed().bed_down_m(state.vessel.motion.pos_ned_m[0, :2]))
    assert simulation.depths_m(1)[0] == pytest.approx(below_m, rel=0.021)
    assert simulation.over_bed(state) is simulation
    back = replace(state.vessel.motion, pos_ned_m=np.array([[-20.0, 0.0, 0.0]]))
    deep = simulation.over_bed(replace(state, vessel=replace(state.vessel, motion=back)))
    before = over_bottom(shipped("otter"), DEEP_M).vessel
    assert deep.vessel.acceleration_per_term == pytest.approx(before.acceleration_per_term, rel=0.0, abs=0.0)


@pytest.mark.medium
def test_each_vessel_of_a_fleet_moves_as_alone_over_the_bed_below_it() -> None:
    """Three Otters and a WAM-V cross a slope: one comes from deep water, one leaves for it, one stays shallow."""
    otter, wamv = shipped("otter"), shipped("wamv16")
    models, commands = [otter, otter, wamv, otter], [[0.5, 0.5], [-0.6, -0.4], [0.3, 0.3], [0.4, 0.5]]
    places, waterway = [4.0, 8.0, 6.0, 12.0], Waterway(Capsules.joined(()), SlopingBed(), contact=False)
    environment, headings = over_bottom(otter, DEEP_M).environment, np.zeros(1)
    alone = []
    for model, command, north_m in zip(models, commands, places, strict=True):
        simulation = Simulation.from_spec(model, environment, DT_S, waterway)
        state = initial(simulation, np.array([[north_m, 100.0 * north_m]]), headings, np.random.default_rng(0))
        plant = Plant(simulation, state, np.random.default_rng(0))
        depths = set()
        for _ in range(round(6.0 / DT_S)):
            plant.advance(command)
            depths.add(plant.vessels[0].simulation.depths_m(1)[0])
        alone.append((plant.vessels[0].motion(), depths))
    assert [len(depths) > 1 for _, depths in alone] == [True, True, True, False]
    fleet = Fleet.from_spec(models, environment, DT_S, waterway)
    starts = np.array([[north_m, 100.0 * north_m] for north_m in places])
    plant = Plant(fleet, fleets.initial(fleet, starts, np.zeros(4), np.random.default_rng(0)), np.random.default_rng(0))
    for _ in range(round(6.0 / DT_S)):
        plant.advance(commands)
    for view, (motion, _) in zip(plant.vessels, alone, strict=True):
        assert view.motion().pos_ned_m.tolist() == motion.pos_ned_m.tolist()
        assert view.motion().gyro_frd_radps.tolist() == motion.gyro_frd_radps.tolist()
