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
    """Commands in force, one a motor in [-1, 1], and how old they are on the simulation's clock."""

    motors: tuple[float, ...]
    armed: bool = False
    failsafe: bool = False
    age_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Task:
    """How one periodic task of a node kept its deadlines since the run started."""

    node: str
    task: str
    rate_hz: float
    cycles: int
    missed: int
    start_jitter_max_s: float = 0.0
    run_mean_s: float = 0.0
    run_max_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Clock:
    """One exchange of time stamps with a node, and the relation of the clocks estimated from all of them.

    `offset_s` is node minus host at `host_ns`; `drift_ppm` is how much faster the node's clock runs.
    """

    node: str
    sample: int
    host_ns: int
    node_ns: int
    round_trip_s: float
    offset_s: float
    drift_ppm: float
