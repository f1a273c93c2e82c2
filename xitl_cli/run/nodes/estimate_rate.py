"""The rate at which the autopilot tells its estimate, where nodes of ROS steer by it."""

from __future__ import annotations

from agent.wire import dialect
from xitl_cli.run.core.node import RunNode, RunStep
from xitl_cli.run.nodes.autopilot_commands import AutopilotCommands

ASKED_S = 20.0
"""For so long it is asked, once it is heard: one that does not know the command answers nothing."""


class EstimateRate(RunNode):
    """Asks for position and attitude at `rate_hz`, one after the other, until each is accepted."""

    def __init__(self, commands: AutopilotCommands, rate_hz: float) -> None:
        self._commands = commands
        self._rate_hz = rate_hz
        self._left = [dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION]
        self._since_ns: int | None = None

    def exchange(self, step: RunStep) -> None:
        if not self._left or not self._commands.view.heard:
            return
        self._since_ns = step.now_ns if self._since_ns is None else self._since_ns
        if step.now_ns - self._since_ns > ASKED_S * 1e9:
            self._left.clear()
        elif self._commands.stream(step.now_ns, self._left[0], self._rate_hz):
            del self._left[0]
            self._commands.forget()
