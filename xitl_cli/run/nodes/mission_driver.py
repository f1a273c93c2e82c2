"""The driver node of an autonomous run: arm, start the mission, watch it to its end."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.run.nodes.orders import Orders
from xitl_cli.run.pilot import Progress

READY_TIMEOUT_S = 60.0
ASK_WHY_S = 5.0  # before giving up
PREARM = ("PreArm: ", "Arm: ")


class Phase(Enum):
    """What is waited for."""

    READY = "the autopilot to become ready to arm"
    ARMED = "the autopilot to arm"
    STARTED = "the autopilot to change its mode"
    UNDER_WAY = "nothing"


class Departure:
    """Arms the autopilot when it is ready and sets a mode.

    Raises UserError from `update` when that is not done `timeout_s` after the start.
    """

    def __init__(self, orders: Orders, mode: str, timeout_s: float = READY_TIMEOUT_S) -> None:
        self._orders = orders
        self._mode = mode
        self._timeout_s = timeout_s
        self.phase = Phase.READY

    def update(self, sim_ns: int) -> bool:
        """One look at the autopilot; sends the next command when it is time. True once it is under way."""
        orders = self._orders
        if self.phase is Phase.READY and orders.view.ready_to_arm:
            orders.forget()
            self.phase = Phase.ARMED
        if self.phase is Phase.READY and sim_ns > (self._timeout_s - ASK_WHY_S) * 1e9:
            orders.arm(sim_ns)  # refused, with the reasons
        if self.phase is Phase.ARMED and orders.arm(sim_ns):
            self.phase = Phase.STARTED
        if self.phase is Phase.STARTED and orders.set_mode(sim_ns, self._mode):
            self.phase = Phase.UNDER_WAY
        if self.phase is not Phase.UNDER_WAY and sim_ns > self._timeout_s * 1e9:
            said = f"; it said: {', '.join(_latest_reasons(orders.view.texts))}" if orders.view.texts else ""
            raise UserError(f"gave up after {self._timeout_s:g} s of waiting for {self.phase.value}{said}")
        return self.phase is Phase.UNDER_WAY


def _latest_reasons(texts: Iterable[str]) -> list[str]:
    """What keeps it from arming, each once, else the last thing it said."""
    said = list(texts)
    return list(dict.fromkeys(text for text in said if text.startswith(PREARM))) or said[-1:]


class MissionDriver:
    """Sends the commands a person at a ground station would; the mission has `waypoints` items after home."""

    def __init__(self, orders: Orders, waypoints: int, arm_timeout_s: float = READY_TIMEOUT_S) -> None:
        self._view = orders.view
        self._departure = Departure(orders, "AUTO", arm_timeout_s)
        self._total = waypoints
        self._under_way = False

    def update(self, sim_ns: int) -> None:
        self._under_way = self._under_way or self._departure.update(sim_ns)

    def take(self, message: Any) -> None:
        pass

    def progress(self) -> Progress:
        reached = len({seq for seq in self._view.reached_seqs if 1 <= seq <= self._total})
        done = 0 < self._total == reached
        target = reached if self._under_way and not done else None
        return Progress("", target=target, reached=reached, finished=done, completed=done)
