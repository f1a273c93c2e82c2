from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from tests.golden import Golden
from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses.estimator import analyse
from xitl_cli.plugins.logs.analyses.estimator_cores import estimator_cores

S = 1_000_000_000
AT = np.arange(0, 100 * S, S // 10)
N = len(AT)
ARMED = MadeTable("ARM", [10 * S, 90 * S], {"ArmState": [1, 0]})
GOOD = 0b11_1111
METRE_DEG = 1.0 / 110_574.3


def between(from_s: float, until_s: float) -> Any:
    return (from_s * S <= AT) & (until_s * S >= AT)


def health(core: int | None = 0, **columns: Any) -> MadeTable:
    values: dict[str, Any] = {name: np.full(N, 0.1) for name in ("SV", "SP", "SH", "SM")}
    values |= {"SVT": np.zeros(N), "FS": np.zeros(N, int), "TS": np.full(N, 48), "SS": np.full(N, GOOD)}
    values |= {"PI": np.zeros(N, int), "OFN": np.zeros(N), "OFE": np.zeros(N)}
    values |= columns
    if core is not None:
        values = {"C": np.full(N, core)} | values
    return MadeTable("XKF4", AT, values, instance=None if core is None else "C")


def solution(**columns: Any) -> MadeTable:
    values: dict[str, Any] = {"C": np.zeros(N, int), "Yaw": np.zeros(N), "OH": np.full(N, 55.0)}
    values |= {"PN": np.full(N, 3.0), "PE": np.full(N, 2.0), "VN": np.zeros(N), "VE": np.zeros(N)}
    return MadeTable("XKF1", AT, values | columns, instance="C")


def both(first: MadeTable, second: MadeTable) -> MadeTable:
    """Rows of two cores in turns, as they are logged."""
    stamps = np.concatenate([first.stamp_ns, second.stamp_ns])
    order = np.argsort(stamps, kind="stable")
    values = {name: np.concatenate([first.values(name), second.values(name)])[order] for name in first.columns}
    return MadeTable(first.name, stamps[order], values, instance="C")


def section_of(*tables: MadeTable) -> Section:
    found = analyse(MadeLog(*tables, ARMED))
    assert found is not None
    return found


def found_in(section: Section) -> dict[str, Severity]:
    return {finding.key: finding.severity for finding in section.findings}


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def test_a_healthy_filter_is_worth_no_word() -> None:
    section = section_of(health(), solution())
    assert not section.findings
    assert facts(section)["ratio_position_max"] == 0.1
    assert "ratio_airspeed_max" not in facts(section)


def test_measurements_refused_while_armed() -> None:
    section = section_of(health(SP=np.where(between(40, 50), 1.3, 0.1)))
    (finding,) = section.findings
    assert finding.key == "estimator.refused.position"
    assert finding.severity is Severity.WARNING
    assert "10.0 s in all" in finding.sentence
    assert "1.30" in finding.sentence
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (40 * S, 50 * S)


def test_a_single_refusal_is_a_notice_and_one_before_arming_none() -> None:
    assert found_in(section_of(health(SV=np.where(AT == 40 * S, 1.3, 0.1)))) == {
        "estimator.refused.velocity": Severity.NOTICE
    }
    assert found_in(section_of(health(SV=np.where(between(2, 8), 1.3, 0.1)))) == {}


def test_a_lane_switch() -> None:
    section = section_of(
        both(health(PI=np.where(between(30, 100), 1, 0)), health(1, PI=np.where(between(30, 100), 1, 0)))
    )
    assert found_in(section) == {"estimator.lane_switch": Severity.WARNING}
    assert facts(section)["primary_core"] == 1
    assert facts(section)["lane_switches"] == 1
    assert "core 1 at 0:30.0" in section.findings[0].sentence


def test_a_lane_switch_by_its_error_where_the_primary_is_not_logged() -> None:
    columns = {name: np.full(N, 0.1) for name in ("SV", "SP", "SH", "SM")}
    errors = MadeTable("ERR", [30 * S], {"Subsys": [24], "ECode": [1]})
    assert found_in(section_of(MadeTable("XKF4", AT, columns), errors)) == {"estimator.lane_switch": Severity.WARNING}


def test_cores_of_old_versions_have_messages_of_their_own() -> None:
    plain = {"PN": np.zeros(N), "PE": np.zeros(N), "Yaw": np.zeros(N)}
    log = MadeLog(
        MadeTable("NKF1", AT, plain), MadeTable("NKF6", AT, plain), MadeTable("NKF4", AT, {"SV": np.zeros(N)})
    )
    found = estimator_cores(log)
    assert [core.number for core in found] == [0, 1]
    assert found[0].filter == "EKF2"
    assert found[1].solution is not None
    assert found[1].health is None


def test_a_reset_of_yaw_and_of_position() -> None:
    events = MadeTable("EV", [40 * S], {"Id": [62]})
    section = section_of(
        health(OFN=np.where(between(50, 100), 3.0, 0.0), OFE=np.where(between(50, 100), 4.0, 0.0)), events
    )
    assert found_in(section) == {
        "estimator.yaw_reset": Severity.NOTICE,
        "estimator.position_reset": Severity.WARNING,
    }
    assert "position reset of 5.00 m while armed, at 0:50.0" in section.findings[1].sentence


def test_a_step_of_the_position_that_its_speed_does_not_explain() -> None:
    moving = solution(PN=3.0 + 2e-9 * AT + np.where(between(60, 100), 7.0, 0.0), VN=np.full(N, 2.0))
    section = section_of(health(), moving)
    # 7 m and the 0.2 m that it went in between, less those 0.2 m.
    assert found_in(section) == {"estimator.position_step": Severity.WARNING}
    assert "7.00 m while armed, at 1:00.0" in section.findings[0].sentence


def test_timeouts_that_count_and_those_of_sensors_never_fitted() -> None:
    section = section_of(health(TS=np.where(between(30, 35), 48 | 1 << 3, 48)))
    assert found_in(section) == {"estimator.timeout.compass": Severity.WARNING}
    assert "5.0 s while armed, first at 0:30.0" in section.findings[0].sentence


def test_a_faulty_filter_but_not_one_that_starts() -> None:
    starting = np.where(between(0, 20), 128, 0)
    assert found_in(section_of(health(FS=starting))) == {}
    section = section_of(health(FS=np.where(between(50, 60), 1, starting)))
    assert found_in(section) == {"estimator.faults": Severity.CRITICAL}
    assert "quaternion not a number" in section.findings[0].sentence


def test_a_position_that_is_lost() -> None:
    section = section_of(health(SS=np.where(between(40, 55), 0b1000_0001, GOOD)))
    assert found_in(section) == {"estimator.position_lost": Severity.CRITICAL}
    assert "15.0 s" in section.findings[0].sentence


def test_dead_reckoning_with_a_position() -> None:
    section = section_of(health(SS=np.where(between(40, 55), GOOD | 1 << 18, GOOD)))
    assert found_in(section) == {"estimator.dead_reckoning": Severity.WARNING}


def test_a_filter_that_never_had_a_position_says_what_it_waited_for() -> None:
    section = section_of(health(SS=np.full(N, 1), GPS=np.where(between(0, 70), 1 << 3 | 1 << 8, 1 << 3)))
    assert found_in(section) == {"estimator.never_positioned": Severity.WARNING}
    assert section.findings[0].sentence.endswith("its checks of GPS failed for satellites, no 3D fix")


def test_dcm_takes_over() -> None:
    attitude = MadeTable("ATT", AT, {"AEKF": np.where(between(50, 60), 0, 3), "Yaw": np.zeros(N)})
    section = section_of(health(), attitude)
    assert found_in(section) == {"estimator.dcm_fallback": Severity.CRITICAL}
    assert [row[3] for row in section.grids[0].rows] == ["EKF3", "DCM", "EKF3"]


def test_when_origin_and_position_came() -> None:
    heights = solution(OH=np.where(between(0, 19.95), 0.0, 55.0))
    origin = MadeTable(
        "ORGN", [20 * S, 20 * S], {"Type": [0, 1], "Lat": [-8.8, -8.8], "Lng": [-63.9, -63.9], "Alt": [55.0, 0.0]}
    )
    section = section_of(health(SS=np.where(between(0, 30), 1, GOOD)), heights, origin)
    found = facts(section)
    assert (found["origin_set"], found["origin_height_m"], found["origin_altitude_m"]) == (20.0, 55.0, 55.0)
    assert found["first_position"] == 30.1


def test_a_height_origin_that_moves() -> None:
    section = section_of(health(), solution(OH=np.where(between(0, 50), 55.0, 58.0)))
    assert found_in(section) == {"estimator.height_origin_moved": Severity.NOTICE}
    assert "3.0 m" in section.findings[0].sentence


def test_cores_that_part() -> None:
    section = section_of(
        both(health(), health(1)),
        both(solution(), solution(C=np.ones(N, int), PN=3.0 + np.where(between(70, 100), 8.0, 0.0))),
    )
    assert found_in(section) == {"estimator.cores_apart.position": Severity.WARNING}
    assert facts(section)["cores_apart_max_m"] == pytest.approx(8.0)


def test_the_estimate_against_the_truth() -> None:
    """Four metres north while armed: root mean square and largest are both four."""
    level = {"Lng": np.zeros(N) + 1.0, "Alt": np.zeros(N)}
    estimate = MadeTable("POS", AT, {"Lat": 4.0 * METRE_DEG * between(10, 90), **level})
    truth = MadeTable("SIM", AT, {"Lat": np.zeros(N), "Yaw": np.full(N, 358.0), **level})
    yaw = MadeTable("ATT", AT, {"Yaw": np.full(N, 1.0)})
    section = section_of(health(), estimate, truth, yaw)
    found = facts(section)
    # 110 574 m a degree holds to 1e-5 here, so centimetres.
    assert found["position_error_rms_m"] == pytest.approx(4.0, abs=0.01)
    assert found["position_error_max_m"] == pytest.approx(4.0, abs=0.01)
    assert found["yaw_error_rms_deg"] == pytest.approx(3.0, abs=1e-6)
    assert found_in(section) == {"estimator.position_error": Severity.WARNING}


def test_a_simulated_vehicle_that_the_sensors_are_not_of_is_no_truth() -> None:
    level = {"Lng": np.zeros(N) + 1.0, "Alt": np.zeros(N)}
    north = 2e-9 * AT * METRE_DEG
    fixes = MadeTable(
        "GPS", AT, {"Lat": north, **level, "Status": np.full(N, 3), "Spd": np.full(N, 2.0), "GCrs": np.zeros(N)}
    )
    still = MadeTable("SIM", AT, {"Lat": np.zeros(N), "Yaw": np.zeros(N), **level})
    section = section_of(health(), MadeTable("POS", AT, {"Lat": north, **level}), fixes, still)
    assert found_in(section) == {"estimator.truth_of_another": Severity.NOTICE}
    assert "position_error_rms_m" not in facts(section)


def test_a_receiver_that_is_off_does_not_make_the_truth_another_one() -> None:
    level = {"Lng": np.zeros(N) + 1.0, "Alt": np.zeros(N)}
    north = 2e-9 * AT * METRE_DEG
    off = north + 40.0 * METRE_DEG * between(40, 60)
    fixes = MadeTable(
        "GPS", AT, {"Lat": off, **level, "Status": np.full(N, 3), "Spd": np.full(N, 2.0), "GCrs": np.zeros(N)}
    )
    truth = MadeTable("SIM", AT, {"Lat": north, "Yaw": np.zeros(N), **level})
    section = section_of(health(), MadeTable("POS", AT, {"Lat": off, **level}), fixes, truth)
    assert facts(section)["position_error_max_m"] == pytest.approx(40.0, abs=0.01)
    assert found_in(section) == {"estimator.position_error": Severity.WARNING}


def test_telemetry_reports_its_ratios() -> None:
    names = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
    values: dict[str, Any] = {name: np.full(N, 0.1) for name in names}
    values |= {"flags": np.full(N, GOOD), "compass_variance": np.where(between(40, 50), 1.5, 0.1)}
    beats = {"type": np.full(N, 11), "autopilot": np.full(N, 3), "custom_mode": np.full(N, 10),
             "base_mode": np.where(between(10, 90), 128, 0)}  # fmt: skip
    log = MadeLog(
        MadeTable("EKF_STATUS_REPORT", AT, values), MadeTable("HEARTBEAT", AT, beats), kind="tlog", base="utc"
    )
    found = analyse(log)
    assert found is not None
    assert found_in(found) == {"estimator.refused.compass": Severity.WARNING}


def test_a_log_without_an_estimator_says_so() -> None:
    section = section_of()
    assert section.lacks
    assert not section.facts


def test_a_bias_that_the_filter_has_found_is_told_with_its_beginning(golden: Golden) -> None:
    rate = np.where(between(40.0, 100.0), 1.2, 0.05)
    section = section_of(solution(GX=np.zeros(N), GY=np.full(N, 0.1), GZ=rate), health())
    (finding,) = [each for each in section.findings if each.key == "estimator.gyroscope_bias"]
    assert finding.severity == Severity.NOTICE
    taken, limit = finding.sentence.split("; ")
    golden("text", taken, "1.20 deg/s", "0:40.0")
    golden("second text", limit)
    assert facts(section)["gyroscope_bias"] == pytest.approx(1.2)
    small = section_of(solution(GX=np.zeros(N), GY=np.full(N, 0.1), GZ=np.full(N, 0.3)), health())
    assert "estimator.gyroscope_bias" not in found_in(small)
