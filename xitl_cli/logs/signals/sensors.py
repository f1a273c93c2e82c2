"""Sensors of a log in any format: inertial units, magnetometers, barometers and others; periods at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from xitl_cli.logs.model.log import Log, once_per_log
from xitl_cli.logs.model.table import Flags, Floats, Stamps, Table, by_instance, first_of
from xitl_cli.logs.signals.motion import ground_speed
from xitl_cli.logs.signals.series import bounded_stamps, instance_label, message_of, numbers, stacked, tables_of
from xitl_cli.logs.signals.spans import runs

STANDARD_GRAVITY_MPS2 = 9.80665
_FEWEST_ROWS = 3
_NO_SENSORS = {"SIMSTATE", "SIM_STATE", "HIL_STATE_QUATERNION"}  # truth of a simulator, in the same fields


@dataclass(frozen=True, slots=True)
class InertialUnit:
    """One inertial unit."""

    name: str
    table: Table
    stamp_ns: Stamps
    """(N,) on the log's time."""
    times: SampleTimes
    """On the sensor's own clock if that is logged, else the stamps."""
    gyro_radps: Floats | None
    """(N, 3) NaN if not finite; None if not logged."""
    accel_mps2: Floats | None
    """(N, 3) NaN if not finite; None if not logged."""
    gyro_fields: tuple[str, ...]
    accel_fields: tuple[str, ...]
    temperature_degc: Floats | None
    gyro_rate_hz: float | None
    """Sample rate as reported by the unit."""
    accel_rate_hz: float | None
    """Sample rate as reported by the unit."""
    healthy: Flags | None
    """(N,) as judged by the autopilot."""

    @property
    def sample_ns(self) -> Stamps:
        return self.times.clock_ns


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
    (("gyro_rad",), ("accelerometer_m_s2",)),
)
_ALONE = {"GYR", "GYR1", "GYR2", "GYR3", "ACC", "ACC1", "ACC2", "ACC3"}  # single sensors with raw values
_TEMPERATURES = ("T", "Temp", "temperature")
_SAMPLE_CLOCKS = (("SampleUS", 1000), ("time_usec", 1000), ("time_boot_ms", 1_000_000))


@once_per_log
def inertial_units(log: Log) -> list[InertialUnit]:
    """Every inertial unit with at least three rows and any value that is not 0."""
    found: list[InertialUnit] = []
    for name, table in log.tables.items():
        if message_of(name) in _NO_SENSORS or (layout := _layout(table)) is None:
            continue
        for number, each in by_instance(table).items():
            if len(each) >= _FEWEST_ROWS and (unit := _unit(instance_label(table, number), each, *layout)) is not None:
                found.append(unit)
    return found


def _layout(table: Table) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    for gyro, accel in _LAYOUTS:
        has_gyro = all(name in table.columns for name in gyro)
        has_accel = all(name in table.columns for name in accel)
        if has_gyro and has_accel:
            return gyro, accel
        if (has_gyro or has_accel) and message_of(table.name) in _ALONE:
            return (gyro, ()) if has_gyro else ((), accel)
    return None


def _unit(name: str, table: Table, gyro: tuple[str, ...], accel: tuple[str, ...]) -> InertialUnit | None:
    rates = _vector(table, gyro, "rad/s", 1e-3)
    forces = _vector(table, accel, "m/s/s", 1e-3 * STANDARD_GRAVITY_MPS2)
    if not any(part is not None and np.nan_to_num(part).any() for part in (rates, forces)):
        return None
    warmth = first_of(table, _TEMPERATURES)
    temperature = None if warmth is None else numbers(table, warmth)
    if temperature is not None and message_of(table.name) in ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"):
        temperature = np.where(np.asarray(table.values(warmth or "", raw=True)) == 0, np.nan, temperature)
    names = ("GH", "AH")
    flags = [values for name in names if (values := numbers(table, name, raw=True)) is not None]
    if not flags:
        healthy = None
    else:
        well: Flags = np.stack(flags).min(axis=0) > 0.0
        healthy = well
    return InertialUnit(
        name=name,
        table=table,
        stamp_ns=bounded_stamps(table),
        times=sample_times(table),
        gyro_radps=rates,
        accel_mps2=forces,
        gyro_fields=gyro,
        accel_fields=accel,
        temperature_degc=temperature,
        gyro_rate_hz=_positive_median(table, "GHz"),
        accel_rate_hz=_positive_median(table, "AHz"),
        healthy=healthy,
    )


@dataclass(frozen=True, slots=True)
class SampleTimes:
    """Times of samples."""

    clock_ns: Stamps
    """(N,) sample times on the sensor's own clock, with its jumps removed."""
    jumps: tuple[tuple[int, float], ...] = ()
    """Instant (the log's time) and size (s) of each setting of that clock, while the rows continued."""


_JUMP_NS = 500_000_000


def sample_times(table: Table) -> SampleTimes:
    """Sample times on the sensor's own clock if it is logged, else the rows' stamps."""
    at_ns = bounded_stamps(table)
    for name, factor in _SAMPLE_CLOCKS:
        column = table.columns.get(name)
        if column is not None and column.kind == "number" and column.shape == ():
            clock: Stamps = np.asarray(table.values(name, raw=True)).astype(np.int64) * factor
            return _without_jumps(clock, at_ns) if (clock != 0).any() else SampleTimes(at_ns)
    return SampleTimes(at_ns)


def _without_jumps(clock_ns: Stamps, at_ns: Stamps) -> SampleTimes:
    """Remove the jumps of a clock. A gap is on both clocks; a jump is on one, by more than half of its step."""
    steps, rows = np.diff(clock_ns), np.diff(at_ns)
    apart = steps - rows
    jumped = np.flatnonzero((np.abs(apart) > _JUMP_NS) & (np.abs(apart) > 0.5 * np.abs(steps)) & (rows >= 0))
    if not len(jumped):
        return SampleTimes(clock_ns)
    steps[jumped] = rows[jumped]
    mended = clock_ns[0] + np.concatenate(([0], np.cumsum(steps)))
    return SampleTimes(mended, tuple((int(at_ns[row + 1]), float(apart[row]) * 1e-9) for row in jumped[:100].tolist()))


def _vector(table: Table, names: tuple[str, ...], unit: str, factor: float) -> Floats | None:
    """(N, 3). MAVLink's integer messages are in mrad/s and mG, which not all of them state."""
    if not names:
        return None
    vectors = numbers(table, names[0]) if len(names) == 1 else stacked(table, names)
    if vectors is None or vectors.ndim != 2 or vectors.shape[1] < 3:
        return None
    vectors = vectors[:, :3]
    kind = message_of(table.name)
    if kind == "RAW_IMU" or kind.startswith("SCALED_IMU"):
        logged_unit = table.columns[names[0]].unit.replace("²", "^2")
        if logged_unit not in (unit, "m/s^2", "m/s/s", "rad/s"):
            return vectors * factor
    return vectors


def _positive_median(table: Table, name: str) -> float | None:
    values = numbers(table, name)
    if values is None:
        return None
    good = values[values > 0.0]
    return float(np.median(good)) if len(good) else None


WINDOW_NS = 1_000_000_000
GYRO_DEVIATION_RADPS = 0.01
ACCEL_DEVIATION_MPS2 = 0.3
GYRO_SHIFT_RADPS = 0.003
ACCEL_SHIFT_MPS2 = 0.1
SPEED_MPS = 0.1
_MOST_WINDOWS = 1_000_000  # eleven days; more result from damaged stamps


@dataclass(frozen=True, slots=True)
class RestPeriods:
    """Periods at rest."""

    stretches: tuple[tuple[int, int], ...]
    """Begin and end (ns on the log's time), the longest first."""
    source: str | None
    """The unit that showed it."""
    by_speed: bool
    """Whether a speed over ground was used too."""

    @property
    def longest_s(self) -> float:
        return (self.stretches[0][1] - self.stretches[0][0]) * 1e-9 if self.stretches else 0.0

    def rows(self, stamp_ns: Stamps) -> Flags:
        """(N,) True for stamps within a period at rest."""
        inside = np.zeros(len(stamp_ns), dtype=np.bool_)
        for from_ns, until_ns in self.stretches:
            inside |= (stamp_ns >= from_ns) & (stamp_ns < until_ns)
        return inside


def find_rest(log: Log, found: list[InertialUnit]) -> RestPeriods:
    """Find periods of whole seconds at rest.

    The gyroscope scatters by less than 0.01 rad/s, the specific force by less than 0.3 m/s^2. Their means stay within
    0.003 rad/s and 0.1 m/s^2 over the period. The speed, if known, is below 0.1 m/s. Waves of half a degree are no
    rest.
    """
    whole = [unit for unit in found if unit.gyro_radps is not None and unit.accel_mps2 is not None]
    if not whole:
        return RestPeriods((), None, False)
    unit = max(whole, key=lambda candidate: len(candidate.stamp_ns))
    windows = _windows(unit)
    if windows is None:
        return RestPeriods((), unit.name, False)
    from_ns, means, calm = windows
    speed = ground_speed(log)
    if speed is not None:
        # Use the highest speed at the window's beginning, middle and end. Without a speed, only the inertial unit
        # decides.
        at = np.stack([speed.interpolated(from_ns + part) for part in (0, WINDOW_NS // 2, WINDOW_NS)])
        calm[np.nan_to_num(np.abs(at)).max(axis=0) > SPEED_MPS] = False
    stretches = []
    for first, after_calm in runs(calm):
        away = np.abs(means[first:after_calm] - np.median(means[first:after_calm], axis=0))
        settled = np.asarray(
            (away[:, :3] < GYRO_SHIFT_RADPS).all(axis=1) & (away[:, 3:] < ACCEL_SHIFT_MPS2).all(axis=1)
        )
        for begin, after in runs(settled):
            stretches.append((int(from_ns[first + begin]), int(from_ns[first + after - 1]) + WINDOW_NS))
    stretches.sort(key=lambda stretch: stretch[0] - stretch[1])
    return RestPeriods(tuple(stretches), unit.name, speed is not None)


def _windows(unit: InertialUnit) -> tuple[Stamps, Floats, Flags] | None:
    """For each second with samples: its beginning, means of the six axes (W, 6), and whether it is calm."""
    assert unit.gyro_radps is not None
    assert unit.accel_mps2 is not None
    signals = np.concatenate([unit.gyro_radps, unit.accel_mps2], axis=1)
    good = np.isfinite(signals).all(axis=1) & (np.abs(signals) < 1e6).all(axis=1)
    stamps, signals = unit.stamp_ns[good], signals[good]
    if len(stamps) < 3:
        return None
    # Windows start from the median, so that one damaged stamp does not stretch the record. Distant stamps are omitted.
    begin = int(np.median(stamps))
    number = (stamps - begin) // WINDOW_NS
    near = np.abs(number) < _MOST_WINDOWS
    if not near.any():
        return None
    number, signals = number[near], signals[near]
    base = int(number.min())
    place = number - base
    count = np.bincount(place)
    enough = count >= 3
    divisor = np.maximum(count, 1)
    centre = signals.mean(axis=0)
    sums = np.stack([np.bincount(place, signals[:, axis] - centre[axis]) for axis in range(6)], axis=1)
    squares = np.stack([np.bincount(place, (signals[:, axis] - centre[axis]) ** 2) for axis in range(6)], axis=1)
    means = sums / divisor[:, None]
    deviation = np.sqrt(np.maximum(squares / divisor[:, None] - means**2, 0.0))
    calm: Flags = enough & (deviation[:, :3] < GYRO_DEVIATION_RADPS).all(axis=1)
    calm &= (deviation[:, 3:] < ACCEL_DEVIATION_MPS2).all(axis=1)
    from_ns = begin + (np.arange(len(count), dtype=np.int64) + base) * WINDOW_NS
    return from_ns, means + centre, calm


SensorKind = Literal["magnetometer", "barometer", "rangefinder", "airspeed", "wind", "AHRS"]


@dataclass(frozen=True, slots=True)
class SensorSeries:
    """One sensor."""

    name: str
    sort: SensorKind
    message: str
    fields: tuple[str, ...]
    unit: str
    stamp_ns: Stamps
    """(N,) on the log's time."""
    times: SampleTimes
    """On the sensor's own clock if that is logged, else the stamps."""
    values: Floats
    """(N, k) in `unit`."""
    healthy: Flags | None
    """(N,) as judged by the autopilot."""
    temperature_degc: Floats | None
    calibrated: bool = True
    """Whether the values are in body axes, with the sensor's calibration applied."""

    @property
    def sample_ns(self) -> Stamps:
        return self.times.clock_ns


@dataclass(frozen=True, slots=True)
class _Message:
    kind: str
    sort: SensorKind
    fields: tuple[tuple[str, ...], ...]
    unit: str
    health: tuple[str, ...] = ()
    temperature: tuple[str, ...] = ()
    raw: bool = False  # logged in integer mGauss
    factor: float = 1.0
    calibrated: bool = True


_MAG_FIELDS = (("MagX", "MagY", "MagZ"),)
_MESSAGES = (
    *(_Message(kind, "magnetometer", _MAG_FIELDS, "mGauss", ("Health",), raw=True) for kind in ("MAG", "MAG2", "MAG3")),
    _Message("XITL_MAGNETOMETER", "magnetometer", (("field",),), "mGauss", factor=1e3),
    *(
        _Message(kind, "barometer", (("Press",),), "Pa", ("H", "Health"), ("Temp",))
        for kind in ("BARO", "BAR2", "BAR3")
    ),
    _Message("XITL_BAROMETER", "barometer", (("pressure",),), "Pa", (), ("temperature",)),
    *(
        _Message(kind, "barometer", (("press_abs",),), "Pa", (), ("temperature",))
        for kind in ("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3")
    ),
    # PX4 logs it as the driver reads it, without CAL_MAGn_ROT, offsets and scales.
    _Message("sensor_mag", "magnetometer", (("x", "y", "z"),), "mGauss", factor=1e3, calibrated=False),
    _Message("vehicle_magnetometer", "magnetometer", (("magnetometer_ga",),), "mGauss", factor=1e3),
    _Message("sensor_baro", "barometer", (("pressure",),), "Pa", (), ("temperature",)),
    _Message("vehicle_air_data", "barometer", (("baro_pressure_pa",),), "Pa", (), ("baro_temp_celcius",)),
    _Message("distance_sensor", "rangefinder", (("current_distance",),), "m"),
    _Message("RFND", "rangefinder", (("Dist",), ("Dist1",)), "m"),
    _Message("RNGF", "rangefinder", (("Dist",), ("Dist1",)), "m"),
    _Message("DPTH", "rangefinder", (("Depth",),), "m"),
    _Message("DISTANCE_SENSOR", "rangefinder", (("current_distance",),), "m"),
    _Message("RANGEFINDER", "rangefinder", (("distance",),), "m"),
    _Message("ARSP", "airspeed", (("DiffPress",), ("Airspeed",)), "", ("H",), ("Temp",)),
    _Message("WIND", "wind", (("SpdRaw", "DrRaw"), ("SpdApp", "DrApp")), ""),
    _Message("EAHR", "AHRS", (("Roll", "Pitch", "Yaw"),), "deg"),
    _Message("VNKF", "AHRS", (("Lat", "Lon", "Alt"),), ""),
    _Message("VNAT", "AHRS", (("Q1", "Q2", "Q3", "Q4"),), ""),
)


def sensor_series(log: Log) -> list[SensorSeries]:
    """Every instance with at least three rows and any value that is not 0."""
    return [
        series
        for message in _MESSAGES
        for table in tables_of(log, (message.kind,))
        for series in _series_of(table, message)
    ]


def injected_units(log: Log) -> list[InertialUnit]:
    """Inertial samples that the autopilot received, from the frames of its link in an xitl recording."""
    units = []
    for table in _injected(log, "XITL_IMU"):
        layout = _layout(table)
        if layout is not None and len(table) >= _FEWEST_ROWS:
            units.append(_unit("XITL_IMU", table, *layout))
    return [unit for unit in units if unit is not None]


def injected_series(log: Log) -> list[SensorSeries]:
    """Magnetometer and barometer samples that the autopilot received, from an xitl recording."""
    return [
        replace(series, name=message.kind)
        for message in _MESSAGES
        if message.kind.startswith("XITL_")
        for table in _injected(log, message.kind)
        for series in _series_of(table, message)
    ]


def _injected(log: Log, kind: str) -> list[Table]:
    names = [f"{name}:{kind}" for name in log.tables if name.endswith("/link/agent/tx")]
    return [log.tables[name] for name in names if name in log.tables]


def _series_of(table: Table, message: _Message) -> Iterator[SensorSeries]:
    for number, each in by_instance(table).items():
        names = next((names for names in message.fields if all(name in each.columns for name in names)), None)
        if len(each) < 3 or names is None:
            continue
        if len(names) == 1:
            found = numbers(each, names[0], raw=message.raw)
            values = None if found is None else found * message.factor
        else:
            several = stacked(each, names, raw=message.raw)
            values = None if several is None else several * message.factor
        if values is None or not np.nan_to_num(values).any():
            continue
        health = first_of(each, message.health)
        flags = None if health is None else numbers(each, health, raw=True)
        warmth = first_of(each, message.temperature)
        yield SensorSeries(
            name=instance_label(table, number),
            sort=message.sort,
            message=table.name,
            fields=names,
            unit=message.unit or each.columns[names[0]].unit,
            stamp_ns=bounded_stamps(each),
            times=sample_times(each),
            values=values.reshape(len(values), -1),
            healthy=None if flags is None else flags > 0.0,
            temperature_degc=None if warmth is None else numbers(each, warmth),
            calibrated=message.calibrated,
        )
