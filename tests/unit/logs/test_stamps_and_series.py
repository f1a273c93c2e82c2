"""Stamps, series, gaps, moments and signals by name: exact results at each limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.named_signals import LogSignal, find_signal, interpolation, signals_named
from xitl_cli.logs.model.query import RowCondition, merge_rows, rows_between, stamps_between
from xitl_cli.logs.model.table import (
    Column,
    distinct,
    json_cells,
    rising,
    seconds_since,
    steps_back,
    stretches,
    text_cells,
    whole_ns,
)
from xitl_cli.logs.signals.gaps import Gap, gaps, regularity
from xitl_cli.logs.signals.moments import moments, moments_near, moments_text
from xitl_cli.logs.signals.series import (
    Series,
    bounded_stamps,
    channel_series,
    first_instance,
    instance_label,
    listed,
    make_series,
    message_of,
    numbers,
    rounded,
    significant,
    stacked,
    stacked_columns,
    tables_of,
)

S = 1_000_000_000
NAN = np.nan


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def table(
    name: str, at_s: Any = None, /, *, instance: str | None = None, units: Any = None, **columns: Any
) -> MadeTable:
    rows = len(next(iter(columns.values())))
    return MadeTable(name, ns(range(rows) if at_s is None else at_s), columns, instance=instance, units=units or {})


# Stamps


def test_stamps() -> None:
    assert whole_ns(np.array([1.4, -1.6, NAN, 1e30, -1e30])).tolist()[:3] == [1, -2, 0]
    assert abs(whole_ns(np.array([1e30]))[0]) > 1 << 60
    assert seconds_since(S, ns([1.0, 2.5])).tolist() == [0.0, 1.5]
    assert distinct(np.array([3, 1, 3, 2, 1])).tolist() == [1, 2, 3]
    assert rising(np.array([1, 3, 3, 2, 4])).tolist() == [True, True, False, False, True]
    assert rising(np.array([], dtype=np.int64)).tolist() == []
    assert steps_back(np.array([1, 3, 3, 2, 4, 0])) == 2
    assert [piece.tolist() for piece in stretches(np.arange(5), 2)] == [[0, 1], [2, 3], [4]]
    assert [piece.tolist() for piece in stretches(np.arange(0), 2)] == [[]]


def test_cells() -> None:
    assert text_cells(np.array([1.0, 0.1, NAN], dtype=np.float32)) == ["1", "0.1", "nan"]
    assert text_cells(np.array([[1, 2], [3, 4]])) == ["[1 2]", "[3 4]"]
    assert text_cells(np.array([b"\x01\xff", "x", None], dtype=object)[:2]) == ["01ff", "x"]
    assert json_cells(np.array([0.1, np.inf], dtype=np.float32)) == [0.1, None]
    assert json_cells(np.array([[1.5, NAN]])) == [[1.5, None]]
    assert json_cells(np.array([b"\x01", None], dtype=object)[:1]) == ["01"]
    assert json_cells(np.array([1, 2])) == [1, 2]


# Series


def test_a_series_has_rising_stamps_and_finite_values() -> None:
    made = make_series(ns([0, 1, 1, 3, 2, 4]), np.array([1.0, 2.0, 9.0, NAN, 5.0, 6.0]), "m", "X.Y")
    assert made is not None
    assert (made.stamp_ns / S).tolist() == [0.0, 1.0, 2.0, 4.0]
    assert (made.values.tolist(), made.dropped) == ([1.0, 2.0, 5.0, 6.0], 2)
    vectors = make_series(ns([0, 1]), np.array([[1.0, NAN], [2.0, 3.0]]), "m", "X")
    assert vectors is not None
    assert vectors.values.tolist() == [[2.0, 3.0]]
    assert make_series(ns([0]), np.array([NAN]), "m", "X") is None
    assert make_series(ns([]), np.array([]), "m", "X") is None


def test_values_between_samples() -> None:
    line = Series(ns([1, 3]), np.array([10.0, 30.0]), "m", "X")
    np.testing.assert_array_equal(line.interpolated(ns([0.9, 1, 2.5, 3, 3.1])), [NAN, 10.0, 25.0, 30.0, NAN])
    angle = Series(ns([0, 1, 2]), np.array([350.0, 10.0, 350.0]), "deg", "X", turns=True)
    np.testing.assert_allclose(angle.interpolated(ns([0.25, 0.75, 1.5])), [355.0, 5.0, 0.0], atol=1e-9)
    pairs = Series(ns([0, 2]), np.array([[0.0, 10.0], [2.0, 30.0]]), "m", "X")
    assert pairs.interpolated(ns([1])).tolist() == [[1.0, 20.0]]


def test_columns_as_numbers() -> None:
    made = table("X", a=[1.0, np.inf, 3.0], b=[4, 5, 6], t=["x", "y", "z"], v=[[1, 2], [3, 4], [5, 6]])
    np.testing.assert_array_equal(numbers(made, "a"), [1.0, NAN, 3.0])
    assert (numbers(made, "t"), numbers(made, "none")) == (None, None)
    np.testing.assert_array_equal(stacked(made, ("b", "a")), [[4, 1], [5, NAN], [6, 3]])
    assert stacked(made, ("b", "v")) is None
    assert stacked_columns(made, ("b", "none")) is None
    np.testing.assert_array_equal(stacked_columns(made, ("a", "b")), [[1, 4], [np.inf, 5], [3, 6]])
    channels = channel_series(made, np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]]), "us", "c", used_only=True)
    assert {number: (one.source, one.values.tolist()) for number, one in channels.items()} == {
        2: ("X.c[1]", [1.0, 2.0, 3.0])
    }
    assert list(channel_series(made, np.zeros((3, 2)), "us", "c", used_only=False)) == [1, 2]
    assert bounded_stamps(MadeTable("X", [0, 1 << 62, -(1 << 62)], {"a": [0, 0, 0]})).tolist() == [
        0,
        1 << 61,
        -(1 << 61),
    ]


def test_tables_by_message_and_instance() -> None:
    one, two = table("/link/a/tx:IMU", a=[1]), table("IMU", I=[1, 0, 1], a=[5, 6, 7], instance="I")
    log = MadeLog(one, two, table("GPS", a=[1]))
    assert [each.name for each in tables_of(log, ("GPS", "IMU"))] == ["GPS", "/link/a/tx:IMU", "IMU"]
    assert (message_of("/link/a/tx:IMU"), message_of("IMU")) == ("IMU", "IMU")
    lowest = first_instance(log, "IMU")
    assert lowest is not None
    assert lowest.values("a").tolist() == [6]
    assert (instance_label(one, 0), instance_label(two, 1)) == ("/link/a/tx:IMU", "IMU[1]")
    assert first_instance(log, "none") is None


def test_figures_for_tables() -> None:
    assert (rounded(1.23456), rounded(1.25, 1), rounded(None), rounded(np.inf)) == (1.235, 1.2, None, None)
    assert (significant(123456.0), significant(0.00123456, 3), significant(NAN), significant(None)) == (
        123500.0, 0.00123, None, None,
    )  # fmt: skip
    assert listed(["a", "b", "c", "d"]) == "a, b, c, d"
    assert listed(["a", "b", "c", "d", "e", "f"]) == "a, b, c, d and 2 more"


# Gaps


def test_a_regular_series_with_one_gap() -> None:
    found = regularity(ns(np.delete(np.arange(50), [20, 21, 40]) * 0.1))
    assert found is not None
    assert (found.rows, found.period_s, found.rate_hz, found.bursts) == (
        47,
        pytest.approx(0.1),
        pytest.approx(10.0),
        False,
    )
    assert (found.gaps, found.long_gaps, found.missing) == (2, 0, 3)
    assert found.longest == (Gap(1_900_000_000, 2_200_000_000, 2), Gap(3_900_000_000, 4_100_000_000, 1))
    assert (found.longest_gap_s, found.jitter_s) == (pytest.approx(0.3), pytest.approx(0.0, abs=1e-9))
    assert (found.repeated, found.backward, found.back_s) == (0, 0, 0.0)


@pytest.mark.parametrize(("gap_s", "gaps_", "long"), [(0.1, 0, 0), (0.2, 1, 0), (0.5, 1, 0), (0.51, 1, 1)])
def test_gaps_by_their_length(gap_s: float, gaps_: int, long: int) -> None:
    at_s = np.concatenate((np.arange(20) * 0.1, 1.9 + gap_s + np.arange(20) * 0.1))
    found = regularity(ns(at_s))
    assert found is not None
    assert (found.gaps, found.long_gaps) == (gaps_, long)


def test_a_gap_is_more_than_one_and_a_half_periods() -> None:
    assert len(gaps(ns([0, 1, 2.5, 3.5]), 1.0)) == 0
    found = gaps(ns([0, 1, 2.51, 3.5, 6.5]), 1.0)
    assert (found.row.tolist(), found.missing.tolist()) == ([1, 3], [1, 2])
    assert (found.from_ns.tolist(), found.until_ns.tolist()) == ([S, 3_500_000_000], [2_510_000_000, 6_500_000_000])


def test_stamps_that_repeat_or_go_back_are_counted() -> None:
    found = regularity(ns([0, 1, 2, 2, 3, 1.5, 4, 5, 6]))
    assert found is not None
    assert (found.repeated, found.backward, found.back_s, found.gaps) == (1, 1, pytest.approx(1.5), 0)
    assert regularity(ns([0, 1])) is None
    assert regularity(ns([3, 2, 1])) is None
    nominal = regularity(ns([0, 1, 2, 3]), 0.5)
    assert nominal is not None
    assert (nominal.period_s, nominal.gaps, nominal.missing) == (0.5, 3, 3)


def test_jitter_is_half_the_range_of_the_middle_steps() -> None:
    steps = np.tile([0.9, 1.0, 1.1], 34)
    found = regularity(ns(np.cumsum(steps)))
    assert found is not None
    assert found.jitter_s == pytest.approx(0.1)
    assert len(gaps(ns([]), 1.0)) == 0


# Moments


def test_moments_of_a_log_in_words() -> None:
    log = MadeLog(
        table("ARM", [10, 30], ArmState=[1, 0]), table("MODE", [5, 20], ModeNum=[0, 10]),
        table("MSG", [2], Message=["ArduRover V4.5"]),
        table("CMD", [12, 13, 20], CNum=[0, 1, 0]),
        table("PARM", [0, 0, 40, 41, 42, 43, 50, 51], Name=["A", "B", "A", "B", "A", "B", "A", "STAT_X"],
        Value=[1, 1, 2, 2, 3, 3, 9, 5]),
        table("FILE", [60, 61, 64], FileName=["x", "x", "x"]), table("ORGN", [7, 8, 9], Type=[0, 1, 0]),
        table("XKF1", [6, 7], A=[0, 0]), table("ERR", [70], Subsys=[16], ECode=[2]), table("EV", [71, 72], Id=[10, 62]),
        table("ATT", [0, 100], Yaw=[0, 0]),
    )  # fmt: skip
    found = [(one.at_ns / S, one.until_ns / S, one.kind, one.text) for one in moments(log) if one.kind != "text"]
    assert found == [
        (0.0, 0.0, "log", "the log begins"), (5.0, 5.0, "mode", "mode MANUAL"),
        (6.0, 6.0, "estimator", "the estimator begins"), (7.0, 7.0, "estimator", "origin of the estimator set"),
        (8.0, 8.0, "estimator", "home set"), (10.0, 10.0, "arming", "armed"),
        (12.0, 13.0, "mission", "mission written (2 items)"),
        (20.0, 20.0, "mode", "mode AUTO"), (20.0, 20.0, "mission", "mission written (1 items)"),
        (30.0, 30.0, "arming", "disarmed"), (40.0, 43.0, "parameters", "4 parameters set"),
        (50.0, 50.0, "parameters", "A set"), (60.0, 61.0, "file", "x copied into the log"),
        (64.0, 64.0, "file", "x copied into the log"), (70.0, 70.0, "error", "EKF check: bad variance"),
        (72.0, 72.0, "event", "EKF yaw reset"),
    ]  # fmt: skip


def test_faults_and_takeovers_are_moments() -> None:
    log = MadeLog(
        table("/faults", [3, 5], fault=["cut", "cut"], active=[1, 0]), table("/takeovers", [7], from_node=["LC"]),
        table("/truth/state", [0, 9], a=[0, 0]), kind="mcap", base="simulation",
    )  # fmt: skip
    every = moments(log)
    assert [(one.at_ns / S, one.kind, one.text) for one in every] == [
        (0.0, "log", "the log begins"), (3.0, "fault", "fault cut begins"), (5.0, "fault", "fault cut ends"),
        (7.0, "takeover", "takeover from LC"),
    ]  # fmt: skip
    assert [one.text for one in moments_near(every, 4 * S, 6 * S)] == ["fault cut ends"]
    assert [one.text for one in moments_near(every, 4 * S, 6 * S, S)] == [
        "fault cut begins",
        "fault cut ends",
        "takeover from LC",
    ]
    assert moments_text(moments_near(every, 4 * S, 6 * S, S)) == "fault cut begins; fault cut ends; takeover from LC"
    assert moments_text([]) == "nothing that was logged"


def test_a_line_of_moments_has_six_and_texts_only_alone() -> None:
    many = moments(MadeLog(table("MODE", range(8), ModeNum=list(range(20, 28))), table("MSG", [3], Message=["hello"])))
    assert moments_text(many) == "the log begins; " + "; ".join(f"mode mode {n}" for n in range(20, 25)) + " and 3 more"
    said = [one for one in many if one.kind == "text"]
    assert moments_text(said) == "“hello”"


# Signals by name


def signal(at_s: Any, values: Any, unit: str = "", held: bool = False) -> LogSignal:
    return LogSignal("X.Y", unit, ns(at_s), np.asarray(values, dtype=np.float64), "X", held=held)


def test_numbers_are_lines_between_rows_and_unknown_in_a_pause() -> None:
    at = interpolation(signal([0, 1, 2, 13, 14, 15], [0, 10, 20, 30, 40, NAN]))
    np.testing.assert_array_equal(
        at(ns([-1, 0, 0.5, 2, 2.1, 12.9, 13, 13.5, 14.5])), [NAN, 0, 5, 20, NAN, NAN, 30, 35, NAN]
    )
    kept = interpolation(signal([0, 1, 2, 12, 13], [0, 10, 20, 30, 40]))  # ten intervals are no pause
    assert kept(ns([7])).tolist() == [25.0]
    dense = interpolation(signal([0, 0.1, 0.2, 1.2, 1.3], [0, 1, 2, 3, 4]))
    assert dense(ns([0.7])).tolist() == [2.5]  # a second is none
    assert np.isnan(interpolation(signal([0], [NAN]))(ns([0]))).all()


def test_states_hold_and_angles_take_the_short_way() -> None:
    held = interpolation(signal([1, 2], [5, 7], held=True))
    np.testing.assert_array_equal(held(ns([0.5, 1, 1.9, 2, 99])), [NAN, 5, 5, 7, 7])
    round_ = interpolation(signal([0, 1], [350, 10], "deg"))
    assert round_(ns([0.25, 0.75])) == pytest.approx([355.0, 5.0])
    signed = interpolation(signal([0, 1], [-170, 170], "deg"))
    assert signed(ns([0.25, 0.75])) == pytest.approx([-175.0, 175.0])
    radians = interpolation(signal([0, 1], [3.0, -3.0], "rad"))
    assert abs(radians(ns([0.5]))[0]) == pytest.approx(np.pi)


LOG = MadeLog(
    table("ATT", Roll=[1.0, 2.0, 3.0], Mode=[1, 2, 3], TimeUS=[1, 2, 3]),
    table("IMU", I=[0, 1, 0, 1], AccX=[1.0, 2.0, 3.0, 4.0], instance="I"),
    table("VEC", v=[[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
)


def test_signals_of_instances_and_elements() -> None:
    assert find_signal(LOG, "att.roll").values.tolist() == [1.0, 2.0, 3.0]
    assert find_signal(LOG, "IMU.AccX").values.tolist() == [1.0, 3.0]
    assert find_signal(LOG, "IMU[1].AccX").values.tolist() == [2.0, 4.0]
    assert find_signal(LOG, "VEC.v[1]").values.tolist() == [2.0, 4.0, 6.0]
    (both,) = signals_named([LOG], "IMU.AccX")
    assert [one.name for one in both] == ["IMU[0].AccX", "IMU[1].AccX"]
    (whole,) = signals_named([LOG], "VEC")
    assert [one.name for one in whole] == ["VEC.v[0]", "VEC.v[1]"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("IMU[7].AccX", r"IMU has no instance 7; choose from IMU\[0\], IMU\[1\]"),
        ("ATT[1].Roll", "ATT has no instances; write ATT.FIELD"),
        ("VEC.v", r"VEC.v stands for 2 signals; choose one, such as VEC.v\[0\], VEC.v\[1\]"),
        ("ATT.Rol", "did you mean 'Roll'"),
    ],
)
def test_names_that_are_none_or_several(text: str, said: str) -> None:
    with pytest.raises(LogError, match=said):
        find_signal(LOG, text)


# Rows of a query


def test_rows_of_a_span_include_its_ends() -> None:
    made = table("X", [1, 2, 3, 4], a=[1, 2, 3, 4])
    assert rows_between(made, 2 * S, 3 * S).tolist() == [1, 2]
    assert rows_between(made, None, 2 * S).tolist() == [0, 1]
    assert rows_between(made, 4 * S, None).tolist() == [3]
    log = MadeLog(made)
    assert stamps_between(log, 1.5, None) == (1_500_000_000, None)
    with pytest.raises(LogError, match="--until = 1 is before --from = 2; swap them"):
        stamps_between(log, 2.0, 1.0)
    with pytest.raises(LogError, match="--from = inf is not a time"):
        stamps_between(log, np.inf, None)
    assert stamps_between(log, 2.0, 2.0) == (2 * S, 2 * S)


def holds(text: str, made: MadeTable, log: MadeLog | None = None) -> list[bool]:
    return RowCondition(text, log).holds(made, slice(None), 0).tolist()


def test_conditions_on_rows() -> None:
    made = table(
        "X",
        a=[1.0, NAN, -3.0],
        n=np.array([200, 100, 50], dtype=np.uint8),
        t=["x", "y", "x"],
        v=[[1, 2], [3, 4], [5, 6]],
    )
    assert holds("abs(a) >= 1", made) == [True, False, True]
    assert holds("n + n > 255", made) == [True, False, False]  # small integers do not overflow
    assert holds("t == 'x' and not a < 0", made) == [True, False, False]
    assert holds("v[1] == 4 or a == 1", made) == [True, True, False]
    assert holds("time_s >= 1", made) == [False, True, True]
    assert holds("1 < v[0] <= 5", made) == [False, True, True]
    assert holds("X.a > 0", made) == [True, False, False]
    assert holds("derivative(n) < -60", made) == [True, True, False]
    assert holds("where(t == 'x', 1, 0) > 0", made) == [True, False, True]
    for text, said in (
        ("v > 1", r"v of X is an array; write v\[0\]"), ("a[0] > 1", r"a of X is not an array; remove \[0\]"),
        ("v[2] > 1", r"v of X has 2 elements; the first is \[0\]"), ("a + 1", "is a value, not a condition"),
        ("a == 'x'", "compares a text with a number"), ("t > a", "compares a text with a number"),
    ):  # fmt: skip
        with pytest.raises(LogError, match=said):
            holds(text, made)


def test_rows_of_several_tables_are_in_the_order_of_the_file() -> None:
    one = MadeTable("A", [1, 2, 3], {"x": [1, 2, 3]}, place=[0, 20, 40])
    two = MadeTable("B", [1, 2, 3], {"x": [5, 1, 9]}, place=[10, 30, 50])
    (batch,) = merge_rows([one, two], None, None, None, 0)
    assert batch.order.tolist() == [0, 1, 0, 1, 0, 1]
    (batch,) = merge_rows([one, two], 2, None, RowCondition("x > 1"), 0)
    assert (batch.order.tolist(), [rows.tolist() for rows in batch.rows]) == ([0, 0, 1], [[1, 2], [2]])
    first = batch.first(2)
    assert (first.order.tolist(), [rows.tolist() for rows in first.rows]) == ([0, 0], [[1, 2], []])
    assert batch.first(None) is batch
    many = MadeTable("C", np.arange(1000), {"x": np.arange(1000)})
    assert [len(part.order) for part in merge_rows([many], None, None, None, 0)] == [256, 512, 232]


def test_a_field_that_one_table_lacks_makes_its_rows_false() -> None:
    one, two = MadeTable("A", [1], {"x": [1]}, place=[0]), MadeTable("B", [1], {"y": [1]}, place=[1])
    (batch,) = merge_rows([one, two], None, None, RowCondition("x > 0"), 0)
    assert batch.order.tolist() == [0]
    with pytest.raises(LogError, match="none of A, B has a field 'z'"):
        list(merge_rows([one, two], None, None, RowCondition("z > 0"), 0))


def test_columns_of_bytes_are_not_compared() -> None:
    made = MadeTable(
        "X", [1], {"d": np.array([b"x", None], dtype=object)[:1]}, columns={"d": Column("d", kind="bytes")}
    )
    with pytest.raises(LogError, match="holds bytes"):
        holds("d > 1", made)
