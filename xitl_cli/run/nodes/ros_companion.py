"""ROS nodes in place of the companion: counts their messages for the graph of the run."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import Any

from agent import __version__
from agent.wire import dialect
from xitl_cli.profile.schema.agents import CompanionSpec
from xitl_cli.run.core.node import RunContext, RunNode
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.links.link_accounts import agent_traffic

LINK, ASKED = "ros", "ros"
NODES = "HS,HC,HA"
_STANDS_FOR = {
    "/lidar/points": dialect.MAVLINK_MSG_ID_XITL_CLOUD,
    "/sonar/ping": dialect.MAVLINK_MSG_ID_XITL_PING,
    "/estimate/odometry": dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
}
"""Message that xitl's companion would get instead of each topic, in the terms of graph/measured.py."""


class RosCompanionNode(RunNode):
    """The nodes count as present when they have given an order. Their sensor data then count as used.

    asked_by: number of executed orders to the vessel, by client.
    """

    def __init__(self, companion: CompanionSpec, asked_by: Counter[str]) -> None:
        self._on_board = companion.runs == "board"
        self._asked_by = asked_by
        self._told: Counter[int] = Counter()

    def begin(self, context: RunContext) -> None:
        for topic, number in _STANDS_FOR.items():
            context.recorder.watch(topic, partial(self._count, number))

    def _count(self, number: int, *message: Any) -> None:
        self._told[number] += 1

    def report(self) -> dict[str, Any]:
        orders = self._asked_by[ASKED]
        if not orders:
            return {}
        seen = sum(self._told[number] for topic, number in _STANDS_FOR.items() if topic != "/estimate/odometry")
        told = dict(self._told) | {dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 1}  # /mission is latched
        given = {dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: orders}
        node = NodeReport(
            NODES,
            "companion board" if self._on_board else "this machine",
            __version__,
            memory_mib=None,
            refused=0,
            link=LINK,
            kind="real" if self._on_board else "virtual",
            estimates=seen,
            efforts=orders,
        )
        return {"nodes": [node], "agents": [agent_traffic(node, [], {"tx": told, "rx": given})]}
