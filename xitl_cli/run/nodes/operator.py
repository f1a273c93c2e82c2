"""The operator of a run: accepts actions of users, carries them out at exchanges, and records them.

    refusal = operator.ask({"action": "wind", "mean_mps": 6}, "view")

`listen` registers a source of actions. It is polled at every exchange, and while the run is paused.
"""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

from agent.wire.dialect import MAV_SEVERITY_INFO as INFO
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core.environment.spec import EnvironmentSpec
from sim_core.environment.waves import FlatWater, WaveField
from sim_core.world.debris import BodyKind, Launch
from xitl_cli.record.topics import OperatorAction, SeaComponents
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.core.pace import OperatedLockstep
from xitl_cli.run.nodes.river import RiverNode
from xitl_cli.run.nodes.vessel_orders import VesselOrders, link_fault_name
from xitl_cli.run.operator.actions import (
    ENVIRONMENT,
    OF_PACE,
    STEERED,
    STREAMED,
    ActionError,
    ChangePace,
    ImpairLink,
    LaunchBody,
    Pause,
    Resume,
    Step,
    SwitchFault,
    action_name,
    read_action,
)
from xitl_cli.run.operator.environment_changes import EnvironmentChanges
from xitl_cli.run.operator.operation import TimedAction
from xitl_cli.run.operator.steering import Order, Steering

SOURCE = "operator"
REPLAYED = "--replay-events"
WAVES_NS = 500_000_000
"""Time between two records of changing waves."""


class _Asked(NamedTuple):
    """An accepted action as it is recorded, with its source and the function that carries it out."""

    action: Mapping[str, Any]
    source: str
    carry_out: Callable[[], object]


class OperatorNode(RunNode):
    """Carries out actions: see the package. A refused action has no effect.

    changes, river: receivers of the world's actions. steering: vessels that accept steering orders, by name. orders:
    vessels with an autopilot, by name. events: actions of an earlier run, repeated at their instants. Actions of the
    pace are only recorded again. paused, factor: the current pace; factor None is as fast as possible.
    """

    def __init__(
        self,
        changes: EnvironmentChanges,
        river: RiverNode,
        vessels: Sequence[str],
        steering: Mapping[str, Steering],
        orders: Mapping[str, VesselOrders],
        events: Sequence[TimedAction] = (),
    ) -> None:
        self._changes = changes
        self._river = river
        self._vessels = tuple(vessels)
        self._steering = steering
        self._orders = orders
        self._events = deque(events)
        self._listeners: list[Callable[[], object]] = []
        self._asked: deque[_Asked] = deque()
        self._pace: OperatedLockstep | None = None
        self._paused = False
        self._paused_by: str | None = None
        self._now_ns = 0
        self._waves, self._waves_ns = changes.waves, 0
        self._done: Counter[str] = Counter()
        self._refused = self._replayed = self._superseded = 0

    @property
    def paused(self) -> bool:
        """Whether the run is paused, or will be at the next exchange."""
        return self._paused

    @property
    def paused_by(self) -> str | None:
        """The source that asked for the pause; None while the run is not paused."""
        return self._paused_by if self._paused else None

    @property
    def waiting_launches(self) -> tuple[Launch, ...]:
        """Bodies that the next exchange puts into the water, in the order of the requests."""
        launches = (read_action(asked.action) for asked in self._asked if asked.action["action"] == "launch")
        return tuple(self._launch(asked) for asked in launches if isinstance(asked, LaunchBody))

    @property
    def now_ns(self) -> int:
        """Simulation time of the latest exchange."""
        return self._now_ns

    @property
    def factor(self) -> float | None:
        """Multiple of real time."""
        return None if self._pace is None else self._pace.factor

    @property
    def environment(self) -> EnvironmentSpec:
        """The requested environment."""
        return self._changes.asked

    @property
    def faults(self) -> dict[str, tuple[str, ...]]:
        """Names of the faults that an action can switch on, by vessel."""
        return {vessel: orders.fault_names() for vessel, orders in self._orders.items()}

    def listen(self, poll: Callable[[], object]) -> None:
        """Call `poll` whenever an action is possible."""
        self._listeners.append(poll)

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder
        if isinstance(context.pace, OperatedLockstep):
            self._pace = context.pace
            self._pace.listen = self._poll

    def ask(self, action: object, source: str = SOURCE) -> str | None:
        """Carry out an action at the next exchange; the end of a pause at once.

        Returns the reason in one sentence if it refuses.
        """
        try:
            carry_out = self._carrier(action)
            assert isinstance(action, Mapping)
            asked = _Asked(dict(action), source, carry_out)
            if asked.action["action"] in STREAMED:  # drop an earlier action of the same stream
                earlier = [other for other in self._asked if _stream(other.action) == _stream(asked.action)]
                for other in earlier:
                    self._asked.remove(other)
                    self._superseded += 1
            elif asked.action["action"] == "pause":
                self._paused_by = source
            self._asked.append(asked)
        except ActionError as error:
            self._refused += 1
            return str(error)
        return None

    def exchange(self, step: RunStep) -> None:
        def say(vessel: str, text: str) -> None:
            self._recorder.log(self._now_ns, INFO, SOURCE, f"{vessel}: {text}" if vessel else text)

        self._now_ns = step.now_ns
        self._poll()
        while self._events and self._events[0].time_ns <= step.now_ns:
            event = self._events.popleft()
            try:
                carry_out = self._carrier(event.action, again=True)
            except ActionError as error:
                self._refused += 1
                text = f"{REPLAYED}: refused at {event.time_ns * 1e-9:.2f} s: {error}"
                self._recorder.log(self._now_ns, WARNING, SOURCE, text)
                continue
            self._replayed += 1
            self._asked.append(_Asked(event.action, event.source, carry_out))
        while self._asked:
            asked = self._asked.popleft()
            asked.carry_out()
            self._record(asked.action, asked.source)
        self._changes.update(step.now_ns)
        # Record changed waves. A recording has the profile's waves by the profile alone.
        waves, changes = self._changes.waves, self._changes
        if waves is not self._waves and (changes.is_settled or self._now_ns - self._waves_ns >= WAVES_NS):
            self._waves, self._waves_ns = waves, self._now_ns
            self._recorder.write(self._now_ns, _components(waves))
        for vessel, steering in self._steering.items():
            steering.update(step.now_ns, partial(say, vessel))

    def report(self) -> dict[str, Any]:
        if not (self._done or self._refused or self._events or self._replayed):
            return {"operator": None}
        left = len(self._events)
        silences = sum(steering.silences for steering in self._steering.values())
        return {
            "operator": {
                "actions": dict(self._done),
                "refused": self._refused,
                "replayed": self._replayed,
                "not_replayed": left,
                "superseded": self._superseded,
                "silences": silences,
            },
            "warnings": [f"{REPLAYED}: the run ended before {left} of the actions"] if left else [],
        }

    def _poll(self) -> None:
        for poll in self._listeners:
            poll()

    def _record(self, action: Mapping[str, Any], source: str) -> None:
        self._done[str(action["action"])] += 1
        text = json.dumps(action, ensure_ascii=False, allow_nan=False)
        self._recorder.write(self._now_ns, OperatorAction(text, source))
        steering = self._steering.get(action.get("vessel", ""))
        if steering is not None and action["action"] in STEERED:
            steering.asked_by[source] += 1
        if action["action"] not in STREAMED:  # such as `wind mean_mps 6, direction_deg 90`
            values = {key: json.dumps(value, ensure_ascii=False) for key, value in action.items() if key != "action"}
            words = ", ".join(f"{key} {value}" for key, value in values.items())
            self._recorder.log(self._now_ns, INFO, SOURCE, f"{action['action']} {words}".strip() + f" ({source})")

    # Functions that carry out an action. They raise ActionError.

    def _carrier(self, action: object, again: bool = False) -> Callable[[], object]:
        name = action_name(action)
        assert isinstance(action, Mapping)
        if name in ENVIRONMENT:
            return partial(self._changes.ask, name, self._changes.read(name, action))
        asked = read_action(action)
        if name in OF_PACE:
            return (lambda: None) if again else self._pace_carrier(name, asked)
        if isinstance(asked, LaunchBody):
            body = self._launch(asked)
            refusal = self._river.refusal(body)
            if refusal is not None:
                raise ActionError(f"launch: {refusal}")
            return partial(self._river.launch, body)
        vessel = asked.vessel  # type: ignore[attr-defined]
        if vessel not in self._vessels:
            known = "the only vessel has no name" if self._vessels == ("",) else f"use {', '.join(self._vessels)}"
            raise ActionError(f"{name}: vessel = {vessel!r} is not in this run; {known}")
        if isinstance(asked, SwitchFault):
            orders = self._orders_of(name, vessel)
            return partial(orders.inject, asked.name, orders.read_fault(asked, self._now_ns))
        if isinstance(asked, ImpairLink):
            orders = self._orders_of(name, vessel)
            return partial(orders.inject, link_fault_name(asked), orders.read_link(asked, self._now_ns))
        order = cast(Order, asked)
        if vessel not in self._steering:
            raise self._no_autopilot(name, vessel)
        steering = self._steering[vessel]
        steering.check(order)
        return partial(steering.give, order)

    def _launch(self, asked: LaunchBody) -> Launch:
        kind, heading_rad = BodyKind[asked.kind.upper()], math.radians(asked.heading_deg)
        return Launch(self._now_ns, kind, asked.north_m, asked.east_m, heading_rad, asked.length_m)

    def _orders_of(self, name: str, vessel: str) -> VesselOrders:
        if vessel not in self._orders:
            raise self._no_autopilot(name, vessel)
        return self._orders[vessel]

    @staticmethod
    def _no_autopilot(name: str, vessel: str) -> ActionError:
        hint = ", or driver.kind: ros" if name in STREAMED else ""
        return ActionError(f"{name}: {vessel or 'the vessel'} has no autopilot; use autopilot.kind: embedded{hint}")

    def _pace_carrier(self, name: str, asked: object) -> Callable[[], object]:
        """Return the function for a pace action.

        An action that ends or shortens a pause acts at once, without an exchange.
        """
        pace = self._pace
        if pace is None:
            raise ActionError(f"{name}: not possible in real time; use clock.mode: lockstep")
        if isinstance(asked, Pause):
            if self._paused:
                raise ActionError("pause: the run is paused already; resume or step it")
            self._paused = True
            return lambda: pace.pause(self._now_ns) if self._paused else None
        if isinstance(asked, ChangePace):
            pace.set_factor(asked.factor)
            return lambda: None
        if not self._paused:
            raise ActionError(f"{name}: the run is not paused; pause it first")
        if isinstance(asked, Resume):
            self._paused = False
            pace.resume()
            return lambda: None
        assert isinstance(asked, Step)
        carry_out = partial(pace.step, round(asked.seconds * 1e9))
        if not pace.paused:
            return carry_out
        carry_out()
        return lambda: None


def _components(waves: WaveField | FlatWater) -> SeaComponents:
    if not isinstance(waves, WaveField):
        return SeaComponents((), (), (), (), ())
    north, east = waves.wave_vector_radpm.T.tolist()
    frequency, phase = waves.apparent_omega_radps.tolist(), waves.phase_rad.tolist()
    return SeaComponents(waves.amplitude_m.tolist(), north, east, frequency, phase)


def _stream(action: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the key of a stream: a new action replaces an earlier one with the same key."""
    return action["action"], action.get("vessel", ""), action.get("number")
