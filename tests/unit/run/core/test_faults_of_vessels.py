"""From faults of a profile to what the simulated actuators do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.profile import RunProfile
from xitl_cli.run.core.faults import describe_fault
from xitl_cli.run.nodes.fault_injection import VesselFaults


def profile_with(folder: Path, vehicle: str, faults: str) -> RunProfile:
    path = folder / "boat.yaml"
    path.write_text(f"extends: [sitl, {vehicle}]\nfaults: {faults}\n")
    return load_profile(str(path)).runnable()


def test_a_stuck_propeller_keeps_the_speed_that_it_had_as_the_fault_began(tmp_path: Path) -> None:
    profile = profile_with(tmp_path, "vehicles/asv-full", "{x: {propeller: {which: starboard, stuck: true}}}")
    vessel = VesselFaults(profile.vehicle)
    for rotor in (np.array([0.2, 0.7]), np.array([0.3, 0.1])):  # it began with the first
        condition = vessel.condition(profile.faults, rotor)
        assert condition is not None
        assert condition.actual(np.array([[0.5, 0.5]])).tolist() == [[0.5, 0.7]]
    assert vessel.condition({}, np.zeros(2)) is None
    again = vessel.condition(profile.faults, np.array([0.0, -0.4]))
    assert again is not None
    assert again.actual(np.array([[0.5, 0.5]])).tolist() == [[0.5, -0.4]]


def test_a_jammed_gear_goes_to_its_angle_as_a_share_of_its_stop(tmp_path: Path) -> None:
    profile = profile_with(tmp_path, "vehicles/asv-steered", "{x: {rudder: {jam_angle_deg: -9.0}}}")
    condition = VesselFaults(profile.vehicle).condition(profile.faults, np.zeros(2))
    assert condition is not None
    assert condition.actual(np.array([[0.5, 1.0]]))[0] == pytest.approx([0.5, -0.2])


def test_losses_of_one_propeller_each_take_their_share_of_the_rest(tmp_path: Path) -> None:
    faults = "{x: {propeller: {thrust_loss: 0.5}}, y: {propeller: {which: port, thrust_loss: 0.5, reversed: true}}}"
    profile = profile_with(tmp_path, "vehicles/asv-full", faults)
    condition = VesselFaults(profile.vehicle).condition(profile.faults, np.zeros(2))
    assert condition is not None
    assert condition.thrust_share.tolist() == [[0.25, 1.0]]
    assert condition.actual(np.array([[0.5, 0.5]])).tolist() == [[-0.5, 0.5]]


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("{propeller: {thrust_loss: 0.4}}", "propeller 0: 40% of the thrust lost"),
        ("{propeller: {which: port, stuck_at: 0.5}}", "port propeller: stuck at +0.50"),
        ("{propeller: {reversed: true, stuck: true}}", "propeller 0: stuck at its speed, reversed"),
        ("{battery: {failed_cells: 1, voltage_drop_v: 2}}", "battery: 1 cells failed, 2 V less"),
        ("{gnss: {drift_mps: 0.3, drift_bearing_deg: 90}}", "gnss: position drifts 0.3 m/s to 90 degrees"),
    ],
)
def test_the_log_names_a_fault_by_what_it_does(fault: str, words: str, tmp_path: Path) -> None:
    profile = profile_with(tmp_path, "vehicles/asv-full", f"{{x: {fault}}}")
    assert describe_fault(profile.faults["x"]) == words
