"""Gains that follow from a vessel's data are those that the shipped vessels were tuned to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agent.fcu.control.allocation import ThrustAllocator
from agent.fcu.control.controller import Demand
from agent.fcu.parameters import Parameters
from sim_core.environment.spec import Water
from sim_core.vessel.propulsion import make_propulsion
from sim_core.vessel.spec import Propeller, Rudder, SteeringGear, VesselSpec
from xitl_cli.profile import load_profile
from xitl_cli.profile.files.parameter_files import read_parameter_file
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.links.vessel_gains import TUNED_LENGTH_M, vessel_gains


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


def test_the_tuned_vessel_is_the_full_size_catamaran() -> None:
    vessel = load_profile("asv-full").vehicle
    assert vessel is not None
    assert vessel.length_m == TUNED_LENGTH_M


def driven(vessel: VesselSpec) -> ThrustAllocator:
    return ThrustAllocator(Parameters(vessel_gains(vessel, vessel.cruise_speed_mps or 2.0)))


@pytest.mark.parametrize(
    ("name", "outputs", "pivots"),
    [
        ("asv-full", (1, 3), True),
        ("asv-third", (1, 3), True),
        ("asv-steered", (3, 1), False),
        ("otter", (1, 3), True),
        ("wamv16", (1, 3), True),
        ("heron", (1, 3), True),
        ("blueboat", (1, 3), True),
        ("cybership2", (1, 2, 3, 4, 5), True),
        ("kvlcc2-l7", (3, 1), False),
        ("mariner", (3, 1), False),
    ],
)
def test_a_shipped_vessel_gets_as_many_outputs_as_it_has_commands(
    name: str, outputs: tuple[int, ...], pivots: bool
) -> None:
    vessel = load_profile(name).vehicle
    assert vessel is not None
    mixer = driven(vessel).mixer
    assert mixer.outputs == outputs
    assert len(mixer.outputs) == vessel.commands
    assert mixer.throttles == len(vessel.propellers)
    assert mixer.pivots == pivots


def with_propellers(*propellers: Propeller, rudders: tuple[Rudder, ...] = ()) -> VesselSpec:
    vessel = load_profile("asv-full").vehicle
    assert vessel is not None
    return replace(vessel, propellers=propellers, rudders=rudders)


def at(x_m: float, y_m: float, angle_deg: float = 0.0, gear_deg: float = 0.0) -> Propeller:
    gear = SteeringGear(gear_deg, 60.0) if gear_deg else None
    return Propeller((x_m, y_m, 0.1), 200.0, 120.0, steering=gear, angle_deg=angle_deg, medium="water")


RUDDER = Rudder(position_frd_m=(-1.2, 0.0, 0.1), area_m2=0.05, aspect_ratio=1.5)


@pytest.mark.parametrize(
    "vessel",
    [
        with_propellers(at(-1, 0), rudders=(RUDDER,)),
        with_propellers(at(-1, 0), rudders=(RUDDER, replace(RUDDER, propeller=None))),
        with_propellers(at(-1, -0.5), at(-1, 0.5), at(1, 0, 90)),
        with_propellers(at(-1, -0.4), at(-1, 0.6)),
        with_propellers(at(1, -0.5, 135), at(1, 0.5, -135), at(-1, -0.5, 45), at(-1, 0.5, -45)),
        with_propellers(at(-1, -0.5, gear_deg=30), at(-1, 0.5, gear_deg=30)),
        with_propellers(at(-1, 0, gear_deg=180), at(1, 0, gear_deg=180)),
        with_propellers(at(1, 0, gear_deg=45), rudders=(RUDDER,)),
        with_propellers(*(at(-1, 0.1 * n, gear_deg=40) for n in range(-3, 5))),
    ],
    ids=["rudder", "two rudders", "bow thruster", "uneven", "X", "outboards", "azimuth", "bow pod", "sixteen"],
)
def test_the_physics_turn_and_drive_it_as_the_autopilot_asks(vessel: VesselSpec) -> None:
    """Force and moment of the simulation's own propulsion with these commands in force, under way at 2 m/s."""
    allocator = driven(vessel)
    propulsion = make_propulsion(vessel, Water(), 0.01)
    nu = np.array([[2.0, 0, 0, 0, 0, 0]])
    for steering in (0.15, -0.15):
        for _ in range(50):
            command = allocator.allocate(Demand(0.3, steering), 0.02, 2.0)
        assert len(command) == vessel.commands
        state = np.array([command])
        terms = np.concatenate(propulsion.terms(state, nu, np.array([[2.0, 0.0, 0.0]])), axis=1)
        force = (terms @ propulsion.wrench)[0]
        assert force[0] > 0.0
        assert np.sign(force[5]) == np.sign(steering)
