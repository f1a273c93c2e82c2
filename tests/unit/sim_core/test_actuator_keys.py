"""Propellers and rudders that cannot be are refused with the key and what to do."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from vessels import FULL

from sim_core.keys import SpecificationError
from sim_core.vessel.spec import OpenWater, Propeller, Rudder, SideForceAstern, SteeringGear

CURVE: dict[str, Any] = {
    "diameter_m": 0.2,
    "max_speed_rps": 20.0,
    "advance_ratio": (0.0, 0.4, 0.8),
    "thrust_coefficient": (0.4, 0.25, 0.05),
}
SCREW: dict[str, Any] = {"position_frd_m": (-1.0, 0.0, 0.1), "medium": "water"}
THRUST: dict[str, Any] = {"max_thrust_n": 100.0, "max_reverse_thrust_n": 60.0}
RUDDER = Rudder(position_frd_m=(-1.2, 0.0, 0.1), area_m2=0.03, aspect_ratio=1.5, propeller=0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"thrust_coefficient": (0.4, 0.2)},
            "thrust_coefficient has 2 entries for 3 of advance_ratio; give one K_T",
        ),
        ({"advance_ratio": (0.0, 0.4, 0.4)}, "advance_ratio has to begin at 0 and rise; sort the table by J"),
        ({"advance_ratio": (0.1, 0.4, 0.8)}, "advance_ratio has to begin at 0 and rise"),
        ({"thrust_coefficient": (0.4, 0.45, 0.1)}, "thrust_coefficient.1 = 0.45 does not fall from the 0.4 before it"),
        ({"thrust_coefficient": (0.0, -0.1, -0.2)}, "thrust_coefficient.0 = 0 gives no thrust at rest"),
        (
            {"advance_ratio": (0.0,), "thrust_coefficient": (0.4,)},
            "advance_ratio = (0.0,) is too short; give at least 2",
        ),
        ({"astern_advance_ratio": (-0.2, 0.5)}, "astern_advance_ratio has no astern_thrust_coefficient; give both"),
        (
            {"astern_advance_ratio": (-0.2, 0.5), "astern_thrust_coefficient": (0.3, 0.2, 0.0)},
            "astern_thrust_coefficient has 3 entries for 2 of astern_advance_ratio; give one for each",
        ),
        (
            {"astern_advance_ratio": (0.5, -0.2), "astern_thrust_coefficient": (0.0, 0.3)},
            "astern_advance_ratio goes from 0.5 to -0.2; sort it from the smallest on",
        ),
        (
            {"astern_advance_ratio": (-0.2, 0.5), "astern_thrust_coefficient": (0.3, 0.0), "reverse_share": 0.7},
            "reverse_share and a table astern exclude each other; give one of them",
        ),
        (
            {"astern_advance_ratio": (-0.2, 0.5), "astern_thrust_coefficient": (-0.3, 0.0)},
            "astern_thrust_coefficient gives no thrust at J_s = 0; write the thrust astern positive",
        ),
    ],
)
def test_a_table_that_is_none(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        OpenWater(**{**CURVE, **changed})


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "needs max_thrust_n or open_water; give one of the two"),
        ({**THRUST, "open_water": OpenWater(**CURVE)}, "needs max_thrust_n or open_water; give one of the two"),
        ({"max_thrust_n": 100.0}, "needs max_thrust_n and max_reverse_thrust_n together; give both"),
        (
            {"open_water": OpenWater(**CURVE), "medium": "air"},
            "open_water is of a propeller in water, and this one is",
        ),
        ({**THRUST, "zero_thrust_speed_mps": 4.0, "medium": "air"}, "zero_thrust_speed_mps is of a propeller in water"),
        ({**THRUST, "wake_fraction": 0.2, "medium": "air"}, "wake_fraction is of a propeller in water"),
        ({**THRUST, "tunnel_speed_mps": 1.7, "medium": "air"}, "tunnel_speed_mps is of a propeller in water"),
        (
            {"open_water": OpenWater(**CURVE), "zero_thrust_speed_mps": 4.0},
            "zero_thrust_speed_mps and open_water exclude each other; give one of them",
        ),
        (
            {"open_water": OpenWater(**CURVE), "diameter_m": 0.2},
            "diameter_m is given by open_water.diameter_m",
        ),
        (
            {**THRUST, "tunnel_speed_mps": 1.7, "steering": SteeringGear(180.0, 60.0)},
            "steering turns no thruster in a tunnel; leave out steering or tunnel_speed_mps",
        ),
        (
            {**THRUST, "side_force_astern": SideForceAstern(share=-0.1), "medium": "air"},
            "side_force_astern is of a fixed propeller in water behind a hull",
        ),
        (
            {**THRUST, "side_force_astern": SideForceAstern(advance_ratio=(-0.5, 0.0), coefficient=(-0.1, 0.0))},
            "side_force_astern.coefficient needs open_water for n and D; give it, or use share",
        ),
        ({**THRUST, "angle_deg": 270.0}, "angle_deg = 270.0 is too large; use a value of at most 180"),
    ],
)
def test_a_propeller_that_is_none(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        Propeller(**{**SCREW, **keys})


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({}, "needs share, or advance_ratio and coefficient; give one of the two"),
        ({"share": -0.1, "coefficient": (-0.1, 0.0)}, "needs share, or advance_ratio and coefficient"),
        ({"coefficient": (-0.1, 0.0)}, "coefficient has no advance_ratio; give both"),
        ({"share": -1.1}, "share = -1.1 is too small; use a value of at least -1"),
    ],
)
def test_a_side_force_that_is_none(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        SideForceAstern(**keys)


@pytest.mark.parametrize(
    ("propeller", "number", "said"),
    [
        ({"diameter_m": 0.2}, 2, "= 2 is no propeller; use 0, or leave it out"),
        ({"diameter_m": 0.2, "medium": "air"}, 0, "= 0 is in air; use the number of one in water"),
        ({}, 0, "= 0 has no diameter for its race; give propellers.0.diameter_m"),
        (
            {"diameter_m": 0.2, "angle_deg": 90.0},
            0,
            "= 0 does not push straight ahead, so that its race misses",
        ),
        ({"diameter_m": 0.2, "steering": SteeringGear(90.0, 60.0)}, 0, "= 0 does not push straight ahead"),
        (
            {"diameter_m": 0.2, "position_frd_m": (-1.5, 0.0, 0.1)},
            0,
            "= 0 stands 0.3 m behind the rudder; place it ahead of the rudder, or leave the key out",
        ),
    ],
)
def test_a_rudder_without_a_race(propeller: dict[str, Any], number: int, said: str) -> None:
    screw = Propeller(**{**SCREW, **THRUST, **propeller})
    with pytest.raises(SpecificationError) as refused:
        replace(FULL, propellers=(screw,), rudders=(replace(RUDDER, propeller=number),))
    assert refused.value.path == ("rudders", 0, "propeller")
    assert refused.value.text.startswith(said)


def test_a_race_of_an_open_water_propeller_has_its_diameter() -> None:
    screw = Propeller(**SCREW, open_water=OpenWater(**CURVE))
    assert replace(FULL, propellers=(screw,), rudders=(RUDDER,)).commands == 2
