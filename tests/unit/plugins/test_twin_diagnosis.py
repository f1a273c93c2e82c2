"""The bank of filters names a change of a sensor: a boat at rest, of which the model is linear and known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from xitl_cli.plugins.twin.bank import MOTION, PREDICTED, LinearPrediction
from xitl_cli.plugins.twin.diagnosis import Alarm, Diagnosis

S = 1_000_000_000
BEGAN, NUMBER = 60, 100
DECAY = math.exp(-1.0 / 3.0)
"""Of the velocity through water, in an interval of 1 s."""


def prediction(diagnosis: Diagnosis) -> LinearPrediction:
    """Velocity and yaw rate decay to the current and to zero; means are those of a straight line between the ends."""
    by_state, by_current = np.zeros((PREDICTED, 4)), np.zeros((PREDICTED, 2))
    for axis in (0, 1):
        by_state[[axis, MOTION + axis], axis] = DECAY, 0.5 * (1.0 + DECAY)
        by_state[[4 + axis, MOTION + 4 + axis], axis] = 0.5 * (1.0 + DECAY), (2.0 + DECAY) / 6.0
        by_current[[axis, MOTION + axis], axis] = 1.0 - DECAY, 0.5 * (1.0 - DECAY)
        by_current[[4 + axis, MOTION + 4 + axis], axis] = 0.5 * (1.0 - DECAY), (1.0 - DECAY) / 6.0
    by_state[[2, MOTION + 2], 2] = 1.0
    by_state[[2, MOTION + 2, 3, MOTION + 3], 3] = 1.0, 0.5, DECAY, 0.5 * (1.0 + DECAY)
    state = np.array([*diagnosis.motion])
    motion = by_state @ state + by_current @ diagnosis.parameters.current_ne_mps
    nothing = np.zeros(PREDICTED)
    return LinearPrediction(motion, by_state, np.zeros((PREDICTED, 1)), nothing, by_current, np.zeros((PREDICTED, 2)))


def alarms(measured_change: tuple[float, ...]) -> list[Alarm]:
    """measured_change: added to all measured motions from interval BEGAN on."""
    rng = np.random.default_rng(5)
    diagnosis = Diagnosis(("0",))
    diagnosis.begin(np.zeros(MOTION))
    found = []
    for number in range(1, NUMBER + 1):
        noise = rng.standard_normal(MOTION) * [0.04, 0.04, 0.006, 0.006, 0.08, 0.08]
        measured = noise + (np.array(measured_change) if number > BEGAN else 0.0)
        alarm = diagnosis.update(prediction(diagnosis), np.zeros((1, 2)), measured, number * S)
        found += [] if alarm is None else [alarm]
    return found


@pytest.mark.medium
@pytest.mark.parametrize(
    ("measured_change", "kind", "size", "unit"),
    [
        ((0.0, 0.0, 0.0, 0.0, 3.0, -4.0), "gnss", 5.0, "m"),
        ((0.0, 0.0, -0.25, 0.0, 0.0, 0.0), "compass", -0.25, "rad"),
    ],
)
def test_a_jump_of_a_sensor_is_named_with_size_and_onset(
    measured_change: tuple[float, ...], kind: str, size: float, unit: str
) -> None:
    (alarm,) = alarms(measured_change)
    assert (alarm.kind, alarm.unit) == (kind, unit)
    assert alarm.size == pytest.approx(size, rel=0.1)
    assert abs(alarm.size - size) < 3.0 * alarm.deviation
    assert alarm.onset_ns == pytest.approx(BEGAN * S, abs=2 * S)
    assert alarm.confidence > 0.95
    assert BEGAN * S < alarm.at_ns <= (BEGAN + 20) * S


@pytest.mark.medium
def test_a_boat_like_its_model_raises_no_alarm() -> None:
    assert alarms((0.0,) * MOTION) == []
