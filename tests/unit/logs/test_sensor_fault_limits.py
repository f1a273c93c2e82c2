"""Faults of sensors on either side of each limit, with their times, sizes and evidence in full."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Finding, Mark, Severity
from xitl_cli.logs.signals.gaps import gaps, regularity
from xitl_cli.logs.signals.series import Series
from xitl_cli.logs.signals.spans import find_holds
from xitl_cli.plugins.logs.analyses.sensor_faults import (
    JudgedSensor,
    Saturation,
    _stuck,
    _with_health,
    recording_pauses,
    saturation,
    switched_off,
    timing_section,
)

S, MS = 1_000_000_000, 1_000_000
HZ = 50
ALL_NS = np.arange(60 * HZ, dtype=np.int64) * (S // HZ)
QUIET = MadeLog(MadeTable("ATT", [0, 60 * S], {"Roll": [0.0, 0.0]}))
CLOCK = LogClock(QUIET)


def sensor(name: str = "IMU", without: list[tuple[float, float]] | None = None, **changed) -> JudgedSensor:
    """At 50 Hz with noise, without the rows from one instant to before another (s)."""
    kept = np.ones(len(ALL_NS), dtype=bool)
    for begin_s, end_s in without or []:
        kept &= (round(begin_s * S) > ALL_NS) | (round(end_s * S) <= ALL_NS)
    at_ns = changed.pop("at_ns", ALL_NS[kept])
    found = regularity(at_ns)
    assert found is not None
    values = changed.pop("values", np.random.default_rng(1).standard_normal((len(at_ns), 3)))
    plain = JudgedSensor(
        name, "inertial unit", name.partition("[")[0], "GyrX", at_ns, values, found, gaps(at_ns, found.period_s), (),
        find_holds(values, found.period_s), None, None, None,
    )  # fmt: skip
    return replace(plain, **changed)


def timing(*found: JudgedSensor, telemetry: bool = False) -> tuple[Finding, ...]:
    return timing_section(list(found), CLOCK, telemetry=telemetry).findings


@pytest.mark.parametrize(
    ("until_s", "expected"),
    [
        (10.48, None),  # half a second between two rows
        (10.50, (Severity.NOTICE, "IMU is missing for 0.52 s in 1 gap: at 0:10.0 for 0.52 s")),
        (10.96, (Severity.NOTICE, "IMU is missing for 0.98 s in 1 gap: at 0:10.0 for 0.98 s")),
        (10.98, (Severity.WARNING, "IMU is missing for 1.00 s in 1 gap: at 0:10.0 for 1.00 s")),
    ],
)
def test_a_gap_by_its_length(until_s: float, expected) -> None:
    found = timing(sensor(without=[(10.0, until_s)]))
    if expected is None:
        assert [each.key for each in found] == []  # 24 of 3000 samples are less than 1 %
        return
    (gap,) = found
    assert (gap.severity, gap.sentence) == expected
    assert gap.evidence == (Evidence("IMU", "GyrX", 9_980 * MS, round(until_s * S)),)


def test_sensors_that_are_missing_together_share_one_finding() -> None:
    both = [(20.0, 21.0), (10.0, 11.0)]
    late = [(10.08, 11.08), (20.0, 21.0)]  # 80 ms later: at the same time
    later = [(10.1, 11.1), (20.0, 21.0)]
    longer = [(10.0, 11.1), (20.0, 21.0)]
    found = timing(
        *(sensor(f"IMU[{i}]", without) for i, without in enumerate([both, late, both[:1], later, longer, []]))
    )
    assert [each.sentence for each in found if each.key == "sensors.gap"] == [
        "IMU[0] and IMU[1] are missing together for 2.04 s in 2 gaps: at 0:10.0 for 1.02 s, 0:20.0 for 1.02 s",
        "IMU[2] is missing for 1.02 s in 1 gap: at 0:20.0 for 1.02 s",
        "IMU[3] is missing for 2.04 s in 2 gaps: at 0:10.1 for 1.02 s, 0:20.0 for 1.02 s",
        "IMU[4] is missing for 2.14 s in 2 gaps: at 0:10.0 for 1.12 s, 0:20.0 for 1.02 s",
    ]
    first, second = (9_980 * MS, 11 * S), (19_980 * MS, 21 * S)
    assert found[0].evidence == tuple(Evidence("IMU", "GyrX", *at) for at in (first, second, first, second))


@pytest.mark.parametrize(
    ("lost", "expected"),
    [
        (29, None),  # of 3000
        (30, (Severity.NOTICE, "IMU: 1.0 % of the samples that 50 Hz need are missing, in 30 gaps of up to 0.04 s")),
        (149, (Severity.NOTICE, "IMU: 5.0 % of the samples that 50 Hz need are missing, in 149 gaps of up to 0.04 s")),
        (150, (Severity.WARNING, "IMU: 5.0 % of the samples that 50 Hz need are missing, in 150 gaps of up to 0.04 s")),
    ],
)
def test_missing_samples_by_their_share(lost: int, expected) -> None:
    one = sensor(without=[(0.1 + 0.1 * each, 0.12 + 0.1 * each) for each in range(lost)])
    assert timing(one, telemetry=True) == ()  # thinned out by its link
    found = timing(one)
    assert (None if not found else (found[0].severity, found[0].sentence)) == expected
    if found:
        (shown,) = found[0].evidence
        assert (shown.at_ns, shown.until_ns) == (80 * MS, 120 * MS + (lost - 1) * 100 * MS)


def test_evidence_of_missing_samples_are_spells_of_gaps_up_to_two_seconds_apart() -> None:
    every = [(10.0, 0.2), (12.1, 0.2), (30.0, 0.2), (40.0, 0.4), (42.38, 0.2), (44.7, 0.2)]
    (found,) = timing(sensor(without=[(begin_s, begin_s + length_s) for begin_s, length_s in every]))
    spans = [(one.at_ns, one.until_ns) for one in found.evidence]
    # A gap begins at the sample before it.
    assert spans == [
        (round(begin_s * S), round(end_s * S))
        for begin_s, end_s in ((9.98, 12.3), (29.98, 30.2), (39.98, 42.58), (44.68, 44.9))
    ]


def test_the_eight_longest_spells_of_gaps_are_evidence_in_order_of_time() -> None:
    lengths_s = [0.1, 0.3, 0.2, 0.2, 0.06, 0.2, 0.2, 0.2, 0.2, 0.4]
    (found,) = timing(sensor(without=[(5.0 * at, 5.0 * at + length_s) for at, length_s in enumerate(lengths_s, 1)]))
    assert [one.at_ns for one in found.evidence] == [5 * at * S - 20 * MS for at in (2, 3, 4, 6, 7, 8, 9, 10)]


def test_few_missing_samples_of_a_short_log_are_not_told() -> None:
    def cut(lost: int) -> tuple[Finding, ...]:
        at_ns = np.delete(ALL_NS[:100], np.arange(5, 5 + 2 * lost, 2))
        return timing(sensor(at_ns=at_ns))

    assert cut(4) == ()
    assert [each.key for each in cut(5)] == ["sensors.missing"]


def test_stamps_that_go_back_are_told_with_the_largest_step() -> None:
    at_ns = ALL_NS.copy()
    at_ns[1000] -= 300 * MS
    at_ns[2000] -= 450 * MS
    found = timing(sensor(at_ns=at_ns), telemetry=True)
    assert [(each.severity, each.sentence) for each in found] == [
        (Severity.WARNING, "IMU: 2 stamps go back, by up to 0.43 s")
    ]
    assert found[0].evidence == (Evidence("IMU", "GyrX", 0, int(at_ns[-1])),)


@pytest.mark.parametrize(("hz", "told"), [(52.4, False), (52.6, True)])
def test_instances_with_different_rates(hz: float, told: bool) -> None:
    other = sensor("IMU[1]", at_ns=np.round(np.arange(3000) * S / hz).astype(np.int64))
    alone = sensor("MAG", at_ns=np.arange(600) * 100 * MS)  # another message: nothing to compare with
    found = timing(sensor("IMU[0]"), other, alone)
    assert [each.sentence for each in found] == (
        [f"Instances of IMU are logged at different rates: IMU[0] 50 Hz, IMU[1] {hz:.4g} Hz"] if told else []
    )
    for each in found:
        assert each.severity is Severity.NOTICE
        assert each.evidence == (Evidence("IMU", "GyrX", 0), Evidence("IMU", "GyrX", 0))


def test_a_clock_of_samples_that_jumped_is_told_once_for_its_sensors() -> None:
    one = sensor("IMU[0]", clock_jumps=((5 * S, 0.7), (8 * S, -2.5)))
    other = sensor("IMU[1]", clock_jumps=((5 * S, 9.0),))
    (found,) = timing(one, other, sensor("MAG"))
    assert found.severity is Severity.NOTICE
    assert found.sentence == (
        "The clock that stamps IMU[0] and IMU[1] jumped by -2.5 s at 0:08.0, the largest of 2; "
        "no sample is missing there"
    )
    assert [(each.at_ns, each.value) for each in found.evidence] == [
        (5 * S, "+0.7 s"), (8 * S, "-2.5 s"), (5 * S, "+9 s"),
    ]  # fmt: skip
    (alone,) = timing(other)
    assert alone.sentence == "The clock that stamps IMU[1] jumped by +9 s at 0:05.0; no sample is missing there"


def test_the_plot_of_steps_has_the_sensors_with_gaps() -> None:
    short, long = sensor("IMU[0]", [(10.0, 10.04)]), sensor("IMU[1]", [(20.0, 21.0)])
    section = timing_section([sensor("IMU[2]"), sensor("IMU[3]", [(5.0, 5.02)]), short, long], CLOCK, telemetry=False)
    (plot,) = section.plots
    assert [trace.name for trace in plot.traces] == ["IMU[0]", "IMU[1]"]  # two periods are few
    step = np.full(len(short.stamp_ns) - 1, 20.0)
    step[499] = 60.0
    np.testing.assert_allclose(plot.traces[0].y, step)
    np.testing.assert_array_equal(plot.traces[0].x, short.stamp_ns[1:])
    assert plot.marks == (Mark(19_980 * MS, "IMU[1] missing", 21 * S, Severity.WARNING),)
    assert timing_section([sensor()], CLOCK, telemetry=False).plots == ()


def armed_log(*rows: tuple[float, int], kind="dataflash", **more) -> MadeLog:
    arm = MadeTable("ARM", [round(at * S) for at, _ in rows], {"ArmState": [state for _, state in rows]})
    return MadeLog(arm, MadeTable("ATT", [0, 1000 * S], {"Roll": [0.0, 0.0]}), kind=kind)


@pytest.mark.parametrize(
    ("disarmed_s", "armed_s", "off"),
    [
        (100.0, 300.0, True),
        (79.9, 300.0, False),  # it had logged for longer than it goes on after disarming
        (80.0, 300.0, True),
        (101.0, 300.0, True),
        (101.1, 300.0, False),
        (100.0, 295.0, True),
        (100.0, 294.9, False),
        (100.0, 305.0, True),
        (100.0, 305.1, False),
    ],
)
def test_logging_is_off_from_disarming_to_arming(disarmed_s: float, armed_s: float, off: bool) -> None:
    log = armed_log((10.0, 1), (disarmed_s, 0), (armed_s, 1), (900.0, 0))
    pause = np.array([[100 * S, 300 * S]])
    assert switched_off(log, pause).tolist() == [off]
    telemetry = armed_log((10.0, 1), (disarmed_s, 0), (armed_s, 1), (900.0, 0), kind="tlog")
    assert switched_off(telemetry, pause).tolist() == [False]


def test_a_pause_in_which_it_was_armed_is_a_pause() -> None:
    log = armed_log((10.0, 1), (100.0, 0), (200.0, 1), (250.0, 0), (300.0, 1), (900.0, 0))
    pause = np.array([[100 * S, 300 * S], [250 * S, 300 * S], [400 * S, 410 * S]])
    assert switched_off(log, pause).tolist() == [False, True, False]


def pauses_of(log: MadeLog, *spans: tuple[float, float]) -> tuple[Finding, ...]:
    return recording_pauses(log, np.array([[round(a * S), round(b * S)] for a, b in spans]).reshape(-1, 2), CLOCK)


@pytest.mark.parametrize(
    ("armed_s", "until_s", "severity"),
    [(5.0, 20.99, Severity.NOTICE), (5.0, 21.0, Severity.WARNING), (30.0, 25.0, Severity.NOTICE)],
)
def test_pauses_of_the_whole_log_count_by_length_and_while_armed(
    armed_s: float, until_s: float, severity: Severity
) -> None:
    log = armed_log((armed_s, 1), (900.0, 0))
    (found,) = pauses_of(log, (8.0, 8.49), (10.0, 10.5), (20.0, until_s))  # less than half a second is left out
    assert (found.key, found.severity) == ("sensors.recording_pauses", severity)
    length_s = until_s - 20.0
    assert found.sentence == (
        f"Nothing was logged for {0.5 + length_s:.2f} s in 2 pauses: at 0:10.0 for 0.50 s, 0:20.0 for {length_s:.2f} s"
    )
    assert found.evidence == (
        Evidence("all messages", None, 10 * S, 10_500 * MS), Evidence("all messages", None, 20 * S, round(until_s * S)),
    )  # fmt: skip
    assert "DSF.Dp" in found.next_step


def test_pauses_of_telemetry_are_of_its_link() -> None:
    log = MadeLog(MadeTable("ATT", [0, 60 * S], {"Roll": [0.0, 0.0]}), kind="tlog")
    (found,) = pauses_of(log, (10.0, 11.0))
    assert found.severity is Severity.WARNING  # nothing tells that it was disarmed
    assert found.sentence == "Nothing was received for 1.00 s in 1 pause: at 0:10.0 for 1.00 s"
    assert found.next_step == "Look at the link then, and at both of its ends."
    assert pauses_of(log, (10.0, 10.4)) == ()


def test_a_log_in_bursts_tells_only_of_unusual_pauses() -> None:
    """Twenty pauses of 1.6 s in a minute are how it is recorded; one of five seconds is not."""
    log = MadeLog(MadeTable("ATT", [0, 60 * S], {"Roll": [0.0, 0.0]}))
    usual = [(2.0 * each, 2.0 * each + 1.6) for each in range(20)]
    assert pauses_of(log, *usual) == ()
    (found,) = pauses_of(log, *usual[1:], (50.0, 55.0))
    assert found.sentence == "Nothing was logged for 5.00 s in 1 pause: at 0:50.0 for 5.00 s"
    (most,) = pauses_of(log, *usual[1:])  # nineteen are not many
    assert "in 19 pauses" in most.sentence
    (least,) = pauses_of(log, *((begin, begin + 1.5) for begin, _ in usual))  # half of the minute
    assert "in 20 pauses" in least.sentence


def held(begin_s: float, end_s: float, seed: int = 2) -> np.ndarray:
    """Noise that keeps one value for some time."""
    values = np.random.default_rng(seed).standard_normal((len(ALL_NS), 3))
    values[round(begin_s * HZ) : round(end_s * HZ)] = values[round(begin_s * HZ)]
    return values


def series(value: float, *parts: tuple[float, float, float]) -> Series:
    values = np.full(len(ALL_NS), value)
    for begin_s, end_s, other in parts:
        values[(begin_s * S <= ALL_NS) & (end_s * S > ALL_NS)] = other
    return Series(ALL_NS, values, "m/s", "GPS.Spd")


def test_an_inertial_unit_that_repeats_a_value_under_way() -> None:
    one = sensor(values=held(10.0, 18.0))
    (moving,) = _stuck(QUIET, one, [], None, series(0.0, (10.0, 18.0, 0.31)), CLOCK)
    assert (moving.key, moving.severity) == ("sensors.stuck", Severity.WARNING)
    assert moving.sentence == (
        "IMU shows one and the same value from 0:10.0 for 8.0 s, while the vehicle made 0.31 m/s"
    )
    assert moving.evidence == (Evidence("IMU", "GyrX", 10 * S, 17_980 * MS),)
    (still,) = _stuck(QUIET, one, [], None, series(5.0, (10.0, 18.0, 0.3)), CLOCK)
    assert (still.key, still.severity) == ("sensors.still", Severity.NOTICE)
    assert still.evidence == moving.evidence
    assert _stuck(QUIET, sensor(values=held(10.0, 15.0)), [], None, None, CLOCK) == []  # to 14.98: shorter than 5 s
    assert [each.key for each in _stuck(QUIET, sensor(values=held(10.0, 15.02)), [], None, None, CLOCK)] == [
        "sensors.still"
    ]
    assert _stuck(QUIET, replace(one, sort="rangefinder"), [], None, series(5.0), CLOCK) == []


def compass(begin_s: float = 10.0, end_s: float = 20.0, name: str = "MAG") -> JudgedSensor:
    return sensor(name, values=held(begin_s, end_s), sort="magnetometer", field="MagX")


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([(12.0, 14.0, 2.4)], ""),  # 4.8°
        ([(12.0, 14.0, 2.6)], "5°"),
        ([(12.0, 14.0, -9.0)], "18°"),
        ([(12.0, 14.0, 9.0), (14.0, 16.0, -9.0)], "18°"),  # there and back
        ([(10.0, 20.0, 2.0)], ""),  # as a bias would be
        ([(10.0, 20.0, 3.1)], "31°"),
        ([(0.0, 9.0, 30.0), (21.0, 30.0, 30.0)], ""),  # before and after
    ],
)
def test_a_compass_that_repeats_a_value_in_a_turn(parts: list[tuple[float, float, float]], told: str) -> None:
    found = _stuck(QUIET, compass(), [], series(0.0, *parts), series(9.0), CLOCK)
    assert [each.sentence for each in found] == (
        [f"MAG shows one and the same value from 0:10.0 for 10.0 s, while the vehicle turned by {told}"] if told else []
    )


def test_compasses_that_are_all_constant_stand_still() -> None:
    turning = series(0.0, (12.0, 14.0, 9.0))
    assert _stuck(QUIET, compass(), [compass(10.0, 18.5, "MAG[1]")], turning, None, CLOCK) == []
    for others in ([compass(10.0, 17.0, "MAG[1]")], [compass(name="MAG[1]"), compass(30.0, 40.0, "MAG[2]")]):
        assert [each.key for each in _stuck(QUIET, compass(), others, turning, None, CLOCK)] == ["sensors.stuck"]
    other_sort = sensor("IMU", values=held(10.0, 20.0))
    assert [each.key for each in _stuck(QUIET, compass(), [other_sort], turning, None, CLOCK)] == ["sensors.stuck"]


@dataclass(frozen=True, slots=True)
class Health:
    """What is told of a sensor that stopped from 0:10 to 0:20 with some unhealthy rows."""

    spans: list[tuple[float, float]]
    stuck: str
    unhealthy: str | None


@pytest.mark.parametrize(
    "case",
    [
        Health([], "", None),
        Health([(12.0, 15.0)], "; the autopilot reported it as unhealthy then", None),
        Health([(15.0, 21.0)], "; the autopilot reported it as unhealthy then", None),  # a second after
        Health([(5.0, 15.0)], "", "in 500 of 3000 rows, at 0:05.0 for 10.0 s"),  # set before it stopped
        Health([(30.0, 31.0)], "", "in 50 of 3000 rows, at 0:30.0 for 1.0 s"),
        Health(
            [(5.0, 7.0), (12.0, 15.0)], "; the autopilot reported it as unhealthy then",
            "in 100 of 3000 rows, at 0:05.0 for 2.0 s",
        ),
    ],
)  # fmt: skip
def test_health_while_a_sensor_stopped_belongs_to_the_stop(case: Health) -> None:
    healthy = ~np.any([(a * S <= ALL_NS) & (b * S > ALL_NS) for a, b in case.spans] or [ALL_NS < 0], axis=0)
    one = sensor(values=held(10.0, 20.0), healthy=healthy)
    (stuck,) = _stuck(QUIET, one, [], None, series(2.0), CLOCK)
    first, *rest = _with_health([stuck], one, None, CLOCK)
    assert first.sentence == stuck.sentence + case.stuck
    assert len(first.evidence) == len(stuck.evidence) + bool(case.stuck)
    assert [each.sentence for each in rest] == (
        [] if case.unhealthy is None else [f"IMU was unhealthy according to the autopilot {case.unhealthy}"]
    )


def test_unhealthy_in_every_row_and_only_while_disarmed() -> None:
    one = sensor(healthy=np.zeros(len(ALL_NS), dtype=bool))
    (always,) = _with_health([], one, None, CLOCK)
    assert (always.severity, always.sentence) == (
        Severity.WARNING, "IMU was unhealthy according to the autopilot in every row",
    )  # fmt: skip
    assert always.evidence == (Evidence("IMU", "health", 0, int(ALL_NS[-1]), "0"),)
    (before,) = _with_health([], one, np.zeros(len(ALL_NS), dtype=bool), CLOCK)
    assert (before.severity, before.sentence) == (Severity.NOTICE, f"{always.sentence}, only while disarmed")
    (under_way,) = _with_health([], one, ALL_NS == S, CLOCK)
    assert (under_way.severity, under_way.sentence) == (Severity.WARNING, always.sentence)


def test_a_signal_that_stops_at_its_largest_value() -> None:
    swing = 20.0 * np.sin(np.arange(1000) / 50.0)
    assert saturation(swing, 18.0) is None
    clipped = np.clip(swing, -18.0, 18.0)
    at_limit = np.abs(clipped) == 18.0
    found = saturation(clipped, 18.0)
    assert found is not None
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_limit.astype(int), [0]])))
    begin, end = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0])
    assert found == Saturation(18.0, int(at_limit.sum()), int(begin), int(end) - 1)
    assert saturation(clipped, 18.1) is None  # not the end of any range
    assert saturation(np.array([1.0, 20.0, 20.0, 3.0, 20.0]), 18.0) is None
    assert saturation(np.array([1.0, 20.0, -20.0, 19.999, 3.0, 20.0]), 18.0) == Saturation(20.0, 4, 1, 3)
    assert saturation(np.array([1.0, 20.0, -20.0, 19.99, 3.0, 20.0]), 18.0) is None
    assert saturation(np.array([20.0] * 9 + [1.0]), 18.0) == Saturation(20.0, 9, 0, 8)
    assert saturation(np.array([20.0] * 10 + [1.0]), 18.0) is None  # nearly always: constant, not saturated
    assert saturation(np.array([np.nan, np.nan]), 18.0) is None
    assert saturation(np.empty(0), 18.0) is None
