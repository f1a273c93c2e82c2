"""Gains that follow from a vessel's data are those that the shipped vessels were tuned to."""

from __future__ import annotations

from dataclasses import replace

import pytest

from agent.fcu.parameters import Parameters
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.parameter_files import read_parameter_file
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.links.vessel_gains import vessel_gains


@pytest.mark.parametrize(("name", "speed_mps"), [("asv-full", 3.0), ("asv-third", 1.73)])
def test_they_come_out_as_tuned(name: str, speed_mps: float) -> None:
    vessel, tuned = load_profile(name).vehicle, read_parameter_file(f"embedded-{name}")
    assert vessel is not None
    gains = vessel_gains(vessel, speed_mps)
    # The files are rounded to two digits and were settled by runs.
    assert gains == {key: pytest.approx(tuned[key], rel=0.16) for key in gains}


def test_a_file_wins_over_them_and_the_profile_over_both() -> None:
    run = load_profile("sitl").runnable()
    tuned = read_parameter_file("embedded-asv-full")
    assert tuned.items() <= embedded_parameters(run).items() | {("WP_SPEED", 3.0), ("WP_RADIUS", 3.0)}
    bare = replace(run.autopilot, parameter_files=(), parameters={"LOS_LOOKAHEAD": 9.0})
    values = embedded_parameters(replace(run, autopilot=bare))
    assert values["LOS_LOOKAHEAD"] == 9.0
    assert values["ATC_STR_RAT_FF"] == pytest.approx(0.84)


@pytest.mark.parametrize("length_m", [0.4, 1.6, 6.0, 40.0])
def test_the_autopilot_takes_them_of_any_vessel(length_m: float) -> None:
    vessel = load_profile("asv-full").vehicle
    assert vessel is not None
    share = length_m / 2.3
    hull = replace(vessel.hull, length_m=length_m, width_m=1.6 * share, radius_m=0.2 * share)
    idle = replace(vessel.propellers[0], max_reverse_thrust_n=0.0, position_frd_m=(0.0, 0.0, 0.0))
    for propellers in (vessel.propellers, (idle, idle)):
        odd = replace(vessel, hull=hull, mass_kg=113 * share**3, propellers=propellers)
        for speed_mps in (0.2, 20.0):
            Parameters(vessel_gains(odd, speed_mps))  # raises for a value out of range
