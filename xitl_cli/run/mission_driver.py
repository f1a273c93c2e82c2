"""The driver node of an autonomous run: arm, start the mission, watch it to its end."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any

from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.run.agent_view import AgentView

AUTO_MODE = 10
READY_TIMEOUT_S = 60.0
REPEAT_S = 1.0


class Phase(Enum):
    """What the driver waits for."""

    READY = "the autopilot to become ready to arm"
    ARMED = "the autopilot to arm"
    STARTED = "the autopilot to start the mission"
    ARRIVED = "the mission to end"


class MissionDriver:
    """Sends the commands a person at a ground station would, on simulation time.

    Raises UserError from `update` when the autopilot is not under way `READY_TIMEOUT_S` after the start.
    """

    def __init__(self, view: AgentView, send: Callable[[Any], object], system_id: int, component_id: int) -> None:
        self._view = view
        self._send = send
        self._target = (system_id, component_id)
        self._sent_ns: int | None = None
        self.phase = Phase.READY

    def update(self, sim_ns: int) -> None:
        """One look at the autopilot; sends the next command when it is time."""
        accepted = dialect.MAV_RESULT_ACCEPTED
        if self.phase is Phase.READY and self._view.ready_to_arm:
            self._enter(Phase.ARMED)
        if self.phase is Phase.ARMED:
            if self._view.acks.get(dialect.MAV_CMD_COMPONENT_ARM_DISARM) == accepted:
                self._enter(Phase.STARTED)
            else:
                self._command(sim_ns, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if self.phase is Phase.STARTED:
            if self._view.acks.get(dialect.MAV_CMD_DO_SET_MODE) == accepted:
                self._enter(Phase.ARRIVED)
            else:
                flag = float(dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
                self._command(sim_ns, dialect.MAV_CMD_DO_SET_MODE, flag, float(AUTO_MODE))
        if self.phase is not Phase.ARRIVED and sim_ns > READY_TIMEOUT_S * 1e9:
            said = f"; it last said: {self._view.texts[-1]}" if self._view.texts else ""
            raise UserError(f"gave up after {READY_TIMEOUT_S:.0f} s of waiting for {self.phase.value}{said}")

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._sent_ns = None

    def _command(self, sim_ns: int, command: int, *parameters: float) -> None:
        if self._sent_ns is not None and sim_ns - self._sent_ns < REPEAT_S * 1e9:
            return
        self._sent_ns = sim_ns
        self._view.acks.pop(command, None)
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self._send(dialect.MAVLink_command_long_message(*self._target, command, 0, *values))
