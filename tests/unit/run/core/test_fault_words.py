"""The words for a fault in the log of a run."""

from __future__ import annotations

import json

import pytest

from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.reader import read_group
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.run.core.faults import describe_fault


def described(**groups: object) -> str:
    entry = parse_yaml(json.dumps({"from_s": 1.0, **groups}), "test")
    assert entry is not None
    return describe_fault(read_group(entry, FaultSpec, "test"))


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        (
            {"link": {"delay_s": 0.1, "jitter_s": 0.02, "loss": 0.05}},
            "link to the agent both ways: delay 0.1 s, jitter 0.02 s, loss 5 % of the frames",
        ),
        (
            {"link": {"which": "companion", "direction": "sensors", "duplicate": 0.001, "reorder": 0.5, "cut": True}},
            "link to companion: cut, duplicate 0.1 % of the frames, reorder 50 % of the frames",
        ),
        ({"link": {"which": "companion", "cut": True}}, "link to companion both ways: cut"),
        ({"link": {"direction": "sensors", "cut": True}}, "link to the agent: cut"),
        ({"link": {"direction": "actuators", "cut": True}}, "link from the agent: cut"),
        (
            {"agent": {"cpu_load": 0.8, "clock_offset_s": 0.5, "clock_skew_ppm": -40}},
            "agent: 80% of every processor busy, clock 0.5 s ahead, clock -40 ppm",
        ),
        (
            {"imu": {"gyro_bias_frd_radps": [0, 0, 0.01], "accel_bias_frd_mps2": [0.5, 0, 0]}},
            "imu: gyro + [0, 0, 0.01] rad/s, accel + [0.5, 0, 0] m/s²",
        ),
        (
            {"gnss": {"dropout": 0.25, "drift_mps": 0.5, "drift_bearing_deg": 90, "position_bias_ned_m": [1, 2, 0]}},
            "gnss: 25 % of the samples missing, position + [1, 2, 0] m, position drifts 0.5 m/s to 90 degrees",
        ),
        ({"magnetometer": {"freeze": True}}, "magnetometer: values frozen"),
        ({"barometer": {"pressure_bias_pa": 100}}, "barometer: pressure + 100 Pa"),
        ({"imu": {"freeze": True}, "barometer": {"freeze": True}}, "imu: values frozen; barometer: values frozen"),
    ],
)
def test_a_fault_is_told_with_its_sizes_and_units(groups: dict[str, object], words: str) -> None:
    assert described(**groups) == words


@pytest.mark.parametrize(
    ("propeller", "words"),
    [
        ({"which": "port", "thrust_loss": 0.3}, "port propeller: 30% of the thrust lost"),
        ({"which": "propeller 1", "stuck": True}, "propeller 1: stuck at its speed"),
        ({"which": "port", "stuck_at": -0.5, "stuck": True}, "port propeller: stuck at -0.50"),
        ({"which": "port", "reversed": True}, "port propeller: reversed"),
    ],
)
def test_a_fault_of_a_propeller_is_told(propeller: dict[str, object], words: str) -> None:
    assert described(propeller=propeller) == words


@pytest.mark.parametrize(
    ("rudder", "words"),
    [
        ({"jam": True}, "rudder: jammed at its angle"),
        ({"jam_angle_deg": 12}, "rudder: jammed at +12 degrees"),
        ({"which": "rudder 2", "jam_angle_deg": -3.5}, "rudder 2: jammed at -3.5 degrees"),
    ],
)
def test_a_fault_of_a_rudder_is_told(rudder: dict[str, object], words: str) -> None:
    assert described(rudder=rudder) == words


def test_a_fault_of_the_battery_is_told() -> None:
    words = described(battery={"added_resistance_ohm": 0.05, "failed_cells": 2, "voltage_drop_v": 1.5})
    assert words == "battery: 0.05 ohm more resistance, 2 cells failed, 1.5 V less"
