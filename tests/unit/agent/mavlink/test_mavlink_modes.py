from __future__ import annotations

import struct

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from agent.mavlink.modes import ROVER_MODES, mode_name, set_mode_parameters, shown_mode
from agent.mavlink.parameters import bytewise_field, bytewise_value


@pytest.mark.parametrize(
    ("name", "theirs"),
    [
        ("MANUAL", "MANUAL"),
        ("ACRO", "ACRO"),
        ("LOITER", "LOITER"),
        ("AUTO", "MISSION"),
        ("RTL", "RTL"),
    ],
)
def test_modes_are_those_that_pymavlink_knows(name: str, theirs: str) -> None:
    _, main, sub = mavutil.px4_map[theirs]
    assert set_mode_parameters(name, px4=True) == (1.0, main, sub)
    custom_mode = main << 16 | sub << 24
    assert mode_name(custom_mode, px4=True) == name
    assert mavutil.interpret_px4_mode(mavutil.px4_map[theirs][0] | 1, custom_mode) == theirs


def test_rovers_modes_are_those_that_pymavlink_knows() -> None:
    assert {number: ROVER_MODES[number] for number in mavutil.mode_mapping_rover if number in ROVER_MODES} == {
        number: name for number, name in mavutil.mode_mapping_rover.items() if number in ROVER_MODES
    }
    assert set_mode_parameters("GUIDED") == (1.0, 15.0)
    assert mode_name(21) == "mode 21"


@pytest.mark.parametrize("name", ["HOLD", "GUIDED"])
def test_px4_holds_at_a_place_in_loiter(name: str) -> None:
    assert set_mode_parameters(name, px4=True) == set_mode_parameters("LOITER", px4=True)
    assert shown_mode(name, px4=True) == "LOITER"
    assert shown_mode(name) == name


def test_offboard_is_no_mode_of_a_profile() -> None:
    _, main, sub = mavutil.px4_map["OFFBOARD"]
    assert mode_name(main << 16 | sub << 24, px4=True) == "OFFBOARD"


def test_a_mode_that_is_not_known_has_its_numbers() -> None:
    assert mode_name(4 << 16 | 9 << 24, px4=True) == "mode 4.9"


@pytest.mark.parametrize(
    ("kind", "layout", "value"),
    [
        (mavlink.MAV_PARAM_TYPE_INT32, "<i", 3),
        (mavlink.MAV_PARAM_TYPE_INT32, "<i", -1_000_000),
        (mavlink.MAV_PARAM_TYPE_UINT32, "<I", 2_000_000_000),
        (mavlink.MAV_PARAM_TYPE_INT8, "<bxxx", -5),
    ],
)
def test_whole_numbers_travel_in_the_bytes_of_the_field(kind: int, layout: str, value: int) -> None:
    (raw,) = struct.unpack("<f", struct.pack(layout, value))
    assert struct.pack("<f", bytewise_field(value, kind)) == struct.pack(layout, value)
    told = mavlink.MAVLink_param_value_message(b"RD_TRANS", raw, kind, 1, 0)
    assert bytewise_value(told) == value


def test_other_numbers_travel_as_they_are() -> None:
    told = mavlink.MAVLink_param_value_message(b"RO_SPEED_LIM", 1.5, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)
    assert bytewise_value(told) == 1.5
    assert bytewise_field(1.5, mavlink.MAV_PARAM_TYPE_REAL32) == 1.5


@pytest.mark.parametrize("value", [1.5, 1e12, float("nan"), float("inf")])
def test_what_is_no_whole_number_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="use a whole number"):
        bytewise_field(value, mavlink.MAV_PARAM_TYPE_INT32)
