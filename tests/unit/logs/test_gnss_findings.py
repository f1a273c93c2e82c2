"""Satellite navigation with troubles that were put there: each is reported, where it is, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import actuation
from xitl_cli.plugins.logs.analyses.gnss import analyse

S = 1_000_000_000
STEP_NS = S // 5
ROWS = 500
ORIGIN = LocalFrame(-8.8, -63.95, 50.0)


def sail(seed: int = 0) -> dict[str, np.ndarray]:
    """2 m/s on a wide curve, as a receiver with 5 cm and 3 cm/s of noise tells it."""
    random = np.random.default_rng(seed)
    at_s = np.arange(ROWS) * 0.2
    course = 0.02 * at_s
    velocity = 2.0 * np.stack([np.cos(course), np.sin(course)], axis=1)
    place = np.cumsum(np.vstack([np.zeros((1, 2)), 0.5 * (velocity[1:] + velocity[:-1]) * 0.2]), axis=0)
    place += 0.05 * random.standard_normal(place.shape)
    velocity += 0.03 * random.standard_normal(velocity.shape)
    return {"north": place[:, 0], "east": place[:, 1], "vn": velocity[:, 0], "ve": velocity[:, 1]}


def gps(motion: dict[str, np.ndarray], keep: np.ndarray | None = None, **changed: Any) -> MadeTable:
    ned = np.stack([motion["north"], motion["east"], np.zeros(ROWS)], axis=1)
    lat, lon, alt = ORIGIN.geodetic(ned)
    columns = {
        "Status": np.full(ROWS, 3), "NSats": np.full(ROWS, 14), "HDop": np.full(ROWS, 0.8), "Lat": lat, "Lng": lon,
        "Alt": alt, "Spd": np.hypot(motion["vn"], motion["ve"]),
        "GCrs": np.degrees(np.arctan2(motion["ve"], motion["vn"])) % 360.0, "VZ": np.zeros(ROWS),
        "GWk": np.full(ROWS, 2400), "GMS": np.arange(ROWS) * 200,
    } | changed  # fmt: skip
    rows = np.ones(ROWS, dtype=bool) if keep is None else keep
    return MadeTable("GPS", (np.arange(ROWS) * STEP_NS)[rows], {name: each[rows] for name, each in columns.items()})


def others() -> tuple[MadeTable, MadeTable]:
    """What goes on while the receiver is silent."""
    at = np.arange(ROWS * 10) * (STEP_NS // 10)
    return MadeTable("ATT", at, {"Roll": np.zeros(len(at))}), MadeTable("RCOU", at, {"C1": np.zeros(len(at))})


def report(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables, *others()))
    assert section is not None
    return section


def only(section: Section) -> Finding:
    assert len(section.findings) == 1, [finding.sentence for finding in section.findings]
    return section.findings[0]


def test_a_good_receiver_has_no_finding_and_its_figures_are_right():
    section = report(gps(sail()))
    assert section.findings == ()
    facts = {fact.key: fact.value for fact in section.facts}
    assert facts["fix_share_percent"] == 100.0
    # From fix to fix an axis errs by sqrt(2) 5 cm; the median length of two such axes is 1.1774 times that.
    assert facts["position_step_error_m"] == pytest.approx(0.05 * np.sqrt(2.0) * 1.1774, rel=0.1)
    # The curve adds 0.02 rad/s of 2 m/s in 0.2 s, 8 mm/s: nothing beside 3 cm/s.
    assert facts["speed_noise_mps"] == pytest.approx(0.03, rel=0.15)


def test_silence_is_reported_with_its_times():
    keep = np.ones(ROWS, dtype=bool)
    keep[200:300] = False
    finding = only(report(gps(sail(), keep)))
    assert (finding.key, finding.severity) == ("gnss.silent", Severity.WARNING)
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (199 * STEP_NS, 300 * STEP_NS)


def test_a_receiver_that_falls_silent_for_good():
    keep = np.arange(ROWS) < 300
    finding = only(report(gps(sail(), keep)))
    assert finding.key == "gnss.silent"
    assert finding.evidence[0].at_ns == 299 * STEP_NS
    assert "to the end" in finding.sentence


@pytest.mark.parametrize(
    ("rows", "disarmed_s", "method", "reported"),
    [
        (490, 98.1, 1, False),  # the log ends at 100 s
        (490, 95.0, 1, False),
        (490, 98.1, 6, True),  # a failsafe disarmed it
        (490, 95.0, 6, False),  # the failsafe was before
        (470, 90.0, 1, True),  # the log goes on for longer
        (300, 60.1, 1, True),
    ],
)
def test_a_receiver_that_is_switched_off_after_disarming_is_no_finding(rows, disarmed_s, method, reported):
    keep = np.arange(ROWS) < rows
    arm = MadeTable("ARM", [S, round(disarmed_s * S)], {"ArmState": [1, 0], "Method": [1, method]})
    section = report(gps(sail(), keep), arm)
    assert [finding.key for finding in section.findings] == (["gnss.silent"] if reported else [])


def test_a_lost_fix_is_reported_until_it_is_back():
    status = np.full(ROWS, 3)
    status[100:110] = 1
    status[400] = 0
    finding = only(report(gps(sail(), Status=status)))
    assert finding.key == "gnss.fix_lost"
    assert [(each.at_ns, each.until_ns) for each in finding.evidence] == [
        (99 * STEP_NS, 110 * STEP_NS),
        (399 * STEP_NS, 401 * STEP_NS),
    ]


def test_before_the_first_fix_nothing_is_lost():
    status = np.full(ROWS, 3)
    status[:50] = 1
    section = report(gps(sail(), Status=status))
    assert section.findings == ()
    assert {fact.key: fact.value for fact in section.facts}["first_fix_s"] == 10.0


def test_a_receiver_without_any_fix():
    finding = only(report(gps(sail(), Status=np.ones(ROWS, dtype=int))))
    assert finding.key == "gnss.no_fix"


def test_jumps_there_and_back():
    motion = sail()
    motion["east"][150:300] += 5.0
    finding = only(report(gps(motion)))
    assert (finding.key, finding.severity) == ("gnss.jump", Severity.WARNING)
    assert [each.at_ns for each in finding.evidence] == [150 * STEP_NS, 300 * STEP_NS]
    size_m = float(finding.sentence.split("up to ")[1].split(" m")[0])
    assert size_m == pytest.approx(5.0, abs=0.4)  # noise of 7 cm, and how far it sails in a step


def test_a_small_step_within_the_stated_accuracy_is_a_notice():
    motion = sail()
    motion["east"][150:] += 2.8
    accuracy = MadeTable("GPA", np.arange(ROWS) * STEP_NS, {"HAcc": np.full(ROWS, 1.5)})
    finding = only(report(gps(motion), accuracy))
    assert (finding.key, finding.severity) == ("gnss.jump", Severity.NOTICE)


@pytest.mark.parametrize(
    ("step_m", "severities"), [(1.5, []), (2.5, [Severity.NOTICE]), (3.5, [Severity.WARNING])], ids=str
)
def test_the_limits_of_a_jump(step_m, severities):
    motion = sail()
    motion["east"][150:] += step_m
    assert [finding.severity for finding in report(gps(motion)).findings] == severities


def test_a_position_that_repeats_at_speed():
    motion = sail()
    for name in motion:
        motion[name][200:250] = motion[name][200]
    found = {finding.key: finding for finding in report(gps(motion)).findings}
    # When it measures again it is 20 m on: that is a jump, too.
    assert set(found) == {"gnss.frozen", "gnss.jump"}
    frozen = found["gnss.frozen"].evidence[0]
    assert (frozen.at_ns, frozen.until_ns) == (200 * STEP_NS, 249 * STEP_NS)


@pytest.mark.medium
def test_a_velocity_that_contradicts_the_positions():
    motion = sail()
    motion["vn"][100:400] += 1.0
    table = gps(motion)
    finding = only(report(table))
    assert finding.key == "gnss.velocity_off"
    assert finding.evidence[0].at_ns == pytest.approx(100 * STEP_NS, abs=S)
    assert finding.evidence[0].until_ns == pytest.approx(400 * STEP_NS, abs=S)
    assert actuation.analyse(MadeLog(table)) is None  # it says nothing of the same velocity


def test_few_satellites_are_a_notice():
    satellites = np.full(ROWS, 14)
    satellites[100:200] = 4
    finding = only(report(gps(sail(), NSats=satellites)))
    assert (finding.key, finding.severity) == ("gnss.poor", Severity.NOTICE)
    assert "20 %" in finding.sentence


def test_what_the_autopilot_took_for_a_glitch():
    flags = np.zeros(100, dtype=np.int64)
    flags[40:50] = 1 << 14
    finding = only(report(gps(sail()), MadeTable("XKF4", np.arange(100) * S, {"SS": flags})))
    assert finding.key == "gnss.glitch"
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (40 * S, 49 * S)


def test_no_receiver_and_no_gps_time_are_said():
    assert "GPS" in report().lacks[0]
    section = report(gps(sail(), GWk=np.zeros(ROWS)))
    assert section.findings == ()
    assert any("week 0" in lack for lack in section.lacks)
