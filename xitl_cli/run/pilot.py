"""Who turns sensors into motor commands: one interface for an autopilot anywhere, a script, or an ideal pilot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from sim_core.kinematics import Kinematics
from xitl_cli.recording.recorder import Recorder
from xitl_cli.recording.records import MotorCommand, Task
from xitl_cli.run.histogram import Histogram
from xitl_cli.run.pace import Pace
from xitl_cli.run.score import EstimationScore


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the pilot says it is.

    target: index of the waypoint it heads for, None when it heads for none. finished: there is nothing more to do.
    completed: what the driver was there for is done: every waypoint reached, a script or recording played to its end.
    waypoints: the mission under way as (north, east), None for the profile's. waits_for: why the vessel is still
    moored; empty once it may move.
    """

    mode: str
    armed: bool = False
    target: int | None = None
    reached: int = 0
    finished: bool = False
    completed: bool = False
    waypoints: tuple[tuple[float, float], ...] | None = None
    waits_for: str = ""
    messages: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LinkReport:
    """One direction of a link over a whole run; counts the other end keeps are None until it has told them.

    lost: missing from the sequence at the receiver. unsent: not taken by the transport of the sender. dropped: damaged
    or unknown ones.
    """

    name: str
    sent: int | None
    received: int | None
    lost: int | None
    unsent: int | None
    dropped: int
    latency: Histogram = field(default_factory=Histogram)


@dataclass(frozen=True, slots=True)
class ClockReport:
    """A node's clock against the host's at the end of a run; None where nothing was measured."""

    node: str
    offset_us: float | None
    drift_ppm: float | None
    asymmetry_bound_us: float | None = None
    samples: int = 0


@dataclass(frozen=True, slots=True)
class NodeReport:
    """What a machine in the loop says of itself. `memory_mib` is None where it does not tell."""

    nodes: str
    machine: str
    version: str
    memory_mib: float | None
    refused: int


class Pilot(Protocol):
    """Sensors in, motor commands out, its time beside ours.

    command: the motor commands in force. estimation: error of its estimate, None where it knows the truth.
    stale_exchanges: exchanges at which no new command had come.
    """

    command: MotorCommand
    estimation: EstimationScore | None
    stale_exchanges: int

    def prepare(self) -> None:
        """Reach whatever is needed, before anything is recorded. Raises UserError when that fails."""

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        """The run starts: simulation time is 0."""

    def sense(self, sim_ns: int, motion: Kinematics) -> None:
        """After every physics step: measure and send what is due."""

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        """At the exchange rate: ask for and take in commands."""

    def idle(self, seconds: float) -> None:
        """Nothing is due for so long; may return earlier."""

    def progress(self) -> Progress:
        """How far it is."""

    def position_error_m(self) -> float | None:
        """Latest horizontal error of its estimate, None where it has none."""

    def end(self) -> None:
        """The run is over: ask for final counts."""

    def close(self) -> None:
        """Give back processes and sockets. Safe to call at any time."""

    def links(self) -> list[LinkReport]: ...
    def tasks(self) -> list[Task]: ...
    def clocks(self) -> list[ClockReport]: ...
    def nodes(self) -> list[NodeReport]: ...
