"""Nodes: what takes part in a run, behind one interface, and what the loop tells them.

session.py makes them from the profile (compose.py) and calls, for each in the order of the list:

    attach_operator(operator)  somebody may act in the run
    prepare                    reach what is elsewhere, before anything is recorded
    begin(context)             the run starts
    sense(step)                after every physics step
    exchange(step)             at the exchange rate
    record(step)               after every physics step; of an exchange last, in a fleet before answers are taken in
    receive(seconds)           while there is time until the next step
    end                        the run is over: final counts
    close                      give back processes, sockets and files; may come at any time
    save(folder), report()     files beside the recording, and its part of summary.json
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

from agent.wire.link import Link
from sim_core.kinematics import Kinematics
from sim_core.simulation import SimulationState
from sim_core.world.contact import Contacts
from xitl_cli.record.mcap_file import ChannelMirror
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.pace import Pace
from xitl_cli.run.core.reports import Progress


class SimulationClock:
    """Simulation time. step_ns: end of the latest physics step."""

    def __init__(self, pace: Pace) -> None:
        self.step_ns = 0
        self._pace = pace

    def now_ns(self) -> int:
        """Right now: in real time the world stands at step_ns while time goes on."""
        return self._pace.now_sim_ns(self.step_ns)


@dataclass(frozen=True, slots=True)
class RunContext:
    """What a node is given when the run starts. recorder: takes the topics of the vessel called `vessel`."""

    recorder: Recorder
    pace: Pace
    clock: SimulationClock
    vessel: str = ""


class RunStep(NamedTuple):
    """The world after a physics step. Arrays have a leading vessel axis (N, ...).

    number: counted from 1. now_ns: simulation time at its end. held: the vessel was kept in its state, see Progress.
    """

    number: int
    now_ns: int
    state: SimulationState
    motion: Kinematics
    held: bool = False

    @property
    def contacts(self) -> Contacts:
        """What the vessel touches."""
        return self.state.contacts


class WorldView(Protocol):
    """What a fleet's step is made from; of the latest step of the world."""

    held: bool

    @property
    def state(self) -> SimulationState: ...
    @property
    def contacts(self) -> Contacts: ...
    def motion(self) -> Kinematics: ...


class FleetStep(RunStep):
    """That of one of several vessels: in place of its state stands its view of the plant, which makes it when asked."""

    __slots__ = ()

    @classmethod
    def of(cls, number: int, now_ns: int, view: WorldView) -> FleetStep:
        """As the plant stands now."""
        return cls(number, now_ns, cast("SimulationState", view), view.motion(), view.held)

    @property
    def state(self) -> SimulationState:
        return cast(WorldView, self[2]).state

    @property
    def contacts(self) -> Contacts:
        return cast(WorldView, self[2]).contacts


class RunNode:
    """Does nothing in every method: a node writes those that it needs. See the module for when each is called."""

    def attach_operator(self, operator: Any) -> None:
        """Pass on to `operator` (run.operator.node.OperatorNode) what people ask for. Called before `prepare`."""

    def mirror(self) -> ChannelMirror | None:
        """The object that receives each recorded message too, None for a node that does not."""
        return None

    def prepare(self) -> None:
        """Reach what is elsewhere. Raises UserError when that fails."""

    def begin(self, context: RunContext) -> None:
        """The run starts: simulation time is 0. Raises UserError when it cannot."""

    def sense(self, step: RunStep) -> None:
        """Measure what is due, look at what has happened."""

    def exchange(self, step: RunStep) -> None:
        """Send and take in commands. Raises UserError when the run cannot go on."""

    def record(self, step: RunStep) -> None:
        """Record what is due."""

    def links(self) -> Sequence[Link]:
        """Links on which something may come at any time."""
        return ()

    def receive(self, timeout_s: float) -> None:
        """Take in what has come on them; waits for it at most `timeout_s`."""

    def end(self) -> None:
        """Ask for final counts."""

    def close(self) -> None:
        """Give everything back. Safe to call at any time, and again."""

    def save(self, folder: Path) -> None:
        """Keep files in the run's directory, after `close`. Raises UserError when they cannot be written."""

    def report(self) -> dict[str, Any]:
        """Its part of summary.json by key, see summary.py: lists are joined with those of other nodes."""
        return {}


class ExchangePart(RunNode):
    """The part of an exchange that a node has at another place of the order than its other calls."""

    def __init__(self, exchange: Callable[[RunStep], None]) -> None:
        self._exchange = exchange

    def exchange(self, step: RunStep) -> None:
        self._exchange(step)


class ControlNode(RunNode):
    """The node whose motor commands move the vessel.

    command: in force. progress: as of the latest exchange. position_error_m: latest horizontal error of its estimate,
    None where it has none.
    """

    command: MotorCommand
    progress: Progress
    position_error_m: float | None = None


@dataclass(frozen=True, slots=True)
class VesselNodes:
    """One vessel's nodes, in the order in which they are called; `control` is one of them.

    name: empty where there is one vessel alone. status: of the vessel now, for a view. awaited: a run lasts until it
    has finished.
    """

    name: str
    control: ControlNode
    nodes: tuple[RunNode, ...]
    status: Callable[[], Any] = lambda: None
    awaited: bool = True

    @property
    def ahead(self) -> tuple[RunNode, ...]:
        """Those up to the one that moves the vessel: in an exchange they are called of all vessels before it waits."""
        return self.nodes[: self.nodes.index(self.control)]

    @property
    def behind(self) -> tuple[RunNode, ...]:
        """It, and those behind it."""
        return self.nodes[self.nodes.index(self.control) :]


@dataclass(frozen=True, slots=True)
class WorldNodes:
    """Nodes of what all vessels are in: those that are called before the vessels' and those after."""

    ahead: tuple[RunNode, ...] = ()
    behind: tuple[RunNode, ...] = ()


def overriding(nodes: Iterable[RunNode], method: str) -> list[Callable[..., Any]]:
    """`method` of the nodes that do something there: the others cost nothing at the physics rate."""
    return [getattr(node, method) for node in nodes if getattr(type(node), method) is not getattr(RunNode, method)]
