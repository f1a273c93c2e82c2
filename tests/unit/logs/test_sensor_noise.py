"""Noise at rest and agreement of sensors: tables and sentences from noise of a known size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Section, Severity
from xitl_cli.logs.signals.sensors import RestPeriods, find_rest, inertial_units, sensor_series
from xitl_cli.plugins.logs.analyses.sensor_quality import agreement_section, noise_section

S = 1_000_000_000
G = 9.80665
GYRO_RADPS, ACCEL_MPS2 = 2e-3, 2e-2


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def resting(seconds: float, rate_hz: float = 50.0, keep: Any = None, **more: Any) -> MadeTable:
    rng = np.random.default_rng(3)
    at_s = np.arange(0.0, seconds, 1.0 / rate_hz)
    columns = {f"Gyr{axis}": GYRO_RADPS * rng.normal(size=len(at_s)) for axis in "XYZ"}
    columns |= {f"Acc{axis}": ACCEL_MPS2 * rng.normal(size=len(at_s)) - (G if axis == "Z" else 0.0) for axis in "XYZ"}
    rows = np.ones(len(at_s), dtype=bool) if keep is None else keep(at_s)
    columns |= {name: np.full(len(at_s), value) for name, value in more.items()}
    return MadeTable("IMU", ns(at_s)[rows], {name: values[rows] for name, values in columns.items()})


def noise_of(
    *tables: MadeTable, parameters: Any = None, simulated: bool = False, still: RestPeriods | None = None
) -> Section:
    log = MadeLog(*tables)
    units = inertial_units(log)
    rest = find_rest(log, units) if still is None else still
    return noise_section(units, sensor_series(log), rest, parameters or {}, simulated, LogClock(log))


def test_the_noise_density_of_white_noise() -> None:
    section = noise_of(resting(100.0))
    scatter, allan = section.grids
    rows = {row[1]: dict(zip(allan.columns[2:4], row[2:4], strict=True)) for row in allan.rows}
    assert list(rows) == ["gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z"]
    # A density of sigma sqrt(dt): 2e-3 / sqrt(50)
    for name, row in rows.items():
        sigma = GYRO_RADPS if name.startswith("gyro") else ACCEL_MPS2
        assert row["noise density /√Hz"] == pytest.approx(sigma / np.sqrt(50.0), rel=0.05)
    assert scatter.rows == (
        ("IMU gyro", pytest.approx(GYRO_RADPS, rel=0.02), "rad/s"),
        ("IMU accel", pytest.approx(ACCEL_MPS2, rel=0.02), "m/s²"),
    )
    assert [(plot.key, len(plot.traces)) for plot in section.plots] == [("allan_gyro", 3), ("allan_accel", 3)]
    (finding,) = section.findings
    assert finding.severity is Severity.OK
    assert finding.sentence == (
        "At rest from 0:00.0 for 100 s: Allan deviations up to τ = 11 s; no speed is logged, so slow drifting "
        "would not be visible"
    )


def test_simulated_sensors_and_a_speed_are_in_the_sentence() -> None:
    speed = MadeTable("GPS", ns(range(101)), {"Spd": np.zeros(101)})
    (finding,) = noise_of(resting(100.0), speed, simulated=True).findings
    assert finding.sentence.endswith("up to τ = 11 s; the sensors are simulated: this is their model's noise")


@pytest.mark.parametrize(("seconds", "lack"), [(61.0, ""), (58.0, "the longest stretch at rest is 58 s")])
def test_an_allan_deviation_takes_a_minute(seconds: float, lack: str) -> None:
    section = noise_of(resting(seconds))
    assert bool(section.findings) is not bool(lack)
    assert not lack or lack in section.lacks[0]


def test_a_unit_that_never_lay_still() -> None:
    section = noise_of(resting(100.0), still=RestPeriods((), "IMU", False))
    assert "it never lay still" in section.lacks[0]
    assert section.grids == ()


@pytest.mark.parametrize(("rate_hz", "lack"), [(10.5, ""), (9.5, "9.5 Hz do not show its noise")])
def test_a_slow_unit_does_not_show_its_noise(rate_hz: float, lack: str) -> None:
    section = noise_of(resting(100.0, rate_hz), still=RestPeriods(((0, 100 * S),), "IMU", True))
    assert bool(section.findings) is not bool(lack)
    assert not lack or lack in section.lacks[0]


def test_gaps_leave_the_longest_part() -> None:
    rest = RestPeriods(((0, 130 * S),), "IMU", True)
    kept = noise_of(resting(130.0, keep=lambda at_s: (at_s < 62.0) | (at_s > 62.5)), still=rest)
    assert kept.lacks == ()
    short = noise_of(resting(110.0, keep=lambda at_s: (at_s < 55.0) | (at_s > 55.5)), still=rest)
    assert short.lacks == ("No Allan deviation of IMU: gaps leave 55 s of the longest stretch at rest.",)


@pytest.mark.parametrize(("sampled_hz", "told"), [(61.0, True), (59.0, False)])
def test_a_unit_that_samples_faster_than_it_logs(sampled_hz: float, told: bool) -> None:
    section = noise_of(resting(100.0, GHz=sampled_hz), parameters={"INS_GYRO_FILTER": 4.0, "INS_ACCEL_FILTER": 10.0})
    assert bool(section.lacks) is told
    if told:
        assert section.lacks[0].startswith(
            "IMU is logged at 50 Hz of the 61 Hz it samples after its filters (INS_GYRO_FILTER 4 Hz, INS_ACCEL_FILTER "
            "10 Hz): noise"
        )


def test_scatter_needs_five_seconds() -> None:
    assert len(noise_of(resting(100.0), still=RestPeriods(((0, 5 * S),), "IMU", False)).grids) == 1
    assert noise_of(resting(100.0), still=RestPeriods(((0, 5 * S - 1),), "IMU", False)).grids == ()


# Agreement


def agreed(*tables: MadeTable, two_worlds: bool = False) -> Section:
    log = MadeLog(*tables)
    return agreement_section(inertial_units(log), sensor_series(log), two_worlds, LogClock(log))


def imu(name: str, gyro_x: float = 0.0, accel_z: float = -G, from_s: float = 20.0) -> MadeTable:
    at_s = np.arange(0.0, 40.0, 0.1)
    late = at_s >= from_s
    columns = {axis: np.zeros(400) for axis in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY")}
    columns["GyrX"] = np.where(late, gyro_x, 0.0)
    columns["AccZ"] = np.where(late, accel_z, -G)
    return MadeTable(name, ns(at_s), columns)


def test_units_that_disagree_in_full() -> None:
    section = agreed(imu("IMU"), imu("IMU2", gyro_x=0.1, accel_z=-G - 2.0))
    gyro, accel = section.findings
    assert gyro.sentence == (
        "The gyroscopes of IMU and IMU2 differ by 0.1 rad/s over ten seconds from 0:20.0; ArduPilot allows 0.0873 "
        "rad/s before arming"
    )
    assert gyro.evidence == (Evidence("IMU", "GyrX", 20 * S, 30 * S),)
    assert accel.sentence.startswith("The accelerometers of IMU and IMU2 differ by 1 m/s² over ten seconds from 0:20.0")
    assert section.grids[0].rows == (
        ("IMU, IMU2", "gyroscopes", 0.05, 0.1, "rad/s"), ("IMU, IMU2", "accelerometers", 0.5, 1.0, "m/s²"),
    )  # fmt: skip


def test_one_bad_unit_of_three_is_one_finding() -> None:
    (finding,) = agreed(imu("IMU"), imu("IMU2"), imu("IMU3", gyro_x=0.1)).findings
    assert finding.sentence.endswith("before arming (1 more pair does so, too)")
    assert len(finding.evidence) == 2


def test_units_of_two_worlds_are_one_notice() -> None:
    (finding,) = agreed(imu("IMU"), imu("IMU2", gyro_x=0.1), two_worlds=True).findings
    assert (finding.key, finding.severity, len(finding.evidence)) == ("sensors.two_worlds", Severity.NOTICE, 1)
    assert agreed(imu("IMU"), imu("IMU2"), two_worlds=True).findings == ()


def test_units_of_other_families_are_not_compared() -> None:
    assert agreed(imu("IMU"), imu("/link/a/rx:IMU2", gyro_x=0.1)).findings == ()
    assert agreed(imu("IMU"), imu("XYZ", gyro_x=0.1)).findings == ()
    assert agreed(imu("IMU"), imu("XYZ")).grids == ()
    assert len(agreed(imu("RAW_IMU"), imu("SCALED_IMU2")).grids) == 1


def baro(name: str, pressure_pa: Any) -> MadeTable:
    return MadeTable(name, ns(np.arange(400) * 0.1), {"Press": np.broadcast_to(pressure_pa, 400)})


@pytest.mark.parametrize(("drift_pa", "told"), [(60.0, False), (61.0, True)])
def test_barometers_that_move_apart(drift_pa: float, told: bool) -> None:
    later = 101_300.0 + np.where(np.arange(400) >= 300, drift_pa, 0.0)
    section = agreed(baro("BARO", 101_000.0), baro("BAR2", later))
    assert len(section.findings) == told
    for finding in section.findings:
        assert finding.sentence == ("BARO and BAR2 move apart by 61 Pa, as much as 5.1 m of height, at 0:30.0")
    assert section.grids[0].rows == (("BARO, BAR2", "barometers", 300.0, 300.0 + drift_pa, "Pa"),)


def mag(name: str, x: Any, y: Any = 0.0) -> MadeTable:
    columns = {"MagX": x, "MagY": y, "MagZ": 0.0}
    return MadeTable(
        name, ns(np.arange(400) * 0.1), {key: np.broadcast_to(value, 400) for key, value in columns.items()}
    )


def test_compasses_that_disagree_in_full() -> None:
    later = np.where(np.arange(400) >= 200, 150.0, 0.0)
    section = agreed(mag("MAG", 200.0, 0.0), mag("MAG2", 200.0 - later, 2.0 * later))
    assert [one.key for one in section.findings][:1] == ["sensors.compasses_disagree"]
    # (150, -300) apart: 335; the second points to atan2(300, 50).
    assert section.findings[0].sentence == (
        "MAG and MAG2 differ by 335 mGauss and 81° in the plane of the vessel from 0:20.0; ArduPilot allows 200 mGauss "
        "and 60°"
    )
    assert section.grids[0].rows[0] == ("MAG, MAG2", "compasses", 167.7, 335.4, "mGauss")
    assert section.grids[0].rows[1] == ("MAG, MAG2", "compasses", 40.27, 80.54, "deg")
