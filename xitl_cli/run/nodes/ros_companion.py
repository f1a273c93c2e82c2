"""ROS nodes in place of the companion: the rate of their estimates, and counts of messages for the graph."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import Any

from agent import __version__
from agent.wire import dialect
from xitl_cli.profile.schema.agents import CompanionSpec
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
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
        self._sent: Counter[int] = Counter()

    def begin(self, context: RunContext) -> None:
        def count(number: int, *message: Any) -> None:
            self._sent[number] += 1

        for topic, number in _STANDS_FOR.items():
            context.recorder.watch(topic, partial(count, number))

    def report(self) -> dict[str, Any]:
        orders = self._asked_by[ASKED]
        if not orders:
            return {}
        seen = sum(self._sent[number] for topic, number in _STANDS_FOR.items() if topic != "/estimate/odometry")
        sent = dict(self._sent) | {dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 1}  # /mission is latched
        received = {dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: orders}
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
        return {"nodes": [node], "agents": [agent_traffic(node, [], {"tx": sent, "rx": received})]}


WATCHED_S = 3.0
ENOUGH_SHARE = 0.8
ASKS = 6
_ESTIMATE = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION


class EstimateRate(RunNode):
    """Requests position and attitude at `rate_hz`, and again while estimates arrive more slowly.

    A bridge requests its own rate from its autopilot at the start, so an acknowledgement proves little. An autopilot
    that keeps another rate gets no more than ASKS requests.
    """

    def __init__(self, commands: AutopilotCommands, rate_hz: float) -> None:
        self._commands = commands
        self._rate_hz = rate_hz
        self._asks = 0
        self._estimates = 0
        self._next_ns = 0

    def begin(self, context: RunContext) -> None:
        def count(stamp_ns: int, *odometry: Any) -> None:
            self._estimates += 1

        context.recorder.watch("/estimate/odometry", count)

    def exchange(self, step: RunStep) -> None:
        if self._asks == ASKS or step.now_ns < self._next_ns or not self._commands.view.heard:
            return
        self._next_ns = step.now_ns + round(WATCHED_S * 1e9)
        arrived, self._estimates = self._estimates, 0
        if arrived >= ENOUGH_SHARE * self._rate_hz * WATCHED_S:
            self._asks = ASKS
        elif arrived or not self._asks:
            self._asks += 1
            for message in _ESTIMATE:
                self._commands.stream(message, self._rate_hz)
