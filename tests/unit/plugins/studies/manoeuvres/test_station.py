"""The conditions of station keeping, against the forces that they should make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.fcu.parameters import Parameters
from agent.navigation.estimator import Estimator
from sim_core.environment.spec import Water
from xitl_cli.plugins.studies.manoeuvres import station
from xitl_cli.plugins.studies.manoeuvres.station import loiter_radius_m, station_conditions, station_keeping
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.agents import AutopilotSpec


def test_the_wind_on_the_side_is_a_tenth_of_the_thrust() -> None:
    model = load_profile("vehicles/asv-third").vehicle
    assert model is not None
    current_mps, wind_mps = station_conditions(model, top_speed_mps=3.0, thrust_n=50.0)
    assert current_mps == 0.3
    force_n = 0.5 * 1.2 * model.wind.sway_coefficient * model.wind.lateral_area_m2 * wind_mps**2
    assert force_n == pytest.approx(5.0, rel=0.1 / wind_mps)  # the wind is rounded to 0.1 m/s


def test_the_wind_is_at_most_a_breeze() -> None:
    model = load_profile("vehicles/asv-third").vehicle
    assert model is not None
    sheltered = replace(model, wind=replace(model.wind, lateral_area_m2=0.0))
    assert station_conditions(model, 3.0, 1e9)[1] == station_conditions(sheltered, 3.0, 50.0)[1] == 8.0


def test_the_loiter_radius_is_that_of_the_autopilot_or_its_default() -> None:
    assert loiter_radius_m(AutopilotSpec(parameters={"LOIT_RADIUS": 3.5})) == 3.5
    assert loiter_radius_m(AutopilotSpec()) == loiter_radius_m(None) == Parameters()["LOIT_RADIUS"]


@pytest.mark.medium
def test_the_estimator_gets_its_samples_at_their_rates_and_fixes_after_their_latency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """25 samples of the IMU a second, and every fifth of them one of each other sensor."""
    received: dict[str, list[tuple[int, Any]]] = {}

    def noted(name: str, original: Callable[[Any, Any], object]) -> Callable[[Any, Any], object]:
        def handle(self: Any, sample: Any) -> object:
            now_ns = sample.stamp_ns if name == "on_imu" else received["on_imu"][-1][0]
            received.setdefault(name, []).append((now_ns, sample))
            return original(self, sample)

        return handle

    for name in ("on_imu", "on_magnetometer", "on_barometer", "on_gnss"):
        monkeypatch.setattr(Estimator, name, noted(name, getattr(Estimator, name)))
    monkeypatch.setattr(station, "SETTLED_S", 5.0)
    monkeypatch.setattr(station, "ENDS_S", 10.0)
    model = load_profile("vehicles/asv-third").vehicle
    assert model is not None
    station_keeping(model, None, Water(), 3.0, 50.0)
    assert {name: len(samples) for name, samples in received.items()} == {
        "on_imu": 250,
        "on_magnetometer": 50,
        "on_barometer": 50,
        "on_gnss": 50,
    }
    assert np.diff([sample.stamp_ns for _, sample in received["on_imu"]]).tolist() == [40_000_000] * 249
    for name in ("on_magnetometer", "on_barometer"):
        assert [sample.stamp_ns for _, sample in received[name]] == [now_ns for now_ns, _ in received[name]]
    profile = load_profile("bases/base-sitl")
    site = load_profile("sites/santo-antonio").site
    assert profile.sensors is not None
    assert site is not None
    late_ns = {now_ns - fix.stamp_ns for now_ns, fix in received["on_gnss"]}
    assert late_ns == {-(-round(profile.sensors.gnss.latency_s * 1e9) // 40_000_000) * 40_000_000}
    fix = received["on_gnss"][0][1]
    assert (fix.stamp_ns, fix.fix_type) == (0, 3)
    assert (fix.lat_deg, fix.lon_deg) == pytest.approx((site.latitude_deg, site.longitude_deg), abs=1e-4)
    assert fix.alt_m == pytest.approx(site.altitude_m, abs=5.0)
    x, y, z = received["on_imu"][0][1].accel_frd_mps2
    assert (x, y, z) == pytest.approx((0.0, 0.0, -9.78), abs=0.5)


@pytest.mark.medium
def test_an_autopilot_that_refuses_to_arm_keeps_no_station(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(station, "ARMED_S", 0.4)  # the estimator has no position yet
    model = load_profile("vehicles/asv-third").vehicle
    assert model is not None
    found = station_keeping(model, AutopilotSpec(kind="ardupilot"), Water(), 3.0, 50.0)
    assert (found.key, found.facts, found.plots) == ("station", (), ())
    (lack,) = found.lacks
    assert lack.startswith("station keeping: the autopilot refuses: ")
