"""Requests to the operator before they are carried out: bodies that wait for an exchange, and whose pause it is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from sim_core.world.debris import BodyKind, Launch
from xitl_cli.profile import load_profile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.node import RunContext, RunStep, SimulationClock
from xitl_cli.run.core.pace import OperatedLockstep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.nodes.river import river_from_profile
from xitl_cli.run.operator.environment_changes import EnvironmentChanges
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

Parts = tuple[OperatorNode, Plant]
TRUNK = {"action": "launch", "kind": "trunk", "north_m": 15, "east_m": 18, "length_m": 4}


@pytest.fixture
def parts(tmp_path: Path) -> Iterator[Parts]:
    profile = load_profile("mitl").runnable()
    plant = build_plant([profile], Seeds(1), Scenery(profile))
    river = river_from_profile(profile, Seeds(1), plant, lambda: Progress("AUTO"))
    operator = OperatorNode(EnvironmentChanges(plant, profile.environment, Seeds(1)), river, [""], {}, {})
    recorder = Recorder(tmp_path / "run.mcap", "none")
    pace = OperatedLockstep(lambda: False)
    for node in (operator, river):
        node.begin(RunContext(recorder, pace, SimulationClock(pace)))
    yield operator, plant
    recorder.close()


def exchange(operator: OperatorNode, plant: Plant) -> None:
    view = plant.vessels[0]
    operator.exchange(RunStep(1, plant.state.time_ns, view, view.motion(), view.held))


@pytest.mark.medium
def test_a_current_changes_and_its_tide_does_not(parts: Parts) -> None:
    operator, _ = parts
    refused = operator.ask({"action": "current", "tide": {"flood_deg": 0, "peak_mps": 1}})
    assert refused is not None
    assert "tide cannot change during a run" in refused
    assert operator.ask({"action": "current", "speed_mps": 0.4}) is None


@pytest.mark.medium
def test_a_launch_waits_for_the_exchange_and_is_known_before(parts: Parts) -> None:
    operator, plant = parts
    assert operator.waiting_launches == ()
    assert operator.ask(TRUNK) is None
    assert operator.ask({"action": "wind", "mean_mps": 3}) is None
    assert operator.waiting_launches == (Launch(0, BodyKind.TRUNK, 15.0, 18.0, 0.0, 4.0),)
    foreseen = plant.debris_with(operator.waiting_launches)
    assert not plant.state.debris.bodies
    exchange(operator, plant)
    assert operator.waiting_launches == ()
    debris = plant.state.debris
    assert len(debris.bodies) == len(foreseen.bodies) == 1
    assert debris.pos_ned_m == pytest.approx(foreseen.pos_ned_m)
    assert debris.yaw_rad == pytest.approx(foreseen.yaw_rad)


@pytest.mark.medium
def test_a_refused_launch_does_not_wait(parts: Parts) -> None:
    operator, plant = parts
    north_m, east_m = plant.vessels[0].motion().pos_ned_m[0, :2].tolist()
    refusal = operator.ask(TRUNK | {"north_m": north_m, "east_m": east_m})
    assert refusal is not None
    assert "a vessel is at" in refusal
    assert operator.waiting_launches == ()


@pytest.mark.medium
def test_a_pause_has_the_source_that_asked_for_it(parts: Parts) -> None:
    operator, _ = parts
    assert operator.paused_by is None
    assert operator.ask({"action": "pause"}, "foxglove") is None
    assert operator.paused_by == "foxglove"
    assert operator.ask({"action": "pause"}, "view") is not None
    assert operator.paused_by == "foxglove"
    assert operator.ask({"action": "resume"}, "view") is None
    assert operator.paused_by is None
