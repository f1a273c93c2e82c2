"""Inertial units, magnetometers, barometers and others: rates, gaps, stuck or saturated values, health, noise."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Fact, Grid, Section, Value
from xitl_cli.logs.signals import stray_truth_m
from xitl_cli.logs.signals.sensors import (
    InertialUnit,
    SensorSeries,
    find_rest,
    inertial_units,
    sensor_series,
)
from xitl_cli.logs.signals.series import significant
from xitl_cli.logs.signals.spans import log_pauses
from xitl_cli.logs.signals.states import armed_rows, parameter_values, sensors_simulated
from xitl_cli.plugins.logs.analyses import sensor_faults
from xitl_cli.plugins.logs.analyses.accelerometer_bias import accelerometer_findings
from xitl_cli.plugins.logs.analyses.sensor_departures import departure_findings
from xitl_cli.plugins.logs.analyses.sensor_quality import agreement_section, noise_section

_TITLE = "Sensors"


def analyse(log: Log) -> Section | None:
    """Section on sensors; None if the log has no sensor and is not of a vehicle."""
    clock = LogClock(log)
    inertial, plain = inertial_units(log), sensor_series(log)
    departures = Section(
        "sensors", _TITLE, findings=(*departure_findings(log, clock), *accelerometer_findings(log, clock))
    )
    if not inertial and not plain:
        if log.of_topics:
            return departures if departures.findings else None
        return Section(
            "sensors", _TITLE, lacks=("No sensor is logged; set the bits IMU, COMPASS and RCIN of LOG_BITMASK.",)
        )
    pause = log_pauses(log)
    still = find_rest(log, inertial)
    every: list[InertialUnit | SensorSeries] = [*inertial, *plain]
    judged = [sensor_faults.judged_sensor(sensor, pause, log) for sensor in every]
    sensors = [sensor for sensor in judged if sensor is not None]
    armed = {sensor.name: armed_rows(log, sensor.stamp_ns) for sensor in sensors}
    parts = (
        sensor_faults.timing_section(sensors, clock, telemetry=log.format == "tlog"),
        sensor_faults.trouble_section(log, sensors, inertial, armed, clock),
        agreement_section(inertial, plain, stray_truth_m(log) is not None, clock),
        noise_section(inertial, plain, still, parameter_values(log), sensors_simulated(log), clock),
        departures,
    )
    off = sensor_faults.switched_off(log, pause)
    lengths_s = (pause[:, 1] - pause[:, 0]) * 1e-9
    facts = [
        Fact("sensors", "Sensors", len(sensors)),
        Fact("longest_rest_s", "Longest stretch at rest", significant(still.longest_s), "s"),
        Fact("recording_paused_s", "Nothing logged at all", significant(float(lengths_s[~off].sum())), "s"),
    ]
    if off_s := float(lengths_s[off].sum()):
        facts.append(Fact("logging_off_s", "Logging off while disarmed", significant(off_s), "s"))
    lacks: list[str] = []
    if log.format == "dataflash":  # the writer of a recording or of telemetry selects the sensors
        sorts = {sensor.sort for sensor in plain}
        if not inertial:
            lacks.append("No inertial unit is logged; set the bit IMU of LOG_BITMASK.")
        if "magnetometer" not in sorts:
            lacks.append("No magnetometer is logged; set the bit COMPASS of LOG_BITMASK if there is one.")
        if "barometer" not in sorts:
            lacks.append("No barometer is logged.")
    pauses = sensor_faults.recording_pauses(log, pause, clock)
    first = Section("sensors", _TITLE, tuple(facts), pauses, (_grid(sensors),), lacks=tuple(lacks))
    return Section.joined("sensors", _TITLE, (first, *parts))


def _grid(sensors: list[sensor_faults.JudgedSensor]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for sensor in sensors:
        regular = sensor.regularity
        unwell = None if sensor.healthy is None else int(np.count_nonzero(~sensor.healthy))
        coldest = warmest = None
        if sensor.temperature_degc is not None:
            degc = sensor.temperature_degc[np.isfinite(sensor.temperature_degc)]
            degc = degc[np.abs(degc) < 300.0]
            if degc.any():
                coldest, warmest = significant(float(degc.min())), significant(float(degc.max()))
        rows.append(
            (
                sensor.name,
                sensor.sort,
                regular.rows,
                significant(regular.rate_hz),
                significant(sensor.sensor_rate_hz),
                significant(regular.jitter_s * 1e3, 3),
                regular.gaps,
                regular.long_gaps,
                significant(regular.longest_gap_s, 3),
                significant(100.0 * sensor.holding.repeated, 3),
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
