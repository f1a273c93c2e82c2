"""Expressions over signals of a log against numpy on the arrays that they were made of."""

from __future__ import annotations

import numpy as np
import pytest
from expression_cases import CASES, REFUSED, UNITS, made_signals, ns
from hypothesis import given, settings
from hypothesis import strategies as st
from made_log import MadeLog, MadeTable
from numpy.testing import assert_allclose

from tests.golden import Golden
from tests.recorded import GUST
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.named_signals import LogSignal
from xitl_cli.logs.model.query import RowCondition
from xitl_cli.logs.model.table import ALL

LOG = made_signals()
ATT_S = LOG["ATT"].stamp_ns * 1e-9


def signal(text: str) -> LogSignal:
    return LOG.signal(text)


@pytest.mark.parametrize("text", CASES)
def test_every_case_is_worked_out(text: str) -> None:
    found = signal(text)
    assert len(found.values) == len(found.stamp_ns) > 40
    assert np.isfinite(found.values).mean() > 0.4
    assert (np.diff(found.stamp_ns) > 0).all()


@pytest.mark.parametrize(("text", "unit"), UNITS.items())
def test_units_follow(text: str, unit: str) -> None:
    assert signal(text).unit == unit


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_none_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(LogError) as told:
        signal(text)
    assert "\n" not in str(told.value)
    assert len(str(told.value)) < 500 + len(text)


def test_one_message_is_worked_out_row_by_row() -> None:
    roll, yaw = LOG["ATT"]["Roll"], LOG["ATT"]["Yaw"]
    assert_allclose(signal("wrap180(5 - ATT.Yaw)").values, (185.0 - yaw) % 360.0 - 180.0, atol=1e-12)
    assert_allclose(signal("-ATT.Roll ** 2 + 2 * 3").values, -(roll**2) + 6.0)
    assert_allclose(signal("derivative(unwrap(ATT.Yaw))").values, 4.0, rtol=1e-9)
    assert_allclose(signal("diff(unwrap(ATT.Yaw))").values[1:], 0.4, rtol=1e-9)
    assert_allclose(signal("integral(ATT.DesYaw)").values, 5.0 * (ATT_S - ATT_S[0]), atol=1e-9)
    assert_allclose(signal("smooth(unwrap(ATT.Yaw), 2)").values[20:-20], (350.0 + 4.0 * ATT_S)[20:-20], rtol=1e-9)
    assert signal("ATT.Roll").values is not None
    assert signal("ATT.Roll > 0").values[:3].tolist() == [0.0, 1.0, 1.0]


def test_signals_of_several_messages_meet_at_the_times_of_the_densest() -> None:
    """What is linear in time stays so between the rows, a heading too where it goes through north."""
    found = signal("XKF1.VN - 0 * ATT.Yaw")
    assert (found.base, found.interpolated) == ("ATT", ("XKF1[0]",))
    assert found.time_base == f"{found.name}: at the times of ATT, with XKF1[0] resampled"
    assert_allclose(found.values, 3.0 + 0.1 * found.time_s, rtol=1e-9)
    assert found.time_s[0] >= 0.05  # the first row of XKF1
    course = signal("GPS.GCrs + 0 * ATT.Roll")
    inside = np.isfinite(course.values)
    assert_allclose(course.values[inside], np.mod(355.0 + 5.0 * course.time_s[inside], 360.0), atol=1e-9)
    assert 2.0 <= course.time_s[0] <= course.time_s[-1] <= 18.0


def test_a_state_lasts_until_the_next_row_and_instances_are_told_apart() -> None:
    mode = signal("MODE.ModeNum + 0 * ATT.Yaw")
    assert mode.values[mode.time_s < 9.0].tolist() == [4.0] * int((mode.time_s < 9.0).sum())
    assert set(mode.values[mode.time_s >= 9.0]) == {10.0}
    assert mode.time_s[-1] == pytest.approx(19.9)
    assert_allclose(signal("XKF1[1].VN - XKF1[0].VN").values, 1.0, rtol=1e-9)
    assert signal("XKF1.VN * 1").base == "XKF1[0]"  # the lowest, where none is written


def test_nothing_is_made_up_in_a_pause() -> None:
    at_s = np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(9.0, 14.0, 0.1)])
    whole_s = np.arange(0.0, 14.0, 0.05)
    log = MadeLog(MadeTable("A", ns(at_s), {"x": at_s}), MadeTable("B", ns(whole_s), {"y": np.zeros(len(whole_s))}))
    found = log.signal("A.x + B.y")
    pause = (found.time_s > 4.91) & (found.time_s < 8.99)
    assert np.isnan(found.values[pause]).all()
    assert_allclose(found.values[~pause], found.time_s[~pause], atol=1e-9)


def test_what_is_probably_not_meant_is_noted(golden: Golden) -> None:
    assert "wrap180(ATT.DesYaw - ATT.Yaw) gives the shorter angle" in signal("ATT.DesYaw - ATT.Yaw").notes[0]
    assert signal("wrap180(ATT.DesYaw - ATT.Yaw)").notes == ()
    golden("note", signal("sin(ATT.Roll)").notes)
    assert signal("ATT.Roll + XKF1.VN").notes == ("ATT.Roll + XKF1.VN mixes deg and m/s",)


@pytest.mark.parametrize(
    "text",
    [
        "ATT.Yew - 1",
        "ATX.Yaw - 1",
        "XKF1[7].VN - 1",
        "ATT - 1",
        "ATT.Roll -",
        "smoth(ATT.Roll, 1)",
        "abs(ATT.Roll, 1)",
    ],
)
def test_errors_name_what_is_near(text: str, golden: Golden) -> None:
    with pytest.raises(LogError) as told:
        signal(text)
    golden("error", told.value)


def test_a_condition_on_rows_may_name_other_messages_and_look_along_time() -> None:
    att = LOG["ATT"]

    def rows(text: str) -> list[int]:
        return np.flatnonzero(RowCondition(text, LOG).holds(att, ALL, 0)).tolist()

    assert rows("ATT.Roll > 9.9") == rows("Roll > 9.9") == np.flatnonzero(att["Roll"] > 9.9).tolist()
    late = np.flatnonzero(3.0 + 0.1 * ATT_S > 4.505)
    assert rows("XKF1[0].VN > 4.505") == [row for row in late.tolist() if ATT_S[row] >= 0.05]
    assert rows("MODE.ModeNum == 10") == np.flatnonzero(ATT_S > 9.0 - 1e-9).tolist()
    assert rows("abs(derivative(unwrap(Yaw)) - 4) < 1e-6 and Roll > 9.9") == rows("Roll > 9.9")
    parts = RowCondition("diff(Roll) > 0", LOG)
    whole = RowCondition("diff(Roll) > 0", LOG).holds(att, ALL, 0)
    assert np.concatenate([parts.holds(att, np.arange(n, n + 50), 0) for n in range(0, 200, 50)]).tolist() == (
        whole.tolist()
    )
    with pytest.raises(LogError, match="has no message 'XKF9'"):
        rows("XKF9.VN > 1")


def test_rows_of_instances_are_each_their_own_time_line() -> None:
    core = LOG["XKF1"]
    holds = RowCondition("abs(derivative(VN) - 0.1) < 1e-6", LOG).holds(core, ALL, 0)
    assert holds.all()  # one instance is 1 m/s over the other at the same instants


def test_speed_of_a_real_log_is_that_of_its_receiver() -> None:
    """The estimator of ArduRover and the receiver that it listens to agree within a fifth of a metre a second."""
    with open_log(GUST) as log:
        off = log.signal("hypot(XKF1[0].VN, XKF1[0].VE) - GPS.Spd")
        assert (off.unit, off.base) == ("m/s", "XKF1[0]")
        assert np.nanpercentile(np.abs(off.values), 95) < 0.2
        assert log.signal("att.roll").values.tolist() == log["ATT"]["Roll"].tolist()


@pytest.mark.medium
@given(st.text(alphabet="ATRolYw/.[]()0123 +-*%<>=!,'andortsqumih_", max_size=40))
@settings(max_examples=150, deadline=None)
def test_any_text_is_a_signal_or_refused(text: str) -> None:
    try:
        found = signal(text)
    except LogError:
        return
    assert len(found.values) == len(found.stamp_ns)
