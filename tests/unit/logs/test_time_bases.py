"""Time bases: relations and logs with known clocks, and the figures, sentences and plots that follow from them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.fit import ClockRelation, ClockStep, FitPiece
from xitl_cli.logs.clocks.readings import ClockReadings
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import time_bases
from xitl_cli.plugins.logs.analyses.time_bases import (
    allan_of,
    clock_pair_section,
    even_findings,
    pair_key,
    pair_rate,
    rate_variation,
    real_steps,
    sample_clock_section,
    sample_clocks,
)

SECOND = 1_000_000_000
EMPTY = MadeLog(MadeTable("NONE", [0, 100 * SECOND], {"A": [0, 0]}))
CLOCK = LogClock(EMPTY)


def piece(
    from_s: float, until_s: float, slope_ppm: float = 0.0, error_ppm: float | None = 1.0, offset_s: float = 0.0,
    residual_s: float = 1e-3,
) -> FitPiece:  # fmt: skip
    """A line with this offset at its start."""
    begin, end, offset = (round(one * SECOND) for one in (from_s, until_s, offset_s))
    return FitPiece(begin, end, begin, offset, slope_ppm, error_ppm, 1e-4, residual_s, 100)


def step(at_s: float, size_s: float) -> ClockStep:
    at_ns = round(at_s * SECOND)
    return ClockStep(round(at_s), at_ns, at_ns, size_s)


def relation(*pieces: FitPiece, steps: tuple[ClockStep, ...] = (), **of: Any) -> ClockRelation:
    """Readings each second of 0 s to 100 s, unless `of` gives others."""
    at_ns = np.arange(101, dtype=np.int64) * SECOND
    readings = {"key": "rtc.x", "first": "A", "second": "B", "first_ns": at_ns, "message": "M", "fields": "F"}
    readings |= {name: of.pop(name) for name in list(of) if name in ClockReadings.__dataclass_fields__}
    readings.setdefault("at_ns", readings["first_ns"])
    made = ClockReadings(second_ns=readings["first_ns"], **readings)  # type: ignore[arg-type]
    rest = {
        "residual_s": np.zeros(len(made)),
        "window_s": 10.0,
        "window_ns": np.array([], dtype=np.int64),
        "window_ppm": np.array([]),
    }
    return ClockRelation(made, pieces, steps, **(rest | of))


def pairs(*relations: ClockRelation) -> Section:
    return clock_pair_section(EMPTY, relations, CLOCK)


def findings(*relations: ClockRelation) -> list[Finding]:
    return list(pairs(*relations).findings)


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


# Figures of a pair of clocks


def test_the_rate_is_weighted_by_the_cube_of_the_length_of_each_piece() -> None:
    two = relation(piece(0.0, 10.0, 10.0, 3.0), piece(20.0, 40.0, 40.0, 5.0), piece(40.0, 99.0, 900.0, None))
    assert pair_rate(two) == (pytest.approx((10.0 * 1000.0 + 40.0 * 8000.0) / 9000.0), 5.0)


def test_with_too_few_readings_in_every_piece_the_longest_gives_the_rate() -> None:
    assert pair_rate(relation(piece(0.0, 10.0, 10.0, None), piece(10.0, 21.0, 40.0, None))) == (40.0, None)


def test_windows_vary_by_their_sample_deviation() -> None:
    assert rate_variation(relation(piece(0.0, 100.0), window_ppm=np.array([1.0, 2.0, 3.0, 6.0]))) == pytest.approx(
        (14.0 / 3.0) ** 0.5
    )
    assert rate_variation(relation(piece(0.0, 100.0), window_ppm=np.array([1.0]))) is None
    assert rate_variation(relation(piece(0.0, 100.0), window_ppm=np.array([1.0, 1.0]))) == 0.0


def test_a_small_move_of_utc_is_no_step_but_of_another_clock_it_is() -> None:
    sizes_s = (0.25, 0.2501, -0.2499, -0.4, 0.0, 1e-4)
    steps = tuple(step(float(at_s), size_s) for at_s, size_s in enumerate(sizes_s, start=10))
    pieces = [piece(0.0, 1.0)] * 7
    assert [one.size_s for one in real_steps(relation(*pieces, steps=steps, key="rtc"))] == [0.2501, -0.4]
    assert [one.size_s for one in real_steps(relation(*pieces, steps=steps, key="gps"))] == [
        0.25, 0.2501, -0.2499, -0.4, 1e-4,
    ]  # fmt: skip


def test_keys_of_facts_are_names_for_machines() -> None:
    made = relation(piece(0.0, 100.0, 12.3456, 0.4567), key="header./Lidar/points")
    assert pair_key(made.readings) == "header__lidar_points"
    assert facts(pairs(made)) == {
        "header__lidar_points_ppm": 12.35,
        "header__lidar_points_error_ppm": 0.46,
        "header__lidar_points_steps": 0,
    }
    assert [fact.label for fact in pairs(made).facts] == [
        "Drift of B against A", "Standard error of the drift of B against A", "Steps of B against A",
    ]  # fmt: skip


@pytest.mark.parametrize(("error_ppm", "known"), [(333.3, True), (333.4, False), (None, False)])
def test_a_rate_that_is_hardly_known_is_no_fact(error_ppm: float | None, known: bool) -> None:
    assert ("gps_ppm" in facts(pairs(relation(piece(0.0, 100.0, 1.0, error_ppm), key="gps")))) is known


def test_the_table_has_one_row_for_each_pair() -> None:
    first_ns = np.array([1, 2, 3, 7, 8], dtype=np.int64) * SECOND
    one = relation(
        piece(1.0, 8.0, 1.234, 0.567, residual_s=1.23456e-3), first_ns=first_ns, key="gps", message="GPA", fields="SMS",
        window_ppm=np.array([1.0, 2.0, 6.0]), first="UTC", second="the autopilot",
    )  # fmt: skip
    (grid,) = pairs(one, relation(piece(0.0, 100.0))).grids
    assert dict(zip(grid.columns, grid.rows[0], strict=True)) == {
        "clocks": "the autopilot against UTC",
        "from": "GPA: SMS",
        "readings": 5,
        "over (s)": 7.0,
        "drift (ppm)": 1.23,
        "standard error (ppm)": 0.57,
        "windows vary by (ppm)": 2.65,  # sqrt(7)
        "readings scatter by (ms)": 1.2346,
        "steps": 0,
        "longest gap (s)": 4.0,
    }
    assert [row[0] for row in grid.rows] == ["the autopilot against UTC", "B against A"]
    assert pairs().grids == ()


# Findings on steps


def stepped(*steps_at_and_size: tuple[float, float], residual_s: float = 1e-3, **of: Any) -> ClockRelation:
    """A clock that is even but for steps at these seconds."""
    bounds = [0.0, *(at_s for at_s, _ in steps_at_and_size), 100.0]
    offsets = np.cumsum([0.0, *(size_s for _, size_s in steps_at_and_size)])
    pieces = [
        piece(a, b, offset_s=float(offset), residual_s=residual_s)
        for a, b, offset in zip(bounds, bounds[1:], offsets, strict=False)
    ]
    return relation(*pieces, steps=tuple(step(*each) for each in steps_at_and_size), **of)


@pytest.mark.parametrize(
    ("size_s", "text", "severity"),
    [
        (0.1, "0.100 s ahead", Severity.WARNING),
        (-0.1, "0.100 s back", Severity.WARNING),
        (-1.2346, "1.235 s back", Severity.WARNING),
        (0.0999, "99.9 ms ahead", Severity.NOTICE),
        (-0.00123, "1.2 ms back", Severity.NOTICE),
    ],
)
def test_a_step_has_its_instant_size_and_direction(size_s: float, text: str, severity: Severity) -> None:
    (finding,) = findings(stepped((62.04, size_s)))
    assert finding.key == "time_bases.step"
    assert finding.sentence == f"At 1:02.0 B stepped {text} against A"
    assert finding.severity is severity
    assert finding.evidence == (Evidence("M", "F", 62_040_000_000, value=f"{size_s:+.4f} s"),)


def test_one_step_that_two_pairs_show_is_one_finding_by_the_more_exact_pair() -> None:
    rough = stepped((50.0, 0.5), residual_s=2e-3, second="rough", message="R")
    exact = stepped((52.4, -0.59), residual_s=1e-3, second="exact", message="E")
    (finding,) = findings(rough, exact)
    assert finding.sentence == "At 0:52.4 exact stepped 0.590 s back against A"
    assert [evidence.message for evidence in finding.evidence] == ["E", "R"]


@pytest.mark.parametrize(
    ("at_s", "size_s", "many"),
    [
        (52.49, 0.5, 1),
        (52.51, 0.5, 2),  # farther than 2 s and the size of the step
        (51.0, 0.599, 1),
        (51.0, 0.601, 2),  # another size by more than a fifth
        (51.0, 0.401, 1),
        (51.0, 0.399, 2),
        (51.0, -0.5, 1),  # the other clock of the pair is the one that stepped
    ],
)
def test_steps_of_two_pairs_are_one_if_near_and_alike(at_s: float, size_s: float, many: int) -> None:
    assert len(findings(stepped((50.0, 0.5)), stepped((at_s, size_s), second="C"))) == many


@pytest.mark.parametrize(("at_s", "many"), [(54.9, 1), (55.1, 2)])
def test_steps_of_one_clock_within_five_seconds_are_one_trouble(at_s: float, many: int) -> None:
    assert len(findings(stepped((50.0, 0.5), (at_s, -3.0)))) == many


def test_several_steps_in_a_row_are_summed() -> None:
    found = findings(stepped((50.0, 0.05), (53.0, 0.06), (57.0, -0.02), (80.0, 0.07)))
    assert [finding.sentence for finding in found] == [
        "From 0:50.0 to 0:57.0 B stepped 3 times, in all 90.0 ms ahead against A",
        "At 1:20.0 B stepped 70.0 ms ahead against A",
    ]
    assert [finding.severity for finding in found] == [Severity.NOTICE, Severity.NOTICE]  # by the largest, not the sum
    assert [evidence.value for evidence in found[0].evidence] == ["+0.0500 s", "+0.0600 s", "-0.0200 s"]


def test_the_sum_of_steps_is_between_the_lines_before_and_after_them() -> None:
    """Of which the rate is no step."""
    made = relation(
        piece(0.0, 50.0, 1000.0), piece(50.0, 52.0, 1000.0, offset_s=0.25), piece(52.0, 100.0, 1000.0, offset_s=0.452),
        steps=(step(50.0, 0.2), step(52.0, 0.2)),
    )  # fmt: skip
    # The first line would have reached 0.052 s.
    assert findings(made)[0].sentence == "From 0:50.0 to 0:52.0 B stepped 2 times, in all 0.400 s ahead against A"


def test_at_most_five_steps_are_evidence() -> None:
    (finding,) = findings(stepped(*((50.0 + at, 0.01) for at in range(7))))
    assert [evidence.at_ns for evidence in finding.evidence] == [(50 + at) * SECOND for at in range(5)]


# Findings on rates


@pytest.mark.parametrize(
    ("rate_ppm", "error_ppm", "sentence", "severity"),
    [
        (130.0, 9.9, "B against A runs 130 ppm fast (standard error 9.9), 468 ms an hour", Severity.NOTICE),
        (-130.0, 9.9, "B against A runs 130 ppm slow (standard error 9.9), 468 ms an hour", Severity.NOTICE),
        (999.0, 1.0, "B against A runs 999 ppm fast (standard error 1.0), 3596 ms an hour", Severity.NOTICE),
        (-1000.0, 1.0, "B against A runs 1000 ppm slow (standard error 1.0), 3600 ms an hour", Severity.WARNING),
        (20_000.0, 1.0, "B against A runs 20000 ppm fast (standard error 1.0), 72000 ms an hour", Severity.WARNING),
    ],
)
def test_a_drift_that_no_crystal_has(rate_ppm: float, error_ppm: float, sentence: str, severity: Severity) -> None:
    (finding,) = findings(relation(piece(0.0, 100.0, rate_ppm, error_ppm)))
    assert (finding.key, finding.sentence, finding.severity) == ("time_bases.drift", sentence, severity)
    assert finding.evidence == (Evidence("M", "F", value=f"{rate_ppm:+.1f} ppm"),)


@pytest.mark.parametrize(("rate_ppm", "error_ppm"), [(130.0, 10.0), (-130.0, 10.1), (100.0, 0.0), (5e4, None)])
def test_a_drift_within_its_error_or_that_of_a_crystal_is_none(rate_ppm: float, error_ppm: float | None) -> None:
    assert findings(relation(piece(0.0, 100.0, rate_ppm, error_ppm))) == []


@pytest.mark.parametrize(
    ("rate_ppm", "sentence", "value"),
    [
        (20_001.0, "B went 1.02 times as fast as A: one of them is a simulation's", "1.02"),
        (1_500_000.0, "B went 2.50 times as fast as A: one of them is a simulation's", "2.50"),
        (-600_000.0, "A went 2.50 times as fast as B: one of them is a simulation's", "2.50"),
    ],
)
def test_clocks_with_different_seconds(rate_ppm: float, sentence: str, value: str) -> None:
    (finding,) = findings(relation(piece(0.0, 100.0, rate_ppm, 1.0)))
    assert (finding.key, finding.sentence, finding.severity) == ("time_bases.scaled", sentence, Severity.NOTICE)
    assert finding.evidence == (Evidence("M", "F", value=value),)


def test_on_a_simulated_clock_a_drift_is_only_a_notice_and_that_of_its_samples_none() -> None:
    log = MadeLog(MadeTable("SIM", [0, 100 * SECOND], {"A": [0, 0]}))
    fast = piece(0.0, 100.0, 5000.0, 1.0)
    made = [relation(fast, key="gps"), relation(fast, key="samples.IMU")]
    (finding,) = clock_pair_section(log, made, LogClock(log)).findings
    assert finding.severity is Severity.NOTICE
    assert [one.severity for one in findings(*made)] == [Severity.WARNING, Severity.WARNING]


def bent(before_ppm: float, after_ppm: float, at_s: float = 40.0, errors_ppm: Any = (0.3, 0.4)) -> ClockRelation:
    pieces = piece(0.0, at_s, before_ppm, errors_ppm[0]), piece(at_s, 100.0, after_ppm, errors_ppm[1])
    return relation(*pieces, steps=(step(at_s, 0.0),))


def test_a_change_of_rate_has_both_rates_and_their_common_error() -> None:
    (finding,) = findings(bent(-5.04, 20.0))
    assert finding.key == "time_bases.rate_change"
    assert finding.severity is Severity.NOTICE
    assert finding.sentence == (
        "About 0:40.0 the rate of B against A changed from -5.0 to +20.0 ppm (standard error 0.5)"
    )
    assert finding.evidence == (Evidence("M", "F", 40 * SECOND),)


@pytest.mark.parametrize(
    ("made", "many"),
    [
        (bent(0.0, 10.0), 1),
        (bent(10.0, 0.0), 1),
        (bent(0.0, 9.9), 0),
        (bent(0.0, 50.0, 5.0), 1),
        (bent(0.0, 50.0, 4.9), 0),
        (bent(0.0, 50.0, 95.1), 0),
        (bent(0.0, 15.0, errors_ppm=(3.0, 4.0)), 1),  # 3 x 5 ppm
        (bent(0.0, 14.9, errors_ppm=(3.0, 4.0)), 0),
        (bent(0.0, 50.0, errors_ppm=(None, 0.4)), 0),
        (bent(0.0, 50.0, errors_ppm=(0.3, None)), 0),
    ],
)
def test_a_change_of_rate_counts_if_large_long_and_sure(made: ClockRelation, many: int) -> None:
    assert len([one for one in findings(made) if one.key == "time_bases.rate_change"]) == many


def test_without_a_finding_the_pairs_of_known_rate_are_even() -> None:
    known, unknown = relation(piece(0.0, 100.0, 5.0, 33.3)), relation(piece(0.0, 100.0, 5.0, 33.4))
    no_error = relation(piece(0.0, 100.0, 5.0, None))
    assert even_findings([no_error, unknown]) == ()
    assert [one.sentence for one in even_findings([unknown, known])] == [
        "No step and no drift of more than 100 ppm: B against A"
    ]
    (finding,) = even_findings([known, known, no_error])
    assert finding.sentence == "No step and no drift of more than 100 ppm: 2 pairs of clocks"
    assert (finding.key, finding.severity) == ("time_bases.even", Severity.OK)


# Findings on gaps


def read_at(*at_s: float, key: str = "clocks.LC") -> ClockRelation:
    at_ns = np.round(np.array(at_s) * SECOND).astype(np.int64)
    return relation(piece(0.0, 100.0), first_ns=at_ns, at_ns=at_ns + SECOND, key=key)


def test_a_clock_that_is_read_on_purpose_has_gaps() -> None:
    at_s = [*np.arange(0.0, 10.0, 0.1), 12.0, 12.1, 14.5, *np.arange(14.6, 20.0, 0.1)]
    (finding,) = findings(read_at(*at_s))
    assert finding.key == "time_bases.gap"
    assert finding.sentence == "B was not read for 2.4 s after 0:13.1, else every 0.10 s; 2 such gaps"
    assert finding.evidence == (Evidence("M", "F", 13_100_000_000, 15_500_000_000),)
    assert len(findings(read_at(*at_s, key="timesync.1"))) == 1
    assert findings(read_at(*at_s, key="gps")) == []


@pytest.mark.parametrize(
    ("usual_s", "gap_s", "many"),
    [
        (0.05, 1.0, 0), (0.05, 1.01, 1),  # a second at least
        (0.25, 2.5, 0), (0.25, 2.51, 1),  # ten periods
        (0.5, 5.0, 0), (0.5, 5.01, 1),
        (0.375, 3.76, 1), (0.75, 7.4, 0), (0.75, 7.6, 1),
    ],
)  # fmt: skip
def test_a_gap_is_ten_periods_and_seconds(usual_s: float, gap_s: float, many: int) -> None:
    begin_s = np.arange(20) * usual_s
    assert len(findings(read_at(*begin_s, *(begin_s[-1] + gap_s + begin_s)))) == many


# Plots of pairs


def test_residuals_windows_and_steps_are_drawn() -> None:
    residual_s = np.linspace(-1e-3, 1e-3, 101)
    made = relation(
        piece(0.0, 40.0), piece(40.0, 70.0), piece(70.0, 100.0), steps=(step(40.0, 0.25), step(70.0, 0.0)),
        residual_s=residual_s, window_ns=np.array([5, 15, 200], dtype=np.int64) * SECOND,
        window_ppm=np.array([1.0, 2.0, 3.0]), window_s=9.6, key="gps",
        at_ns=np.arange(101, dtype=np.int64) * SECOND + 7,
    )  # fmt: skip
    residual, rate, allan = pairs(made, relation(piece(0.0, 100.0))).plots  # a pair without residuals is not drawn
    assert [trace.name for trace in allan.traces] == ["B against A"]
    assert (residual.key, residual.title, residual.y_label) == (
        "residual_gps", "B against A: residual of the offset", "ms",
    )  # fmt: skip
    assert residual.traces[0].x.tolist() == (np.arange(101) * SECOND + 7).tolist()
    assert residual.traces[0].y == pytest.approx(np.linspace(-1.0, 1.0, 101))
    assert [(mark.at_ns, mark.text) for mark in residual.marks] == [
        (40 * SECOND, "step +0.250 s"), (70 * SECOND, "rate changes"),
    ]  # fmt: skip
    assert (rate.key, rate.title, rate.y_label) == ("rate_gps", "B against A: drift in windows of 10 s", "ppm")
    assert rate.traces[0].x.tolist() == [5 * SECOND + 7, 15 * SECOND + 7, 100 * SECOND + 7]
    assert rate.traces[0].y.tolist() == [1.0, 2.0, 3.0]
    assert rate.marks == residual.marks


def test_many_readings_are_thinned_and_one_window_is_no_curve() -> None:
    first_ns = np.arange(12_001, dtype=np.int64) * 10_000_000
    residual_s = np.where(np.arange(12_001) % 2, 1e-3, -1e-3)
    made = relation(
        piece(0.0, 1.0), first_ns=first_ns, residual_s=residual_s, window_ppm=np.array([1.0]),
        window_ns=np.array([SECOND]),
    )  # fmt: skip
    residual, allan = pairs(made).plots
    assert residual.traces[0].x.tolist() == first_ns[::3].tolist()
    assert residual.traces[0].y.tolist() == (residual_s[::3] * 1e3).tolist()
    assert (allan.key, allan.kind, allan.traces[0].name) == ("clock_allan", "loglog", "B against A")


def test_the_allan_deviation_of_white_time_errors_falls_with_the_averaging_time() -> None:
    """The second differences of independent errors of 1 ms: 1 ms sqrt(3) / tau (IEEE 1139, white phase noise)."""
    rng = np.random.default_rng(4)
    first_ns = np.arange(20_000, dtype=np.int64) * 100_000_000 + 7 * SECOND
    made = relation(piece(7.0, 2100.0), first_ns=first_ns, residual_s=rng.normal(0.0, 1e-3, 20_000))
    curve = allan_of(made)
    assert curve is not None
    assert curve.tau_s[0] == pytest.approx(0.1)
    near = curve.tau_s < 20.0
    assert curve.deviation[near] == pytest.approx(1e-3 * 3.0**0.5 / curve.tau_s[near], rel=0.1)


def test_the_allan_deviation_is_that_of_the_longest_piece_alone() -> None:
    rng = np.random.default_rng(5)
    residual_s = rng.normal(0.0, 1e-3, 101)
    first_ns = np.arange(61, dtype=np.int64) * SECOND
    alone = allan_of(relation(piece(0.0, 60.0), first_ns=first_ns, residual_s=residual_s[30:91]))
    part = allan_of(relation(piece(0.0, 29.0), piece(30.0, 90.0), residual_s=residual_s))
    assert alone is not None
    assert part is not None
    assert part.tau_s.tolist() == alone.tau_s.tolist()
    assert part.deviation.tolist() == alone.deviation.tolist()


@pytest.mark.parametrize(("rows", "known"), [(39, False), (40, True)])
def test_forty_readings_give_an_allan_deviation(rows: int, known: bool) -> None:
    first_ns = np.arange(rows, dtype=np.int64) * SECOND
    residual_s = np.random.default_rng(6).normal(0.0, 1e-3, rows)
    made = relation(piece(0.0, 100.0), first_ns=first_ns, residual_s=residual_s)
    assert (allan_of(made) is not None) is known
    assert allan_of(relation(piece(0.0, 100.0), first_ns=first_ns)) is None  # no error, no deviation


def test_readings_with_long_pauses_have_no_allan_deviation() -> None:
    """Interpolated instants would be more than twice the readings."""
    residual_s = np.random.default_rng(7).normal(0.0, 1e-3, 101)
    for pause_s, known in ((95.0, True), (110.0, False)):
        first_s = np.arange(101.0)
        first_s[60:] += pause_s
        made = relation(piece(0.0, 400.0), first_ns=(first_s * SECOND).astype(np.int64), residual_s=residual_s)
        assert (allan_of(made) is not None) is known


# Clocks against the sample number


def messages(name: str, stamps_us: Any, **columns: Any) -> MadeTable:
    return MadeTable(name, np.asarray(stamps_us, dtype=np.int64) * 1000, {"A": np.zeros(len(stamps_us)), **columns})


def rows_of(log: MadeLog) -> list[dict[str, Any]]:
    section = sample_clock_section(log, (), LogClock(log))
    return [dict(zip(grid.columns, row, strict=True)) for grid in section.grids for row in grid.rows]


def test_an_even_message_has_its_period_and_the_deviation_from_the_nominal_rate() -> None:
    log = MadeLog(messages("IMU", 5000 + np.arange(200) * 20_010))
    assert rows_of(log) == [
        {
            "clock": "IMU, autopilot's clock",
            "from": "IMU.TimeUS",
            "samples": 200,
            "ms a sample": 20.01,
            "parts vary by (us)": 0.0,
            "steps scatter by (us)": 0.0,
            "meant (Hz)": 50.0,
            "off (ppm)": 500.0,
            "gaps": 0,
            "longest gap (s)": 0.0,
        }
    ]
    section = sample_clock_section(log, (), LogClock(log))
    assert facts(section) == {"sample_clock": "IMU, autopilot's clock", "seconds_per_sample": 0.02001}
    assert section.findings == ()  # without numbers, a lost row looks like a slow clock


def test_the_slope_and_its_variation_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(2)
    stamps_us = np.cumsum(rng.integers(9_000, 11_000, 500))
    (row,) = rows_of(MadeLog(messages("ATT", stamps_us)))
    number, clock_us = np.arange(500.0), stamps_us - stamps_us[0]
    parts = [
        np.polyfit(*part, 1)[0] for part in zip(np.array_split(number, 10), np.array_split(clock_us, 10), strict=False)
    ]
    assert row["ms a sample"] == pytest.approx(np.polyfit(number, clock_us, 1)[0] * 1e-3, abs=1e-6)
    assert row["parts vary by (us)"] == pytest.approx(np.std(parts, ddof=1), abs=1e-3)
    assert row["steps scatter by (us)"] == pytest.approx(np.std(np.diff(stamps_us)), abs=0.1)


def test_lost_rows_are_counted_and_late_ones_are_not() -> None:
    kept = np.delete(np.arange(300), [100, 200, 201])
    stamps_us = kept * 20_000
    stamps_us[50] += 15_000  # late; its neighbour makes up for it
    (clock,) = sample_clocks(MadeLog(messages("IMU", stamps_us)))
    assert clock.number.tolist() == kept.tolist()
    assert clock.gaps == 3  # and the late row
    assert clock.longest_gap_s == pytest.approx(0.06)
    assert clock.per_sample_s == pytest.approx(0.02, rel=1e-4)
    assert clock.scatter_s == pytest.approx(np.std([*[0.02] * 294, 0.035, 0.005]), rel=1e-3)


@pytest.mark.parametrize(
    ("stamps_us", "even"),
    [
        (np.arange(51) * 20_000, True),
        (np.arange(50) * 20_000, False),  # too few steps
        (np.cumsum(20_000 + np.tile([-4_700, 0, 4_700], 30)), True),
        (np.cumsum(20_000 + np.tile([-4_750, 0, 4_750], 30)), False),  # 1.4826 of it is more than 0.35 periods
        (np.sort(np.append(np.arange(100), 40)) * 20_000, False),  # one stamp twice
        (np.append(np.arange(100), 40) * 20_000, False),  # back
    ],
)
def test_a_message_is_a_clock_if_it_is_even(stamps_us: Any, even: bool) -> None:
    assert bool(sample_clocks(MadeLog(messages("IMU", stamps_us)))) is even


@pytest.mark.parametrize(
    ("period_us", "loop_hz", "meant_hz"),
    [
        (20_000, None, 50.0),
        (19_610, None, 50.0),  # 50.99 Hz
        (19_600, None, None),  # 51.02 Hz
        (20_400, None, None),
        (33_333, None, None),
        (33_333, 300.0, 30.0),  # a tenth of the loop
        (3_333, 300.0, 300.0),
        (2_500, 300.0, 400.0),  # faster than the loop
        (20_000, 0.0, 50.0),
        (23_000, 300.0, 300.0 / 7.0),
    ],
)
def test_the_rate_that_is_meant(period_us: int, loop_hz: float | None, meant_hz: float | None) -> None:
    tables = [messages("IMU", np.arange(100) * period_us)]
    if loop_hz is not None:
        tables.append(MadeTable("PARM", [0], {"Name": ["SCHED_LOOP_RATE"], "Value": [loop_hz]}))
    (clock,) = sample_clocks(MadeLog(*tables))
    assert clock.rate_hz == (None if meant_hz is None else pytest.approx(meant_hz))
    if meant_hz is None:
        assert clock.off_ppm is None
    else:
        assert clock.off_ppm == pytest.approx(1e6 * (period_us * 1e-6 * meant_hz - 1.0))


def test_rates_that_a_user_sets_are_known() -> None:
    for rate_hz in (1, 2, 4, 5, 8, 10, 20, 25, 50, 100, 200, 250, 400, 500, 800, 1000, 2000):
        (clock,) = sample_clocks(MadeLog(messages("IMU", np.arange(60) * 1_000_000 // rate_hz)))
        assert clock.off_ppm == pytest.approx(0.0, abs=0.01), rate_hz


def test_the_sensors_clock_numbers_the_samples_of_a_message() -> None:
    """The autopilot's clock runs 1 % fast, and a row is lost."""
    kept = np.delete(np.arange(200), 77)
    imu = messages("IMU", kept * 20_200, SampleUS=kept * 20_000)
    sensor, autopilot = sample_clocks(MadeLog(imu))
    assert (sensor.name, sensor.field) == ("IMU, sensor's clock", "SampleUS")
    assert (autopilot.name, autopilot.field) == ("IMU, autopilot's clock", "TimeUS")
    assert sensor.per_sample_s == pytest.approx(0.02)
    assert autopilot.per_sample_s == pytest.approx(0.0202)
    assert autopilot.number.tolist() == kept.tolist()


def test_sensors_are_first_and_tables_of_the_format_are_left_out() -> None:
    even_us = np.arange(100) * 20_000
    names = ("AAA", "ATT", "IMU", "PARM", "ISBH", "MSG", "ZZZ")
    log = MadeLog(*(messages(name, even_us) for name in names if name != "PARM"))
    assert [clock.message for clock in sample_clocks(log)] == ["IMU", "ATT", "AAA", "ZZZ"]
    assert sample_clocks(MadeLog(messages("IMU", even_us), kind="mcap")) == []


def test_each_instance_is_a_clock_of_its_own() -> None:
    stamps_us = np.sort(np.concatenate((np.arange(100) * 20_000, 3 + np.arange(100) * 20_000)))
    table = MadeTable("IMU", stamps_us * 1000, {"I": np.tile([0, 1], 100)}, instance="I")
    assert [clock.name for clock in sample_clocks(MadeLog(table))] == [
        "IMU 0, autopilot's clock", "IMU 1, autopilot's clock",
    ]  # fmt: skip


def test_at_most_forty_clocks_are_shown() -> None:
    log = MadeLog(*(messages(f"M{number:02}", np.arange(60) * 20_000) for number in range(45)))
    assert len(sample_clocks(log)) == 40


def test_only_the_longest_part_between_steps_of_the_clock_counts() -> None:
    log = MadeLog(messages("IMU", np.arange(300) * 20_000))
    made = relation(piece(0.0, 100.0), steps=(step(1.0, 0.3), step(2.0, 0.0), step(4.0, -0.2)), key="samples.IMU")
    (clock,) = sample_clocks(log, [made])
    assert clock.at_ns.tolist() == (np.arange(50, 200) * 20_000_000).tolist()
    (whole,) = sample_clocks(log, [relation(piece(0.0, 100.0), steps=(step(4.0, 0.3),), key="gps")])
    assert len(whole.number) == 300  # GPS stepped, not this clock


def clocks_table(period_ms: float, rows: int = 200, late_from: int = 0) -> MadeTable:
    """Exchanges with LC, and steps of the host (PS1) each second one of which is numbered."""
    numbers = np.arange(rows, dtype=np.int64)
    at_ns = np.round(numbers * period_ms * 1e6).astype(np.int64)
    stamps = np.where(numbers < late_from, 0, at_ns)
    return MadeTable(
        "/clocks",
        np.concatenate((stamps, stamps)),
        {
            "node": np.array(["LC"] * rows + ["PS1"] * rows),
            "sample": np.concatenate((numbers, numbers * 4)),
            "node_ns": np.concatenate((7 * SECOND + at_ns, numbers * SECOND)),
            "host_ns": np.concatenate((numbers * SECOND, 9 * SECOND + at_ns)),
        },
    )


@pytest.mark.parametrize(
    ("period_ms", "sentence"),
    [
        (10.15, "LC, exchange takes 10.1500 ms a sample where 100 Hz is meant (+1.5 %)"),
        (9.85, "LC, exchange takes 9.8500 ms a sample where 100 Hz is meant (-1.5 %)"),
        (10.101, "LC, exchange takes 10.1010 ms a sample where 100 Hz is meant (+1.0 %)"),
        (10.099, None),
        (11.0, None),  # no nominal rate is near
    ],
)
def test_a_numbered_clock_that_is_off_its_rate_is_a_finding(period_ms: float, sentence: str | None) -> None:
    log = MadeLog(clocks_table(period_ms), kind="mcap", base="simulation")
    exchange, host = sample_clocks(log)
    assert (exchange.name, exchange.field) == ("LC, exchange", "sample, node_ns")
    assert (host.name, host.field) == ("PS1, step", "sample, host_ns")
    assert exchange.per_sample_s == pytest.approx(period_ms * 1e-3)
    assert host.per_sample_s == pytest.approx(period_ms * 1e-3 / 4.0)
    found = [one for one in sample_clock_section(log, (), LogClock(log)).findings if "LC" in one.sentence]
    assert [one.sentence for one in found] == ([] if sentence is None else [sentence])
    for one in found:
        assert (one.key, one.severity) == ("time_bases.sample_rate", Severity.NOTICE)
        assert one.evidence == (Evidence("/clocks", "sample, node_ns"),)


def test_exchanges_before_the_run_begins_do_not_count() -> None:
    exchange, host = sample_clocks(MadeLog(clocks_table(10.0, late_from=30), kind="mcap", base="simulation"))
    assert exchange.number.tolist() == list(range(30, 200))
    assert host.number.tolist() == list(range(120, 800, 4))


def test_a_recording_without_numbers_of_samples_has_no_sample_clock() -> None:
    table = clocks_table(10.0)
    columns = {name: table.values(name) for name in ("node", "node_ns", "host_ns")}
    log = MadeLog(MadeTable("/clocks", table.stamp_ns, columns), kind="mcap", base="simulation")
    assert sample_clocks(log) == []
    assert sample_clock_section(log, (), LogClock(log)) == Section("time_bases", "Clocks against the sample number")


def test_the_line_and_what_is_left_of_it_are_drawn() -> None:
    number = np.arange(4100)
    late_us = np.where(number == 2000, 300, 0)
    log = MadeLog(messages("IMU", 10**6 + number * 20_000 + late_us))
    line, left = sample_clock_section(log, (), LogClock(log)).plots
    assert (line.key, line.y_label, line.kind, line.x_label) == ("sample_clocks", "s", "xy", "sample")
    assert (left.key, left.y_label, left.kind, left.x_label) == ("sample_residuals", "ms", "xy", "sample")
    assert line.traces[0].x.tolist() == number[::2].tolist()  # at most some 2000 points
    assert line.traces[0].y == pytest.approx((number * 0.02 + late_us * 1e-6)[::2])
    assert left.traces[0].x.tolist() == number[::2].tolist()
    fitted = np.polyfit(number, number * 20.0 + late_us * 1e-3, 1)
    expected_ms = number * 20.0 + late_us * 1e-3 - fitted[0] * number
    assert left.traces[0].y == pytest.approx((expected_ms - np.median(expected_ms))[::2], abs=1e-6)


def test_six_clocks_are_drawn() -> None:
    log = MadeLog(*(messages(f"M{number}", np.arange(60) * 20_000) for number in range(8)))
    for plot in sample_clock_section(log, (), LogClock(log)).plots:
        assert [trace.name for trace in plot.traces] == [f"M{number}, autopilot's clock" for number in range(6)]


# The whole analysis


def test_a_log_without_two_clocks_says_what_would_give_them() -> None:
    section = time_bases.analyse(MadeLog(messages("IMU", np.arange(100) * 20_000)))
    assert section is not None
    assert (section.findings, len(section.grids), len(section.plots)) == ((), 1, 2)
    assert section.lacks == (
        "The log has only the autopilot's clock. A GPS fix (GPA) or UTC in PM.R is needed to judge it.",
    )
    assert time_bases.analyse(EMPTY) is None


def test_pairs_and_samples_are_one_section() -> None:
    """UTC by PM, and an autopilot whose clock is even."""
    stamps_us = np.arange(1, 101) * 1_000_000
    utc_us = 1_790_000_000_000_000 + stamps_us
    section = time_bases.analyse(MadeLog(messages("PM", stamps_us, R=utc_us)))
    assert section is not None
    assert [grid.key for grid in section.grids] == ["clock_pairs", "sample_clocks"]
    assert facts(section) == {
        "rtc_ppm": 0.0, "rtc_error_ppm": pytest.approx(0.0, abs=0.01), "rtc_steps": 0,
        "sample_clock": "PM, autopilot's clock", "seconds_per_sample": 1.0,
    }  # fmt: skip
    assert [one.sentence for one in section.findings] == [
        "No step and no drift of more than 100 ppm: UTC against the autopilot's clock"
    ]
    assert section.lacks == ()
