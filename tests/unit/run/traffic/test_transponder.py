"""When a transponder reports (ITU-R M.1371-5, annex 1, tables 1 and 2), and what receivers make of it."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from xitl_cli.run.traffic.ais import (
    AisClass,
    AisDimensions,
    AisPosition,
    AisStatic,
    AisTransmission,
    CourseChange,
    Transponder,
    adsb_vehicle,
    ais_vessel,
    mavlink_receiver,
    reporting_interval_s,
)
from xitl_cli.run.traffic.self_report import SelfReport

KNOT = 1852.0 / 3600.0
S = 1_000_000_000
FRAME = LocalFrame(-8.8, -63.95, 50.0)
BARGE = AisStatic(200001001, "BARGE", "BRG1", 70, AisDimensions(30, 30, 6, 6))


@pytest.mark.parametrize(
    ("ais_class", "knots", "moored", "turning", "seconds"),
    [
        ("class-a", 0.0, True, False, 180.0),
        ("class-a", 3.5, True, False, 10.0),
        ("class-a", 0.0, False, False, 10.0),
        ("class-a", 14.0, False, False, 10.0),
        ("class-a", 14.0, False, True, 10.0 / 3.0),
        ("class-a", 20.0, False, False, 6.0),
        ("class-a", 20.0, False, True, 2.0),
        ("class-a", 24.0, False, False, 2.0),
        ("class-a", 24.0, False, True, 2.0),
        ("class-b", 1.9, False, False, 180.0),
        ("class-b", 2.1, False, True, 30.0),
    ],
)
def test_intervals(ais_class: AisClass, knots: float, moored: bool, turning: bool, seconds: float) -> None:
    assert reporting_interval_s(ais_class, knots * KNOT, moored, turning) == pytest.approx(seconds)


def sail(transponder: Transponder, seconds: float, speed_mps: float, heading: Any = lambda at_s: 0.0) -> list[Any]:
    """Looked at ten times a second: (s, what) of each transmission."""
    sent = []
    for tick in range(round(seconds * 10) + 1):
        yaw = heading(tick / 10)
        velocity = speed_mps * math.cos(yaw), speed_mps * math.sin(yaw)
        report = SelfReport(tick * S // 10, (0.3 * tick, 0.0), velocity, yaw)
        sent += [(tick / 10, one.report) for one in transponder.due(tick * S // 10, report)]
    return sent


def test_a_vessel_under_way_reports_every_ten_seconds_from_a_given_start() -> None:
    sent = sail(Transponder("class-a", BARGE, FRAME, first_s=4.0), 60.0, 3.0)
    assert [at_s for at_s, one in sent if isinstance(one, AisPosition)] == [4.0, 14.0, 24.0, 34.0, 44.0, 54.0]
    assert [(at_s, one) for at_s, one in sent if isinstance(one, AisStatic)] == [(4.0, BARGE)]


def test_what_it_is_comes_again_after_six_minutes() -> None:
    sent = sail(Transponder("class-b", BARGE, FRAME), 750.0, 3.0)
    assert [at_s for at_s, one in sent if isinstance(one, AisStatic)] == [0.0, 360.0, 720.0]
    assert len([one for _, one in sent if isinstance(one, AisPosition)]) == 26


def test_a_turn_is_told_three_times_as_often_and_for_twenty_seconds_more() -> None:
    """A right angle at 30 s: the mean of the last 30 s has caught up to 5 degrees at about 58 s."""
    sent = sail(Transponder("class-a", BARGE, FRAME), 120.0, 3.0, lambda at_s: math.pi / 2 if at_s > 30.0 else 0.0)
    at = [at_s for at_s, one in sent if isinstance(one, AisPosition)]
    gaps = {round(after - before, 1) for before, after in itertools.pairwise(at) if before > 31.0 and after < 75.0}
    assert gaps == {3.4}  # looked at every tenth of a second
    assert {round(b - a, 1) for a, b in itertools.pairwise(at) if a > 85.0} == {10.0}


def test_a_vessel_that_weaves_by_less_than_five_degrees_does_not_turn() -> None:
    turn = CourseChange()
    said = {turn.update(tick * S // 10, math.radians(4.0 * math.sin(0.1 * tick))) for tick in range(600)}
    assert said == {False}


def test_a_vessel_that_has_no_position_yet_is_silent() -> None:
    assert Transponder("class-a", BARGE, FRAME).due(0, None) == []


def test_a_report_is_the_vessel_as_it_says_it_is() -> None:
    report = SelfReport(0, (100.0, -50.0), (0.0, 2.0), math.radians(80.0), math.radians(-2.0), False, armed=False)
    position = Transponder("class-a", BARGE, FRAME).due(0, report)[0].report
    assert isinstance(position, AisPosition)
    lat, lon, _ = FRAME.geodetic(np.array([[100.0, -50.0, 0.0]]))
    assert (position.lat_deg, position.lon_deg) == (lat[0], lon[0])
    assert (position.speed_mps, position.course_deg, position.heading_deg) == (2.0, 90.0, pytest.approx(80.0))
    assert position.turn_rate_degpmin == pytest.approx(-120.0)
    assert (position.accurate, position.status) == (False, 5)


def test_ais_vessel_has_the_units_of_the_message() -> None:
    position = AisPosition(BARGE.mmsi, -8.8, -63.95, 2.0, 90.04, 79.6, -60.0, accurate=True)
    message = ais_vessel(position, BARGE)
    assert (message.MMSI, message.lat, message.lon) == (BARGE.mmsi, -88_000_000, -639_500_000)
    assert (message.COG, message.heading, message.turn_rate) == (9000, 8000, -10)  # -60 deg/min: -1 deg/s
    assert message.velocity == round(3.9 * KNOT * 100)  # 2 m/s in tenths of a knot
    assert (message.name, message.callsign, message.type, message.dimension_bow) == ("BARGE", "BRG1", 70, 30)
    known = ("POSITION_ACCURACY", "VALID_COG", "VALID_VELOCITY", "VALID_TURN_RATE", "VALID_DIMENSIONS")
    flags = sum(getattr(dialect, f"AIS_FLAGS_{name}") for name in (*known, "VALID_CALLSIGN", "VALID_NAME"))
    assert message.flags == flags


def test_what_is_not_known_is_not_flagged() -> None:
    message = ais_vessel(AisPosition(1, -8.8, -63.95), None)
    assert (message.flags, message.COG, message.velocity, message.heading) == (0, 0, 0, 0xFFFF)


def test_names_come_with_the_position_after_them() -> None:
    told: list[Any] = []
    receive = mavlink_receiver(told.append)
    position = AisPosition(BARGE.mmsi, -8.8, -63.95, 2.0)
    for report in (position, BARGE, position):
        receive(AisTransmission("class-a", report, (0.0, 0.0)))
    assert [message.name for message in told] == ["", "BARGE"]


def test_px4_is_told_by_the_message_that_it_reads() -> None:
    message = adsb_vehicle(AisPosition(BARGE.mmsi, -8.8, -63.95, 2.0, 90.0), BARGE)
    assert (message.ICAO_address, message.callsign) == (BARGE.mmsi & 0xFFFFFF, "BRG1")
    assert (message.lat, message.heading, message.hor_velocity, message.flags) == (-88_000_000, 9000, 200, 31)
