"""Nodes of ROS in the companion's place: the measured graph has them once they have given an order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, cast

import pytest

from xitl_cli.profile import load_profile
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.nodes.companion import RosCompanionNode
from xitl_cli.run.run_graph import graph_section


class Watched:
    """A recorder that hands on what the test says is recorded."""

    def __init__(self) -> None:
        self.seen: dict[str, Callable[..., object]] = {}

    def watch(self, topic: str, seen: Callable[..., object]) -> None:
        self.seen[topic] = seen


@pytest.mark.parametrize(("runs", "kind"), [("in-process", "virtual"), ("board", "real")])
def test_who_sees_and_orders_is_in_the_measured_graph_as_claimed(runs: str, kind: str) -> None:
    profile = load_profile("ros-companion", [f"companion.runs={runs}"]).runnable()
    assert profile.companion is not None
    asked_by: Counter[str] = Counter(view=3)
    node, recorder = RosCompanionNode(profile.companion, asked_by), Watched()
    node.begin(RunContext(cast(Any, recorder), cast(Any, None), cast(Any, None)))
    for topic in ("/lidar/points", "/sonar/ping", "/estimate/odometry"):
        recorder.seen[topic](0, "whatever is recorded")
    assert node.report() == {}  # a person at the view is none of them
    asked_by["ros"] += 1
    report = node.report()
    own: NodeReport = report["nodes"][0]
    assert (own.kind, own.nodes) == (kind, "HS,HC,HA")
    graph = graph_section(profile, report["agents"], [("PS1", "M")])
    high = {"PS1-HS", "LS-HC", "LC-HC", "LC-HA", "HS-HC", "HC-HA", "HA-M"}
    assert high <= set(graph["claimed"]["links"])
    assert high <= set(graph["measured"]["links"])
    assert graph["unclaimed"] == []
    kinds = {one["name"]: one["kind"] for one in graph["measured"]["nodes"]}
    assert {kinds[name] for name in ("HS", "HC", "HA")} == {kind}
