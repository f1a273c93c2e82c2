"""Topics of the twin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from xitl_cli.record.cdr import Float64, Float64Sequence, Int64, String
from xitl_cli.record.topics import Topic


@dataclass(frozen=True, slots=True)
class TwinInnovation:
    """Measured less predicted motion of one interval, with its deviations, and the nominal parameters."""

    innovation: Annotated[
        Float64Sequence, "velocity north and east (m/s), heading (rad), yaw rate (rad/s), position (m)"
    ]
    deviation: Annotated[Float64Sequence, "expected standard deviation of each"]
    thrust_share: Annotated[Float64Sequence, "estimated share of the modelled thrust of each propeller"]
    drag_share: Annotated[float, "float64", "estimated share of the modelled drag ahead"]
    current_ned_mps: Annotated[Float64Sequence, "estimated current, north and east"]
    wind_ned_mps: Annotated[Float64Sequence, "estimated velocity of the air, north and east"]


@dataclass(frozen=True, slots=True)
class TwinEvidence:
    """Evidence for each kind of difference."""

    kinds: Annotated[str, "string", "names of the kinds, separated by commas"]
    evidence: Annotated[Float64Sequence, "log likelihood ratio of each kind against no change"]
    threshold: Annotated[float, "float64", "evidence of an alarm"]


@dataclass(frozen=True, slots=True)
class TwinPrediction:
    """The oldest ghost, up to 30 s after its start."""

    age_s: Float64
    position_ned_m: Annotated[Float64Sequence, "north and east"]
    heading_rad: Float64
    error_m: Annotated[float, "float64", "distance from the boat"]


@dataclass(frozen=True, slots=True)
class TwinAlarm:
    """A difference between boat and model."""

    kind: String
    onset_ns: Annotated[int, "int64", "on the boot clock of the boat"]
    confidence: Annotated[float, "float64", "probability of this kind among all kinds"]
    size: Annotated[float, "float64", "new value of the parameter"]
    deviation: Float64
    unit: String
    runner_up: Annotated[str, "string", "second likeliest kind"]
    intervals: Int64


TOPICS = (
    Topic("/twin/innovation", "xitl_msgs/msg/TwinInnovation", "1 Hz", "measured less predicted", TwinInnovation),
    Topic("/twin/evidence", "xitl_msgs/msg/TwinEvidence", "1 Hz", "evidence for each difference", TwinEvidence),
    Topic("/twin/prediction", "xitl_msgs/msg/TwinPrediction", "1 Hz", "the oldest ghost", TwinPrediction),
    Topic("/twin/alarm", "xitl_msgs/msg/TwinAlarm", "each", "a difference was found", TwinAlarm),
)
