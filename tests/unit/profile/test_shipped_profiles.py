"""What comes with xitl: every profile is right, and says what it is."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from shipped import shipped

from sim_core.keys import key_annotations
from xitl_cli.profile import load_profile, load_with_origins, resolved_yaml
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.resolved import values_with_origins
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.agents import AutopilotSpec

Write = Callable[..., Path]


EMULATED = [f"hitl-virtual-{what}" for what in ("board", "full")]
LOOPBACKS = [f"hitl-{link}-loopback" for link in ("beaglebone", "can", "canfd", "serial")]
BOARDS = [f"hitl-{link}" for link in ("beaglebone", "can", "canfd", "serial")]
ARDUPILOT_WAYS = [f"hitl-ardupilot-{way}{what}" for way in ("ahrs", "linux", "usb") for what in ("", "-loopback")]
OTHERS = [
    *ARDUPILOT_WAYS, "sitl-ardupilot", "sitl-ardupilot-ahrs", "sitl-ardupilot-fast", "sitl-ardupilot-steered",
    "sitl-px4", "hitl-px4",
]  # fmt: skip
PERCEPTION = ["sitl-perception", "sitl-ardupilot-perception", "hitl-jetson", "hitl-jetson-loopback", "hitl-full"]
FLEETS = [f"fleet-{what}" for what in ("ardupilot", "convoy", "crossing", "head-on", "overtaking")]
ALONE = ["ground-station", "hitl-loopback", "identify-excitation", "mitl", "mitl-replay", "sitl"]
SENSING = ["sitl-camera", "sitl-radar"]
NODES_OF_ROS = ["ros", "ros-companion", "ros-lockstep", "ros-thrusters"]
RUNNABLE = sorted([*EMULATED, *ALONE, *SENSING, *PERCEPTION, *BOARDS, *LOOPBACKS, *OTHERS, *FLEETS, *NODES_OF_ROS])


@pytest.mark.parametrize("name", shipped_profiles())
def test_every_shipped_profile_loads_and_describes_itself(name: str) -> None:
    profile = shipped(name).profile
    assert profile.name == name
    assert 10 < len(profile.description) < 100
    assert shipped_profiles()[name].read_text(encoding="utf-8").startswith("# ")


def test_those_at_the_top_run_and_no_others() -> None:
    assert [name for name in shipped_profiles() if shipped(name).profile.role() == "runs"] == RUNNABLE


@pytest.mark.parametrize("name", shipped_profiles())
def test_the_resolved_profile_loads_to_an_equal_one(name: str, write: Write) -> None:
    profile = shipped(name).profile
    text = resolved_yaml(profile)
    assert "extends" not in text
    assert load_profile(str(write(text, "resolved/profile.yaml"))) == profile


def test_the_resolved_profile_keeps_awkward_text_and_numbers(write: Write) -> None:
    awkward = ["1e3", "0o7", "null", "true", "yes", "12", "a: b", "# c", "", " x ", "é", "line\nbreak", "'", ".5"]
    for text in awkward:
        parameters = {"A": 1e-300, "B": 1e22, text: 0.1}
        profile = Profile(name=text, description=text, autopilot=AutopilotSpec(parameters=parameters))
        assert load_profile(str(write(resolved_yaml(profile)))) == profile


def test_relative_paths_are_meant_from_the_file_and_survive_a_move(write: Write, tmp_path: Path) -> None:
    write("graph: {nodes: {D: {kind: real}}, links: {D: [D]}}", "boats/real.yaml")
    write("WP_SPEED 3\n", "boats/tune.parm")
    write("extends: sitl\ngraph: {reference: real.yaml}\nautopilot: {parameter_files: [tune.parm]}", "boats/mine.yaml")
    profile = load_profile("boats/mine.yaml")
    assert profile.graph is not None
    assert profile.autopilot is not None
    assert profile.graph.reference == str(tmp_path / "boats/real.yaml")
    assert profile.autopilot.parameter_files == (str(tmp_path / "boats/tune.parm"),)
    assert load_profile(str(write(resolved_yaml(profile), "elsewhere/profile.yaml"))) == replace(profile, name="mine")


def test_the_file_to_replay_is_meant_from_the_profile_that_names_it(write: Write, tmp_path: Path) -> None:
    write("time_s,C1,C3\n0,1500,1500\n", "boats/mine.csv")
    write(
        "extends: mitl\ndriver: {kind: replay, file: mine.csv}\nautopilot: {controller: 'fast.py:Fast'}",
        "boats/mine.yaml",
    )
    profile = load_profile("boats/mine.yaml")
    assert profile.driver is not None
    assert profile.autopilot is not None
    assert profile.autopilot.controller == f"{tmp_path}/boats/fast.py:Fast"
    assert profile.driver.file == str(tmp_path / "boats/mine.csv")
    shipped = load_profile("mitl-replay").driver
    assert shipped is not None
    assert Path(shipped.file or "").is_file()


def test_every_value_has_an_origin_or_is_a_default() -> None:
    loaded = load_with_origins("sitl", ["clock.seed=3"])
    origins = {key: (value, origin) for key, value, origin in values_with_origins(loaded)}
    assert origins["clock.seed"] == ("3", "--set clock.seed")
    assert origins["autopilot.connect_timeout_s"] == ("6.0", "default")
    assert origins["mission.waypoints_ned_m"][0].startswith("[[8.0, 6.0], ")
    assert "santo-antonio.yaml:" in origins["mission.waypoints_ned_m"][1]


def test_the_mission_is_some_400_m_along_the_log_boom() -> None:
    run = load_profile("sitl").runnable()
    start = (run.mission.start.north_m, run.mission.start.east_m)
    points = [start, *run.mission.waypoints_ned_m]
    length_m = sum(math.dist(one, other) for one, other in itertools.pairwise(points))
    assert length_m == pytest.approx(407, abs=1)
    assert run.mission.speed_mps == 3.0
    assert run.world.log_boom is not None
    boom = [point[:2] for point in run.world.log_boom.points_ned_m]
    from_boom = [_distance(point, boom[0], boom[-1]) for point in points]
    assert from_boom == pytest.approx([28, 8, 8, 8, 23, 23, 23], abs=0.1)


def _distance(point: tuple[float, float], one: tuple[float, ...], other: tuple[float, ...]) -> float:
    along = (other[0] - one[0], other[1] - one[1])
    offset = (point[0] - one[0], point[1] - one[1])
    return abs(along[0] * offset[1] - along[1] * offset[0]) / math.hypot(*along)


def test_a_move_to_a_board_changes_only_where_nodes_run_and_time() -> None:
    sitl, board = load_profile("sitl"), load_profile("hitl-beaglebone")
    same = set(key_annotations(Profile)) - {"name", "description", "technique", "autopilot", "clock", "graph"}
    assert all(getattr(sitl, group) == getattr(board, group) for group in same)
    assert board.autopilot is not None
    assert board.autopilot.link == "udp://192.168.7.2:14660"
    assert board.graph is not None
    real = {name for name, node in board.graph.nodes.items() if node.kind == "real"}
    assert real == {"LS", "LC", "LA"}
    assert board.clock is not None
    assert board.clock.mode == "realtime"


@pytest.mark.parametrize("environment", ["calm", "current-waves", "current-waves-gusts"])
def test_the_environments_can_be_exchanged(environment: str, write: Write) -> None:
    run = load_profile(str(write(f"extends: [sitl, {environment}]"))).runnable()
    surroundings = run.environment
    assert surroundings == load_profile(environment).environment  # nothing of another environment is left
    assert (surroundings.current.speed_mps > 0) == (environment != "calm")
    assert (surroundings.waves.spectrum != "none") == (environment != "calm")
    gusty = environment == "current-waves-gusts"
    assert (surroundings.wind.mean_mps > 0) == gusty
    assert bool(surroundings.wind.discrete_gusts) == gusty


def test_the_scale_vessel_is_the_full_one_by_froude() -> None:
    full, third = load_profile("asv-full").vehicle, load_profile("asv-third").vehicle
    assert full is not None
    assert third is not None
    assert third.mass_kg * 27 == pytest.approx(full.mass_kg, rel=1e-2)
    assert third.hull.length_m * 3 == pytest.approx(full.hull.length_m, rel=1e-2)
    assert third.propellers[0].max_thrust_n * 27 == pytest.approx(full.propellers[0].max_thrust_n, rel=1e-2)
    assert [moment * 243 for moment in third.inertia_kgm2] == pytest.approx(full.inertia_kgm2, rel=1e-2)


@pytest.mark.medium
def test_the_reference_is_what_the_schema_says() -> None:
    folder = Path(__file__).parents[3]
    told = subprocess.run(
        [sys.executable, "tools/generate_profile_reference.py", "--check"],
        cwd=folder, env=os.environ | {"PYTHONPATH": str(folder)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
