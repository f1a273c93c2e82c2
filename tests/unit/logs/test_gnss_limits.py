"""Satellite navigation: sentences, evidence and figures at each limit, of receivers whose motion is exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.gnss import analyse

S = 1_000_000_000
ROWS = 200
AT_S = np.arange(ROWS) * 0.2
PLACE = LocalFrame(47.0, 8.0, 400.0)


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s) * S).astype(np.int64)


def gps(
    north_m: Any = None, keep: Any = None, name: str = "GPS", instance: int | None = None, **changed: Any
) -> MadeTable:
    """North at 2 m/s, as a receiver without noise tells it."""
    north = 2.0 * AT_S if north_m is None else np.broadcast_to(north_m, ROWS)
    latitude, longitude, _ = PLACE.geodetic(np.stack([north, np.zeros(ROWS), np.zeros(ROWS)], axis=1))
    columns: dict[str, Any] = {
        "Status": 3, "NSats": 14, "HDop": 0.8, "Lat": latitude, "Lng": longitude, "Alt": 400.0, "Spd": 2.0, "GCrs": 0.0,
        "VZ": 0.0, "GWk": 2400, "GMS": np.arange(ROWS) * 200,
    } | changed  # fmt: skip
    rows = np.ones(ROWS, dtype=bool) if keep is None else keep
    return MadeTable(name, ns(AT_S)[rows], {key: np.broadcast_to(value, ROWS)[rows] for key, value in columns.items()})


def others() -> list[MadeTable]:
    """Dense messages that go on while a receiver is silent."""
    at = ns(np.arange(ROWS * 10) * 0.02)
    return [MadeTable("ATT", at, {"Roll": np.zeros(len(at))}), MadeTable("RCOU", at, {"C1": np.zeros(len(at))})]


def report(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables, *others()))
    assert section is not None
    return section


def only(section: Section) -> Finding:
    assert len(section.findings) == 1, [finding.sentence for finding in section.findings]
    return section.findings[0]


def rows(first: int, many: int, inside: Any, outside: Any) -> np.ndarray:
    values = np.full(ROWS, outside)
    values[first : first + many] = inside
    return values


def test_a_receiver_without_noise() -> None:
    section = report(gps())
    assert section.findings == ()
    assert {fact.key: fact.value for fact in section.facts} == {
        "fix_share_percent": 100.0, "first_fix_s": 0.0, "satellites_median": 14.0, "hdop_median": 0.8,
        "position_step_error_m": pytest.approx(0.0, abs=1e-4), "speed_noise_mps": 0.0,
    }  # fmt: skip
    (grid,) = section.grids
    assert dict(zip(grid.columns, grid.rows[0], strict=True)) == {
        "receiver": "GPS", "Hz": 5.0, "gaps": 0, "longest s": 0.0, "fix": "3D fix 100 %", "satellites": 14.0,
        "HDop": 0.8,
        "horizontal ± m": None, "vertical ± m": None, "speed ± m/s": None, "interval ms": None, "logged after ms": None,
    }  # fmt: skip
    assert section.lacks == ("GPS states no accuracy (GPA.HAcc).",)


def test_the_accuracy_and_the_age_of_fixes_are_in_the_table() -> None:
    accuracy = MadeTable(
        "GPA", ns(AT_S), {"HAcc": np.full(ROWS, 1.25), "VAcc": np.full(ROWS, 2.5), "SAcc": np.full(ROWS, 0.5),
                          "SMS": np.round(AT_S * 1e3) - 120, "Delta": np.full(ROWS, 200)},
    )  # fmt: skip
    section = report(gps(Status=rows(0, 50, 4, 3)), accuracy)
    row = dict(zip(section.grids[0].columns, section.grids[0].rows[0], strict=True))
    assert (row["horizontal ± m"], row["vertical ± m"], row["speed ± m/s"]) == (1.25, 2.5, 0.5)
    assert (row["interval ms"], row["logged after ms"]) == (200.0, 120.0)
    assert row["fix"] == "3D fix 75 %, 3D fix with differential corrections 25 %"
    names = {plot.key: [trace.name for trace in plot.traces] for plot in section.plots}
    assert names["gnss_view"] == ["GPS fix type", "GPS satellites", "GPS HDop"]
    assert names["gnss_accuracy"] == ["GPS horizontal m", "GPS vertical m", "GPS speed m/s"]


@pytest.mark.parametrize(
    ("silent", "sentence"),
    [
        (slice(100, 104), None),  # a second
        (slice(100, 105), "GPS said nothing once (it comes every 200 ms): at 0:19.8 for 1.2 s"),
        (slice(6, 20), "GPS said nothing once (it comes every 200 ms): at 0:01.0 for 3.0 s"),
        (slice(190, 200), "GPS said nothing once (it comes every 200 ms): at 0:37.8 for 2.2 s, to the end of the log"),
    ],
)
def test_silence_of_more_than_a_second(silent: slice, sentence: str | None) -> None:
    keep = np.ones(ROWS, dtype=bool)
    keep[silent] = False
    found = report(gps(keep=keep)).findings
    assert [one.sentence for one in found] == ([] if sentence is None else [sentence])


@pytest.mark.parametrize(("pause_s", "told"), [(5.9, True), (6.3, False), (12.0, False)])
def test_silence_is_that_of_the_whole_log_if_half_of_it_is(pause_s: float, told: bool) -> None:
    """The receiver is silent for 12.2 s, and all other messages in their middle for some of them."""
    keep = np.ones(ROWS, dtype=bool)
    keep[100:160] = False
    tables = [
        MadeTable(table.name, table.stamp_ns[there], {name: table.values(name)[there] for name in table.columns})
        for table in others()
        for there in [np.abs(table.stamp_ns - 25_900_000_000) > 0.5 * pause_s * S]
    ]
    section = analyse(MadeLog(gps(keep=keep), *tables))
    assert section is not None
    assert [one.key for one in section.findings] == ["gnss.silent"] * told


def test_fixes_that_were_lost_are_a_warning_only_while_armed() -> None:
    status = rows(50, 5, 1, 3)
    status[150] = 2
    finding = only(report(gps(Status=status)))
    assert finding.sentence == "GPS lost its fix 2 times (it comes every 200 ms): at 0:09.8 for 1.2 s, 0:29.8 for 0.4 s"
    assert finding.severity is Severity.WARNING
    assert finding.evidence == (
        Evidence("GPS", "Status", 9_800_000_000, 11 * S), Evidence("GPS", "Status", 29_800_000_000, 30_200_000_000),
    )  # fmt: skip
    disarmed = MadeTable("ARM", ns([0.0, 35.0]), {"ArmState": [0, 1]})
    assert only(report(gps(Status=status), disarmed)).severity is Severity.NOTICE


def test_a_receiver_that_never_had_a_fix() -> None:
    finding = only(report(gps(Status=rows(50, 5, 2, 1))))
    assert finding.sentence == "GPS never had a 3D fix; the best was: 2D fix"
    assert finding.evidence == (Evidence("GPS", "Status", 0, 39_800_000_000),)


def test_a_lost_rtk_solution() -> None:
    finding = only(report(gps(Status=np.concatenate((np.full(50, 6), np.full(50, 5), np.full(50, 3), np.full(50, 6))))))
    assert finding.sentence == "GPS lost its RTK solution 2 times: at 0:10.0, 0:20.0"
    assert (finding.key, finding.severity) == ("gnss.rtk_lost", Severity.NOTICE)
    assert [one.at_ns for one in finding.evidence] == [10 * S, 20 * S]


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"NSats": rows(100, 10, 5, 14)}, None),  # 5 %
        ({"NSats": rows(100, 11, 5, 14)}, "GPS had fewer than 6 satellites for 6 % of the time with a fix"),
        ({"NSats": rows(100, 50, 6, 14)}, None),
        ({"HDop": rows(100, 50, 2.1, 0.8)}, "GPS had a horizontal dilution over 2 for 25 % of the time with a fix"),
        ({"HDop": rows(100, 50, 2.0, 0.8)}, None),
    ],
)
def test_a_poor_quality_for_more_than_a_twentieth_of_the_time(changed: dict[str, Any], sentence: str | None) -> None:
    found = report(gps(**changed)).findings
    assert [one.sentence for one in found] == ([] if sentence is None else [sentence])


@pytest.mark.parametrize(
    ("accuracy", "sentence"),
    [
        ({"HAcc": 5.1}, "GPS had an accuracy worse than 5 m horizontally for 100 % of the time with a fix"),
        ({"HAcc": 5.0}, None),
        ({"SAcc": 1.1}, "GPS had an accuracy worse than 1 m/s in speed for 100 % of the time with a fix"),
        ({"SAcc": 1.0}, None),
    ],
)
def test_a_poor_accuracy(accuracy: dict[str, float], sentence: str | None) -> None:
    table = MadeTable(
        "GPA", ns(AT_S), {key: np.full(ROWS, value) for key, value in ({"HAcc": 1.0, "SAcc": 0.2} | accuracy).items()}
    )
    found = report(gps(), table).findings
    assert [one.sentence for one in found] == ([] if sentence is None else [sentence])


def test_the_time_before_the_first_fix_is_not_judged() -> None:
    table = MadeTable("GPA", ns(AT_S), {"HAcc": np.where(AT_S < 20.0, 99.0, 1.0)})
    assert report(gps(Status=np.where(AT_S < 20.0, 1, 3), NSats=np.where(AT_S < 20.0, 1, 14)), table).findings == ()


@pytest.mark.parametrize(
    ("step_m", "accuracy_m", "severity"),
    [(1.99, 0.1, None), (2.01, 0.1, Severity.NOTICE), (2.99, 0.1, Severity.NOTICE), (3.01, 0.1, Severity.WARNING),
     (5.8, 3.0, Severity.NOTICE), (6.2, 3.0, Severity.WARNING)],
)  # fmt: skip
def test_a_jump_by_its_size_and_the_stated_accuracy(
    step_m: float, accuracy_m: float, severity: Severity | None
) -> None:
    accuracy = MadeTable("GPA", ns(AT_S), {"HAcc": np.full(ROWS, accuracy_m)})
    section = report(gps(2.0 * AT_S + np.where(AT_S >= 20.0, step_m, 0.0)), accuracy)
    found = [one for one in section.findings if one.key == "gnss.jump"]
    assert [one.severity for one in found] == ([] if severity is None else [severity])
    for one in found:
        speed = (step_m + 0.4) / 0.2
        assert one.sentence == (
            f"The position of GPS jumped once, by up to {step_m:.1f} m (as if at {speed:.0f} m/s, where it reported "
            "2.0 m/s): at 0:20.0"
        )
        assert one.evidence == (Evidence("GPS", "Lat", 20 * S, None, f"{step_m:.1f} m"),)


@pytest.mark.parametrize(
    ("many", "speed_mps", "told"), [(30, 2.0, True), (9, 2.0, False), (30, 0.5, False), (30, 0.51, True)]
)
def test_a_position_that_repeats_while_it_moves(many: int, speed_mps: float, told: bool) -> None:
    north = speed_mps * AT_S
    north[100 : 100 + many] = north[100]
    found = [one for one in report(gps(north, Spd=speed_mps)).findings if one.key == "gnss.frozen"]
    assert len(found) == told
    for one in found:
        assert one.sentence == f"GPS repeats one position while it reports {speed_mps:.1f} m/s: from 0:20.0 for 5.8 s"
        assert one.evidence == (Evidence("GPS", "Lat", 20 * S, 25_800_000_000),)


@pytest.mark.parametrize("usual_m", [1.0, 4.0])
@pytest.mark.parametrize(
    ("further_m", "severity"), [(4.9, None), (5.1, Severity.NOTICE), (14.9, Severity.NOTICE), (15.1, Severity.WARNING)]
)
def test_receivers_that_come_apart(usual_m: float, further_m: float, severity: Severity | None) -> None:
    """Further apart than usual for some time."""
    apart_m = usual_m + further_m
    north = 2.0 * AT_S + np.where((AT_S >= 20.0) & (AT_S < 30.0), apart_m, usual_m)
    section = report(gps(), gps(north, name="GPS2", Spd=np.nan))
    found = [one for one in section.findings if one.key == "gnss.receivers_apart"]
    assert [one.severity for one in found] == ([] if severity is None else [severity])
    for one in found:
        assert one.sentence.startswith(f"GPS and GPS2 are {usual_m:.1f} m apart as a rule and {apart_m:.1f} m at 0:2")
    far = report(gps(), gps(2.0 * AT_S + 50.0, name="GPS2"))  # antennas may be far from each other
    assert not [one for one in far.findings if one.key == "gnss.receivers_apart"]


def test_what_the_autopilot_called_a_glitch() -> None:
    flags = MadeTable(
        "XKF4", ns(np.arange(40.0)), {"SS": rows(0, 0, 0, 0)[:40] + np.where(np.arange(40) == 15, 1 << 15, 0)}
    )
    errors = MadeTable("ERR", ns([12.0, 13.0]), {"Subsys": [11, 11], "ECode": [2, 0]})
    said = MadeTable(
        "MSG",
        ns([9.0, 10.0, 11.0]),
        {"Message": ["GPS Glitch or Compass error", "GPS Glitch cleared", "Compass glitch"]},
    )
    finding = only(report(gps(), flags, errors, said))
    assert finding.sentence == "The autopilot judged positions to be a glitch, first at 0:09.0"
    assert [(one.message, one.at_ns) for one in finding.evidence if one.message != "XKF4"] == [
        ("MSG", 9 * S),
        ("ERR", 12 * S),
    ]
