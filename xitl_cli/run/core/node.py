"""Nodes: the parts of a run, behind one interface, and the data that the loop gives them.

run/composition makes them from the profile. session.py and loop.py call, for each node in the order of the list:

    attach_operator(operator)  somebody may act in the run
    prepare                    connect to other processes and boards, before the recording begins
    begin(context)             the run starts
    touch(step)                after each physics step in which the vessel touches something
    sense(step)                after every physics step, or every `sense_every` steps
    exchange(step)             at the exchange rate
    record(step)               after every physics step, or every `record_every` steps; last in an exchange, in a fleet
                               before answers are read
    receive(seconds)           while there is time until the next step
    end                        the run is over: final counts
    close                      release processes, sockets and files; may be called at any time
    save(folder), report()     files beside the recording, and its part of summary.json
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from agent.wire.link import Link
from sim_core.dataclass import dataclass
from sim_core.kinematics import Kinematics
from sim_core.simulation import SimulationState
from sim_core.state_class import state_class
from sim_core.world.contact import Contacts
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Edge
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
        """Current simulation time. In real time, it continues after the latest step."""
        return self._pace.now_sim_ns(self.step_ns)


@dataclass(frozen=True, slots=True)
class RunContext:
    """Data for a node when the run starts."""

    recorder: Recorder
    """Recorder of the topics of `vessel`."""
    pace: Pace
    clock: SimulationClock
    vessel: str = ""


class WorldView(Protocol):
    """A vessel's view of the latest step of the world."""

    @property
    def state(self) -> SimulationState: ...
    @property
    def contacts(self) -> Contacts: ...


@state_class
class RunStep:
    """The world after a physics step. Arrays have a leading vessel axis (N, ...)."""

    number: int
    """Counts from 1."""
    now_ns: int
    """Simulation time at the end of the step."""
    world: WorldView
    motion: Kinematics
    held: bool = False
    """The vessel was frozen, see Progress."""

    @property
    def state(self) -> SimulationState:
        """State of the world around the vessel. In a fleet it is made on request."""
        return self.world.state

    @property
    def contacts(self) -> Contacts:
        """Contacts of the vessel."""
        return self.world.contacts


class RunNode:
    """Base of all nodes. Each method does nothing; a node overrides those it needs. The module lists the calls.

    A period counts physics steps: a call is due when it divides the number of the step. The loop reads it once, at the
    start of the run.
    """

    sense_every = 1
    """Period of `sense`."""
    record_every = 1
    """Period of `record`."""

    def attach_operator(self, operator: Any) -> None:
        """Pass on to `operator` (run.nodes.operator.OperatorNode) what people ask for. Called before `prepare`."""

    def mirror(self) -> ChannelMirror | None:
        """The object that receives each recorded message too, None for a node that does not."""
        return None

    def prepare(self) -> None:
        """Connect to other processes and boards. Raises UserError when that fails."""

    def begin(self, context: RunContext) -> None:
        """The run starts: simulation time is 0. Raises UserError when it cannot."""

    def touch(self, step: RunStep) -> None:
        """Evaluate the contacts of the vessel, of which there is at least one."""

    def sense(self, step: RunStep) -> None:
        """Take the measurements that are due."""

    def exchange(self, step: RunStep) -> None:
        """Send samples and receive commands. Raises UserError when the run cannot continue."""

    def record(self, step: RunStep) -> None:
        """Record what is due."""

    def links(self) -> Sequence[Link]:
        """Links on which data may arrive at any time."""
        return ()

    def receive(self, timeout_s: float) -> None:
        """Read the data that arrived on the links; wait for it at most `timeout_s`."""

    def end(self) -> None:
        """Request the final counts."""

    def close(self) -> None:
        """Release all resources. It is safe to call this at any time, and again."""

    def save(self, folder: Path) -> None:
        """Write files into the directory of the run, after `close`. Raises UserError when that fails."""

    def report(self) -> dict[str, Any]:
        """Return the node's part of summary.json by key. summary.py joins lists with those of other nodes."""
        return {}


class ExchangePart(RunNode):
    """The exchange of a node, at another position of the order than its other calls."""

    def __init__(self, exchange: Callable[[RunStep], None]) -> None:
        self._exchange = exchange

    def exchange(self, step: RunStep) -> None:
        self._exchange(step)


class ControlNode(RunNode):
    """Node that moves the vessel by its motor commands."""

    command: MotorCommand
    """Active command."""
    progress: Progress
    """Progress at the latest exchange."""
    position_error_m: float | None = None
    """Latest horizontal error of the node's position estimate, None without an estimate."""


@dataclass(frozen=True, slots=True)
class VesselNodes:
    """Nodes of one vessel."""

    name: str
    """Name of the vessel, empty if there is only one."""
    control: ControlNode
    nodes: tuple[RunNode, ...]
    """All nodes in the order of the calls, with `control`."""
    awaited: bool = True
    """The run waits until this vessel has finished."""
    edges: tuple[Edge, ...] = ()
    """Links of the run's graph that the nodes declare."""

    @property
    def ahead(self) -> tuple[RunNode, ...]:
        """Nodes before `control`. In an exchange, they are called for all vessels before any `control` waits."""
        return self.nodes[: self.nodes.index(self.control)]

    @property
    def behind(self) -> tuple[RunNode, ...]:
        """`control` and the nodes after it."""
        return self.nodes[self.nodes.index(self.control) :]


@dataclass(frozen=True, slots=True)
class WorldNodes:
    """Nodes of the shared world: called before the nodes of the vessels, and after them."""

    ahead: tuple[RunNode, ...] = ()
    behind: tuple[RunNode, ...] = ()


def overriding(nodes: Iterable[RunNode], method: str) -> list[Callable[..., Any]]:
    """Return `method` of the nodes that override it, so that the others cost nothing at the physics rate."""
    return [getattr(node, method) for node in nodes if getattr(type(node), method) is not getattr(RunNode, method)]


class PluginNodeError(UserError):
    """A node of a plug-in raised an exception. It ends the run, whatever `clock.on_loss` is."""
