"""Delay, rise and overshoot of what was achieved, against second-order responses and delays that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from numpy.typing import NDArray

from tests.recorded import EXTERNAL_AHRS
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.sections import Section
from xitl_cli.plugins.logs.analyses import control
from xitl_cli.plugins.logs.analyses.control import response_delay_s, step_responses

S = 1_000_000_000
T_S = np.round(np.arange(0.0, 120.0, 0.05), 3)
STAMPS = np.rint(T_S * S).astype(np.int64)
Array = NDArray[np.float64]


def second_order(after_s: Array, damping: float, natural_radps: float) -> Array:
    """Unit step response of an underdamped second-order system (Ogata, Modern Control Engineering, 5-12)."""
    damped = natural_radps * math.sqrt(1.0 - damping**2)
    t_s = np.maximum(after_s, 0.0)
    phase = math.acos(damping)
    envelope = np.exp(-damping * natural_radps * t_s) / math.sqrt(1.0 - damping**2)
    return np.where(after_s > 0.0, 1.0 - envelope * np.sin(damped * t_s + phase), 0.0)


def overshoot_percent(damping: float) -> float:
    return 100.0 * math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))


@pytest.mark.parametrize("damping", [0.2, 0.4, 0.6, 0.8])
def test_overshoot_and_rise_of_a_second_order_system(damping: float) -> None:
    demanded = np.where(T_S >= 20.0, 60.0, 0.0)
    achieved = 60.0 * second_order(T_S - 20.0, damping, 1.0)
    (found,) = step_responses(STAMPS, demanded, achieved, 10.0)
    assert found.overshoot_percent == pytest.approx(overshoot_percent(damping), abs=0.1)
    way = second_order(np.arange(0.0, 20.0, 1e-4), damping, 1.0)
    rise_s = (np.argmax(way >= 0.9) - np.argmax(way >= 0.1)) * 1e-4
    assert found.rise_s == pytest.approx(rise_s, abs=0.01)
    outside = np.flatnonzero(np.abs(way - 1.0) > 0.1)[-1] * 1e-4
    assert found.settled_s == pytest.approx(outside, abs=0.11)  # two rows
    assert found.at_ns == pytest.approx(20 * S, abs=0.06 * S)


@pytest.mark.parametrize("delay_s", [0.0, 0.13, 0.4, 2.5])
def test_the_delay_of_what_follows_at_a_distance(delay_s: float) -> None:
    """To a tenth of a row: the demand is smooth, and the minimum is taken between the rows."""

    def course(t_s: Array) -> Array:
        return 40.0 * np.sin(0.3 * t_s) + 20.0 * np.sin(0.11 * t_s + 1.0)

    assert response_delay_s(STAMPS, course(T_S), course(T_S - delay_s), 3.0) == pytest.approx(delay_s, abs=0.005)


def test_the_delay_of_a_first_order_lag_is_its_time_constant_on_a_ramp() -> None:
    demanded = np.abs((T_S % 80.0) - 40.0)
    achieved = np.empty_like(demanded)
    achieved[0] = demanded[0]
    for row in range(1, len(T_S)):
        achieved[row] = achieved[row - 1] + (demanded[row] - achieved[row - 1]) * -math.expm1(-0.05 / 1.5)
    assert response_delay_s(STAMPS, demanded, achieved, 3.0) == pytest.approx(1.5, abs=0.1)


def test_no_delay_is_told_where_none_can_be() -> None:
    rng = np.random.default_rng(7)
    constant = np.full(len(T_S), 90.0)
    assert response_delay_s(STAMPS, constant, constant + rng.normal(0.0, 2.0, len(T_S)), 3.0) is None
    walks = np.cumsum(rng.normal(0.0, 1.0, (2, len(T_S))), axis=1)
    found = response_delay_s(STAMPS, walks[0], walks[1], 3.0)
    assert found is None or found < 10.0
    assert step_responses(STAMPS, constant, constant, 10.0) == []
    ramp = np.clip(T_S, 0.0, 60.0)
    assert step_responses(STAMPS, ramp, ramp, 10.0) == []  # a second of it is one degree
    assert step_responses(STAMPS, np.where(T_S < 60, 0.0, 30.0), np.zeros(len(T_S)), 10.0)[0].rise_s is None


def test_a_response_that_hardly_varies_has_no_delay() -> None:
    still = np.random.default_rng(5).normal(0.0, 0.2, len(T_S))
    for achieved in (np.full(len(T_S), 12.0), still):
        assert response_delay_s(STAMPS, np.abs((T_S % 80.0) - 40.0), achieved, 3.0) is None


def log_of(demanded: Array, yaw: Array, *, speed: Array | None = None, told: bool = False) -> MadeLog:
    moving = np.full(len(T_S), 2.0)
    achieved = moving if speed is None else speed
    tables = [
        MadeTable("MSG", [0], {"Message": ["ArduRover V4.7.0 (12345678)"]}),
        MadeTable("MODE", [0], {"ModeNum": [10], "Mode": [10]}),
        MadeTable("ARM", [0, S], {"ArmState": [0, 1]}),
        MadeTable("NTUN", STAMPS, {"DesYaw": demanded % 360.0, "Yaw": yaw % 360.0}),
        MadeTable("ATT", STAMPS, {"Roll": 0 * yaw, "Pitch": 0 * yaw, "Yaw": yaw % 360.0, "DesYaw": 0 * yaw}),
    ]
    if told:
        tables.append(MadeTable("NAV_CONTROLLER_OUTPUT", STAMPS, {"aspd_error": moving - achieved}))
        tables.append(MadeTable("GPS", STAMPS, {"Spd": achieved}))
    else:
        tables.append(MadeTable("THR", STAMPS, {"DesSpeed": moving, "Speed": achieved}))
    return MadeLog(*tables)


def facts(log: MadeLog) -> dict[str, object]:
    return {fact.key: fact.value for fact in section(log).facts}


def section(log: MadeLog) -> Section:
    found = control.analyse(log)
    assert found is not None
    return found


def test_a_turn_through_north_is_one_step() -> None:
    """From 340 to 40 degrees: 60 of them, not 300."""
    demanded = np.where(T_S >= 40.0, 40.0, -20.0)
    yaw = -20.0 + 60.0 * second_order(T_S - 40.0, 0.4, 0.8)
    log = log_of(demanded, yaw)
    assert facts(log)["heading_overshoot_percent"] == pytest.approx(overshoot_percent(0.4), abs=0.2)
    grid = next(each for each in section(log).grids if each.key == "heading_steps")
    (row,) = grid.rows
    assert row[1:3] == (340.0, 40.0)
    assert facts(log)["heading_error_max_deg"] == pytest.approx(60.0, abs=0.1)
    plot = next(each for each in section(log).plots if each.key == "tracking.heading")
    assert [trace.name for trace in plot.traces] == ["demanded", "achieved", "error"]
    assert np.abs(plot.traces[2].y).max() <= 60.1


def test_speed_of_what_tells_its_error_alone() -> None:
    speed = 2.0 - 0.5 * np.exp(-T_S / 30.0)
    there = facts(log_of(np.full(len(T_S), 90.0), np.full(len(T_S), 90.0), speed=speed, told=True))
    after = T_S >= 1.0  # armed
    assert there["speed_error_rms_mps"] == pytest.approx(np.sqrt(np.mean((speed - 2.0)[after] ** 2)), rel=0.01)
    assert any("STER.DesTurnRate" in lack for lack in section(log_of(T_S, T_S)).lacks)


def test_a_boat_behind_a_bridge_answers_late() -> None:
    """ArduRover on our vessel: speed and turn rate take about a second to build up, as its motors and its mass do."""
    with open_log(EXTERNAL_AHRS) as log:
        found = control.analyse(log)
        assert found is not None
        there = {fact.key: fact.value for fact in found.facts}
    for key in ("turn_rate_delay_s", "speed_delay_s"):
        assert 0.3 < float(there[key] or 0) < 3.0
