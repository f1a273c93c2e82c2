"""Quantities by PX4's topics: units, frames and the topics that they are read from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from scipy.spatial.transform import Rotation

from xitl_cli.logs.signals import px4

SECOND = 1_000_000_000


def ulog(*tables: MadeTable, facts: dict[str, str] | None = None, kind: Any = "ulog") -> MadeLog:
    log = MadeLog(*tables, kind=kind)
    log.facts = facts or {}
    return log


def table(name: str, **columns: Any) -> MadeTable:
    rows = max(len(value) for value in columns.values())
    return MadeTable(name, SECOND * np.arange(rows), columns)


@pytest.mark.parametrize("of", ["estimate", "truth"])
def test_angles_are_those_of_the_quaternion(of: Any) -> None:
    """Checked against SciPy. PX4 writes w first."""
    wanted_deg = np.array([[170.0, -20.0, 5.0], [-10.0, 30.0, 60.0], [5.0, 10.0, -60.0]])  # yaw, pitch, roll
    xyzw = Rotation.from_euler("ZYX", wanted_deg, degrees=True).as_quat()
    name = "vehicle_attitude" + ("_groundtruth" if of == "truth" else "")
    log = ulog(table(name, q=np.roll(xyzw, 1, axis=1)))
    for angle, expected in (("yaw", [170.0, 350.0, 5.0]), ("pitch", [-20.0, 30.0, 10.0]), ("roll", [5.0, 60.0, -60.0])):
        series = px4.angle(log, angle, of)
        assert series is not None
        assert series.values == pytest.approx(expected)
        assert (series.unit, series.source, series.turns) == ("deg", f"{name}.q", angle == "yaw")
    assert px4.angle(log, "yaw", "estimate" if of == "truth" else "truth") is None
    assert px4.angle(ulog(table(name, q=[[1.0, 0.0, 0.0]])), "yaw", of) is None
    assert px4.angle(ulog(table(name, q=[1.0])), "yaw", of) is None
    assert px4.angle(ulog(table(name, q=[[1.0, 0.0, 0.0, 0.0]]), kind="mcap"), "yaw", of) is None


def test_speed_is_that_of_valid_rows() -> None:
    columns = {"vx": [3.0, 6.0, 5.0], "vy": [-4.0, 8.0, 12.0], "v_xy_valid": [1, 0, 1]}
    log = ulog(table("vehicle_local_position", **columns), table("vehicle_local_position_groundtruth", **columns))
    series, truth = px4.ground_speed(log), px4.ground_speed(log, "truth")
    assert series is not None
    assert truth is not None
    assert (series.values.tolist(), series.stamp_ns.tolist()) == ([5.0, 13.0], [0, 2 * SECOND])
    assert (series.unit, series.source) == ("m/s", "vehicle_local_position.vx, vy")
    assert truth.values.tolist() == [5.0, 10.0, 13.0]
    assert px4.ground_speed(ulog(table("vehicle_local_position", vx=[1.0]))) is None


def test_the_yaw_rate_is_about_the_third_axis() -> None:
    series = px4.yaw_rate(ulog(table("vehicle_angular_velocity", xyz=np.radians([[1.0, 2.0, 3.0], [4.0, 5.0, -6.0]]))))
    assert series is not None
    assert series.values == pytest.approx([3.0, -6.0])
    assert (series.unit, series.source) == ("deg/s", "vehicle_angular_velocity.xyz[2]")
    assert px4.yaw_rate(ulog(table("vehicle_angular_velocity", xyz=[1.0, 2.0]))) is None


def test_the_place_is_that_of_the_estimate_or_of_a_receiver() -> None:
    nowhere = table("vehicle_global_position", lat=[np.nan, 47.0], lon=[8.0, np.nan], alt=[1.0, 1.0])
    new = table("sensor_gps", latitude_deg=[1.0], longitude_deg=[2.0], altitude_msl_m=[3.0], lat=[4.0])
    old = table("vehicle_gps_position", lat=[5.0], lon=[6.0], alt=[7.0])
    estimate = table("vehicle_global_position", lat=[8.0, np.nan], lon=[9.0, 9.0], alt=[10.0, 10.0])
    truth = table("vehicle_global_position_groundtruth", lat=[11.0], lon=[12.0], alt=[13.0])

    def place(*tables: MadeTable, of: Any = "estimate") -> Any:
        found = px4.geodetic(ulog(*tables), of)
        return None if found is None else (found[1][0].tolist(), found[2])

    assert place(nowhere, new, old, truth) == ([5.0, 6.0, 7.0], "vehicle_gps_position")
    assert place(nowhere, new, truth) == ([1.0, 2.0, 3.0], "sensor_gps")
    assert place(estimate, new, old) == ([8.0, 9.0, 10.0], "vehicle_global_position")
    assert place(truth, old, of="truth") == ([11.0, 12.0, 13.0], "vehicle_global_position_groundtruth")
    assert place(nowhere, of="truth") is None
    assert place(nowhere) is None


def test_arming_and_states() -> None:
    log = ulog(table("vehicle_status", arming_state=[1, 2, 2, 3], nav_state=[4, 3, 3, 17]))
    armed, states = px4.arm_states(log), px4.nav_states(log)
    assert armed is not None
    assert states is not None
    assert (armed[1].tolist(), armed[2]) == ([False, True, True, False], "vehicle_status.arming_state")
    assert [px4.NAV_STATES[state] for state in states[1].tolist()] == ["Hold", "Mission", "Mission", "Takeoff"]
    assert (px4.NAV_STATES[23], px4.NAV_STATES[30], 31 in px4.NAV_STATES) == ("External 1", "External 8", False)
    other = ulog(table("vehicle_status", other=[1]))
    assert (px4.arm_states(other), px4.nav_states(other)) == (None, None)


@pytest.mark.parametrize(
    ("columns", "kind"),
    [
        ({"vehicle_type": [3, 1]}, "copter"),
        ({"vehicle_type": [1, 2]}, "plane"),
        ({"vehicle_type": [1, 3], "system_type": [2, 2]}, "rover"),
        ({"vehicle_type": [1, 0], "system_type": [2, 11]}, "rover"),  # MAV_TYPE_SURFACE_BOAT
        ({"system_type": [11, 2]}, "copter"),  # MAV_TYPE_QUADROTOR
        ({"other": [1]}, "unknown"),
    ],
)
def test_the_kind_of_vehicle(columns: dict[str, Any], kind: str) -> None:
    assert px4.vehicle_kind(ulog(table("vehicle_status", **columns))) == kind


def test_the_release_is_packed_in_a_number() -> None:
    facts = {"ver_sw_release": str(0x010E03FF), "ver_sw": "0123456789abcdef", "ver_hw": "PX4_SITL"}
    assert px4.release(ulog(facts=facts)) == ("1.14.3", "01234567", "PX4_SITL")
    assert px4.release(ulog(facts={"ver_sw_release": "x", "ver_sw": ""})) == (None, None, None)
    assert px4.release(ulog(facts=facts, kind="mcap")) == (None, None, None)


def test_outputs_in_use() -> None:
    values = np.array([[1500, 0, 1100, 900], [1600, 0, 1200, 900]])
    counted = px4.outputs(ulog(table("actuator_outputs", output=values, noutputs=[2, 3])))
    assert {channel: series.values.tolist() for channel, series in counted.items()} == {
        1: [1500.0, 1600.0], 3: [1100.0, 1200.0],
    }  # fmt: skip
    assert (counted[3].unit, counted[3].source) == ("us", "actuator_outputs.output[2]")
    assert list(px4.outputs(ulog(table("actuator_outputs", output=values)))) == [1, 3, 4]
    assert list(px4.outputs(ulog(table("actuator_outputs", output=values, noutputs=[9, 9])))) == [1, 3, 4]
    assert px4.outputs(ulog(table("actuator_outputs", output=values[:, 0]))) == {}


def test_utc_is_that_of_rows_with_a_fix() -> None:
    gps = {"time_utc_usec": [5, 1_790_000_000_000_000, 1 << 60], "fix_type": [2, 3, 4]}
    found = px4.utc(ulog(table("sensor_gps", **gps)))
    assert found is not None
    assert found[0].tolist() == [SECOND, 2 * SECOND]
    assert found[1].tolist() == [1_790_000_000_000_000_000, (1 << 52) * 1000]
    assert px4.utc(ulog(table("sensor_gps", time_utc_usec=[5], fix_type=[2]))) is None
    both = ulog(table("sensor_gps", **gps), table("vehicle_gps_position", time_utc_usec=[7], fix_type=[3]))
    found = px4.utc(both)
    assert found is not None
    assert found[1].tolist() == [7000]
