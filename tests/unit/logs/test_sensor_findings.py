"""Sensors with troubles that were put there: each is reported, where it is, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from sim_core.kinematics import Kinematics
from sim_core.sensors.imu import Imu
from sim_core.sensors.spec import ImuSpec
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.sensors import analyse

S = 1_000_000_000
RATE_HZ = 50
GYRO_DENSITY, ACCEL_DENSITY = 4.9e-5, 6.9e-4


def stamps(seconds: float, rate_hz: float = RATE_HZ) -> np.ndarray:
    return (np.arange(int(seconds * rate_hz)) * (S / rate_hz)).astype(np.int64)


def imu_columns(seconds: float, seed: int = 0, rate_hz: float = RATE_HZ) -> dict[str, np.ndarray]:
    """At sea: noise, and a slow roll that is no rest."""
    random = np.random.default_rng(seed)
    at_s = stamps(seconds, rate_hz) * 1e-9
    columns = {name: 1e-3 * random.standard_normal(len(at_s)) for name in ("GyrX", "GyrY", "GyrZ")}
    columns |= {name: 1e-2 * random.standard_normal(len(at_s)) for name in ("AccX", "AccY", "AccZ")}
    columns["GyrX"] += 0.05 * np.sin(2.0 * np.pi * at_s / 4.0)
    columns["AccZ"] -= 9.81
    return columns


def imu(seconds: float = 60.0, **changed: Any) -> MadeTable:
    return MadeTable("IMU", stamps(seconds), imu_columns(seconds) | changed)


def report(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return section


def keys(section: Section) -> list[str]:
    return [finding.key for finding in section.findings]


def only(section: Section) -> Finding:
    assert len(section.findings) == 1, [finding.sentence for finding in section.findings]
    return section.findings[0]


def other_messages(seconds: float) -> MadeTable:
    """Goes on while a sensor is missing."""
    return MadeTable("ATT", stamps(seconds, 100.0), {"Roll": np.zeros(int(seconds * 100))})


def test_a_healthy_unit_has_no_finding():
    assert keys(report(imu())) == []


def test_a_gap_is_reported_where_it_is():
    table = imu()
    keep = np.ones(len(table), dtype=bool)
    keep[1000:1150] = False
    cut = MadeTable("IMU", table.stamp_ns[keep], {name: table.values(name)[keep] for name in table.columns})
    finding = only(report(cut, other_messages(60.0), rcou(60.0)))
    assert (finding.key, finding.severity) == ("sensors.gap", Severity.WARNING)
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (table.stamp_ns[999], table.stamp_ns[1150])
    assert "3.02 s" in finding.sentence


def rcou(seconds: float) -> MadeTable:
    return MadeTable("RCOU", stamps(seconds, 10.0), {"C1": np.zeros(int(seconds * 10))})


def test_a_pause_of_the_whole_log_is_no_fault_of_the_sensor():
    tables = []
    for table in (imu(), other_messages(60.0), rcou(60.0)):
        keep = (table.stamp_ns < 20 * S) | (table.stamp_ns > 24 * S)
        columns = {name: table.values(name)[keep] for name in table.columns}
        tables.append(MadeTable(table.name, table.stamp_ns[keep], columns))
    finding = only(report(*tables))
    assert finding.key == "sensors.recording_pauses"
    assert finding.evidence[0].at_ns == pytest.approx(20 * S, abs=0.02 * S)


def test_lost_samples_are_a_share():
    table = imu()
    keep = np.random.default_rng(1).random(len(table)) > 0.1
    cut = MadeTable("IMU", table.stamp_ns[keep], {name: table.values(name)[keep] for name in table.columns})
    finding = only(report(cut, other_messages(60.0), rcou(60.0)))
    assert (finding.key, finding.severity) == ("sensors.missing", Severity.WARNING)
    share = float(finding.sentence.split(":")[1].split("%")[0])
    assert share == pytest.approx(100.0 * float(1.0 - keep.mean()), abs=0.2)


def test_saturation_is_told_from_a_peak():
    at_s = stamps(60.0) * 1e-9
    swing = 40.0 * np.sin(2.0 * np.pi * at_s / 3.0)
    assert keys(report(imu(AccX=swing))) == []
    section = report(imu(AccX=np.clip(swing, -39.23, 39.23)))
    finding = only(section)
    assert (finding.key, finding.evidence[0].field) == ("sensors.saturated", "AccX")
    assert "39.23" in finding.sentence


def test_a_stuck_magnetometer_while_the_vehicle_turns():
    seconds = 60.0
    at_s = stamps(seconds) * 1e-9
    unit = imu(GyrZ=np.where((at_s > 30.0) & (at_s < 40.0), 0.1, 0.0) + 1e-3 * np.sin(50.0 * at_s))
    heading = np.cumsum(unit.values("GyrZ")) / RATE_HZ
    field = np.stack([300.0 * np.cos(heading), -300.0 * np.sin(heading), np.full(len(heading), 400.0)], axis=1)
    field = np.rint(field + np.random.default_rng(2).standard_normal(field.shape))
    assert keys(report(unit, mag(field))) == []
    stuck = field.copy()
    stuck[1500:2000] = field[1500]
    finding = only(report(unit, mag(stuck)))
    assert (finding.key, finding.severity) == ("sensors.stuck", Severity.WARNING)
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (30 * S, 1999 * S // RATE_HZ)
    # A field that does not change while nothing turns is as it should be.
    still = field.copy()
    still[100:600] = field[100]
    assert keys(report(unit, mag(still))) == []


def test_missing_samples_are_evidence_only_near_the_gaps():
    """Ten in a row of gaps at 20 s, and some at 50 s."""
    table = imu()
    keep = np.ones(len(table), dtype=bool)
    keep[1000:1040:2] = keep[2500:2560:2] = False
    cut = MadeTable("IMU", table.stamp_ns[keep], {name: table.values(name)[keep] for name in table.columns})
    finding = only(report(cut, other_messages(60.0), rcou(60.0)))
    assert finding.key == "sensors.missing"
    spans_s = [(each.at_ns / S, each.until_ns / S) for each in finding.evidence]
    assert spans_s == [pytest.approx((19.98, 20.78)), pytest.approx((49.98, 51.18))]


@pytest.mark.parametrize(
    ("method", "disarmed_s", "expected"), [(1, 58.0, []), (6, 58.0, ["sensors.stuck"]), (6, 30.0, [])]
)
def test_a_unit_that_stops_after_disarming_is_switched_off_unless_a_failsafe_disarmed(
    method: int, disarmed_s: float, expected: list[str]
):
    columns = imu_columns(60.0)
    for values in columns.values():
        values[2900:] = values[2900]
    moving = MadeTable("GPS", stamps(60.0, 5.0), {"Spd": np.full(300, 2.0)})
    arm = MadeTable("ARM", [5 * S, round(disarmed_s * S)], {"ArmState": [1, 0], "Method": [1, method]})
    assert keys(report(imu(**columns), arm, moving)) == expected
    armed_again = MadeTable("ARM", [5 * S, 30 * S, 40 * S], {"ArmState": [1, 0, 1], "Method": [1, method, 1]})
    assert keys(report(imu(**columns), armed_again, moving)) == ["sensors.stuck"]


@pytest.mark.parametrize(("speed_mps", "expected"), [(2.0, ["sensors.stuck"]), (0.0, [])])
def test_a_barometer_under_way_that_repeats_a_value_is_stuck(speed_mps: float, expected: list[str]):
    pressure_pa = 100_600.0 + np.random.default_rng(4).standard_normal(len(stamps(60.0)))
    moving = MadeTable("GPS", stamps(60.0, 5.0), {"Spd": np.full(300, speed_mps)})
    assert keys(report(imu(), baro(pressure_pa), moving)) == []
    pressure_pa[1500:2000] = pressure_pa[1500]
    assert keys(report(imu(), baro(pressure_pa), moving)) == expected


def test_a_damaged_pressure_holds_no_other():
    """Pressures are equal within a step of their single precision, not of the damaged one's."""
    pressure_pa = 100_600.0 + np.random.default_rng(4).standard_normal(len(stamps(60.0)))
    pressure_pa[1700] = 1e12
    moving = MadeTable("GPS", stamps(60.0, 5.0), {"Spd": np.full(300, 2.0)})
    assert "sensors.stuck" not in keys(report(imu(), baro(pressure_pa), moving))


def test_a_barometer_whose_means_of_one_value_are_rounded_is_stuck():
    noise = np.random.default_rng(4).standard_normal(len(stamps(60.0)))
    pressure_pa = (100_600.0 + noise).astype(np.float32)
    moving = MadeTable("GPS", stamps(60.0, 5.0), {"Spd": np.full(300, 2.0)})
    neighbours = np.nextafter(pressure_pa[1500], np.float32([0.0, np.inf]))
    pressure_pa[1500:2000] = pressure_pa[1500]
    pressure_pa[1510:1990:7], pressure_pa[1513:1990:11] = neighbours
    assert keys(report(imu(), baro(pressure_pa.astype(np.float64)), moving)) == ["sensors.stuck"]


def test_the_table_shows_the_share_of_repeated_rows():
    pressure_pa = 100_600.0 + 0.1 * np.arange(len(stamps(60.0)))
    pressure_pa[1::2] = pressure_pa[::2]
    (grid,) = report(imu(), baro(pressure_pa)).grids
    repeated = {row[0]: row[grid.columns.index("repeated %")] for row in grid.rows}
    assert repeated == {"IMU": 0.0, "BARO": pytest.approx(100.0 * 1500 / 2999, abs=0.05)}


def baro(pressure_pa: np.ndarray) -> MadeTable:
    return MadeTable("BARO", stamps(60.0), {"Press": pressure_pa}, units={"Press": "Pa"})


def mag(field: np.ndarray, **more: Any) -> MadeTable:
    columns = {f"Mag{axis}": field[:, place].astype(np.int16) for place, axis in enumerate("XYZ")}
    return MadeTable("MAG", stamps(len(field) / RATE_HZ), columns | more, units={"MagX": "mGauss"})


def test_health_flags_count_while_armed_and_before():
    unwell = np.ones(3000)
    unwell[500:600] = 0
    for armed_s, severity in ((5, Severity.WARNING), (30, Severity.NOTICE)):
        arm = MadeTable("ARM", [armed_s * S], {"ArmState": [1]})
        finding = only(report(imu(GH=unwell, AH=np.ones(3000)), arm))
        assert (finding.key, finding.severity) == ("sensors.unhealthy", severity)
        assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (10 * S, 599 * S // RATE_HZ)


def test_driver_errors_and_a_slow_sensor():
    errors, rate = np.zeros(3000), np.full(3000, 1000.0)
    errors[1000:] = 7
    rate[2000:2050] = 400.0
    found = {finding.key: finding for finding in report(imu(EG=errors, GHz=rate)).findings}
    assert set(found) == {"sensors.errors", "sensors.slow"}
    assert found["sensors.errors"].evidence[0].at_ns == 20 * S
    assert found["sensors.slow"].evidence[0].at_ns == 40 * S


def test_two_units_that_disagree():
    one, other = imu_columns(60.0, seed=1), imu_columns(60.0, seed=2)
    other["GyrX"] = one["GyrX"] + 1e-3
    columns = {name: np.stack([one[name], other[name]], axis=1).reshape(-1) for name in one}
    both = np.repeat(stamps(60.0), 2)
    instance = np.tile([0, 1], 3000)
    assert keys(report(MadeTable("IMU", both, columns | {"I": instance}, "I"))) == []
    columns["AccY"] = columns["AccY"] + np.where((instance == 1) & (both >= 20 * S), 1.0, 0.0)
    finding = only(report(MadeTable("IMU", both, columns | {"I": instance}, "I")))
    assert finding.key == "sensors.disagree"
    assert "1 m/s²" in finding.sentence
    assert (finding.evidence[0].at_ns or 0) >= 20 * S


def at_rest(seconds: float, rate_hz: float, imu_model: Imu, seed: int) -> dict[str, np.ndarray]:
    """What our own simulator measures on a vessel that does not move, as an IMU message."""
    random = np.random.default_rng(seed)
    zero = np.zeros((1, 3))
    truth = Kinematics(zero, zero, zero, np.array([[1.0, 0.0, 0.0, 0.0]]), np.eye(3)[None], zero, zero)
    state = imu_model.initial(1, random)
    rows = np.empty((int(seconds * rate_hz), 6))
    for row in rows:
        state, sample = imu_model.measure(state, truth, random)
        row[:3], row[3:] = sample.gyro_frd_radps[0], sample.accel_frd_mps2[0]
    return dict(zip(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"), rows.T, strict=True))


@pytest.mark.medium
def test_allan_deviation_finds_the_densities_that_the_simulator_was_given():
    rate_hz, seconds = 100.0, 120.0
    model = Imu(
        ImuSpec(
            rate_hz=rate_hz,
            gyro_noise_density_radpsprthz=GYRO_DENSITY,
            accel_noise_density_mps2prthz=ACCEL_DENSITY,
            gyro_turn_on_bias_radps=0.0017,
            accel_turn_on_bias_mps2=0.05,
        )
    )
    columns = at_rest(seconds, rate_hz, model, seed=3)
    section = report(MadeTable("IMU", stamps(seconds, rate_hz), columns))
    assert keys(section) == ["sensors.at_rest"]
    grid = next(grid for grid in section.grids if grid.key == "allan")
    found = {row[1]: row[3] for row in grid.rows}
    # The fit is led by times of a few samples, of 12 000 squares: 0.6 % one sigma, and the slope lets longer ones in.
    for axis in "xyz":
        assert found[f"gyro {axis}"] == pytest.approx(GYRO_DENSITY, rel=0.04)
        assert found[f"accel {axis}"] == pytest.approx(ACCEL_DENSITY, rel=0.04)
    # White noise falls to the longest time, a ninth of the record, and hides a bias instability (IEEE Std 952).
    for _, axis, _, _, _, bias, error_percent, tau_s, _, _ in grid.rows:
        density = GYRO_DENSITY if axis.startswith("gyro") else ACCEL_DENSITY
        floor = density / (seconds / 9.0) ** 0.5 / 0.664
        assert 0.3 * floor < float(str(bias).removeprefix("≤ ")) < 1.7 * floor
        assert str(bias).startswith("≤ ") or tau_s < seconds / 9.0
        assert 1.0 < tau_s < 1.01 * seconds / 9.0
        assert error_percent == pytest.approx(100.0 / (2.0 * (seconds / tau_s - 1.0)) ** 0.5, rel=0.03)
    scatter = {row[0]: row[1] for row in next(grid for grid in section.grids if grid.key == "scatter").rows}
    # One sample of white noise scatters by the density times the root of the rate; 36 000 differences.
    assert scatter["IMU gyro"] == pytest.approx(GYRO_DENSITY * rate_hz**0.5, rel=0.02)
    assert [plot.kind for plot in section.plots] == ["loglog", "loglog"]


def test_without_rest_the_section_says_so():
    section = report(imu())
    assert not any(grid.key == "allan" for grid in section.grids)
    assert any("Allan" in lack and "60 s" in lack for lack in section.lacks)


def test_a_decimated_log_says_that_its_density_is_not_the_sensors():
    seconds = 90.0
    random = np.random.default_rng(5)
    columns = {name: 1e-4 * random.standard_normal(int(seconds * RATE_HZ)) for name in ("GyrX", "GyrY", "GyrZ")}
    columns |= {name: 1e-3 * random.standard_normal(int(seconds * RATE_HZ)) for name in ("AccX", "AccY", "AccZ")}
    columns["GHz"] = np.full(int(seconds * RATE_HZ), 1000.0)
    section = report(MadeTable("IMU", stamps(seconds), columns))
    assert any("50 Hz of the 1000 Hz" in lack for lack in section.lacks)


def test_slow_waves_are_no_rest():
    seconds = 120.0
    at_s = stamps(seconds) * 1e-9
    random = np.random.default_rng(6)
    columns = {
        name: 1e-4 * random.standard_normal(len(at_s)) for name in ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")
    }
    columns["GyrX"] += np.radians(0.5) * np.sin(2.0 * np.pi * at_s / 6.0)
    section = report(MadeTable("IMU", stamps(seconds), columns))
    assert not any(grid.key == "allan" for grid in section.grids)


def test_telemetry_in_milligravities_is_read_in_si():
    rows = 200
    columns = {name: np.zeros(rows) for name in ("xgyro", "ygyro", "zgyro", "xacc", "yacc")}
    columns["xgyro"] = np.where(np.arange(rows) % 2, 100.0, -100.0)
    columns["zacc"] = np.full(rows, -1000.0)
    from xitl_cli.logs.signals.sensors import inertial_units as units

    unit = units(MadeLog(MadeTable("RAW_IMU", stamps(50.0, 4.0), columns), kind="tlog"))[0]
    assert unit.accel_mps2 is not None
    assert unit.gyro_radps is not None
    assert unit.accel_mps2[0, 2] == pytest.approx(-9.80665)
    assert np.abs(unit.gyro_radps[:, 0]).max() == pytest.approx(0.1)


def test_a_log_without_sensors_says_what_to_set():
    section = report(MadeTable("MSG", [0], {"Message": ["hello"]}))
    assert section.findings == ()
    assert "LOG_BITMASK" in section.lacks[0]
    assert analyse(MadeLog(kind="mcap")) is None
