"""A script of timed orders to an autopilot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.profile.schema.operation import ScriptStep
from xitl_cli.run.nodes.orders import REPEAT_S, Orders
from xitl_cli.run.pilot import Progress

LAST_ORDER_S = 2.0  # an end waits so long for the orders of its own step
RC_INTERVAL_S = 0.1  # an autopilot takes an override that is not repeated for a lost transmitter


class ScriptDriver:
    """Gives the orders of each step from its time on: mode, then arm, then RC and target.

    Mode and arm are repeated every second until they are accepted or the next step begins; RC pulses stay in force,
    and are repeated, until a later step gives others. Completed is a script whose steps were all reached and whose
    orders were all accepted. The mission on board, which a script may start, has `waypoints` items after home.
    """

    def __init__(self, orders: Orders, frame: LocalFrame, steps: Sequence[ScriptStep], waypoints: int) -> None:
        self._orders = orders
        self._steps = steps
        self._targets = [_place(frame, step.goto_ned_m) for step in steps]
        self._total = waypoints
        self._number = -1
        self._now_ns = -1
        self._mode_set = self._armed = True
        self._refused = 0
        self._pulses: tuple[int | None, ...] | None = None
        self._pulses_ns: int | None = None
        self._target_ns: int | None = None

    def update(self, sim_ns: int) -> None:
        self._now_ns = sim_ns
        while self._number + 1 < len(self._steps) and round(self._steps[self._number + 1].at_s * 1e9) <= sim_ns:
            self._begin(self._number + 1)
        if self._number < 0:
            return
        step = self._steps[self._number]
        if step.mode is not None and not self._mode_set:
            self._mode_set = self._orders.set_mode(sim_ns, step.mode)
        if step.arm is not None and self._mode_set and not self._armed:
            self._armed = self._orders.arm(sim_ns, step.arm)
        if self._mode_set and self._armed:
            self._go_to(sim_ns)
        if self._pulses is not None and _is_due(self._pulses_ns, RC_INTERVAL_S, sim_ns):
            self._orders.rc(self._pulses)
            self._pulses_ns = sim_ns

    def take(self, message: Any) -> None:
        pass

    def progress(self) -> Progress:
        played = self._number + 1 == len(self._steps)
        settled = self._settled()
        given_up = self._now_ns - round(self._steps[-1].at_s * 1e9) >= LAST_ORDER_S * 1e9
        view = self._orders.view
        reached = len({seq for seq in view.reached_seqs if 1 <= seq <= self._total})
        sailing = view.armed and view.mode == "AUTO" and reached < self._total
        return Progress(
            "",
            target=reached if sailing else None,
            reached=reached,
            finished=played and self._steps[-1].end and (settled or given_up),
            completed=played and settled and not self._refused,
        )

    def _settled(self) -> bool:
        """Whether the orders of the step in force were accepted."""
        mode = self._mode_set or self._orders.accepted(dialect.MAV_CMD_DO_SET_MODE)
        return mode and (self._armed or self._orders.accepted(dialect.MAV_CMD_COMPONENT_ARM_DISARM))

    def _begin(self, number: int) -> None:
        if not self._settled():
            self._refused += 1
        step = self._steps[number]
        self._orders.forget()
        self._number = number
        self._mode_set, self._armed = step.mode is None, step.arm is None
        self._target_ns = None
        if step.rc_us is not None:
            self._pulses = _laid_over(self._pulses or (), step.rc_us)
            self._pulses_ns = None

    def _go_to(self, sim_ns: int) -> None:
        """Nothing answers a target: it is repeated while the step is in force and the vehicle is in GUIDED."""
        target = self._targets[self._number]
        if target is None or not _is_due(self._target_ns, REPEAT_S, sim_ns):
            return
        if self._target_ns is None or self._orders.view.mode == "GUIDED":
            self._orders.go_to(sim_ns, *target)
        self._target_ns = sim_ns


def _laid_over(before: Sequence[int | None], pulses: Sequence[int | None]) -> tuple[int | None, ...]:
    count = max(len(before), len(pulses))
    old, new = ([*values, *[None] * (count - len(values))] for values in (before, pulses))
    return tuple(o if n is None else n for o, n in zip(old, new, strict=True))


def _is_due(last_ns: int | None, every_s: float, now_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns >= every_s * 1e9


def _place(frame: LocalFrame, goto_ned_m: tuple[float, float] | None) -> tuple[float, float, float] | None:
    if goto_ned_m is None:
        return None
    lat, lon, alt = frame.geodetic(np.array([[*goto_ned_m, 0.0]]))
    return float(lat[0]), float(lon[0]), float(alt[0])
