"""Profiles that nodes of ROS drive, or stand beside: what does not go together, and the graph that follows."""

from __future__ import annotations

import pytest

from xitl_cli.errors import UserError
from xitl_cli.graph.wdri import profile_wdri
from xitl_cli.profile import load_profile


@pytest.mark.parametrize(
    ("profile", "overrides", "problem"),
    [
        ("sitl", ["driver.kind=ros"], r"driver\.kind = ros needs ROS; add ros: \{enabled: true\}"),
        ("sitl", ["companion={kind: ros}", "ros.enabled=true"], "its nodes have neither lidar nor sonar"),
        ("sitl-perception", ["companion.kind=ros"], "companion.kind = ros needs ROS"),
        ("sitl-px4", ["driver.kind=ros", "ros.enabled=true"], "uses ArduPilot's GUIDED, which PX4 does not have"),
        ("ros-lockstep", ["clock.mode=realtime"], r"use clock\.mode: lockstep"),
        (
            "ros-lockstep",
            ["ros.lockstep.step_s=0.03"],
            r"step_s = 0\.03 is not .*; use a multiple of 0\.02",
        ),
        ("ros-lockstep", ["ros.lockstep.nodes=[]"], "ros.lockstep.nodes"),
        ("ros", ["ros.silent_s=0"], "ros.silent_s = 0"),
    ],
)
def test_what_does_not_go_together_is_refused(profile: str, overrides: list[str], problem: str) -> None:
    with pytest.raises(UserError, match=problem):
        load_profile(profile, overrides)


def test_nodes_of_ros_stand_in_the_companion_s_place_and_weigh_as_where_they_run() -> None:
    def vertices(*overrides: str) -> dict[str, tuple[str, str]]:
        graph = profile_wdri(load_profile("ros-companion", list(overrides))).graph
        return {one.name: (one.kind, one.runs_on) for one in graph.vertices if one.name.startswith("H")}

    assert set(vertices().values()) == {("virtual", "this machine")}
    assert set(vertices("companion.runs=board").values()) == {("real", "companion board")}
    here, there = (
        profile_wdri(load_profile("ros-companion", list(given))).wdri for given in ((), ("companion.runs=board",))
    )
    assert here < there
    assert profile_wdri(load_profile("ros")).wdri < here
