"""The interface of whatever an operator can steer."""

from __future__ import annotations

from collections import Counter

from xitl_cli.run.operator.actions import (
    Arm,
    ChangeMission,
    ChangeMode,
    CommandMotor,
    EndRun,
    GoTo,
    SteerVelocity,
)
from xitl_cli.run.operator.streams import Say

Order = Arm | ChangeMode | GoTo | SteerVelocity | CommandMotor | ChangeMission | EndRun


class Steering:
    """Receiver of an operator's orders to a vessel."""

    silences: int
    """Number of command streams that ended without a request."""
    asked_by: Counter[str]
    """Number of orders carried out, by client."""

    def check(self, order: Order) -> None:
        """Raise ActionError for an order that is not possible, or while no autopilot is present."""
        raise NotImplementedError

    def give(self, order: Order) -> None:
        """Replace the former order."""
        raise NotImplementedError

    def update(self, now_ns: int, say: Say) -> None:
        """Continue the order. Call it at every exchange, after the orders of that exchange."""
        raise NotImplementedError
