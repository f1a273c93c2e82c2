"""Figures of a comparison from values that are worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.compare.comparison import (
    channel_section,
    difference_grid,
    difference_or_reason,
    difference_plot,
    motion_section,
    overlay,
    signal_difference,
    stray_truth_finding,
)
from xitl_cli.logs.compare.pairing import (
    Pairing,
    best_lag,
    common_samples,
    contradiction,
    event_section,
    limited,
    pair_logs,
    paired_events,
    precise_modes,
    time_integral,
    zero_ns,
)
from xitl_cli.logs.compare.trajectories import (
    PosePair,
    Trajectory,
    align_trajectory,
    error_statistics,
    frame_pairs,
    off_path_m,
    path_pairs,
    relative_errors,
    thinned_path,
    trajectory_section,
    tum_text,
    umeyama,
)
from xitl_cli.logs.model.analysis import LogAnalysis
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Fact, Finding, Plot, Section, Severity, Trace
from xitl_cli.logs.signals import Series

S = 1_000_000_000


def shifted(offset_s: float = 0.0, **of: Any) -> Pairing:
    return Pairing(lambda stamp_ns: stamp_ns + round(offset_s * S), "shift", "", **of)


def series(at_s: Any, values: Any, unit: str = "m/s", turns: bool = False) -> Series:
    stamps = np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)
    return Series(stamps, np.asarray(values, dtype=np.float64), unit, "X.Y", turns)


# Samples at common instants


def test_samples_are_at_the_instants_of_a_within_b() -> None:
    a, b = series(range(10), np.arange(10.0)), series([12.0, 14.0, 16.0], [0.0, 20.0, 60.0])
    found = common_samples(a, b, shifted(-10.0))
    assert found is not None
    stamps, in_a, in_b = found
    assert (stamps / S).tolist() == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert (in_a.tolist(), in_b.tolist()) == ([2.0, 3.0, 4.0, 5.0, 6.0], [0.0, 10.0, 20.0, 40.0, 60.0])
    found = common_samples(a, b, shifted(-10.0, from_ns=3 * S, until_ns=5 * S))
    assert found is not None
    assert (found[0] / S).tolist() == [3.0, 4.0, 5.0]
    assert common_samples(a, b, shifted(-10.0, from_ns=6 * S)) is None
    assert common_samples(a, b, shifted(100.0)) is None


@pytest.mark.parametrize(("gap_s", "rows"), [(2.0, 21), (2.1, 20), (1.0, 11)])
def test_nothing_is_compared_within_a_gap(gap_s: float, rows: int) -> None:
    """Two seconds, as three usual steps are shorter."""
    a = series(np.arange(0.0, 20.0, 0.1), np.zeros(200))
    b = series(np.concatenate((np.arange(0.0, 0.55, 0.1), 0.5 + gap_s + np.arange(0.0, 0.55, 0.1))), np.zeros(12))
    found = common_samples(a, b, shifted())
    assert found is not None
    inside = np.count_nonzero((found[0] > 0.51 * S) & (found[0] < (0.49 + gap_s) * S))
    assert inside == (0 if gap_s > 2.0 else round(gap_s * 10) - 1)


def test_an_integral_is_by_trapezoids_without_gaps() -> None:
    stamps = np.array([0, 1, 2, 12, 13]) * S
    covered_s, area = time_integral(stamps, np.array([0.0, 2.0, 4.0, 100.0, 102.0]))
    assert (covered_s, area) == (pytest.approx(3.0), pytest.approx(1.0 + 3.0 + 101.0))
    assert time_integral(np.array([5]), np.array([1.0])) == (0.0, 0.0)
    slow = np.array([0, 10, 20, 49, 50]) * S  # steps of 10 s are usual, and 29 s are less than three of them
    assert time_integral(slow, np.ones(5)) == (pytest.approx(50.0), pytest.approx(50.0))


@pytest.mark.parametrize("delay_s", [-3.3, 0.0, 1.25, 8.0])
def test_a_lag_is_the_delay_of_b(delay_s: float) -> None:
    at_s = np.arange(0.0, 120.0, 0.1)

    def bumps(t_s: np.ndarray) -> np.ndarray:
        return np.asarray(np.exp(-(((t_s - 50.0) / 3.0) ** 2)) + 0.5 * np.exp(-(((t_s - 75.0) / 2.0) ** 2)))

    stamps = np.round(at_s * S).astype(np.int64)
    highest, lag_s = best_lag(stamps, bumps(at_s), bumps(at_s - delay_s), turns=False)
    assert highest == pytest.approx(1.0, abs=1e-3)
    assert lag_s == pytest.approx(delay_s, abs=0.02)


def test_no_lag_without_change_or_likeness_or_at_the_end_of_the_shifts() -> None:
    stamps = np.arange(1200) * S // 10
    wave = np.sin(stamps / S)
    assert best_lag(stamps, wave, np.full(1200, 3.0), turns=False) == (None, None)
    ramp = np.where(stamps < 60 * S, 0.0, 1.0)
    late = np.where(stamps < 75 * S, 0.0, 1.0)
    highest, lag_s = best_lag(stamps, ramp, late, turns=False)
    assert highest is not None
    assert lag_s is None  # 15 s are more than the longest shift
    assert best_lag(stamps, wave, wave, turns=False, longest_s=0.01) == (None, None)


def test_angles_are_correlated_as_directions() -> None:
    stamps = np.arange(1200) * S // 10
    angle = 100.0 * np.sin(stamps / S / 5.0)
    highest, lag_s = best_lag(stamps, angle % 360.0, (angle + 720.0) % 360.0, turns=True)
    assert (highest, lag_s) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-3))


# Differences


def test_a_difference_has_its_figures() -> None:
    found = signal_difference(
        "speed", series(range(5), [0, 0, 0, 0, 0]), series(range(5), [1, -1, 1, -3, 1]), shifted()
    )
    assert found is not None
    assert found.errors.tolist() == [1, -1, 1, -3, 1]
    assert (found.iae, found.rms, found.mean) == (
        pytest.approx(6.0),
        pytest.approx((13 / 5) ** 0.5),
        pytest.approx(-0.2),
    )
    assert (found.most, found.most_ns, found.covered_s) == (3.0, 3 * S, 4.0)
    assert (found.correlation, found.lag_s, found.constant) == (None, None, False)
    (grid,) = difference_grid("motion", [found])
    assert dict(zip(grid.columns, grid.rows[0], strict=True)) == {
        "quantity": "speed", "unit": "m/s", "IAE": 6.0, "RMS": 1.612, "most": 3.0, "mean": -0.2, "B later (s)": None,
        "correlation": None,
    }  # fmt: skip
    assert difference_grid("motion", []) == ()


def test_angles_differ_the_short_way() -> None:
    found = signal_difference(
        "yaw",
        series(range(3), [350.0, 10.0, 0.0], "deg", True),
        series(range(3), [10.0, 350.0, 180.0], "deg", True),
        shifted(),
    )
    assert found is not None
    assert found.errors.tolist() == [20.0, -20.0, -180.0]


def test_the_reason_without_a_difference() -> None:
    one, late, angle = series(range(3), [1, 2, 3]), series([50, 51], [1, 2]), series(range(3), [1, 2, 3], "deg")
    assert difference_or_reason("speed", None, None, shifted()) == "Speed is not in either log."
    assert difference_or_reason("speed", one, None, shifted()) == "Speed is not in B."
    assert difference_or_reason("speed", None, one, shifted()) == "Speed is not in A."
    assert difference_or_reason("speed", one, angle, shifted()) == "Speed is in m/s in A and in deg in B."
    plain = series(range(3), [1, 2, 3], "")
    assert difference_or_reason("output 1", plain, one, shifted()) == "Output 1 is in commands in A and in m/s in B."
    assert difference_or_reason("speed", one, late, shifted()) == "Speed has no common time in both."


def test_a_plot_has_no_line_across_at_north() -> None:
    found = signal_difference(
        "a yaw",
        series(range(3), [350.0, 10.0, 20.0], "deg", True),
        series(range(3), [10.0, 20.0, 30.0], "deg", True),
        shifted(),
    )
    assert found is not None
    plot = difference_plot("motion", found)
    assert (plot.key, plot.title, plot.y_label) == ("motion.a_yaw", "A yaw", "deg")
    np.testing.assert_array_equal(plot.traces[0].y, [350.0, np.nan, 20.0])
    assert plot.traces[1].y.tolist() == [10.0, 20.0, 30.0]


# Channels


def rcou(**columns: Any) -> MadeTable:
    return MadeTable("RCOU", S * np.arange(3), {name: np.broadcast_to(value, 3) for name, value in columns.items()})


def test_channels_side_by_side() -> None:
    a = MadeLog(rcou(C1=[1500, 1600, 1700], C2=1500, C3=1500, C4=1500, C6=1500, C7=1100, C8=1100))
    b = MadeLog(rcou(C1=[1500, 1610, 1700], C2=1500, C3=1500, C4=1500, C6=1500, C7=1110, C9=1100))
    section = channel_section(a, b, shifted())
    assert section is not None
    assert [(fact.key, fact.value) for fact in section.facts] == [("same_outputs", "2 to 4, 6")]
    assert [row[:5] for row in section.grids[0].rows] == [
        ("output 1", "us", 10.0, 5.774, 10.0), ("output 7", "us", 20.0, 10.0, 10.0),
    ]  # fmt: skip
    assert section.lacks == ("Output 8 is in A alone.", "Output 9 is in B alone.")
    assert len(section.plots) == 2
    more = channel_section(a, MadeLog(rcou(C1=1500, C2=1500)), shifted())
    assert more is not None
    assert more.lacks == ("Outputs 3, 4, 6 to 8 are in A alone.",)
    alone = channel_section(a, MadeLog(), shifted())
    assert alone is not None
    assert alone.lacks == ("B logs no outputs.",)
    assert channel_section(MadeLog(), MadeLog(), shifted()) is None


def test_commands_give_way_to_pulses_if_one_log_has_only_those() -> None:
    commands = MadeTable("/actuators", S * np.arange(3), {"command": np.zeros((3, 1))})
    pulses = MadeTable("SERVO_OUTPUT_RAW", S * np.arange(3), {"servo1_raw": [1500, 1500, 1500]})
    section = channel_section(MadeLog(rcou(C1=1500)), MadeLog(commands, pulses, kind="mcap"), shifted())
    assert section is not None
    assert [(fact.key, fact.value) for fact in section.facts] == [("same_outputs", "1")]
    section = channel_section(MadeLog(rcou(C1=1500)), MadeLog(commands, kind="mcap"), shifted())
    assert section is not None
    assert section.lacks == ("Output 1 is in us in A and in commands in B.",)


def test_motion_side_by_side() -> None:
    columns = {"Lat": [47.0] * 3, "Lng": [8.0] * 3}
    a = MadeLog(
        MadeTable("POS", S * np.arange(3), {**columns, "Alt": [400.0] * 3}),
        MadeTable("XKF1", S * np.arange(3), {"OH": [1.0] * 3, "VN": [1.0] * 3, "VE": [0.0] * 3}),
    )
    b = MadeLog(
        MadeTable("POS", S * np.arange(3), {**columns, "Alt": [401.5] * 3}),
        MadeTable("NKF1", S * np.arange(3), {"OH": [3.0] * 3}),
    )
    section = motion_section(a, b, shifted(), "estimate", "estimate")
    assert section is not None
    assert [(row[0], row[5]) for row in section.grids[0].rows] == [("altitude", 1.5), ("EKF origin height", 2.0)]
    assert section.lacks == (
        "Speed over ground is not in B.", "Yaw is not in either log.", "Roll is not in either log.",
        "Pitch is not in either log.",
    )  # fmt: skip


# Events and pairing


def autopilot(
    at_s: float,
    *texts: tuple[float, str],
    armed_s: tuple[float, ...] = (),
    modes: tuple[tuple[float, int], ...] = (),
    path: str = "a",
) -> MadeLog:
    def ns(second: float) -> int:
        return round((at_s + second) * S)

    tables = [
        MadeTable("ATT", [ns(0.0), ns(100.0)], {"Roll": [0.0, 0.0]}),
        MadeTable("MSG", [ns(0.0), *(ns(t) for t, _ in texts)],
        {"Message": ["ArduRover V4.5", *(text for _, text in texts)]}),
    ]  # fmt: skip
    if armed_s:
        tables.append(
            MadeTable("ARM", [ns(t) for t in armed_s], {"ArmState": [(at + 1) % 2 for at in range(len(armed_s))]})
        )
    if modes:
        tables.append(MadeTable("MODE", [ns(t) for t, _ in modes], {"ModeNum": [number for _, number in modes]}))
    return MadeLog(*tables, path=f"/{path}.bin")


def test_events_of_one_log() -> None:
    log = autopilot(
        5.0,
        (30.0, "Reached waypoint #3"),
        (50.0, "Mission complete"),
        armed_s=(10.0, 60.0, 70.0),
        modes=((0.0, 0), (20.0, 10)),
    )
    found = paired_events(log, lambda at_ns: at_ns / S - 5.0)
    assert [(event.what, event.at_s) for event in found] == [
        ("mode MANUAL", 0.0), ("armed", 10.0), ("mode AUTO", 20.0), ("waypoint 3 reached", 30.0),
        ("mission complete", 50.0), ("disarmed", 60.0), ("armed", 70.0),
    ]  # fmt: skip


def test_events_next_to_each_other() -> None:
    a = autopilot(5.0, (30.0, "Reached waypoint #1"), armed_s=(10.0, 60.0, 70.0))
    b = autopilot(105.0, (33.5, "Reached waypoint #1"), (40.0, "Reached waypoint #2"), armed_s=(12.0, 80.0))
    section = event_section(a, b, shifted(-100.0), 15 * S)
    assert section is not None
    assert section.grids[0].rows == (
        ("armed", 0.0, 2.0, 2.0),
        ("waypoint 1 reached", 20.0, 23.5, 3.5),
        ("waypoint 2 reached", None, 30.0, None),
        ("disarmed", 50.0, 70.0, 20.0),
        ("armed", 60.0, None, None),
    )
    nothing = MadeLog(MadeTable("X", [1], {"A": [1]}))
    assert event_section(nothing, nothing, shifted(), 0) is None


def test_a_mode_of_heartbeats_begins_with_its_text() -> None:
    beats = MadeTable(
        "HEARTBEAT",
        S * np.arange(6),
        {"autopilot": [3] * 6, "type": [11] * 6, "custom_mode": [0, 0, 0, 10, 10, 4], "base_mode": [0] * 6},
    )
    said = MadeTable("STATUSTEXT", [S // 2, 5 * S // 2, 3 * S], {"text": ["Mode AUTO", "mode auto", "Mode HOLD"]})
    log = MadeLog(beats, said, kind="tlog", base="utc")
    assert [(mode.text, mode.from_ns / S, mode.until_ns / S) for mode in precise_modes(log)] == [
        ("MANUAL", 0.0, 0.5), ("AUTO", 0.5, 3.0), ("HOLD", 3.0, 5.0),
    ]  # fmt: skip


@pytest.mark.parametrize("method", ["mission", "armed"])
def test_two_runs_are_paired_by_an_event(method: Any) -> None:
    a = autopilot(5.0, armed_s=(10.0,), modes=((0.0, 0), (20.0, 10)), path="a")
    b = autopilot(105.0, armed_s=(30.0,), modes=((0.0, 10), (50.0, 0)), path="b")
    pairing = pair_logs(a, b, method)
    begins = {"mission": (25.0, 135.0), "armed": (15.0, 135.0)}[method]
    assert pairing.method == method
    assert pairing.zero_ns == round(begins[0] * S)
    assert pairing.instant(round(begins[1] * S)) == round(begins[0] * S)
    assert zero_ns(a, b, pairing) == round(begins[0] * S)
    words = {"mission": "navigated by itself while armed", "armed": "armed"}[method]
    assert pairing.sentence == f"two runs, aligned where each first {words}"


def test_without_an_event_the_reason_names_the_log() -> None:
    a, b = autopilot(0.0, armed_s=(1.0,), path="a"), autopilot(0.0, path="b")
    with pytest.raises(
        LogError, match=r"cannot be aligned in time: B does not show when it armed; align them with --shift"
    ):
        pair_logs(a, b, "armed")
    with pytest.raises(LogError, match=r"A does not show when it moved faster than 0\.3 m/s"):
        pair_logs(a, b, "motion")
    with pytest.raises(LogError, match="has no time stamps"):
        pair_logs(a, MadeLog(), "armed")


def test_a_shift_is_between_the_first_rows_and_one_file_is_not_moved() -> None:
    a, b = autopilot(5.0, path="a"), autopilot(105.0, path="b")
    pairing = pair_logs(a, b, shift_s=2.5)
    assert pairing.instant(105 * S) == round(7.5 * S)
    assert (pairing.sentence, pairing.zero_ns) == ("B begins 2.5 s after A, as asked", None)
    assert zero_ns(a, b, pairing) == round(7.5 * S)
    assert zero_ns(a, b, pair_logs(a, b, shift_s=-2.5)) == 5 * S
    same = pair_logs(a, autopilot(105.0, path="a"))
    assert (same.method, same.instant(7)) == ("same file", 7)


def test_motion_begins_with_a_second_of_it() -> None:
    def moving(path: str, *spans_s: tuple[float, float]) -> MadeLog:
        at_s = np.arange(0.0, 60.0, 0.1)
        speed = np.zeros(600)
        for begin, end in spans_s:
            speed[(at_s > begin - 0.05) & (at_s < end + 0.05)] = 0.31
        return MadeLog(MadeTable("GPS", np.round(at_s * S).astype(np.int64), {"Spd": speed}), path=f"/{path}")

    a, b = moving("a", (5.0, 5.9), (10.0, 11.0)), moving("b", (20.0, 30.0))
    assert pair_logs(a, b, "motion").instant(20 * S) == 10 * S


def test_limits_of_the_compared_time() -> None:
    a, b = autopilot(0.0, armed_s=(10.0, 60.0), path="a"), autopilot(100.0, armed_s=(20.0, 90.0), path="b")
    laid = shifted(-100.0, zero_ns=5 * S)
    plain = limited(a, b, laid, 2.0, 30.0, False)
    assert (plain.from_ns, plain.until_ns) == (7 * S, 35 * S)
    both = limited(a, b, laid, None, None, True)
    assert (both.from_ns, both.until_ns) == (20 * S, 60 * S)
    within = limited(a, b, laid, 20.0, 40.0, True)
    assert (within.from_ns, within.until_ns) == (25 * S, 45 * S)
    wider = limited(a, b, laid, 2.0, 80.0, True)
    assert (wider.from_ns, wider.until_ns) == (20 * S, 60 * S)
    with pytest.raises(LogError, match="the end is before the beginning"):
        limited(a, b, laid, 30.0, 30.0, False)
    with pytest.raises(LogError, match="B does not show when it was armed"):
        limited(a, autopilot(0.0, path="c"), laid, None, None, True)


@pytest.mark.parametrize(("rows", "size_deg", "told"), [(50, 2.0, True), (49, 2.0, False), (50, 0.6, False)])
def test_a_signal_that_differs_contradicts_a_pairing(rows: int, size_deg: float, told: bool) -> None:
    def rolling(phase: float) -> MadeLog:
        at_s = np.arange(rows) * 0.5
        roll = size_deg * (np.sin(at_s) if phase == 0.0 else np.sin(1.7 * at_s))
        return MadeLog(
            MadeTable(
                "ATT", np.round(at_s * S).astype(np.int64), {"Roll": roll, "Pitch": 0.0 * roll, "Yaw": 0.0 * roll}
            )
        )

    against = contradiction(rolling(0.0), rolling(1.0), shifted())
    assert (against is not None) is told
    assert against is None or against.startswith("roll of both correlates 0.")
    assert contradiction(rolling(0.0), rolling(0.0), shifted()) is None


# Trajectories


def path_of(pos_m: Any, quat: Any = (1.0, 0.0, 0.0, 0.0)) -> Trajectory:
    pos = np.asarray(pos_m, dtype=np.float64)
    return Trajectory(S * np.arange(len(pos)), pos, np.broadcast_to(np.asarray(quat, dtype=np.float64), (len(pos), 4)))


def test_statistics_of_errors() -> None:
    found = error_statistics(np.array([3.0, 4.0, 0.0, 5.0]))
    assert found is not None
    figures = (found.count, found.rms, found.mean, found.median, found.std, found.least, found.most, found.sse)
    assert figures == (4, pytest.approx(12.5**0.5), 3.0, 3.5, pytest.approx(3.5**0.5), 0.0, 5.0, 50.0)
    assert error_statistics(np.array([])) is None


def test_pairs_of_poses() -> None:
    assert frame_pairs(7, 3).tolist() == [[0, 3], [3, 6]]
    assert frame_pairs(1, 1).tolist() == []
    along = np.array([[0, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [1.4, 0, 0], [1.4, 0.7, 0], [1.4, 1.6, 0]])
    assert path_pairs(along, 1.0).tolist() == [[0, 2], [2, 4]]


def test_distance_from_a_path() -> None:
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]])
    points = np.array([[5.0, 2.0], [-3.0, 4.0], [13.0, 9.0], [12.0, 2.0], [10.0, 0.0]])
    assert off_path_m(points, path).tolist() == [2.0, 5.0, 5.0, 2.0, 0.0]
    assert off_path_m(points[:2], path[:1]).tolist() == pytest.approx([29.0**0.5, 5.0])


def test_a_path_is_thinned_by_its_length() -> None:
    path = np.stack([np.repeat(np.arange(11.0), 2), np.zeros(22)], axis=1)
    assert thinned_path(path, 2.0)[:, 0].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert thinned_path(path, 0.1, most=5)[:, 0].tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert thinned_path(np.zeros((5, 2))).tolist() == [[0.0, 0.0]]


def test_relative_errors_by_hand() -> None:
    """B turns 90 degrees more than A between the poses, and goes 3 m ahead where A goes 2 m."""
    half = np.sqrt(0.5)
    a = path_of([[0, 0, 0], [2, 0, 0]])
    b = Trajectory(
        a.stamp_ns, np.array([[5.0, 5.0, 0.0], [5.0, 8.0, 0.0]]), np.array([[half, 0, 0, half], [0.0, 0, 0, 1.0]])
    )
    moved_m, turned_deg = relative_errors(a, b, np.array([[0, 1]]))
    assert (moved_m.tolist(), turned_deg.tolist()) == ([pytest.approx(1.0)], [pytest.approx(90.0)])


def test_the_similarity_of_known_points() -> None:
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    found = umeyama(points, 2.5 * points @ rotation.T + [1.0, 2.0, 3.0], with_scale=True)
    assert found is not None
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, [1.0, 2.0, 3.0], atol=1e-12)
    assert found.scale == pytest.approx(2.5)
    mirrored = umeyama(points, points * [1.0, 1.0, -1.0])
    assert mirrored is not None
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1.0)
    assert umeyama(points[:2], points[:2]) is None


def test_first_poses_are_made_equal() -> None:
    half = np.sqrt(0.5)
    a = path_of([[10.0, 20.0, 0.0], [11.0, 20.0, 0.0]])
    b = path_of([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], (half, 0.0, 0.0, half))  # heads north
    moved, how = align_trajectory(a, b, "origin")
    assert how is not None
    np.testing.assert_allclose(moved.pos_m, a.pos_m, atol=1e-12)
    np.testing.assert_allclose(np.abs(moved.quat_wxyz), a.quat_wxyz, atol=1e-12)
    assert align_trajectory(a, b, "none") == (b, None)


def test_lines_for_evo() -> None:
    trajectory = Trajectory(
        np.array([1_790_000_000_000_000_007]), np.array([[1.0, -2.0, 0.5]]), np.array([[0.1, 0.2, 0.3, 0.4]])
    )
    assert tum_text(trajectory) == (
        "1790000000.000000007 1.000000000 -2.000000000 0.500000000 0.200000000 0.300000000 0.400000000 0.100000000\n"
    )


def poses(apart: Any, common: bool = True, attitudes: bool = True, rows: int = 5) -> PosePair:
    pos = np.stack([np.arange(rows) * 3.0, np.arange(rows) ** 2 * 1.0, np.zeros(rows)], axis=1)
    a, b = path_of(pos), path_of(pos + np.asarray(apart, dtype=np.float64))
    return PosePair(a, b, (47.0, 8.0, 400.0), common, attitudes, ("POS", "POS"), pos[:, :2])


def keys(section: Section) -> dict[str, Severity]:
    return {one.key.partition(".")[2]: one.severity for one in section.findings}


def test_the_section_of_a_shifted_path() -> None:
    section = trajectory_section(poses([3.0, -4.0, 0.5]), "none")
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["common_time_s"], facts["iae_x_ms"], facts["iae_y_ms"]) == (4.0, 12.0, 16.0)
    assert (facts["position_rms_m"], facts["position_max_m"]) == (5.0, 5.0)
    assert (facts["east_max_m"], facts["north_max_m"]) == (3.0, 4.0)
    assert (facts["alignment"], facts["origin"]) == ("none", "47.0000000, 8.0000000, 400.00 m")
    assert [one.sentence for one in section.findings] == ["B is 5 m (RMS) from A at the same instant, at most 5 m"]
    assert keys(section) == {"distance": Severity.OK}
    rows = {row[0]: row[1:] for row in section.grids[0].rows}
    assert rows["ATE, level (m)"] == (5.0, 5.0, 5.0, 5.0, 0.0, 5.0, 125.0, 5)
    assert rows["ATE, in space (m)"][0] == pytest.approx(25.25**0.5)
    assert rows["RPE, pose to pose (m)"] == (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4)
    assert list(rows)[2:] == [
        "RPE, pose to pose (m)", "RPE, pose to pose (deg)", "RPE, 1 m of B's path (m)", "RPE, 1 m of B's path (deg)",
    ]  # fmt: skip
    paths, apart, off = section.plots
    assert (paths.kind, paths.traces[1].x.tolist()) == ("map", [3.0, 6.0, 9.0, 12.0, 15.0])
    assert [trace.y.tolist() for trace in apart.traces] == [[3.0] * 5, [-4.0] * 5, [5.0] * 5]
    assert len(off.traces[0].y) == 5


@pytest.mark.parametrize(
    ("apart", "common", "expected"),
    [
        ([9.9, 0, 0], True, {"distance": Severity.OK}),
        ([10.0, 0, 0], True, {"distance": Severity.NOTICE}),
        ([0, 50.0, 0], True, {"distance": Severity.WARNING}),
        ([2001.0, 0, 0], True, {"distance": Severity.WARNING, "elsewhere": Severity.WARNING}),
        ([1999.0, 0, 0], True, {"distance": Severity.WARNING}),
        ([0.1, 0, 2.1], True, {"distance": Severity.OK, "heights": Severity.NOTICE}),
        ([0.1, 0, -1.9], True, {"distance": Severity.OK}),
        ([1.0, 0, 2.9], True, {"distance": Severity.OK}),  # less than three times the horizontal distance
        ([1.0, 0, 3.1], True, {"distance": Severity.OK, "heights": Severity.NOTICE}),
        ([1.0, 0, 0], False, {"distance": Severity.OK, "zeros": Severity.WARNING}),
    ],
)
def test_findings_on_paths(apart: list[float], common: bool, expected: dict[str, Severity]) -> None:
    section = trajectory_section(poses(apart, common), "none")
    assert keys(section) == expected
    for one in section.findings:
        if one.key == "trajectory.elsewhere":
            assert one.sentence.startswith("The two paths lie 2.0 km apart")
        if one.key == "trajectory.heights":
            assert f"differ by {apart[2]:.1f} m (RMS), at most {apart[2]:.1f} m" in one.sentence


def test_an_aligned_path_says_how_it_was_moved() -> None:
    section = trajectory_section(poses([3.0, -4.0, 0.5], common=False), "se3")
    facts = {fact.key: fact.value for fact in section.facts}
    assert facts["alignment"] == "se3"
    assert facts["moved_m"] == "-3 east, 4 north, -0.5 up"
    assert (facts["turned_deg"], facts["scale"]) == (pytest.approx(0.0, abs=1e-3), 1.0)
    assert facts["position_rms_m"] == pytest.approx(0.0, abs=1e-9)
    assert keys(section) == {"distance": Severity.OK}


def test_a_straight_path_cannot_be_fitted() -> None:
    pos = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
    moved = path_of(pos + np.array([1.0, 0.0, 0.0]))
    straight = PosePair(path_of(pos), moved, None, True, False, ("A", "B"), pos[:, :2])
    section = trajectory_section(straight, "se3")
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["alignment"], facts["origin"], "moved_m" in facts) == ("se3: not possible", None, False)
    assert keys(section) == {"distance": Severity.OK, "not_aligned": Severity.WARNING}
    assert section.lacks == ("Rotations are not compared, because one of the logs has no attitude.",)
    assert not any("deg" in str(row[0]) for row in section.grids[0].rows)


# Analyses of both logs


def analysis(of: dict[str, Section | None], name: str = "x") -> LogAnalysis:
    def section(log: Log) -> Section | None:
        return of[log.path.stem]

    return LogAnalysis(name, section)


def judged(*facts: Fact, plots: tuple[Plot, ...] = (), lacks: tuple[str, ...] = ()) -> Section:
    return Section("x", "Things", facts, (Finding.ok("x", "y"),), plots=plots, lacks=lacks)


A, B = MadeLog(path="a"), MadeLog(path="b")


def test_facts_of_both_logs() -> None:
    one = judged(
        Fact("n", "Number", 3, "m"),
        Fact("r", "Rate", 0.1),
        Fact("w", "Words", "yes"),
        Fact("a", "Alone", 1, "s"),
        Fact("t", "Truth", True),
        lacks=("one.",),
    )
    other = judged(
        Fact("n", "Number", 5, "m"),
        Fact("r", "Rate", 0.4),
        Fact("w", "Words", "no"),
        Fact("z", "Last", 7),
        Fact("t", "Truth", False),
        lacks=("two.",),
    )
    section = overlay(analysis({"a": one, "b": other}), A, B, shifted())
    assert section is not None
    both, alone = section.grids
    assert both.rows == (("Number", "m", 3, 5, 2), ("Rate", "", 0.1, 0.4, 0.3), ("Truth", "", True, False, None))
    assert alone.rows == (("Alone", "s", 1, None), ("Last", "", None, 7))
    assert [(fact.key, fact.value) for fact in section.facts] == [("w", "A: yes; B: no")]
    assert section.lacks == ("A: one.", "B: two.")
    assert section.findings == ()


def test_plots_of_both_logs_are_joined_on_the_time_of_a() -> None:
    def plot(key: str, *names: str, kind: Any = "time") -> Plot:
        return Plot(
            key, key, "m", tuple(Trace(name, np.array([S, 2 * S]), np.array([1.0, 2.0])) for name in names), kind
        )

    one = judged(plots=(plot("p", "v", "w"), plot("a", "v"), plot("xy", "v", kind="xy")))
    other = judged(plots=(plot("p", "w", "u"), plot("b", "v"), plot("xy", "v", kind="xy")))
    section = overlay(analysis({"a": one, "b": other}), A, B, shifted(10.0))
    assert section is not None
    drawn = {each.key: [(trace.name, trace.x.tolist()) for trace in each.traces] for each in section.plots}
    here, there = [S, 2 * S], [11 * S, 12 * S]
    assert drawn == {
        "p": [("A · w", here), ("B · w", there)], "a": [("A · v", here)], "xy": [("A · v", here), ("B · v", here)],
        "b": [("B · v", there)],
    }  # fmt: skip


def test_an_analysis_of_one_log_alone_or_that_fails() -> None:
    only_a = overlay(analysis({"a": judged(), "b": None}), A, B, shifted())
    only_b = overlay(analysis({"a": None, "b": judged()}), A, B, shifted())
    assert only_a is not None
    assert only_b is not None
    assert (only_a.lacks, only_b.lacks) == (
        ("Things can be judged for A only.",),
        ("Things can be judged for B only.",),
    )
    assert overlay(analysis({"a": None, "b": None}), A, B, shifted()) is None
    failed = overlay(analysis({}), A, B, shifted())
    assert failed is not None
    assert len(failed.lacks) == 1


def test_sim_of_another_vessel_is_a_finding() -> None:
    assert stray_truth_finding("A", MadeLog(MadeTable("ATT", [0], {"Roll": [0.0]}))) is None
