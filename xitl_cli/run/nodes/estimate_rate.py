"""The rate of the autopilot's estimates, for ROS nodes that steer by them."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.links.autopilot_commands import AutopilotCommands

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
        self._came = 0
        self._look_ns = 0

    def begin(self, context: RunContext) -> None:
        context.recorder.watch("/estimate/odometry", self._count)

    def exchange(self, step: RunStep) -> None:
        if self._asks == ASKS or step.now_ns < self._look_ns or not self._commands.view.heard:
            return
        self._look_ns = step.now_ns + round(WATCHED_S * 1e9)
        came, self._came = self._came, 0
        if came >= ENOUGH_SHARE * self._rate_hz * WATCHED_S:
            self._asks = ASKS
        elif came or not self._asks:
            self._asks += 1
            for message in _ESTIMATE:
                self._commands.stream(message, self._rate_hz)

    def _count(self, stamp_ns: int, *odometry: Any) -> None:
        self._came += 1
