"""Lockstep with ROS nodes: the run stops until each has answered the /clock."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.ros import RosLockstepSpec
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.core.pace import LISTEN_S, OperatedLockstep

LOOK_S = 0.002
CLOCK_AGAIN_S = 0.2
SETTLED_S = 1.0
"""Wait after the first message of a node, so that its other endpoints and the bridge discover each other."""


class AnsweringNodes(Protocol):
    """Source of nodes' answers: see LiveRosNode."""

    answers_ns: dict[str, int]

    @property
    def lost(self) -> bool: ...
    def poll(self, timeout_s: float = 0.0) -> None: ...
    def tell_clock_again(self) -> None: ...


class RosLockstepNode(RunNode):
    """Runs after the bridge, which has received everything recorded up to a standstill.

    Requests of nodes before their answer are carried out at the next exchange. tell: shows a text to the user.
    interrupted: returns True when the user asked to stop.
    """

    def __init__(
        self,
        keys: RosLockstepSpec,
        clock: ClockSpec,
        nodes: AnsweringNodes,
        tell: Callable[[str], object],
        interrupted: Callable[[], bool],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._keys = keys
        self._every = max(round(keys.step_s * clock.physics_rate_hz), 1)
        self._nodes = nodes
        self._tell = tell
        self._interrupted = interrupted
        self._now_s = now_s
        self._stood_s = 0.0
        self._standstills = 0
        self._unanswered: Counter[str] = Counter()
        self._given_up: dict[str, int] = {}
        self._warnings: list[str] = []
        self._recorder: Any = None
        self._pace: Any = None

    def begin(self, context: RunContext) -> None:
        self._recorder, self._pace = context.recorder, context.pace
        self._tell(f"ros: waits for {', '.join(self._keys.nodes)} to publish on ready")
        self._stand(0, self._keys.start_timeout_s)
        until_s = self._now_s() + SETTLED_S
        while self._now_s() < until_s and not self._interrupted() and not self._nodes.lost:
            self._nodes.poll(LOOK_S)

    def record(self, step: RunStep) -> None:
        if step.number % self._every == 0:
            self._standstills += 1
            self._stand(step.now_ns, self._keys.timeout_s)

    def _stand(self, now_ns: int, timeout_s: float) -> None:
        """Wait until each node has answered, `timeout_s` at most. A missing node counts again after its next answer."""
        answers_ns = self._nodes.answers_ns
        self._given_up = {node: told for node, told in self._given_up.items() if answers_ns.get(node, -1) == told}
        self._unanswered.update(self._given_up.keys())
        began_s = now_s = listened_s = told_s = self._now_s()
        while (missing := self._missing(now_ns)) and not self._interrupted() and not self._nodes.lost:
            if now_s - began_s >= timeout_s:
                self._give_up(now_ns, missing, timeout_s)
                break
            self._nodes.poll(LOOK_S)
            now_s = self._now_s()
            if now_s - told_s >= CLOCK_AGAIN_S:
                told_s = now_s
                self._nodes.tell_clock_again()
            if now_s - listened_s >= LISTEN_S and isinstance(self._pace, OperatedLockstep):
                listened_s = now_s
                self._pace.listen()
        self._stood_s += now_s - began_s

    def _missing(self, now_ns: int) -> list[str]:
        answers_ns = self._nodes.answers_ns
        waited_for = [node for node in self._keys.nodes if node not in self._given_up]
        return [node for node in waited_for if answers_ns.get(node, -1) < now_ns]

    def _give_up(self, now_ns: int, missing: list[str], timeout_s: float) -> None:
        heard = ", ".join(self._nodes.answers_ns) or "nobody"
        text = (
            f"ros.lockstep: {', '.join(missing)} did not answer the /clock {now_ns * 1e-9:g} s on ready within "
            f"{timeout_s:g} s (heard: {heard})"
        )
        if self._keys.without_answer == "end":
            raise UserError(f"{text}; give more ros.lockstep.timeout_s, or without_answer: go-on")
        first = not any(self._unanswered[node] for node in missing)
        self._unanswered.update(missing)
        self._given_up |= {node: self._nodes.answers_ns.get(node, -1) for node in missing}
        if first:
            self._warnings.append(f"{text}; the run goes on, does not repeat, and waits once it answers again")
            self._recorder.log(now_ns, WARNING, "ros", self._warnings[-1])
            self._tell(f"warning: {self._warnings[-1]}")

    def report(self) -> dict[str, Any]:
        """Return ros.lockstep: number of standstills, their wall clock time, missing answers."""
        lockstep = {
            "standstills": self._standstills,
            "stood_s": self._stood_s,
            "unanswered": dict(self._unanswered),
        }
        return {"ros": {"lockstep": lockstep}, "warnings": list(self._warnings)}
