"""Cores of the estimator: each finding on either side of its limit, with sizes, times and evidence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Mark, Severity
from xitl_cli.plugins.logs.analyses.estimator_cores import (
    EstimateJump,
    EstimatorCore,
    FilterUse,
    _steps,
    agreement_facts,
    agreement_findings,
    bias_facts,
    bias_findings,
    estimate_jumps,
    estimator_cores,
    estimator_origin,
    fault_findings,
    filter_uses,
    first_position_ns,
    lane_switches,
    never_positioned,
    position_findings,
    primary_core,
    ratio_facts,
    ratio_plot,
    refusal_findings,
    reset_findings,
    reset_marks,
    step_facts,
    timeout_findings,
    unused_core_findings,
)
from xitl_cli.plugins.logs.analyses.estimator_cores import TestRatios as Ratios
from xitl_cli.plugins.logs.analyses.estimator_cores import test_ratios as ratios_of

S = 1_000_000_000
ROWS = 1000
AT_NS = np.arange(ROWS) * S // 10
ARM = MadeTable("ARM", [10 * S], {"ArmState": [1]})  # from row 100
ABSOLUTE, CONSTANT, GLITCH, RECKONING = 1 << 4, 1 << 7, 1 << 14, 1 << 18


def column(first: float = 0.0, *parts: tuple[int, int, float]) -> np.ndarray:
    """A value in all rows, and others from one row to before another."""
    values = np.full(ROWS, first)
    for begin, end, other in parts:
        values[begin:end] = other
    return values


def table(name: str, core: int = 0, **columns: Any) -> MadeTable:
    values = {"C": np.full(ROWS, core)} | {key: np.broadcast_to(each, ROWS) for key, each in columns.items()}
    return MadeTable(name, AT_NS, values, instance="C")


def core_of(number: int = 0, solution: MadeTable | None = None, health: MadeTable | None = None) -> EstimatorCore:
    return EstimatorCore(number, "EKF3", solution, None, health)


def clock(armed: bool = True) -> LogClock:
    return LogClock(MadeLog(table("ATT"), *([ARM] if armed else [])))


def said(found: Any) -> list[tuple[Severity, str]]:
    return [(finding.severity, finding.sentence) for finding in found]


def test_cores_by_the_newest_filter_that_was_logged() -> None:
    two = MadeTable("XKF1", [0, 0, 1, 1, 2, 2], {"C": [0, 1, 0, 1, 9, 1], "PN": np.arange(6.0)}, instance="C")
    log = MadeLog(two, table("XKF4", 2), table("NKF1"))
    first, second, third = estimator_cores(log)
    assert [(each.number, each.filter) for each in (first, second, third)] == [(0, "EKF3"), (1, "EKF3"), (2, "EKF3")]
    assert first.solution is not None
    assert second.solution is not None
    np.testing.assert_array_equal(first.solution.values("PN"), [0.0, 2.0])
    np.testing.assert_array_equal(second.solution.values("PN"), [1.0, 3.0, 5.0])
    assert (first.health, third.solution, third.innovations) == (None, None, None)
    assert [each.filter for each in estimator_cores(MadeLog(table("NKF3"), table("EKF1")))] == ["EKF2"]
    assert [each.filter for each in estimator_cores(MadeLog(table("EKF1")))] == ["EKF1"]
    assert estimator_cores(MadeLog()) == []


def test_biases_of_the_last_twenty_seconds() -> None:
    gyro = table("XKF2", AX=0.0, AY=column(0.0, (500, ROWS, -0.4)), AZ=0.1)
    log = MadeLog(gyro, table("XKF1", GX=0.0, GY=column(9.0, (799, 901, 0.49), (901, ROWS, 0.47)), GZ=-0.2))
    assert list(bias_facts(log, core_of())) == [
        Fact("gyroscope_bias", "Bias of the gyroscope by the filter, at the end", 0.49, "deg/s"),
        Fact("accelerometer_bias", "Bias of the accelerometer by the filter, at the end", 0.4, "m/s²"),
    ]
    (found,) = bias_findings(log, core_of(), clock())  # under half a degree a second is nothing
    assert (found.key, found.severity) == ("estimator.accelerometer_bias", Severity.NOTICE)
    assert found.sentence == (
        "The filter estimates that the accelerometer is off by -0.40 m/s² on y, since 0:50.0; the estimate stays at "
        "its largest value, so the true error may be larger"
    )
    assert found.evidence == (Evidence("XKF2", "AY", 50 * S, int(AT_NS[-1]), "-0.40 m/s²"),)
    assert list(bias_findings(log, core_of(1), clock())) == []
    assert list(bias_findings(log, None, clock())) == []


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (column(0.49), None),
        (column(0.5), (Severity.NOTICE, "0.50 deg/s on x, since 0:00.0", True)),
        (column(1.99), (Severity.NOTICE, "1.99 deg/s on x, since 0:00.0", True)),
        (column(-2.0), (Severity.WARNING, "-2.00 deg/s on x, since 0:00.0", True)),
        (column(0.4, (300, ROWS, 1.0)), (Severity.NOTICE, "1.00 deg/s on x, since 0:30.0", True)),
        (column(0.6, (300, ROWS, 1.0)), (Severity.NOTICE, "1.00 deg/s on x, since 0:00.0", True)),
        (column(1.0, (300, 301, 1.01)), (Severity.NOTICE, "1.00 deg/s on x, since 0:00.0", False)),
        (column(1.0, (ROWS - 20, ROWS - 19, 0.99)), (Severity.NOTICE, "1.00 deg/s on x, since 0:00.0", False)),
        (column(1.0, (ROWS - 21, ROWS - 20, 0.99)), (Severity.NOTICE, "1.00 deg/s on x, since 0:00.0", True)),
    ],
)
def test_a_bias_of_the_gyroscope_by_its_size(values: np.ndarray, expected: Any) -> None:
    found = list(bias_findings(MadeLog(table("XKF1", GX=values, GY=0.0, GZ=0.0)), core_of(), clock()))
    if expected is None:
        assert found == []
        return
    severity, text, at_limit = expected
    (finding,) = found
    assert finding.severity is severity
    assert finding.sentence.partition(";")[0] == f"The filter estimates that the gyroscope is off by {text}"
    assert ("stays at its largest value" in finding.sentence) is at_limit


def test_a_filter_that_ran_for_less_than_half_a_minute_knows_no_bias() -> None:
    for many, told in ((301, 1), (300, 0)):
        values = {"C": np.zeros(many), "GX": np.ones(many), "GY": np.zeros(many), "GZ": np.zeros(many)}
        log = MadeLog(MadeTable("XKF1", AT_NS[:many], values, instance="C"))
        assert len(list(bias_facts(log, core_of()))) == told
    gap = column(np.nan, (997, ROWS, 1.0))
    assert len(list(bias_facts(MadeLog(table("XKF1", GX=gap, GY=0.0, GZ=0.0)), core_of()))) == 1
    gap[997] = np.nan
    assert list(bias_facts(MadeLog(table("XKF1", GX=gap, GY=0.0, GZ=0.0)), core_of())) == []


def two_cores(**second: Any) -> list[EstimatorCore]:
    first = {"PN": 0.0, "PE": 0.0, "Yaw": 5.0}
    return [core_of(0, table("XKF1", **first)), core_of(1, table("XKF1", 1, **(first | second)))]


@pytest.mark.parametrize(
    ("second", "expected"),
    [
        ({"PN": column(0.0, (500, 501, 3.0)), "PE": column(0.0, (500, 501, -3.9))}, []),
        (
            {"PN": column(0.0, (500, 501, 3.0)), "PE": column(0.0, (500, 501, -4.0))},
            ["Cores 0 and 1 were up to 5.0 m apart in position while armed, at 0:50.0"],
        ),
        ({"PN": column(0.0, (50, 100, 900.0))}, []),  # before arming
        ({"Yaw": column(5.0, (600, 601, 355.1))}, []),
        (
            {"Yaw": column(5.0, (600, 601, 355.0))},
            ["Cores 0 and 1 were up to 10.0 deg apart in yaw while armed, at 1:00.0"],
        ),
        ({"Yaw": column(5.0, (600, 601, np.nan))}, []),
    ],
)
def test_cores_apart(second: dict[str, Any], expected: list[str]) -> None:
    found = list(agreement_findings(two_cores(**second), False, clock()))
    assert [each.sentence for each in found] == expected
    assert all(each.severity is Severity.WARNING for each in found)
    for each in found:
        assert each.evidence == (Evidence("XKF1", None, 50 * S if "position" in each.key else 60 * S),)


def test_how_far_cores_were_apart() -> None:
    cores = two_cores(PN=column(0.0, (500, 501, -6.0), (50, 51, 99.0)), Yaw=column(5.0, (700, 701, 353.0)))
    assert list(agreement_facts(cores, clock())) == [
        Fact("cores_apart_max_m", "Cores apart in position, largest", 6.0, "m"),
        Fact("cores_apart_max_deg", "Cores apart in yaw, largest", 12.0, "deg"),
    ]
    outside = list(agreement_findings(cores, True, clock()))
    assert said(outside)[0] == (
        Severity.NOTICE,
        "Cores 0 and 1 were up to 6.0 m apart in position while armed, at 0:50.0: one IMU is fed from outside, the "
        "other is simulated",
    )
    for few in (cores[:1], [cores[0], core_of(1)], []):
        assert list(agreement_facts(few, clock())) == []
    assert list(agreement_facts(cores, clock(armed=False))) == []


def test_steps_of_the_filter_without_windows_at_the_start() -> None:
    times = MadeTable(
        "XKT", np.arange(7) * S,
        {"Cnt": [100, 10, 51, 50, 100, 100, 100],
         "IMUMin": [0.002, 0.001, 0.0015, 0.001, 0.002, 0.002, 0.002],
         "IMUMax": [0.003, 0.009, 0.004, 0.009, 0.003, 0.003, 0.003]},
    )  # fmt: skip
    assert list(step_facts(MadeLog(times))) == [
        Fact("imu_step_min_ms", "IMU step, least", 1.5, "ms"), Fact("imu_step_max_ms", "IMU step, longest", 4.0, "ms"),
    ]  # fmt: skip
    old = MadeTable("NKT", [0, S], {"EKFMin": [0.01, 0.008], "EKFMax": [0.012, 0.02]})
    assert [(each.key, each.value) for each in step_facts(MadeLog(old))] == [
        ("ekf_step_min_ms", 8.0), ("ekf_step_max_ms", 20.0),
    ]  # fmt: skip
    assert list(step_facts(MadeLog())) == []


def test_ratios_by_their_measurement_and_core() -> None:
    health = table("XKF4", SV=column(0.0), SP=column(0.2, (200, 201, np.nan)), SH=np.nan, SM=0.5)
    found = ratios_of(MadeLog(), [core_of(0, None, health), core_of(1)])
    assert [(each.core, each.of, each.source, len(each.values)) for each in found] == [
        (0, "position", "XKF4.SP", ROWS - 1), (0, "compass", "XKF4.SM", ROWS),
    ]  # fmt: skip
    assert not (found[0].stamp_ns == 20 * S).any()
    first = table("EKF4", SMX=0.1, SMY=column(0.2, (5, 6, 0.9)), SMZ=0.3)
    (axes,) = ratios_of(MadeLog(), [core_of(0, None, first)])
    assert (axes.of, axes.source) == ("compass", "EKF4.SMX")
    np.testing.assert_array_equal(axes.values, column(0.3, (5, 6, 0.9)))


def ratio(values: np.ndarray, core: int = 0, of: str = "velocity") -> Ratios:
    return Ratios(core, of, "XKF4.SV", AT_NS, values)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([(200, 300, 0.99)], []),
        ([(20, 60, 5.0)], []),  # before arming
        ([(200, 201, 1.0)], [(Severity.NOTICE, "1 single samples; the test ratio reached 1.00 at 0:20.0")]),
        ([(200, 210, 1.5)], [(Severity.NOTICE, "0.90 s in all; the test ratio reached 1.50 at 0:20.0")]),
        (
            [(200, 210, 1.5), (220, 222, 3.0)],
            [(Severity.WARNING, "1.0 s in all; the test ratio reached 3.00 at 0:22.0")],
        ),
        (
            [(200, 203, 1.5), (205, 208, 1.5)],
            [(Severity.NOTICE, "0.70 s in all; the test ratio reached 1.50 at 0:20.0")],
        ),
    ],
)
def test_refusals_while_armed(parts: list[tuple[int, int, float]], expected: Any) -> None:
    found = list(refusal_findings([ratio(column(0.1, *parts))], clock()))
    assert said(found) == [
        (severity, f"The estimator refused GNSS velocity while armed, {text}") for severity, text in expected
    ]
    for each in found:
        assert each.evidence[0] == Evidence("XKF4", "SV", 20 * S, int(AT_NS[parts[0][1] - 1])) or len(parts) == 2


def test_the_largest_ratio_counts_while_armed() -> None:
    values = column(0.1, (50, 51, 9.0), (100, 101, 0.7654))
    (armed,) = ratio_facts([ratio(values)], clock())
    assert armed == Fact("ratio_velocity_max", "Largest test ratio, velocity", 0.765)
    (never,) = ratio_facts([ratio(values)], clock(armed=False))
    assert never.value == 9.0


def test_the_plot_of_ratios_has_the_limit() -> None:
    marks = (Mark(5, "x"),)
    plot = ratio_plot([ratio(column(0.1)), ratio(column(0.2), 1)], marks)
    assert plot is not None
    assert [trace.name for trace in plot.traces] == ["velocity, core 0", "velocity, core 1", "refused from here"]
    np.testing.assert_array_equal(plot.traces[2].x, [0, AT_NS[-1]])
    np.testing.assert_array_equal(plot.traces[2].y, [1.0, 1.0])
    np.testing.assert_array_equal(plot.traces[1].y, column(0.2))
    assert plot.marks == marks
    single = ratio_plot([ratio(column(0.1)), ratio(column(0.2), of="compass")], ())
    assert single is not None
    assert [trace.name for trace in single.traces][:2] == ["velocity", "compass"]
    assert ratio_plot([], ()) is None


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (column(0, (200, 210, 1 << 3)), []),  # 0.9 s
        (column(0, (200, 211, 1 << 3)), ["The estimator went without compass for 1.0 s while armed, first at 0:20.0"]),
        (column(0, (50, 99, 1)), []),
        (column(0, (200, 400, 1 << 4 | 1 << 5)), []),
        (
            column(0, (200, 230, 0b110)),
            [
                "The estimator went without velocity for 2.9 s while armed, first at 0:20.0",
                "The estimator went without height for 2.9 s while armed, first at 0:20.0",
            ],
        ),
    ],
)
def test_timeouts_of_a_second(flags: np.ndarray, expected: list[str]) -> None:
    found = list(timeout_findings(core_of(0, None, table("XKF4", TS=flags)), clock()))
    assert [each.sentence for each in found] == expected
    for each in found:
        assert (each.evidence[0].at_ns, each.evidence[0].field) == (20 * S, "TS")
        assert each.key == f"estimator.timeout.{each.evidence[0].value}"
    assert list(timeout_findings(core_of(), clock())) == []


def test_faults_of_the_filter_after_its_start() -> None:
    flags = column(1 << 7 | 1, (100, ROWS, 0), (300, 311, 1 << 2), (500, 506, 1 << 7 | 1 << 6))
    (found,) = fault_findings(core_of(0, None, table("XKF4", FS=flags)), clock())
    assert found.severity is Severity.CRITICAL
    assert found.sentence == (
        "The filter itself was faulty for 1.5 s, first at 0:30.0: fusion of compass X badly conditioned, "
        "fusion of sideslip badly conditioned, not initialised"
    )
    assert found.evidence == (
        Evidence("XKF4", "FS", 30 * S, 31 * S, "0xc4"), Evidence("XKF4", "FS", 50 * S, 50 * S + S // 2, "0xc4"),
    )  # fmt: skip
    first = EstimatorCore(0, "EKF1", None, None, table("EKF4", FS=flags))
    (old,) = fault_findings(first, clock())
    assert old.sentence.endswith("its bits are 0xc4; their meaning depends on the version")
    for good in (column(0), column(1 << 7)):
        assert list(fault_findings(core_of(0, None, table("XKF4", FS=good)), clock())) == []


def test_the_core_that_was_not_in_use() -> None:
    used = table("XKF4", PI=0, SV=column(0.1, (200, 300, 3.0)), FS=0)
    idle = table("XKF4", 1, PI=column(0, (500, ROWS, 1)), FS=column(0, (600, 700, 4), (150, 156, 4),
    (160, 170, 1 << 7)),
                 SV=column(0.1, (200, 211, 3.0), (510, 600, 3.0)), SP=column(0.1, (300, 310, 2.0)))  # fmt: skip
    cores = [core_of(0, None, used), core_of(1, None, idle)]
    (found,) = unused_core_findings(MadeLog(), cores, clock())
    assert found.severity is Severity.NOTICE
    assert found.sentence == (
        "Core 1 of the estimator, not in use then: it refused GNSS velocity for 1.0 s, it was faulty for 0.50 s"
    )
    assert found.evidence == (
        Evidence("XKF4", "SV", 20 * S, 21 * S), Evidence("XKF4", "FS", 15 * S, 15 * S + S // 2),
    )  # fmt: skip
    assert list(unused_core_findings(MadeLog(), cores[1:], clock())) == []


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([(200, 210, 0)], [("position_lost", Severity.WARNING, "had no absolute position for 0.90 s")]),
        ([(200, 211, 0)], [("position_lost", Severity.CRITICAL, "had no absolute position for 1.0 s")]),
        ([(200, 201, 0)], [("position_lost", Severity.WARNING, "had no absolute position for 1 samples")]),
        (
            [(200, 211, ABSOLUTE | CONSTANT)],
            [("position_lost", Severity.CRITICAL, "had no absolute position for 1.0 s")],
        ),
        ([(0, 150, 0)], []),  # it had none before
        ([(50, 100, 0)], []),
        (
            [(200, 210, ABSOLUTE | GLITCH)],
            [("gps_glitch", Severity.NOTICE, "judged GPS to be glitching for 0.90 s")],
        ),
        (
            [(200, 211, ABSOLUTE | GLITCH)],
            [("gps_glitch", Severity.WARNING, "judged GPS to be glitching for 1.0 s")],
        ),
        ([(200, 210, ABSOLUTE | RECKONING)], []),
        ([(200, 211, ABSOLUTE | RECKONING)], [("dead_reckoning", Severity.WARNING, "was dead reckoning for 1.0 s")]),
    ],
)  # fmt: skip
def test_the_position_of_the_filter(parts: list[tuple[int, int, float]], expected: Any) -> None:
    core = core_of(0, None, table("XKF4", SS=column(ABSOLUTE, *parts)))
    found = list(position_findings(MadeLog(), core, clock()))
    assert [(each.key, each.severity, each.sentence) for each in found] == [
        (f"estimator.{key}", severity, f"The estimator {text} while armed, first at 0:20.0")
        for key, severity, text in expected
    ]
    for each in found:
        assert each.evidence == (Evidence("XKF4", "SS", 20 * S, int(AT_NS[parts[0][1] - 1])),)


def test_the_position_by_telemetry() -> None:
    report = MadeTable(
        "EKF_STATUS_REPORT", AT_NS, {"flags": column(ABSOLUTE, (200, 211, GLITCH), (300, 400, GLITCH | 16))}
    )
    (found,) = position_findings(MadeLog(report, kind="tlog"), None, clock())  # glitches are of XKF4
    assert (found.key, found.evidence) == (
        "estimator.position_lost", (Evidence("EKF_STATUS_REPORT", "flags", 20 * S, 21 * S),),
    )  # fmt: skip


def test_a_position_that_never_came() -> None:
    checks = column(0, (0, 500, 1 << 3), (500, 900, 1 << 8), (900, 950, 1 << 0), (950, 960, 1 << 6))
    health = table("XKF4", SS=1 << 5, GPS=checks)
    (found,) = never_positioned([core_of(0, None, health)], clock())
    assert (found.severity, found.sentence) == (
        Severity.WARNING,
        "The estimator had no absolute position until 1:39.9, when the log ends; its checks of GPS failed for "
        "satellites, no 3D fix, speed accuracy",
    )
    assert found.evidence == (Evidence("XKF4", "SS", 0, int(AT_NS[-1])),)
    (idle,) = never_positioned([core_of(0, None, table("XKF4", SS=0))], clock(armed=False))
    assert (idle.severity, idle.sentence) == (
        Severity.NOTICE, "The estimator had no absolute position until 1:39.9, when the log ends",
    )  # fmt: skip
    late = [core_of(0, None, health), core_of(1, None, table("XKF4", 1, SS=column(0, (700, ROWS, ABSOLUTE))))]
    assert list(never_positioned(late, clock())) == []
    assert first_position_ns([*late, core_of(2, None, table("XKF4", 2, SS=column(0, (600, ROWS, ABSOLUTE))))]) == 60 * S
    assert first_position_ns(late[:1]) is None


@pytest.mark.parametrize(("set_s", "known"), [(1.0, None), (1.1, 1.1)])
def test_when_the_origin_was_set(set_s: float, known: float | None) -> None:
    origin = MadeTable(
        "ORGN", [0, round(set_s * S)], {"Type": [1, 0], "Lat": [0.0, 47.0], "Lng": [0.0, 8.0], "Alt": [0.0, 400.0]}
    )
    heights = core_of(0, table("XKF1", OH=column(0.0, (300, 400, 55.0), (400, 500, np.nan), (500, 600, 55.009),
                                                 (600, ROWS, 55.02))))  # fmt: skip
    found = estimator_origin(MadeLog(origin), [core_of(), heights], clock())
    assert found is not None
    assert found.set_ns == (None if known is None else round(known * S))
    assert (found.latitude_deg, found.longitude_deg, found.altitude_m, found.height_m) == (47.0, 8.0, 400.0, 55.0)
    assert found.heights == ((30 * S, 55.0), (60 * S, 55.02))
    by_text = MadeTable("MSG", [7 * S, 9 * S], {"Message": ["EKF3 IMU0 Origin set", "EKF3 IMU1 origin set"]})
    told = estimator_origin(MadeLog(by_text), [], clock())
    assert told is not None
    assert (told.set_ns, told.latitude_deg, told.height_m, told.heights) == (7 * S, None, None, ())
    assert estimator_origin(MadeLog(), [], clock()) is None


def test_filters_by_the_attitude() -> None:
    attitude = MadeTable("ATT", np.arange(6) * S, {"AEKF": [3, 3, 0, 0, 7, 7]})
    assert filter_uses(MadeLog(attitude)) == [
        FilterUse(0, 2 * S, "EKF3"), FilterUse(2 * S, 4 * S, "DCM"), FilterUse(4 * S, 5 * S, "filter 7"),
    ]  # fmt: skip
    assert filter_uses(MadeLog()) == []


def test_switches_of_the_core() -> None:
    health = table("XKF4", PI=column(0, (50, 60, 1), (200, 400, 1), (400, 500, 2)))
    cores = [core_of(0, None, health), core_of(1)]
    assert lane_switches(MadeLog(), cores) == [(5 * S, 1), (6 * S, 0), (20 * S, 1), (40 * S, 2), (50 * S, 0)]
    assert primary_core(cores) == 0
    (found,) = reset_findings(MadeLog(), cores, None, (), clock())
    assert (found.severity, found.sentence) == (
        Severity.WARNING, "The estimator switched its core 3 times while armed, first to core 1 at 0:20.0",
    )  # fmt: skip
    assert found.evidence == tuple(
        Evidence("XKF4", "PI", at * S, value=to) for at, to in ((20, "1"), (40, "2"), (50, "0"))
    )
    once = [core_of(0, None, table("XKF4", PI=column(0, (300, ROWS, 1))))]
    assert [each.sentence for each in reset_findings(MadeLog(), once, None, (), clock())] == [
        "The estimator switched its core once while armed, first to core 1 at 0:30.0"
    ]
    mostly = [core_of(0, None, table("XKF4", PI=column(1, (0, 400, 0), (400, 410, 2)))), core_of(1)]
    assert primary_core(mostly) == 1
    assert (primary_core([]), primary_core([core_of(2)])) == (0, 2)
    errors = MadeTable("ERR", [30 * S, 31 * S], {"Subsys": [24, 16], "ECode": [1, 1]})
    assert lane_switches(MadeLog(errors), [core_of()]) == [(30 * S, 1)]


def moving(*steps: tuple[int, float], speed: float = 0.5) -> MadeTable:
    """To the north with some speed, and with steps from one row to the next."""
    north = 1.0 + speed * AT_NS * 1e-9
    for row, size in steps:
        north[row:] += size
    return table("XKF1", PN=north, PE=2.0, VN=speed, VE=0.0)


def test_steps_that_the_velocity_does_not_explain() -> None:
    found = _steps(core_of(0, moving((300, 1.01), (400, 0.99), (500, -2.5))))
    assert [(each.at_ns, each.what, each.source) for each in found] == [
        (30 * S, "position step", "XKF1.PN"), (50 * S, "position step", "XKF1.PN"),
    ]  # fmt: skip
    # 0.05 m of each step is the way at 0.5 m/s in 0.1 s
    assert [each.size_m for each in found] == pytest.approx([1.01, 2.5 - 0.05 - 0.05])
    begun = table("XKF1", PN=column(0.0, (300, ROWS, 9.0)), PE=0.0, VN=0.0, VE=0.0)
    assert _steps(core_of(0, begun)) == []  # from nothing to the first position
    assert _steps(core_of()) == []


def test_jumps_are_told_once_in_order_of_time() -> None:
    events = MadeTable("EV", [80 * S, 30 * S + 150_000_000, 40 * S], {"Id": [60, 62, 25]})
    health = table("XKF4", OFN=column(0.0, (499, ROWS, 3.0)), OFE=column(0.0, (499, ROWS, -4.0)))
    core = core_of(0, moving((300, 5.0), (500, 6.0), (700, 7.0)), health)
    found = estimate_jumps(MadeLog(events), core)
    # The steps at 0:30 and 0:50 are those of the yaw reset and of the logged reset, up to 0.2 s apart.
    assert [(each.at_ns, each.what, each.size_m, each.source) for each in found] == [
        (30 * S + 150_000_000, "yaw reset", None, "EV.Id"),
        (49_900_000_000, "position reset", 5.0, "XKF4.OFN"),
        (70 * S, "position step", pytest.approx(7.0), "XKF1.PN"),
        (80 * S, "height reset", None, "EV.Id"),
    ]
    assert [each.what for each in estimate_jumps(MadeLog(events), None)] == ["yaw reset", "height reset"]
    cores = [core_of(0, None, table("XKF4", PI=column(0, (600, ROWS, 1))))]
    marks = reset_marks(MadeLog(), cores, found)
    assert [(mark.at_ns, mark.text, mark.severity) for mark in marks] == [
        (30 * S + 150_000_000, "yaw reset", Severity.NOTICE), (49_900_000_000, "position reset", Severity.NOTICE),
        (60 * S, "lane 1", Severity.WARNING), (70 * S, "position step", Severity.NOTICE),
        (80 * S, "height reset", Severity.NOTICE),
    ]  # fmt: skip


def jump(at_s: float, what: str, size_m: float | None = None) -> EstimateJump:
    return EstimateJump(round(at_s * S), what, size_m, "XKF4.OFN")


def told_jumps(*jumps: EstimateJump) -> list[Finding]:
    return list(reset_findings(MadeLog(), [], None, jumps, clock()))


def test_jumps_while_armed_are_told_by_their_kind() -> None:
    found = told_jumps(
        jump(5, "position reset", 99.0), jump(20, "position reset", 0.99), jump(30, "yaw reset"),
        jump(40, "position step", 1.0), jump(50, "yaw reset"), jump(60, "position step", 0.4), jump(3, "height reset"),
    )  # fmt: skip
    assert [(each.key, each.severity, each.sentence) for each in found] == [
        ("estimator.position_reset", Severity.NOTICE,
         "The estimator made a position reset of 0.99 m while armed, at 0:20.0"),
        ("estimator.yaw_reset", Severity.NOTICE,
         "The estimator made a yaw reset 2 times while armed, first at 0:30.0"),
        ("estimator.position_step", Severity.WARNING,
         "The estimator made a position step 2 times while armed, by up to 1.00 m, first at 0:40.0"),
    ]  # fmt: skip
    assert found[0].evidence == (Evidence("XKF4", "OFN", 20 * S, value="0.99 m"),)
    assert found[1].evidence[1] == Evidence("XKF4", "OFN", 50 * S)
    (alone,) = told_jumps(jump(30, "yaw reset"))
    assert alone.sentence == "The estimator made a yaw reset while armed, at 0:30.0"
