"""The conditions of station keeping, against the forces that they should make."""

from __future__ import annotations

from dataclasses import replace

import pytest

from agent.fcu.parameters import Parameters
from xitl_cli.plugins.studies.manoeuvres.station import loiter_radius_m, station_conditions
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
