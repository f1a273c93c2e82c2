"""What leaves the range of the models is counted, told once, and said in the summary."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water, WaveSpec
from sim_core.environment.waves import realise_waves
from sim_core.simulation import Simulation, SimulationState, initial, step
from tests.golden import Golden
from xitl_cli.profile.load import load_profile
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.nodes.model_range import ModelRange
from xitl_cli.run.world.plant import Plant

MODEL = load_profile("sitl").runnable().vehicle
FLAT = Simulation.from_spec(MODEL, Environment(), 0.0025)


def afloat(simulation: Simulation = FLAT, speed_mps: float = 0.0, sunk_m: float = 0.0) -> SimulationState:
    rng = np.random.default_rng(0)
    state = step(simulation, initial(simulation, np.zeros((1, 2)), np.zeros(1), rng), np.zeros((1, 2)), rng)
    motion = state.vessel.motion
    motion = replace(motion, vel_ned_mps=np.array([[speed_mps, 0.0, 0.0]]), acc_ned_mps2=np.zeros((1, 3)))
    motion = replace(motion, pos_ned_m=motion.pos_ned_m + np.array([0.0, 0.0, sunk_m]))
    return replace(state, vessel=replace(state.vessel, motion=motion))


def seen(states: list[SimulationState], simulation: Simulation = FLAT, held: bool = False) -> tuple[dict, list[str]]:
    told: list[str] = []
    plant = Plant(simulation, afloat(simulation), np.random.default_rng(0))
    node = ModelRange(plant.vessels[0])
    node.begin(SimpleNamespace(recorder=SimpleNamespace(log=lambda *words: told.append(words[-1]))))  # type: ignore[arg-type]
    for number, state in enumerate(states, start=1):
        plant.state = state
        node.record(RunStep(20 * number, 50_000_000 * number, plant.vessels[0], state.vessel.motion, held))
    assert node.record_every == 20
    return node.report(), told


def test_a_calm_run_stays_inside() -> None:
    report, told = seen([afloat(speed_mps=3.0)] * 4)
    assert report["warnings"] == told == []
    froude = report["model_range"]["froude_number"]
    assert froude["max"] == pytest.approx(3.0 / np.sqrt(9.80665 * 2.3))
    assert froude["share"] == 0.0
    assert all(part["share"] == 0.0 for part in report["model_range"].values())


def test_speed_is_through_the_water_and_its_share_is_counted(golden: Golden) -> None:
    fast = afloat(speed_mps=6.0)
    carried = replace(fast, current_ned_mps=np.array([[5.0, 0.0, 0.0]]))
    report, told = seen([carried, fast, fast, afloat()])
    froude = report["model_range"]["froude_number"]
    assert froude["share"] == 0.5
    assert froude["max"] == pytest.approx(6.0 / np.sqrt(9.80665 * 2.3))
    golden("warning", report["warnings"], "1.26", "50.0")
    assert told == ["froude_number = 1.26 leaves the models' range: at most 1"]


def test_speed_is_held_against_that_of_waves_where_a_hull_sinks() -> None:
    shallow = Simulation.from_spec(MODEL, Environment(water=Water(depth_m=0.5)), 0.0025)
    report, told = seen([afloat(shallow, speed_mps=speed_mps) for speed_mps in (1.0, 1.5, 2.0, 3.0)], shallow)
    assert report["model_range"]["depth_froude_number"]["share"] == 0.5  # 0.45, 0.68, 0.90, 1.35
    assert report["model_range"]["depth_froude_number"]["max"] == pytest.approx(3.0 / np.sqrt(9.80665 * 0.5))
    assert told == ["depth_froude_number = 0.90 leaves the models' range: at most 0.7"]
    assert report["warnings"][0].startswith("speed over the root of g h up to 1.35, above 0.7 for 50.0%")


def test_a_deck_under_water_is_said() -> None:
    report, _ = seen([afloat(), afloat(sunk_m=0.35)])
    assert report["model_range"]["deck_under_water"] == {"limit": 0.0, "max": 1.0, "share": 0.5}
    assert report["warnings"][0].startswith("up to 100% of the hulls under water with their deck")


@pytest.mark.medium
def test_a_steep_sea_and_a_quick_motion_are_said() -> None:
    waves = realise_waves(WaveSpec("regular", 1.7, 4.0), Environment().water, np.random.default_rng(1))
    simulation = Simulation.from_spec(MODEL, Environment(waves=waves), 0.0025)
    states, state, rng = [], afloat(simulation), np.random.default_rng(0)
    for _ in range(1600):
        state = step(simulation, state, np.zeros((1, 2)), rng)
        states.append(state)
    report, _ = seen(states, simulation)
    slope = report["model_range"]["surface_slope"]
    # k a = 0.85 (2 pi / 4)^2 / g, less (k L)^2 / 24 = 1.4 % over the hull.
    assert slope["max"] == pytest.approx(0.2109, rel=0.01)
    steep = [np.hypot(*state.surface.gradient_ned[0, :2]) > 0.2 for state in states]
    assert slope["share"] == pytest.approx(np.mean(steep), abs=1e-9)
    assert 0.05 < slope["share"] < 0.3
    still = afloat()
    motion = replace(still.vessel.motion, gyro_frd_radps=np.array([[0.0, 0.0, 40.0]]))
    report, _ = seen([replace(still, vessel=replace(still.vessel, motion=motion))])
    assert report["model_range"]["motion_per_step"]["max"] == pytest.approx(0.1)
    assert "raise clock.physics_rate_hz" in report["warnings"][0]


def test_a_held_vessel_is_not_looked_at() -> None:
    report, _ = seen([afloat(speed_mps=9.0)], held=True)
    assert report["model_range"]["froude_number"] == {"limit": 1.0, "max": None, "share": 0.0}
