"""Parts that find the error of a single sensor, against exact made series, and the sentences with their figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from scipy.spatial.transform import Rotation

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence
from xitl_cli.logs.signals.sensors import InertialUnit, SampleTimes, SensorSeries
from xitl_cli.plugins.logs.analyses.sensor_departures import (
    FieldError,
    SensorStep,
    _heading_error_deg,
    _of_field,
    _of_field_error,
    _of_gyro,
    _of_pressure,
    _throttle_text,
    field_steps,
    paired_steps,
    pressure_steps,
    rotations,
)

S = 1_000_000_000
MS = 1_000_000
END_NS = 90 * S
QUIET = MadeLog(MadeTable("ATT", [0, END_NS], {"Roll": [0.0, 0.0]}))
CLOCK = LogClock(QUIET)


def unit(rates: np.ndarray, stamp_ns: np.ndarray, fields: tuple[str, ...] = ("GyrX", "GyrY", "GyrZ")) -> InertialUnit:
    return InertialUnit(
        "IMU[0]", MadeTable("IMU", stamp_ns, {}), stamp_ns, SampleTimes(stamp_ns), rates, None, fields, (), None, None,
        None, None,
    )  # fmt: skip


def sensor(values: Any, sort: Any = "barometer", period_ns: int = 100 * MS) -> SensorSeries:
    values = np.atleast_2d(np.asarray(values, dtype=float).T).T
    stamp_ns = np.arange(len(values)) * period_ns
    name, field, measure = {"barometer": ("BARO", "Press", "Pa")}.get(sort, ("MAG", "MagX", "mGauss"))
    return SensorSeries(name, sort, name, (field,), measure, stamp_ns, SampleTimes(stamp_ns), values, None, None)


def test_rotations_are_products_of_the_turns_between_the_rows() -> None:
    """Against scipy; a step of more than a second counts as a second, and rows without a rate are left out."""
    rates = np.random.default_rng(4).normal(size=(37, 3))
    steps_ns = np.full(37, 50 * MS)
    steps_ns[0], steps_ns[20], steps_ns[30] = 0, 3 * S, 0
    stamp_ns = np.cumsum(steps_ns)
    holey = np.insert(rates, 5, [np.nan, 0.0, 0.0], axis=0)
    found = rotations(unit(holey, np.insert(stamp_ns, 5, stamp_ns[4] + 1)))
    assert found is not None
    np.testing.assert_array_equal(found.stamp_ns, stamp_ns)
    expected, turn = [], Rotation.identity()
    for rate, step_ns in zip(rates, steps_ns, strict=True):
        turn = turn * Rotation.from_rotvec(rate * min(step_ns * 1e-9, 1.0))
        expected.append(turn.as_matrix())
    np.testing.assert_allclose(found.matrices, expected, atol=1e-12)


def test_a_gyroscope_whose_stamps_go_back_or_are_few_gives_no_rotations() -> None:
    rates, stamp_ns = np.zeros((10, 3)), np.arange(10) * MS
    assert rotations(unit(rates, stamp_ns)) is not None
    assert rotations(unit(rates[:9], stamp_ns[:9])) is None
    stamp_ns[5] = 0
    assert rotations(unit(rates, stamp_ns)) is None


def test_a_step_ends_with_the_next_that_reverses_it() -> None:
    sizes = [np.array(size) for size in ([10.0, 0.0], [0.0, 5.0], [-7.0, 2.0], [0.0, -5.0], [-10.0, 0.0], [3.0, 0.0])]
    found = paired_steps([1, 2, 3, 4, 5, 6], sizes)
    # 10 and -7 leave 3.6 of 10, less than two fifths; what remains of the others is nothing.
    assert [(each.from_ns, each.until_ns) for each in found] == [(1, 3), (2, 4), (5, None), (6, None)]
    np.testing.assert_array_equal(found[0].size, sizes[0])
    exact = paired_steps([1, 2], [np.array([10.0]), np.array([-6.0])])
    assert [each.until_ns for each in exact] == [None, None]  # two fifths are left
    assert [each.until_ns for each in paired_steps([1, 2], [np.array([10.0]), np.array([-6.1])])] == [2]
    assert paired_steps([], []) == []


def test_steps_of_a_pressure_are_exact_without_noise() -> None:
    pressure = np.full(400, 101_300.0) + 2.0 * np.arange(400)  # a steady climb is no step
    pressure[100:250] += 60.0
    pressure[300:] -= 200.0
    found = pressure_steps(sensor(pressure), 36.0)
    assert [(each.from_ns, each.until_ns) for each in found] == [(10 * S, 25 * S), (30 * S, None)]
    assert [each.size.tolist() for each in found] == [pytest.approx([60.0]), pytest.approx([-200.0])]
    assert [each.from_ns for each in pressure_steps(sensor(pressure), 61.0)] == [30 * S]


@pytest.mark.parametrize(
    ("values", "period_ns", "many"),
    [
        (np.repeat([0.0, 60.0], 50), 100 * MS, 1),
        (np.interp(np.arange(100), [45, 55], [0.0, 60.0]), 100 * MS, 0),  # within a second, but in many rows
        (np.repeat([0.0, 60.0], 50), 0, 0),
        (np.r_[np.zeros(50), np.nan, np.full(50, 60.0)], 100 * MS, 0),
    ],
)
def test_what_is_a_step_of_a_pressure(values: np.ndarray, period_ns: int, many: int) -> None:
    trembling = values + 0.01 * np.arange(len(values)) % 3  # not held
    found = pressure_steps(sensor(trembling, period_ns=period_ns), 36.0)
    assert len(found) == many


def test_the_jump_at_the_end_of_a_held_value_is_no_step() -> None:
    noise = np.random.default_rng(1).normal(size=400)
    drifting = np.linspace(0.0, 400.0, 400) + noise
    drifting[100:200] = drifting[100]
    assert pressure_steps(sensor(drifting), 36.0) == []
    drifting[300:] += 200.0
    assert [each.from_ns for each in pressure_steps(sensor(drifting), 36.0)] == [30 * S]


def test_a_step_of_the_field_is_found_in_body_axes_while_the_vessel_turns() -> None:
    """It turns at 10° a second; the error turns with it, and is given in its axes."""
    stamp_ns = np.arange(3000) * 20 * MS
    turns = rotations(unit(np.broadcast_to([0.0, 0.0, np.radians(10.0)], (3000, 3)), stamp_ns))
    assert turns is not None
    at_s = np.arange(600) * 0.1
    north, east = 200.0 * np.cos(np.radians(10.0 * at_s)), -200.0 * np.sin(np.radians(10.0 * at_s))
    field = np.stack([north, east, np.full(600, -100.0)], axis=1)
    assert field_steps(turns, sensor(field, "magnetometer")) == []
    field[300:] += [0.0, 60.0, -20.0]
    (found,) = field_steps(turns, sensor(field, "magnetometer"))
    assert (found.from_ns, found.until_ns) == (30 * S, None)
    # within the window of 1.6 s the error itself turns by 16°
    np.testing.assert_allclose(found.size, [0.0, 60.0, -20.0], atol=2.0)
    assert field_steps(None, sensor(field, "magnetometer")) == []


def test_the_sentence_of_a_field_that_is_off() -> None:
    field = np.tile([120.0, -160.0, 400.0], (100, 1))  # 200 along the level
    field[50:] += [60.0, -80.0, 5.0]
    compass = sensor(field, "magnetometer")
    found = _of_field(QUIET, compass, SensorStep(5 * S, 8 * S, np.array([60.0, -80.0, 5.0])), CLOCK, END_NS)
    assert found.sentence == (
        "MAG: the field is off by 100 mGauss (x +60, y -80, z +5, body axes) from 0:05.0 to 0:08.0, which turns its "
        "heading by 30.0 degrees; no output is logged to compare it with"
    )
    assert found.evidence == (Evidence("MAG", "MagX", 5 * S, 8 * S, "100 mGauss"),)
    lasting = _of_field(QUIET, compass, SensorStep(5 * S, None, np.array([60.0, -80.0, 5.0])), CLOCK, END_NS)
    assert "from 0:05.0 to the end of the log" in lasting.sentence
    assert lasting.evidence[0].until_ns == END_NS


def test_the_largest_error_of_a_heading() -> None:
    compass = sensor(np.tile([120.0, -160.0, 400.0], (100, 1)), "magnetometer")

    def error(*size: float, from_ns: int = 5 * S) -> float:
        return _heading_error_deg(compass, SensorStep(from_ns, None, np.array(size)))

    assert error(100.0, 0.0, 0.0) == pytest.approx(30.0)
    assert error(0.0, -100.0, 900.0) == pytest.approx(30.0)  # the vertical part turns nothing
    assert error(0.0, 300.0, 0.0) == pytest.approx(90.0)
    assert error(100.0, 0.0, 0.0, from_ns=0) == pytest.approx(30.0)  # from the start on
    vertical = sensor(np.tile([0.0, 0.0, 400.0], (100, 1)), "magnetometer")
    assert _heading_error_deg(vertical, SensorStep(0, None, np.array([1.0, 0.0, 0.0]))) == 180.0


def test_a_field_that_follows_an_output() -> None:
    stamp_ns = np.arange(100) * 100 * MS
    command = np.repeat([0.0, 1.0, 0.3, 0.0, 0.8], 20)
    other = np.random.default_rng(2).normal(size=100)
    for mixed, follows in ((command, True), (other, False)):
        field = np.zeros((100, 3))
        field[:, 2] = 400.0 + 50.0 * mixed
        outputs = MadeTable("RCOU", stamp_ns, {"C1": 1500.0 + 400.0 * command, "C2": np.full(100, 1500.0)})
        text = _throttle_text(MadeLog(outputs), sensor(field, "magnetometer"))
        expected = abs(np.corrcoef(command, field[:, 2])[0, 1])
        assert text == (
            "the field follows an output (correlation 1.00): a motor current"
            if follows
            else f"it does not follow the outputs (correlation {expected:.2f})"
        )
    still = MadeTable("RCOU", stamp_ns, {"C2": np.full(100, 1500.0)})
    assert _throttle_text(MadeLog(still), sensor(np.ones((100, 3)))) == "no output is logged to compare it with"


def test_sentences_of_lasting_errors_of_a_field() -> None:
    compass = sensor(np.ones((101, 3)), "magnetometer")  # ten seconds
    none = np.zeros(2)
    found = _of_field_error(compass, FieldError(np.array([30.0, -40.0]), np.array([-6.0, 8.0]), np.array([0.0, 70.0])))
    assert [each.key for each in found] == ["sensors.field_drive", "sensors.field_ramp", "sensors.field_offset"]
    assert [each.sentence.partition("(")[2].partition(",")[0] for each in found] == ["x +0", "x -60", "x +30"]
    assert found[0].sentence.startswith(
        "MAG: the field is off by 70 mGauss (x +0, y +70, body axes) at full command of the motors"
    )
    assert found[1].sentence.startswith("MAG: the field is off by 100 mGauss (x -60, y +80, body axes) more at the end")
    assert found[2].evidence == (Evidence("MAG", "MagX", 0, 10 * S, "50 mGauss"),)
    assert _of_field_error(compass, FieldError(none, none, none)) == []


def test_sentences_of_a_pressure_and_a_gyroscope_that_are_off() -> None:
    pressure = _of_pressure(sensor(np.ones(10)), SensorStep(5 * S, None, np.array([60.0])), CLOCK, END_NS)
    assert pressure.sentence == (
        "BARO: the pressure is off by +60 Pa from 0:05.0 to the end of the log, as much as -5.0 m of height within "
        "a second"
    )
    assert pressure.evidence == (Evidence("BARO", "Press", 5 * S, END_NS, "+60 Pa"),)
    step = SensorStep(5 * S, 7 * S, np.radians([0.0, -2.5, 1.0]))
    stamp_ns = np.arange(10) * MS
    gyro = _of_gyro(unit(np.zeros((10, 3)), stamp_ns), step, CLOCK, END_NS)
    assert gyro.sentence == ("IMU[0]: the gyroscope is off by -2.50 deg/s on y from 0:05.0 to 0:07.0, by pitch")
    assert gyro.evidence == (Evidence("IMU", "GyrY", 5 * S, 7 * S, "-2.50 deg/s"),)
    packed = _of_gyro(unit(np.zeros((10, 3)), stamp_ns, ("gyro",)), step, CLOCK, END_NS)
    assert packed.evidence[0].field == "gyro[1]"
