"""Sensors of one kind are reported from ArduPilot's limits before arming on, and not below them."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.logs.signals.sensors import InertialUnit, SampleTimes, SensorKind, SensorSeries
from xitl_cli.plugins.logs.analyses.sensor_quality import agreement_section

STAMPS = np.arange(400) * 100_000_000
"""40 s at 10 Hz."""
TABLE = MadeTable("IMU", STAMPS, {})
CLOCK = LogClock(MadeLog(TABLE))


def findings(*sensors: InertialUnit | SensorSeries) -> list[Finding]:
    inertial = [sensor for sensor in sensors if isinstance(sensor, InertialUnit)]
    plain = [sensor for sensor in sensors if isinstance(sensor, SensorSeries)]
    return list(agreement_section(inertial, plain, False, CLOCK).findings)


def unit(name: str, gyro: tuple[float, ...], accel: tuple[float, ...]) -> InertialUnit:
    axes = ("X", "Y", "Z"), ("AX", "AY", "AZ")
    both = np.tile(gyro, (400, 1)), np.tile(accel, (400, 1))
    return InertialUnit(name, TABLE, STAMPS, SampleTimes(STAMPS), *both, *axes, None, None, None, None)


def series(name: str, sort: SensorKind, unit_name: str, values: np.ndarray) -> SensorSeries:
    rows = np.broadcast_to(values, (400, values.shape[-1])).astype(np.float64)
    return SensorSeries(name, sort, "MAG", ("X",), unit_name, STAMPS, SampleTimes(STAMPS), rows, None, None)


@pytest.mark.parametrize(
    ("gyro_degps", "accel_mps2", "what"),
    [
        ((0.0, 3.0, -3.9), (0.0, 0.0, 0.0), None),  # 4.92 degrees per second together
        ((0.0, 3.0, -4.1), (0.0, 0.0, 0.0), "gyroscopes"),
        ((0.0, 0.0, 0.0), (0.74, 0.0, 0.0), None),
        ((0.0, 0.0, 0.0), (0.0, 0.76, 0.0), "accelerometers"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.49), None),  # the vertical has half weight
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.51), "accelerometers"),
    ],
)
def test_inertial_units(gyro_degps: tuple[float, ...], accel_mps2: tuple[float, ...], what: str | None) -> None:
    one = unit("IMU[0]", (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
    other = unit("IMU[1]", tuple(np.radians(gyro_degps)), tuple(np.add(accel_mps2, (0.0, 0.0, -9.8))))
    found = findings(one, other)
    assert [finding.key for finding in found] == ([] if what is None else ["sensors.disagree"])
    assert what is None or what in found[0].sentence


@pytest.mark.parametrize(
    ("level_mgauss", "other_mgauss", "turned_deg", "reported"),
    [
        (100.0, 100.0, 59.0, False),
        (100.0, 100.0, 61.0, True),
        (100.0, 100.0, -61.0, True),
        (50.0, 50.0, 170.0, False),  # too weak in the plane of the vessel for a direction
        (500.0, 699.0, 0.0, False),
        (500.0, 701.0, 0.0, True),
    ],
)
def test_compasses(level_mgauss: float, other_mgauss: float, turned_deg: float, reported: bool) -> None:
    turned_rad = np.radians(turned_deg + 170.0)
    start = level_mgauss * np.array([np.cos(np.radians(170.0)), np.sin(np.radians(170.0)), 0.0])
    end = other_mgauss * np.array([np.cos(turned_rad), np.sin(turned_rad), 0.0])
    down = np.array([0.0, 0.0, 400.0])
    found = findings(
        series("MAG[0]", "magnetometer", "mGauss", start + down), series("MAG[1]", "magnetometer", "mGauss", end + down)
    )
    assert [finding.key for finding in found] == (["sensors.compasses_disagree"] if reported else [])


@pytest.mark.parametrize(
    ("change", "severity"),
    [(0.29, None), (0.31, Severity.NOTICE), (0.59, Severity.NOTICE), (0.61, Severity.WARNING)],
)
def test_the_length_of_the_field(change: float, severity: Severity | None) -> None:
    share = np.repeat([-0.5, 0.0, 0.5], [40, 320, 40])
    field = 400.0 * (1.0 + change * share)[:, None] * np.array([[0.6, 0.0, 0.8]])
    found = findings(series("MAG[0]", "magnetometer", "mGauss", field))
    assert [(finding.key, finding.severity) for finding in found] == (
        [] if severity is None else [("sensors.field_changes", severity)]
    )


@pytest.mark.parametrize(("strayed_pa", "reported"), [(59.0, False), (-59.0, False), (61.0, True), (-61.0, True)])
def test_barometers_may_differ_but_not_drift(strayed_pa: float, reported: bool) -> None:
    one = np.full((400, 1), 101_325.0)
    other = one + 300.0
    other[300:] += strayed_pa
    found = findings(series("BARO[0]", "barometer", "Pa", one), series("BARO[1]", "barometer", "Pa", other))
    assert [finding.key for finding in found] == (["sensors.barometers_drift"] if reported else [])
    assert not reported or f"{61.0 / 12.0:.1f} m" in found[0].sentence
