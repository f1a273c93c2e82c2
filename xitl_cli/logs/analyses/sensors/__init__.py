"""Inertial units, magnetometers, barometers and the rest: rates, gaps, values that stick or saturate, health, noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.sensors.agreement import agreement
from xitl_cli.logs.analyses.sensors.noise import noise
from xitl_cli.logs.analyses.sensors.sensor import Sensor, sensor_of
from xitl_cli.logs.analyses.sensors.timing import recording_pauses, timing
from xitl_cli.logs.analyses.sensors.trouble import trouble
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Fact, Grid, Section, Value
from xitl_cli.logs.sensing.columns import told
from xitl_cli.logs.sensing.inertial import Inertial, units
from xitl_cli.logs.sensing.pauses import pauses
from xitl_cli.logs.sensing.plain import Plain, sensors
from xitl_cli.logs.sensing.rest import Rest, rest
from xitl_cli.logs.sensing.settings import armed_rows, settings, simulated
from xitl_cli.logs.signals import stray_truth_m

_TITLE = "Sensors"


def analyse(log: Log) -> Section | None:
    """None where the log holds no sensor at all and is none of a vehicle's."""
    instants = Instants(log)
    inertial, plain = units(log), sensors(log)
    if not inertial and not plain:
        if log.format == "mcap":
            return None
        return Section(
            "sensors", _TITLE, lacks=("No sensor is logged; set the bits IMU, COMPASS and RCIN of LOG_BITMASK.",)
        )
    pause = pauses(log)
    still = rest(log, inertial)
    every: list[Inertial | Plain] = [*inertial, *plain]
    found = [sensor for each in every if (sensor := sensor_of(each, pause)) is not None]
    armed = {sensor.name: armed_rows(log, sensor.stamp_ns) for sensor in found}
    parts = (
        timing(found, instants),
        trouble(log, found, inertial, armed, instants),
        agreement(inertial, plain, stray_truth_m(log) is not None, instants),
        noise(inertial, plain, still, settings(log), simulated(log), instants),
    )
    return Section(
        "sensors",
        _TITLE,
        facts=(*_facts(found, still, pause), *(fact for part in parts for fact in part.facts)),
        findings=(*recording_pauses(log, pause, instants), *(finding for part in parts for finding in part.findings)),
        grids=(_grid(found), *(grid for part in parts for grid in part.grids)),
        plots=tuple(plot for part in parts for plot in part.plots),
        lacks=(*_lacks(log, inertial, plain), *(lack for part in parts for lack in part.lacks)),
    )


def _facts(found: list[Sensor], still: Rest, pause: NDArray[np.int64]) -> tuple[Fact, ...]:
    paused_s = float((pause[:, 1] - pause[:, 0]).sum()) * 1e-9
    return (
        Fact("sensors", "Sensors", len(found)),
        Fact("longest_rest_s", "Longest stretch at rest", told(still.longest_s), "s"),
        Fact("recording_paused_s", "Nothing logged at all", told(paused_s), "s"),
    )


def _grid(found: list[Sensor]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for sensor in found:
        regular = sensor.regularity
        unwell = None if sensor.healthy is None else int(np.count_nonzero(~sensor.healthy))
        coldest, warmest = _span(sensor.temperature_degc)
        rows.append(
            (
                sensor.name,
                sensor.sort,
                regular.rows,
                told(regular.rate_hz),
                told(sensor.sensor_rate_hz),
                told(regular.jitter_s * 1e3, 3),
                regular.gaps,
                regular.long_gaps,
                told(regular.longest_gap_s, 3),
                told(100.0 * sensor.holding.repeated, 3),
                unwell,
                coldest,
                warmest,
            )
        )
    columns = (
        "sensor", "sort", "rows", "logged Hz", "sampled Hz", "jitter ms", "gaps", "long gaps", "longest s",
        "repeated %", "unhealthy rows", "from °C", "to °C",
    )  # fmt: skip
    return Grid("sensors", "Rates, gaps, health", columns, tuple(rows))


def _span(temperature_degc: NDArray[np.float64] | None) -> tuple[float | None, float | None]:
    if temperature_degc is None:
        return None, None
    known = temperature_degc[np.isfinite(temperature_degc) & (np.abs(temperature_degc) < 300.0)]
    return (told(float(known.min())), told(float(known.max()))) if len(known) and known.any() else (None, None)


def _lacks(log: Log, inertial: list[Inertial], plain: list[Plain]) -> tuple[str, ...]:
    sorts = {each.sort for each in plain}
    missing: list[str] = []
    if log.format != "dataflash":
        return ()  # which sensors a recording or telemetry carries is its own choice
    if not inertial:
        missing.append("No inertial unit is logged; set the bit IMU of LOG_BITMASK.")
    if "magnetometer" not in sorts:
        missing.append("No magnetometer is logged; set the bit COMPASS of LOG_BITMASK if there is one.")
    if "barometer" not in sorts:
        missing.append("No barometer is logged.")
    return tuple(missing)
