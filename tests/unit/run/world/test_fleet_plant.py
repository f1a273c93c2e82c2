"""A plant of several vessels: each has its own view, and sees and feels the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.fleet import Fleet, FleetState
from sim_core.sensors.rangefinder import ObstacleScanner, Rangefinder
from sim_core.simulation import Simulation, SimulationState
from sim_core.world.contact import Contacts
from sim_core.world.debris import BodyKind, Launch
from xitl_cli.profile import load_profile
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

FLEET = """
extends: [sitl]
sensors:
  messages: {obstacle_distance: {}}
  rangefinders: [{direction_frd: [1, 0, 0], through: air}, {}]
vessels:
  starboard: {mission: {start: {north_m: 0, east_m: 0, heading_deg: 0}, waypoints_ned_m: [[50, 0]]}}
  port: {mission: {start: {north_m: 0, east_m: -12, heading_deg: 0}, waypoints_ned_m: [[50, -12]]}}
  barge: {traffic: {track_ned_m: [[40, 0]], heading_deg: 90, length_m: 60, beam_m: 12}}
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    path: Path = tmp_path_factory.mktemp("profile") / "fleet.yaml"
    path.write_text(FLEET)
    profiles = load_profile(str(path)).run_profiles()
    return build_plant(profiles, Seeds(1), Scenery(profiles[0]))


@pytest.mark.medium
def test_each_vessel_has_its_view(plant: Plant) -> None:
    starboard, port = plant.vessels
    assert isinstance(plant.simulation, Fleet)
    assert plant.simulation.names == ("starboard", "port")
    assert starboard.simulation is port.simulation  # of one model
    np.testing.assert_array_equal(port.motion().pos_ned_m[0, :2], [0.0, -12.0])
    port.held = True
    plant.advance([(1.0, 1.0), (1.0, 1.0)])
    port.held = False
    assert (starboard.held_steps, port.held_steps) == (0, 1)
    assert not port.motion().vel_ned_mps.any()
    assert starboard.motion().vel_ned_mps.any()
    assert starboard.state.time_ns == plant.state.time_ns == 2_500_000


def test_each_sees_the_others_and_what_drifts_but_not_itself(plant: Plant) -> None:
    starboard, port = plant.vessels
    plant.launch(Launch(0, BodyKind.TRUNK, -30.0, 0.0))
    for one, other in ((starboard, port), (port, starboard)):
        bodies = one.bodies()
        assert len(bodies.meshes) == 3  # trunk, the other, the barge
        np.testing.assert_array_equal(bodies.pos_ned_m[1], other.motion().pos_ned_m[0])
    assert starboard.hulls is not None
    assert len(starboard.hulls(100.0).top_down_m) == 2 * 4 + 6  # box-shaped in plan, twice, and the barge
    assert not len(starboard.hulls(9.0).top_down_m)


@pytest.mark.medium
def test_range_sensors_of_the_suite_hear_of_hulls_and_alone_of_none(plant: Plant) -> None:
    view = plant.vessels[0]
    assert isinstance(plant.simulation, Fleet)
    profile = load_profile("sitl", ["sensors.messages.obstacle_distance.rate_hz=10"]).runnable()
    alone = build_plant([profile], Seeds(1), Scenery(profile))
    assert isinstance(alone.simulation, Simulation)
    assert alone.vessels[0].hulls is None
    rng, found = np.random.default_rng(1), []
    for hulls in (view.hulls, alone.vessels[0].hulls):
        suite = make_sensing(profile, Seeds(1), hulls)
        units = [channel._sensor for channel in suite._channels if hasattr(channel, "_sensor")]
        scanner = next(unit for unit in units if isinstance(unit, ObstacleScanner))
        assert not any(isinstance(unit, Rangefinder) and unit.hulls for unit in units)
        found.append(scanner.measure(scanner.initial(1, rng), view.motion(), rng)[1].range_m[0])
    with_hulls, without = found
    assert with_hulls[0] == pytest.approx(34.0, abs=0.2)  # the barge's side, ahead
    assert with_hulls[54] < 12.0  # the other, abeam
    assert with_hulls[0] < without[0]


def test_what_is_derived_from_a_state_is_computed_once_for_all_vessels_of_a_model(plant: Plant) -> None:
    starboard, port = plant.vessels
    calls: list[int] = []

    def north_m(simulation: Simulation, state: SimulationState) -> list[float]:
        calls.append(state.time_ns)
        places: list[float] = state.vessel.motion.pos_ned_m[:, 0].tolist()
        return places

    for _ in range(2):
        for vessel in (starboard, port):
            places, row = vessel.derived(north_m)
            assert places[row] == vessel.motion().pos_ned_m[0, 0]
    assert calls == [plant.state.time_ns]
    plant.advance([(1.0, 1.0), (1.0, 1.0)])
    port.derived(north_m)
    assert calls[1:] == [plant.state.time_ns]


def test_vessels_with_a_contact_are_named(plant: Plant) -> None:
    assert not plant.touching()
    _, port = plant.vessels
    state = plant.state
    assert isinstance(state, FleetState)
    touched = Contacts(np.array([1]), ("t",), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1), np.zeros(1))
    batch = replace(state.batches[0], afloat=replace(state.batches[0].afloat, contacts=touched))
    plant.state = replace(state, batches=(batch,))
    assert list(plant.touching()) == [port.number]
    plant.state = state
