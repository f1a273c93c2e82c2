"""Estimator: errors against a known truth, and sentences with their figures at each limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.estimator import EstimateError, analyse, position_error, yaw_error

S = 1_000_000_000
PLACE = LocalFrame(47.0, 8.0, 400.0)
AT_S = np.arange(0.0, 100.0, 0.5)


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s) * S).astype(np.int64)


def geodetic(north_m: Any, east_m: Any = 0.0, down_m: Any = 0.0) -> dict[str, np.ndarray]:
    ned = np.stack([np.broadcast_to(part, len(AT_S)) for part in (north_m, east_m, down_m)], axis=1)
    latitude, longitude, altitude = PLACE.geodetic(ned)
    return {"Lat": latitude, "Lng": longitude, "Alt": altitude}


def core(**columns: Any) -> MadeTable:
    values = {"C": 0, "Yaw": 0.0, "OH": 55.0, "PN": 3.0, "PE": 2.0, "VN": 0.0, "VE": 0.0} | columns
    return MadeTable(
        "XKF1", ns(AT_S), {name: np.broadcast_to(value, len(AT_S)) for name, value in values.items()}, instance="C"
    )


def truth(yaw: Any = 10.0, **moved: Any) -> MadeTable:
    return MadeTable("SIM", ns(AT_S), {**geodetic(np.arange(len(AT_S)) * 0.5), "Yaw": np.broadcast_to(yaw, len(AT_S))})


def estimate(north_m: Any = 0.0, east_m: Any = 0.0, down_m: Any = 0.0, yaw: Any = 10.0) -> list[MadeTable]:
    place = geodetic(np.arange(len(AT_S)) * 0.5 + north_m, east_m, down_m)
    yaw_deg = np.broadcast_to(np.mod(yaw, 360.0), len(AT_S))
    zero = np.zeros(len(AT_S))
    return [
        MadeTable("POS", ns(AT_S), place),
        MadeTable("ATT", ns(AT_S), {"Yaw": yaw_deg, "Roll": zero, "Pitch": zero}),
    ]


def section_of(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return section


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


def finding_of(section: Section, key: str) -> Finding:
    (finding,) = [one for one in section.findings if one.key == key]
    return finding


def test_errors_are_the_estimate_less_the_truth() -> None:
    log = MadeLog(truth(yaw=355.0), *estimate(3.0, -4.0, 0.5, yaw=5.0))
    place, yaw = position_error(log), yaw_error(log)
    assert place is not None
    assert yaw is not None
    np.testing.assert_allclose(place.values, np.tile([3.0, -4.0, 0.5], (len(AT_S), 1)), atol=1e-3)
    np.testing.assert_allclose(yaw.values, 10.0)
    assert (place.source, place.truth, yaw.source, yaw.truth) == ("POS", "SIM", "ATT.Yaw", "SIM.Yaw")
    part = yaw.while_in([(0, 2 * S), (10 * S, 10 * S)])
    assert (part.stamp_ns / S).tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 10.0]
    assert yaw.while_in([]) is yaw
    assert position_error(MadeLog(*estimate())) is None
    assert yaw_error(MadeLog(truth())) is None


def test_figures_against_the_truth_leave_out_damaged_rows() -> None:
    wrong = np.full(len(AT_S), 0.6)
    wrong[[20, 21, 90]] = 500.0  # two rows in a row, or one
    found = facts(section_of(truth(), *estimate(wrong, 0.8, 0.25, yaw=12.0)))
    assert found["position_error_rms_m"] == pytest.approx(1.0, abs=2e-3)
    assert found["position_error_max_m"] == pytest.approx(1.0, abs=2e-3)
    assert found["height_error_rms_m"] == pytest.approx(0.25, abs=2e-3)
    assert (found["yaw_error_rms_deg"], found["yaw_error_max_deg"]) == (2.0, 2.0)


@pytest.mark.parametrize(
    ("north_m", "severity"), [(0.99, None), (1.01, Severity.NOTICE), (2.98, Severity.NOTICE), (3.02, Severity.WARNING)]
)
def test_a_position_off_the_truth(north_m: float, severity: Severity | None) -> None:
    found = [one for one in section_of(truth(), *estimate(north_m)).findings if one.key == "estimator.position_error"]
    assert [one.severity for one in found] == ([] if severity is None else [severity])
    for one in found:
        assert one.sentence.startswith(
            f"The estimated position was off the truth by {north_m:.2f} m RMS and up to {north_m:.2f} m, at "
        )
        assert one.evidence[1] == Evidence("SIM")


@pytest.mark.parametrize(
    ("off_deg", "severity"), [(4.9, None), (-5.1, Severity.NOTICE), (9.9, Severity.NOTICE), (10.1, Severity.WARNING)]
)
def test_a_yaw_off_the_truth(off_deg: float, severity: Severity | None) -> None:
    yaw = np.full(len(AT_S), 10.0 + off_deg)
    yaw[100:105] += np.sign(off_deg)
    found = [one for one in section_of(truth(), *estimate(yaw=yaw)).findings if one.key == "estimator.yaw_error"]
    assert [one.severity for one in found] == ([] if severity is None else [severity])
    for one in found:
        assert f"up to {abs(off_deg) + 1:.2f} deg, at 0:50.0" in one.sentence
        assert one.evidence[0].at_ns == 50 * S
        assert (one.evidence[0].message, one.evidence[0].field) == ("ATT", "Yaw")


def test_only_the_armed_time_counts() -> None:
    yaw = np.where((AT_S >= 30.0) & (AT_S <= 60.0), 10.0, 100.0)
    armed = MadeTable("ARM", ns([0.0, 30.0, 60.0]), {"ArmState": [0, 1, 0]})
    found = facts(section_of(truth(), *estimate(yaw=yaw), armed))
    assert found["yaw_error_max_deg"] == 0.0
    traces = {plot.key: plot for plot in section_of(truth(), *estimate(yaw=yaw), armed).plots}
    assert (traces["yaw_error"].traces[0].x[0], traces["yaw_error"].traces[0].x[-1]) == (30 * S, 60 * S)


def test_values_that_are_no_error_are_left_out() -> None:
    error = EstimateError(ns([0.0]), np.array([1.0]), "a", "b")
    assert error.while_in([(1, 2)]).values.tolist() == []


# Origin and heights


def gps(alt_m: float, status: int = 3) -> MadeTable:
    many = len(AT_S)
    return MadeTable("GPS", ns(AT_S), {"Status": np.full(many, status), "Alt": np.full(many, alt_m),
    "Lat": np.full(many, 47.0),
                                       "Lng": np.full(many, 8.0)})  # fmt: skip


@pytest.mark.parametrize(("alt_m", "told"), [(64.9, False), (65.0, True), (45.1, False), (45.0, True)])
def test_an_origin_at_another_height_than_the_receiver(alt_m: float, told: bool) -> None:
    found = [one for one in section_of(core(), gps(alt_m)).findings if one.key == "estimator.height_origin_off"]
    assert len(found) == told
    for one in found:
        assert one.sentence == f"The estimator's origin is at 55.0 m, but GPS was at {alt_m:.1f} m when it was set"
    assert not [one for one in section_of(core(), gps(999.0, status=2)).findings if "height" in one.key]


@pytest.mark.parametrize(("moved_m", "told"), [(0.99, False), (1.0, True)])
def test_a_height_of_the_origin_that_moves(moved_m: float, told: bool) -> None:
    heights = np.where(AT_S < 40.0, 55.0, np.where(AT_S < 70.0, 55.0 + moved_m, 55.5))
    found = [one for one in section_of(core(OH=heights)).findings if one.key == "estimator.height_origin_moved"]
    assert len(found) == told
    for one in found:
        assert one.sentence == "The height of the estimator's origin moved by 1.0 m in 2 steps, first at 0:40.0"
        assert [(each.at_ns, each.value) for each in one.evidence] == [
            (0, "55.00 m"), (40 * S, "56.00 m"), (70 * S, "55.50 m"),
        ]  # fmt: skip


def test_the_origin_and_the_sources_are_facts() -> None:
    origin = MadeTable(
        "ORGN", ns([12.0, 13.0]), {"Type": [0, 1], "Lat": [47.12345678, 1.0], "Lng": [8.5, 1.0], "Alt": [400.126, 0.0]}
    )
    sources = MadeTable("XKFS", ns([1.0, 2.0]), {"SS": [0, 1], "MAG_FUSION": [0, 2]})
    found = facts(section_of(core(), origin, sources))
    assert (found["origin_latitude_deg"], found["origin_longitude_deg"]) == (47.1234568, 8.5)
    assert (found["origin_altitude_m"], found["origin_height_m"]) == (400.13, 55.0)
    assert {"source_set", "mag_fusion"} <= found.keys()
    assert (found["filter"], found["cores"]) == ("EKF3", 1)


def test_dcm_that_takes_over_while_armed() -> None:
    used = np.where((AT_S >= 40.0) & (AT_S < 43.0), 0, 3)
    zero = np.zeros(len(AT_S))
    attitude = MadeTable("ATT", ns(AT_S), {"AEKF": used, "Yaw": zero, "Roll": zero, "Pitch": zero})
    armed = MadeTable("ARM", ns([0.0, 10.0]), {"ArmState": [0, 1]})
    section = section_of(core(), attitude, armed)
    finding = finding_of(section, "estimator.dcm_fallback")
    assert finding.sentence == "EKF3 gave up and DCM took over while armed for 3.0 s, first at 0:40.0"
    assert finding.evidence == (Evidence("ATT", "AEKF", 40 * S, 43 * S, "0"),)
    (grid,) = [grid for grid in section.grids if grid.key == "filters"]
    assert grid.rows == ((0.0, 40.0, 40.0, "EKF3"), (40.0, 43.0, 3.0, "DCM"), (43.0, 99.5, 56.5, "EKF3"))
    early = MadeTable("ARM", ns([0.0, 60.0]), {"ArmState": [0, 1]})
    assert not [one for one in section_of(core(), attitude, early).findings if one.key == "estimator.dcm_fallback"]


def test_innovations_are_drawn_by_their_unit() -> None:
    zero = np.zeros(len(AT_S))
    innovations = MadeTable(
        "XKF3",
        ns(AT_S),
        {"C": zero.astype(int), "IVN": zero + 1.0, "IPN": zero + 2.0, "IPE": zero, "IYAW": zero},
        instance="C",
    )
    plots = {plot.key: plot for plot in section_of(core(), innovations).plots}
    assert {key: [trace.name for trace in plot.traces] for key, plot in plots.items() if key.startswith("innov")} == {
        "innovations_velocity": ["IVN"], "innovations_position": ["IPN", "IPE"], "innovations_yaw": ["IYAW"],
    }  # fmt: skip
    assert plots["innovations_position"].y_label == "innovation (m)"
