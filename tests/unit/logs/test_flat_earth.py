"""Metres of a world that ArduPilot's simulator made, against its own count of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.geodesy import ardupilot_ned
from xitl_cli.logs import signals
from xitl_cli.logs.compare.comparison import compare
from xitl_cli.logs.model.sections import Severity

A_DEGREE_M = 0.011131884502145034e7
"""LOCATION_SCALING_FACTOR of AP_Common/Location.h, metres for 1e-7 degrees."""


def log_of(simulated: bool, moving: bool = True) -> MadeLog:
    """100 m of latitude, as ArduPilot counts."""
    share = np.linspace(0.0, 1.0, 50)
    place = {"Lat": -8.8 + 100.0 / A_DEGREE_M * share, "Lng": np.full(50, -63.95), "Alt": np.full(50, 3.0)}
    stamps = np.arange(50) * 10**8
    tables = [MadeTable("POS", stamps, place)]
    if simulated:
        tables.append(MadeTable("SIM", stamps, place if moving else {**place, "Lat": np.full(50, -8.8)}))
        fix = {"Status": np.full(50, 3), "Spd": np.full(50, 100.0 / 4.9), "GCrs": np.zeros(50)}
        tables.append(MadeTable("GPS", stamps, {**place, **fix}))
    return MadeLog(*tables)


def test_metres_are_those_of_its_sphere() -> None:
    places = np.array([[-8.8 + 1e-3, -63.95, 3.0], [-8.8, -63.95 + 1e-3, 5.0]])
    found = ardupilot_ned((-8.8, -63.95, 3.0), places)
    assert found[0] == pytest.approx([A_DEGREE_M * 1e-3, 0.0, 0.0], abs=1e-6)
    assert found[1] == pytest.approx([0.0, A_DEGREE_M * 1e-3 * math.cos(math.radians(8.8)), -2.0], abs=1e-6)


def test_it_goes_the_short_way_over_the_date_line() -> None:
    found = ardupilot_ned((0.0, 179.9995, 0.0), np.array([[0.0, -179.9995, 0.0]]))
    assert found[0, 1] == pytest.approx(A_DEGREE_M * 1e-3, rel=1e-6)


@pytest.mark.parametrize("of", ["estimate", "truth"])
def test_a_simulated_way_is_as_long_as_in_its_world(of: signals.SignalSource) -> None:
    found = signals.position_ned(log_of(simulated=True), of)
    assert found is not None
    assert found.path.values[-1, 0] == pytest.approx(100.0, abs=1e-3)


@pytest.mark.parametrize("log", [log_of(simulated=False), log_of(simulated=True, moving=False)])
def test_a_way_on_the_real_earth_is_measured_on_the_ellipsoid(log: MadeLog) -> None:
    """A degree of the meridian at 8.8 deg is 110.60 km by WGS 84 (Snyder, Map projections, 1987, table 1: 8-9 deg)."""
    found = signals.position_ned(log)
    assert found is not None
    assert found.path.values[-1, 0] == pytest.approx(100.0 * 110_600.0 / A_DEGREE_M, abs=0.02)


def test_about_another_place_both_fit() -> None:
    here = signals.position_ned(log_of(simulated=True))
    there = signals.position_ned(log_of(simulated=True), "estimate", (-8.81, -63.95, 3.0))
    assert here is not None
    assert there is not None
    moved = there.path.values - there.path.values[0]
    assert moved[:, :2] == pytest.approx(here.path.values[:, :2], abs=1e-3)
    assert there.path.values[0, 0] == pytest.approx(0.01 * 110_600.0, rel=1e-4)


def test_telemetry_of_a_simulated_vehicle_is_measured_alike() -> None:
    share = np.linspace(0.0, 1.0, 50)
    latitude = -8.8 + 100.0 / A_DEGREE_M * share
    stamps = np.arange(50) * 10**8
    place = {"lat": latitude, "lon": np.full(50, -63.95), "alt": np.full(50, 3.0)}
    state = MadeTable("SIMSTATE", stamps, {"lat": latitude, "lng": np.full(50, -63.95)})
    log = MadeLog(MadeTable("GLOBAL_POSITION_INT", stamps, place), state, kind="tlog", base="utc")
    found = signals.position_ned(log)
    assert found is not None
    assert np.ptp(found.path.values[:, 0]) == pytest.approx(100.0, abs=0.01)


def test_a_truth_of_another_vehicle_is_none() -> None:
    stray = log_of(simulated=True, moving=False)
    assert signals.stray_truth_m(stray) == pytest.approx(100.0 * 110_600.0 / A_DEGREE_M, abs=15.0)  # half a second less
    assert signals.position_geodetic(stray, "truth") is None
    assert signals.stray_truth_m(log_of(simulated=True)) is None


def test_a_truth_of_another_vehicle_is_a_warning() -> None:
    doubted = compare(log_of(simulated=True, moving=False), log_of(simulated=True), of_a="truth", shift_s=0.0)
    assert [each.key for each in doubted.sections[0].findings if each.severity == Severity.WARNING] == [
        "trajectory.stray_truth"
    ]
    trusted = compare(log_of(simulated=True), log_of(simulated=True), of_a="truth", shift_s=0.0)
    assert all(each.severity == Severity.OK for each in trusted.sections[0].findings)
