"""Inertial sensors of a log, whichever format and message they are in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.columns import kind_of, labelled, numbers, stacked, stamps
from xitl_cli.logs.table import Table, by_instance, first_of

STANDARD_GRAVITY_MPS2 = 9.80665
_FEWEST_ROWS = 3
_NO_SENSORS = {"SIMSTATE", "SIM_STATE", "HIL_STATE_QUATERNION"}  # what a simulator knows, in the same words


@dataclass(frozen=True, slots=True)
class Inertial:
    """One unit. gyro_radps, accel_mps2: (N, 3) with NaN for what was no number, None when not logged.

    stamp_ns: (N,) on the log's time; sample_ns: (N,) on the sensor's own clock where that is logged, else the stamps.
    gyro_rate_hz, accel_rate_hz: at which the unit says it samples. healthy: (N,) as the autopilot saw it.
    """

    name: str
    table: Table
    stamp_ns: NDArray[np.int64]
    sample_ns: NDArray[np.int64]
    gyro_radps: NDArray[np.float64] | None
    accel_mps2: NDArray[np.float64] | None
    gyro_fields: tuple[str, ...]
    accel_fields: tuple[str, ...]
    temperature_degc: NDArray[np.float64] | None
    gyro_rate_hz: float | None
    accel_rate_hz: float | None
    healthy: NDArray[np.bool_] | None


_XYZ = "XYZ"
_LAYOUTS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (tuple(f"Gyr{axis}" for axis in _XYZ), tuple(f"Acc{axis}" for axis in _XYZ)),
    (tuple(f"{axis.lower()}gyro" for axis in _XYZ), tuple(f"{axis.lower()}acc" for axis in _XYZ)),
    (tuple(f"G{axis}" for axis in _XYZ), tuple(f"A{axis}" for axis in _XYZ)),
    (
        tuple(f"angular_velocity.{axis.lower()}" for axis in _XYZ),
        tuple(f"linear_acceleration.{axis.lower()}" for axis in _XYZ),
    ),
    (("gyro",), ("accel",)),
)
_ALONE = {"GYR", "GYR1", "GYR2", "GYR3", "ACC", "ACC1", "ACC2", "ACC3"}  # raw sensors, each by itself
_TEMPERATURES = ("T", "Temp", "temperature")
_SAMPLE_CLOCKS = (("SampleUS", 1000), ("time_usec", 1000), ("time_boot_ms", 1_000_000))


def units(log: Log) -> list[Inertial]:
    """Every inertial unit that has at least three rows and ever shows anything but zeros."""
    found: list[Inertial] = []
    for name, table in log.tables.items():
        if kind_of(name) in _NO_SENSORS or (layout := _layout(table)) is None:
            continue
        for number, each in by_instance(table).items():
            if len(each) >= _FEWEST_ROWS and (unit := _unit(labelled(table, number), each, *layout)) is not None:
                found.append(unit)
    return found


def _layout(table: Table) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    for gyro, accel in _LAYOUTS:
        has_gyro = all(name in table.columns for name in gyro)
        has_accel = all(name in table.columns for name in accel)
        if has_gyro and has_accel:
            return gyro, accel
        if (has_gyro or has_accel) and kind_of(table.name) in _ALONE:
            return (gyro, ()) if has_gyro else ((), accel)
    return None


def _unit(name: str, table: Table, gyro: tuple[str, ...], accel: tuple[str, ...]) -> Inertial | None:
    rates = _vector(table, gyro, "rad/s", 1e-3)
    forces = _vector(table, accel, "m/s/s", 1e-3 * STANDARD_GRAVITY_MPS2)
    if not any(part is not None and np.nan_to_num(part).any() for part in (rates, forces)):
        return None
    at_ns = stamps(table)
    samples = sample_clock(table)
    warmth = first_of(table, _TEMPERATURES)
    temperature = None if warmth is None else numbers(table, warmth)
    if temperature is not None and kind_of(table.name) in ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"):
        temperature = np.where(np.asarray(table.values(warmth or "", raw=True)) == 0, np.nan, temperature)
    return Inertial(
        name=name,
        table=table,
        stamp_ns=at_ns,
        sample_ns=at_ns if samples is None else samples,
        gyro_radps=rates,
        accel_mps2=forces,
        gyro_fields=gyro,
        accel_fields=accel,
        temperature_degc=temperature,
        gyro_rate_hz=_positive_median(table, "GHz"),
        accel_rate_hz=_positive_median(table, "AHz"),
        healthy=_healthy(table, ("GH", "AH")),
    )


def sample_clock(table: Table) -> NDArray[np.int64] | None:
    """(N,) when each sample was taken, by the sensor's own clock (ns); None where only the row's stamp is logged."""
    for name, factor in _SAMPLE_CLOCKS:
        column = table.columns.get(name)
        if column is not None and column.kind == "number" and column.shape == ():
            clock: NDArray[np.int64] = np.asarray(table.values(name, raw=True)).astype(np.int64) * factor
            return clock if (clock != 0).any() else None
    return None


def _vector(table: Table, names: tuple[str, ...], unit: str, factor: float) -> NDArray[np.float64] | None:
    """(N, 3). MAVLink's whole-number messages are in mrad/s and mG, which not every one of them says."""
    if not names:
        return None
    found = numbers(table, names[0]) if len(names) == 1 else stacked(table, names)
    if found is None or found.ndim != 2 or found.shape[1] < 3:
        return None
    found = found[:, :3]
    kind = kind_of(table.name)
    if kind == "RAW_IMU" or kind.startswith("SCALED_IMU"):
        told = table.columns[names[0]].unit.replace("²", "^2")
        if told not in (unit, "m/s^2", "m/s/s", "rad/s"):
            return found * factor
    return found


def _positive_median(table: Table, name: str) -> float | None:
    values = numbers(table, name)
    if values is None:
        return None
    good = values[values > 0.0]
    return float(np.median(good)) if len(good) else None


def _healthy(table: Table, names: tuple[str, ...]) -> NDArray[np.bool_] | None:
    flags = [values for name in names if (values := numbers(table, name, raw=True)) is not None]
    if not flags:
        return None
    well: NDArray[np.bool_] = np.stack(flags).min(axis=0) > 0.0
    return well
