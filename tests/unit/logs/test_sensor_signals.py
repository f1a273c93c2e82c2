"""Sensors of every kind of log: units and layouts, jumps of a sensor's clock, and the limits of rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.signals.sensors import (
    STANDARD_GRAVITY_MPS2,
    InertialUnit,
    RestPeriods,
    find_rest,
    inertial_units,
    injected_series,
    injected_units,
    sample_times,
    sensor_series,
)

SECOND = 1_000_000_000
NAN = np.nan
G = STANDARD_GRAVITY_MPS2


def table(
    name: str, instance: str | None = None, rows: int = 3, units: dict[str, str] | None = None, **columns: Any
) -> MadeTable:
    every = {
        key: np.broadcast_to(value, rows) if np.ndim(value) < 2 else np.asarray(value) for key, value in columns.items()
    }
    return MadeTable(name, SECOND * np.arange(rows), every, instance=instance, units=units or {})


def unit_of(*tables: MadeTable, kind: Any = "dataflash") -> InertialUnit:
    (unit,) = inertial_units(MadeLog(*tables, kind=kind))
    return unit


def test_an_inertial_unit_of_ardupilot() -> None:
    unit = unit_of(
        table(
            "IMU", GyrX=[1.0, NAN, 3.0], GyrY=4.0, GyrZ=5.0, AccX=6.0, AccY=7.0, AccZ=[8.0, 9.0, np.inf],
            T=[20.0, 21.0, 22.0],
            GH=[1, 1, 0], AH=[1, 0, 1], GHz=[0, 400, 402], AHz=[NAN, 0, 0], SampleUS=[0, 1_000_001, 2_000_003],
        )
    )  # fmt: skip
    assert (unit.name, unit.gyro_fields, unit.accel_fields) == (
        "IMU",
        ("GyrX", "GyrY", "GyrZ"),
        ("AccX", "AccY", "AccZ"),
    )
    np.testing.assert_array_equal(unit.gyro_radps, [[1, 4, 5], [NAN, 4, 5], [3, 4, 5]])
    np.testing.assert_array_equal(unit.accel_mps2, [[6, 7, 8], [6, 7, 9], [6, 7, NAN]])
    np.testing.assert_array_equal(unit.temperature_degc, [20.0, 21.0, 22.0])
    assert unit.healthy is not None
    assert unit.healthy.tolist() == [True, False, False]
    assert (unit.gyro_rate_hz, unit.accel_rate_hz) == (401.0, None)
    assert unit.sample_ns.tolist() == [0, 1_000_001_000, 2_000_003_000]


def mavlink(name: str, unit: str = "") -> MadeTable:
    columns = {f"{axis}{sort}": 1000.0 for sort in ("gyro", "acc") for axis in "xyz"}
    return table(
        name, units=dict.fromkeys(columns, unit) if unit else None, temperature=[0, 2500, 2600], **columns
    )  # fmt: skip


@pytest.mark.parametrize("name", ["SCALED_IMU", "SCALED_IMU2", "RAW_IMU", "/link/agent/rx:SCALED_IMU3"])
def test_integers_of_mavlink_are_in_thousandths(name: str) -> None:
    unit = unit_of(mavlink(name), kind="tlog")
    np.testing.assert_allclose(unit.gyro_radps, np.ones((3, 3)))
    np.testing.assert_allclose(unit.accel_mps2, np.full((3, 3), G))
    np.testing.assert_array_equal(unit.temperature_degc, [NAN, 2500, 2600])  # 0 is unknown


def test_values_with_a_stated_unit_are_not_scaled() -> None:
    np.testing.assert_array_equal(unit_of(mavlink("SCALED_IMU", "rad/s")).gyro_radps, np.full((3, 3), 1000.0))
    np.testing.assert_array_equal(unit_of(mavlink("SCALED_IMU", "m/s²")).gyro_radps, np.full((3, 3), 1000.0))
    np.testing.assert_allclose(unit_of(mavlink("SCALED_IMU", "mrad/s")).gyro_radps, np.ones((3, 3)))
    np.testing.assert_array_equal(unit_of(mavlink("HIGHRES_IMU")).gyro_radps, np.full((3, 3), 1000.0))


def test_vectors_and_single_sensors() -> None:
    ros = {f"{sort}.{axis}": 2.0 for sort in ("angular_velocity", "linear_acceleration") for axis in "xyz"}
    np.testing.assert_array_equal(unit_of(table("/imu", **ros), kind="mcap").accel_mps2, np.full((3, 3), 2.0))
    px4 = unit_of(
        table("sensor_combined", gyro_rad=np.ones((3, 3)), accelerometer_m_s2=np.full((3, 3), 2.0)), kind="ulog"
    )
    assert (px4.gyro_fields, px4.accel_fields) == (("gyro_rad",), ("accelerometer_m_s2",))
    np.testing.assert_array_equal(px4.accel_mps2, np.full((3, 3), 2.0))
    gyro = unit_of(table("GYR", GyrX=1.0, GyrY=2.0, GyrZ=3.0))
    assert (gyro.accel_mps2, gyro.accel_fields) == (None, ())
    accel = unit_of(table("ACC1", AccX=1.0, AccY=2.0, AccZ=3.0))
    assert (accel.gyro_radps, accel.gyro_fields) == (None, ())
    np.testing.assert_array_equal(accel.accel_mps2, [[1, 2, 3]] * 3)
    assert inertial_units(MadeLog(table("XXX", GyrX=1.0, GyrY=2.0, GyrZ=3.0))) == []


def test_a_unit_has_three_rows_and_a_value() -> None:
    zero = dict.fromkeys(("GX", "GY", "GZ", "AX", "AY", "AZ"), 0.0)
    assert inertial_units(MadeLog(table("A", **zero))) == []
    assert inertial_units(MadeLog(table("A", rows=2, **{**zero, "AZ": G}))) == []
    assert len(inertial_units(MadeLog(table("A", **{**zero, "AZ": [0.0, NAN, G]})))) == 1
    assert inertial_units(MadeLog(table("SIMSTATE", **{**zero, "AZ": G}))) == []
    flat = table("B", gyro=np.ones((3, 2)), accel=np.ones((3, 2)))
    assert inertial_units(MadeLog(flat)) == []


def test_each_instance_is_a_unit() -> None:
    both = table("IMU", "I", 6, I=[0, 1] * 3, GyrX=0.0, GyrY=0.0, GyrZ=0.0, AccX=0.0, AccY=0.0, AccZ=[1, 2] * 3)
    first, second = inertial_units(MadeLog(both))
    assert (first.name, second.name) == ("IMU[0]", "IMU[1]")
    assert second.accel_mps2 is not None
    assert second.accel_mps2[:, 2].tolist() == [2, 2, 2]


@pytest.mark.parametrize(
    ("columns", "clock"),
    [
        ({"SampleUS": [1, 2, 3]}, [1000, 2000, 3000]),
        ({"time_usec": [1, 2, 3], "time_boot_ms": [7, 8, 9]}, [1000, 2000, 3000]),
        ({"time_boot_ms": [1, 2, 3]}, [1_000_000, 2_000_000, 3_000_000]),
        ({"SampleUS": [0, 0, 0]}, [0, 10, 20]),  # never set
        ({"SampleUS": [[1], [2], [3]]}, [0, 10, 20]),
        ({"SampleUS": ["a", "b", "c"]}, [0, 10, 20]),
    ],
)
def test_samples_have_the_times_of_their_own_clock(columns: dict[str, Any], clock: list[int]) -> None:
    times = sample_times(MadeTable("X", [0, 10, 20], columns))
    assert (times.clock_ns.tolist(), times.jumps) == (clock, ())


def test_a_jump_of_a_clock_is_removed_and_reported() -> None:
    at_ms = np.arange(0, 8000, 1000)
    clock_ms = at_ms + np.array([0, 0, 700, 700, 5000, 5000, 4400, 4400])
    times = sample_times(MadeTable("X", at_ms * 1_000_000, {"time_boot_ms": clock_ms}))
    # A jump of 0.7 s is less than half of its step of 1.7 s, a step of 1 s at most.
    assert times.jumps == ((4 * SECOND, pytest.approx(4.3)), (6 * SECOND, pytest.approx(-0.6)))
    expected_ms = at_ms + np.array([0, 0, 700, 700, 700, 700, 700, 700])
    assert times.clock_ns.tolist() == (expected_ms * 1_000_000).tolist()


@pytest.mark.parametrize(("apart_ms", "jumps"), [(500, 0), (501, 1)])
def test_a_jump_is_more_than_half_a_second(apart_ms: int, jumps: int) -> None:
    at_ms = np.arange(0, 800, 100)
    times = sample_times(
        MadeTable("X", at_ms * 1_000_000, {"time_boot_ms": at_ms + np.where(at_ms >= 400, apart_ms, 0)})
    )
    assert len(times.jumps) == jumps


def test_a_gap_of_both_clocks_and_stamps_that_go_back_are_no_jump() -> None:
    at_ms = np.array([0, 100, 5000, 5100, 4000, 4100])
    times = sample_times(MadeTable("X", at_ms * 1_000_000, {"time_boot_ms": [0, 100, 5000, 5100, 5200, 5300]}))
    assert times.jumps == ()
    assert times.clock_ns.tolist() == [0, 100_000_000, 5 * SECOND, 5_100_000_000, 5_200_000_000, 5_300_000_000]


# Rest


def resting(seconds: int = 20, **change: Any) -> MadeTable:
    """20 Hz at rest; `change` is (from_s, until_s, value added) for a column."""
    time_s = np.arange(seconds * 20) / 20.0
    columns = {name: np.zeros(len(time_s)) for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY")}
    columns["AccZ"] = np.full(len(time_s), -G)
    for name, (from_s, until_s, added) in change.items():
        inside = (time_s >= from_s) & (time_s < until_s)
        columns[name] = columns[name] + np.where(inside, added(time_s) if callable(added) else added, 0.0)
    return MadeTable("IMU", np.round(time_s * SECOND).astype(np.int64), columns)


def alternating(size: float) -> Any:
    return lambda time_s: np.where(np.round(time_s * 20) % 2 == 0, size, -size)


def rest_of(*tables: MadeTable) -> RestPeriods:
    log = MadeLog(*tables)
    return find_rest(log, inertial_units(log))


def spans_s(rest: RestPeriods) -> list[tuple[float, float]]:
    """Relative to the median stamp, from which windows are counted."""
    return [((begin - 9_975_000_000) / SECOND, (end - 9_975_000_000) / SECOND) for begin, end in rest.stretches]


def test_a_vessel_on_land_is_at_rest() -> None:
    rest = rest_of(resting())
    assert (rest.source, rest.by_speed) == ("IMU", False)
    assert spans_s(rest) == [(-10.0, 10.0)]
    assert rest.longest_s == 20.0
    begin, end = rest.stretches[0]
    assert rest.rows(np.array([begin - 1, begin, end - 1, end])).tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("name", "size", "calm"),
    [("GyrY", 0.0099, True), ("GyrY", 0.0101, False), ("AccX", 0.299, True), ("AccX", 0.301, False)],
)
def test_what_scatters_is_not_at_rest(name: str, size: float, calm: bool) -> None:
    rest = rest_of(resting(**{name: (11.975, 13.975, alternating(size))}))
    assert spans_s(rest) == ([(-10.0, 10.0)] if calm else [(-10.0, 2.0), (4.0, 10.0)])


@pytest.mark.parametrize(
    ("name", "size", "calm"),
    [("GyrZ", 0.0029, True), ("GyrZ", 0.0031, False), ("AccY", 0.099, True), ("AccY", 0.101, False)],
)
def test_a_mean_that_moves_ends_the_rest(name: str, size: float, calm: bool) -> None:
    rest = rest_of(resting(**{name: (14.975, 20.0, size)}))
    assert spans_s(rest) == ([(-10.0, 10.0)] if calm else [(-10.0, 5.0)])


def test_rest_does_not_depend_on_the_forces_of_the_rest_of_the_log() -> None:
    """Ten seconds of 20 m/s^2 more, and of a turn: the mean of the log is far from that of the rest."""
    moved = {"AccX": (9.975, 20.0, alternating(20.0)), "AccZ": (9.975, 20.0, 20.0), "GyrZ": (9.975, 20.0, 5.0)}
    assert spans_s(rest_of(resting(**moved))) == [(-10.0, 0.0)]


@pytest.mark.parametrize(("speed_mps", "calm"), [(0.1, True), (0.11, False)])
def test_a_vessel_that_moves_evenly_is_not_at_rest(speed_mps: float, calm: bool) -> None:
    stamps = SECOND * np.arange(21)
    speed = np.where((np.arange(21) >= 15) & (np.arange(21) <= 16), speed_mps, 0.0)
    rest = rest_of(resting(), MadeTable("GPS", stamps, {"Spd": speed}))
    assert rest.by_speed
    assert len(rest.stretches) == (1 if calm else 2)


def test_the_unit_with_most_rows_shows_the_rest() -> None:
    other = MadeTable(
        "IMU2", [0, 1, 2], {name: [1.0, 2.0, 3.0] for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")}
    )
    assert rest_of(resting(), other).source == "IMU"
    assert rest_of(table("GYR", GyrX=1.0, GyrY=0.0, GyrZ=0.0)) == RestPeriods((), None, False)
    assert RestPeriods((), None, False).longest_s == 0.0
    nothing = table("IMU", GyrX=[NAN, NAN, 1e7], GyrY=0.0, GyrZ=0.0, AccX=0.0, AccY=0.0, AccZ=G)
    assert rest_of(nothing) == RestPeriods((), "IMU", False)


# Other sensors


def test_magnetometers_and_barometers_have_one_unit_each() -> None:
    found = sensor_series(
        MadeLog(
            table("MAG", "I", 6, I=[0, 1] * 3, MagX=1, MagY=2, MagZ=3, Health=[1, 0] * 3),
            table("XITL_MAGNETOMETER", field=np.tile([0.1, 0.2, 0.3], (3, 1))),
            table("BARO", Press=101_000.0, H=1, Temp=30.0),
            table("sensor_mag", x=0.1, y=0.2, z=0.3),
            table("RFND", Dist1=4.0, units={"Dist1": "cm"}),
            table("ARSP", DiffPress=7.0, Airspeed=3.0, units={"DiffPress": "Pa"}),
            table("WIND", SpdApp=1.0, DrApp=2.0),
            table("DPTH", Depth=0.0),
        )
    )
    assert [(one.name, one.sort, one.unit, one.calibrated) for one in found] == [
        ("MAG[0]", "magnetometer", "mGauss", True), ("MAG[1]", "magnetometer", "mGauss", True),
        ("XITL_MAGNETOMETER", "magnetometer", "mGauss", True), ("BARO", "barometer", "Pa", True),
        ("sensor_mag", "magnetometer", "mGauss", False), ("RFND", "rangefinder", "m", True),
        ("ARSP", "airspeed", "Pa", True), ("WIND", "wind", "", True),
    ]  # fmt: skip
    first, second, own, baro, px4, _, airspeed, wind = found
    assert first.values.tolist() == [[1, 2, 3]] * 3
    assert first.healthy is not None
    assert second.healthy is not None
    assert (first.healthy.tolist(), second.healthy.tolist()) == ([True] * 3, [False] * 3)
    np.testing.assert_allclose(own.values, [[100, 200, 300]] * 3)
    np.testing.assert_allclose(px4.values, [[100, 200, 300]] * 3)
    assert (baro.values.tolist(), baro.fields) == ([[101_000.0]] * 3, ("Press",))
    np.testing.assert_array_equal(baro.temperature_degc, [30.0] * 3)
    assert (airspeed.fields, wind.fields) == (("DiffPress",), ("SpdApp", "DrApp"))
    assert own.healthy is None


def test_what_a_run_sent_to_its_autopilot() -> None:
    link = table("/link/agent/tx", frame=1)
    imu = table("/link/agent/tx:XITL_IMU", gyro=np.ones((3, 3)), accel=np.full((3, 3), 2.0))
    mag = table("/link/agent/tx:XITL_MAGNETOMETER", field=np.tile([0.1, 0.2, 0.3], (3, 1)))
    baro = table("/link/agent/tx:XITL_BAROMETER", pressure=101_000.0, temperature=21.0)
    log = MadeLog(link, imu, mag, baro, kind="mcap")
    assert [unit.name for unit in injected_units(log)] == ["XITL_IMU"]
    assert [(one.name, one.message) for one in injected_series(log)] == [
        ("XITL_MAGNETOMETER", "/link/agent/tx:XITL_MAGNETOMETER"), ("XITL_BAROMETER", "/link/agent/tx:XITL_BAROMETER"),
    ]  # fmt: skip
    assert injected_units(MadeLog(imu, kind="mcap")) == []
    few = table("/link/agent/tx:XITL_IMU", rows=2, gyro=np.ones((2, 3)), accel=np.full((2, 3), 2.0))
    assert injected_units(MadeLog(link, few, kind="mcap")) == []
