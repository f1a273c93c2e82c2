"""What a run reports, in one form for the recorder, the live view and the summary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the autopilot believes about the vessel, in the same local frame as the truth."""

    pos_ned_m: NDArray[np.float64]
    vel_ned_mps: NDArray[np.float64]
    quat_ned_frd: NDArray[np.float64]
    gyro_frd_radps: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MotorCommand:
    """Commands in force, one a motor in [-1, 1], and how old they are; None where that cannot be told."""

    motors: tuple[float, ...]
    armed: bool = False
    failsafe: bool = False
    age_s: float | None = 0.0


@dataclass(frozen=True, slots=True)
class Task:
    """How one periodic task of a node kept its deadlines since the run started.

    missed: cycles skipped, or ended after the next was due; skipped: the first kind alone. worst_run_ns,
    worst_start_ns: simulation time at which the longest run and the most delayed start began, None unknown.
    Histograms count cycles by time: bin 0 below 2 µs, bin k from 2^k to below 2^(k+1) µs, the last one all that is
    longer; empty where none was kept.
    """

    node: str
    task: str
    rate_hz: float
    cycles: int
    missed: int
    start_jitter_max_s: float = 0.0
    run_mean_s: float = 0.0
    run_max_s: float = 0.0
    skipped: int = 0
    start_jitter_mean_s: float = 0.0
    worst_run_ns: int | None = None
    worst_start_ns: int | None = None
    start_histogram: tuple[int, ...] = ()
    run_histogram: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Miss:
    """One deadline that a task missed; instants in simulation time. skipped: cycles skipped before it started."""

    node: str
    task: str
    cycle: int
    due_ns: int
    start_ns: int
    end_ns: int
    skipped: int = 0


@dataclass(frozen=True, slots=True)
class Clock:
    """One exchange of time stamps with a node, and the relation of the clocks estimated from all of them.

    `offset_s` is node minus host at `host_ns`; `drift_ppm` is how much faster the node runs. residual_s: of this
    exchange against the estimate. path_delay_s: shortest way there and back, halved. asymmetry_bound_s: how far the
    offset can be wrong for want of symmetry. steps: how often the node's clock has stepped. None: not known.
    """

    node: str
    sample: int
    host_ns: int
    node_ns: int
    round_trip_s: float
    offset_s: float
    drift_ppm: float
    residual_s: float | None = None
    path_delay_s: float | None = None
    asymmetry_bound_s: float | None = None
    steps: int = 0


@dataclass(frozen=True, slots=True)
class LinkState:
    """One direction of a link so far, counted as LinkReport counts; None where the other end has not told yet.

    name: as in LinkReport, `sensors` or `standby actuators`.
    """

    name: str
    sent: int | None
    received: int | None
    lost: int | None = None
    gaps: int | None = None
    late: int | None = None
    repeated: int | None = None
    dropped: int | None = None
    unsent: int | None = None
    refused: int | None = None
    impaired: int | None = None
    latency_p50_s: float | None = None
    latency_p99_s: float | None = None
    latency_max_s: float | None = None


@dataclass(frozen=True, slots=True)
class ActuatorAge:
    """How old the motor commands in use were so far, from the agent's sending to the exchange that used them.

    stale: exchanges without a new one; longest_stale: the most of them in a row.
    """

    exchanges: int
    stale: int
    longest_stale: int
    age_p50_s: float | None = None
    age_p99_s: float | None = None
    age_max_s: float | None = None


@dataclass(frozen=True, slots=True)
class NodeState:
    """What a machine in the loop says of itself. node: the link it is on; nodes: the kinds it runs, as `LS,LC,LA`.

    kind: `real` or `virtual`. flags: how it runs, in words. cpu_percent: of one core. None: not known.
    """

    node: str
    nodes: str
    kind: str
    machine: str
    kernel: str
    version: str
    memory_mib: float | None = None
    cpu_percent: float | None = None
    load: float | None = None
    temperature_c: float | None = None
    running: bool = False
    flags: str = ""


@dataclass(frozen=True, slots=True)
class Takeover:
    """One agent stepped in for another. step: the largest change of a motor command in the exchange that switched."""

    from_node: str
    to_node: str
    silent_s: float
    step: float


@dataclass(frozen=True, slots=True)
class PaceReport:
    """How often the world stood still because the machine that simulates it did, and for how long in all."""

    slips: int = 0
    slipped_s: float = 0.0
