"""Who turns sensors into motor commands: one interface for an autopilot anywhere, a script, or an ideal pilot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand, TaskTiming
from xitl_cli.run.pace import Pace

if TYPE_CHECKING:
    from xitl_cli.run.nodes.bridge import AutopilotReport
    from xitl_cli.run.nodes.score import EstimationScore
from xitl_cli.run.statistics import Histogram


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the pilot says it is.

    target: index of the waypoint it heads for, None when it heads for none. finished: there is nothing more to do.
    completed: what the driver was there for is done: every waypoint reached, a script or recording played to its end.
    waypoints: the mission under way as (north, east), None for the profile's. waits_for: why the vessel is still
    moored; empty once it may move. faults: names of those in force.
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
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LinkReport:
    """One direction of a link over a whole run; counts the other end keeps are None until it has told them.

    name: `sensors` (to the agent) or `actuators` (from it); those of another link than `agent` have its name before
    them: `standby sensors`.
    lost: sent and never received. gaps: missing from the sequence at the receiver, late: out of order, repeated: came
    twice. unsent: not taken by the transport of the sender. dropped: damaged or unknown ones. refused: without a good
    signature. impaired: kept back for good by a fault on purpose, part of the lost ones. host_end: what the host's
    transport has counted beside that, by name, told with the direction that it hears.
    """

    name: str
    sent: int | None
    received: int | None
    lost: int | None
    unsent: int | None
    dropped: int
    latency: Histogram = field(default_factory=Histogram)
    gaps: int | None = None
    late: int | None = None
    repeated: int | None = None
    refused: int | None = None
    impaired: int | None = None
    host_end: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ClockReport:
    """A node's clock against the host's at the end of a run; None where nothing was measured.

    drift_std_ppm: variation of the drift over windows of 10 s. slope_s, slope_std_s: mean and standard deviation of
    the node's time base a sample. residual_us: spread of the exchanges about the estimate. path_delay_us: shortest
    way there and back, halved. steps: of the node's clock.
    """

    node: str
    offset_us: float | None
    drift_ppm: float | None
    asymmetry_bound_us: float | None = None
    samples: int = 0
    residual_us: float | None = None
    path_delay_us: float | None = None
    drift_std_ppm: float | None = None
    slope_s: float | None = None
    slope_std_s: float | None = None
    steps: int = 0


@dataclass(frozen=True, slots=True)
class NodeReport:
    """What a machine in the loop says of itself. link: the one it is on. None where it does not tell.

    kind: `real` or `virtual`. flags: how it runs, in words. estimates: those that its control used, efforts: those that
    its actuation allocated. log_dropped: records that its log had no room for. stations_missed: what ground stations
    did not get, or said in vain. events_lost: sentences that nobody took in time.
    """

    nodes: str
    machine: str
    version: str
    memory_mib: float | None
    refused: int
    link: str = "agent"
    kind: str = "virtual"
    kernel: str = ""
    python: str = ""
    flags: tuple[str, ...] = ()
    processors: int | None = None
    temperature_c: float | None = None
    cpu_percent: float | None = None
    estimates: int = 0
    efforts: int = 0
    log_dropped: int = 0
    stations_missed: int = 0
    events_lost: int = 0


@dataclass(frozen=True, slots=True)
class ActuatorReport:
    """How old the motor commands were at the exchanges that used them.

    stale: exchanges at which no new one had come; longest_stale: the most of them in a row.
    """

    age: Histogram = field(default_factory=Histogram)
    stale: int = 0
    longest_stale: int = 0


@dataclass(frozen=True, slots=True)
class TakeoverReport:
    """One agent stepped in for another at `at_s`; see records.Takeover."""

    at_s: float
    from_node: str
    to_node: str
    silent_s: float
    step: float


@dataclass(frozen=True, slots=True)
class FaultReport:
    """A fault on purpose: when it was in force, and counts of what it did.

    from_s None: the run ended before it began; until_s None: it was in force to the end.
    """

    name: str
    kind: str
    from_s: float | None
    until_s: float | None
    did: dict[str, int] = field(default_factory=dict)


Traffic = dict[str, dict[str, dict[int, int]]]
"""Frames that crossed each link: by link (`agent`), by direction (`tx` to the agent, `rx` from it), by message id."""


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

    def sense(self, sim_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        """After every physics step: measure and send what is due. air_ned_mps: (N, 3) velocity of the air there."""

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
    def tasks(self) -> list[TaskTiming]: ...
    def clocks(self) -> list[ClockReport]: ...
    def nodes(self) -> list[NodeReport]: ...
    def actuators(self) -> ActuatorReport | None: ...
    def takeovers(self) -> list[TakeoverReport]: ...
    def faults(self) -> list[FaultReport]: ...
    def traffic(self) -> Traffic: ...
    def autopilot(self) -> AutopilotReport | None: ...
