"""Samples of a recording in place of simulated samples, from a real boat's bag or from another run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, flu_to_frd
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from sim_core.sensors.barometer import BarometerSample
from sim_core.sensors.gnss import GnssSample
from sim_core.sensors.imu import ImuSample
from sim_core.sensors.magnetometer import MagnetometerSample
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.signals.series import stacked_columns
from xitl_cli.profile.schema.sensors import AUTO, SIMULATED, RecordedSensorsSpec
from xitl_cli.profile.schema.world import SiteSpec
from xitl_cli.run.sensors.sensor_faults import SensorFaults
from xitl_cli.run.sensors.sensor_messages import Message
from xitl_cli.run.world.world import local_frame

FARTHEST_M = 50_000.0
GAUSS_PER_TESLA = 1e4
USUAL_ACCURACY_M, USUAL_SPEED_ACCURACY_MPS, USUAL_SATELLITES, USUAL_DEGC = 1.5, 0.3, 12, 25.0
"""Values that ROS messages do not contain."""
_FIX_3D, _NO_FIX = 3, 1
_NEAR_NS = 10_000_000_000
_XYZ = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class RecordedSamples:
    """Samples of one sensor in a recording."""

    stamp_ns: NDArray[np.int64]
    """(N,), not falling, from the start of the run."""
    sample: Callable[[int], Any]
    """Returns the sample of a row."""


class RecordedChannel:
    """A SensorChannel for samples at given times. A sample is sent in the physics step that reaches its time.

    sent: samples so far. skipped: samples with a newer one in the same step.
    """

    every, latency_ns = 1, 0

    def __init__(
        self, samples: RecordedSamples, encode: Callable[[int, Any], Message], faults: SensorFaults | None = None
    ) -> None:
        self.faults = faults or None
        self.sent = self.skipped = 0
        self._samples = samples
        self._encode = encode
        self._next = 0

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        stamps = self._samples.stamp_ns
        if self._next >= len(stamps) or stamps[self._next] > stamp_ns:
            return None
        row = int(np.searchsorted(stamps, stamp_ns, side="right")) - 1
        self.skipped += row - self._next
        self._next = row + 1
        sample, taken_ns = self._samples.sample(row), int(stamps[row])
        if self.faults is not None:
            sample = self.faults.applied(taken_ns, sample)
            if sample is None:
                return None
        self.sent += 1
        return self._encode(taken_ns // 1000, sample)


def read_samples(spec: RecordedSensorsSpec, site: SiteSpec) -> Mapping[str, RecordedSamples]:
    """Return the samples by sensor, for the sensors that are not simulated.

    They have no rows if the recording has none.

    Raises UserError with the problem in the recording.
    """
    try:
        with open_log(Path(spec.file)) as log:
            return _read(log, spec, local_frame(site))
    except LogError as error:
        raise UserError(f"sensors.recorded.file: {error}") from error


_COLUMNS = {
    "imu": ("angular_velocity.z", "linear_acceleration.z"),
    "gnss": ("latitude", "longitude", "altitude"),
    "magnetometer": ("magnetic_field.z",),
    "barometer": ("fluid_pressure",),
}


def _read(log: Log, spec: RecordedSensorsSpec, frame: LocalFrame) -> Mapping[str, RecordedSamples]:
    start_ns = log.zero_ns + round(spec.from_s * 1e9)
    recorded: dict[str, RecordedSamples] = {}
    for sensor, columns in _COLUMNS.items():
        topic = getattr(spec, sensor)
        if topic == SIMULATED:
            continue
        table = _table_of(log, sensor, topic, columns)
        if table is None:
            recorded[sensor] = RecordedSamples(np.zeros(0, dtype=np.int64), lambda row: None)
            continue
        stamps = sample_stamps(table)
        order = np.argsort(stamps, kind="stable")
        order = order[stamps[order] >= start_ns]
        samples = _SAMPLES[sensor](log, table, order)
        recorded[sensor] = RecordedSamples(stamps[order] - start_ns, samples)
        if sensor == "gnss" and len(order):
            _check_near(log, table, order, frame)
    if not any(len(samples.stamp_ns) for samples in recorded.values()):
        raise UserError(
            f"{log.path} has no samples of a sensor from {spec.from_s:g} s on; use a recording with sensor_msgs/Imu "
            "or NavSatFix, or another sensors.recorded.from_s"
        )
    return recorded


def _table_of(log: Log, sensor: str, topic: str, columns: tuple[str, ...]) -> Table | None:
    if topic != AUTO:
        table = log.tables.get(topic)
        if table is None or not set(columns) <= set(table.columns):
            raise UserError(
                f"{log.path} has no {topic} with {', '.join(columns)} for sensors.recorded.{sensor}; "
                "`xitl logs info` lists its topics"
            )
        return table
    names = [
        name for name, table in log.tables.items() if "truth" not in name.lower() and set(columns) <= set(table.columns)
    ]
    if len(names) > 1:
        raise UserError(f"{log.path} has {', '.join(names)}; select one of them by sensors.recorded.{sensor}")
    return log.tables[names[0]] if names else None


def sample_stamps(table: Table) -> NDArray[np.int64]:
    """Return the times (N,) of the samples: header stamps on the recorder's clock, otherwise the times of arrival."""
    if "header.stamp" in table.columns and len(table):
        stamps: NDArray[np.int64] = table.values("header.stamp").astype(np.int64)
        if (stamps > 0).all() and abs(float(np.median(stamps - table.stamp_ns))) < _NEAR_NS:
            return stamps
    return table.stamp_ns


def _stacked(table: Table, names: tuple[str, ...], rows: NDArray[np.intp]) -> Array:
    columns = stacked_columns(table, names)
    assert columns is not None
    values: Array = columns[rows]
    return values


def _imu(log: Log, table: Table, rows: NDArray[np.intp]) -> Callable[[int], ImuSample]:
    gyro = flu_to_frd(_stacked(table, tuple(f"angular_velocity.{axis}" for axis in _XYZ), rows))
    accel = flu_to_frd(_stacked(table, tuple(f"linear_acceleration.{axis}" for axis in _XYZ), rows))
    _check_finite(log, table, np.column_stack([gyro, accel]))
    warm = np.array([USUAL_DEGC])
    return lambda row: ImuSample(gyro[row : row + 1], accel[row : row + 1], warm)


def _magnetometer(log: Log, table: Table, rows: NDArray[np.intp]) -> Callable[[int], MagnetometerSample]:
    field = GAUSS_PER_TESLA * flu_to_frd(_stacked(table, tuple(f"magnetic_field.{axis}" for axis in _XYZ), rows))
    _check_finite(log, table, field)
    return lambda row: MagnetometerSample(field[row : row + 1])


def _barometer(log: Log, table: Table, rows: NDArray[np.intp]) -> Callable[[int], BarometerSample]:
    pressure = _stacked(table, ("fluid_pressure",), rows)[:, 0]
    _check_finite(log, table, pressure)
    warm = np.array([USUAL_DEGC])
    return lambda row: BarometerSample(pressure[row : row + 1], warm)


def _gnss(log: Log, table: Table, rows: NDArray[np.intp]) -> Callable[[int], GnssSample]:
    place = _stacked(table, ("latitude", "longitude", "altitude"), rows)
    status = table.values("status.status", rows) if "status.status" in table.columns else np.zeros(len(rows))
    fixed = (status >= 0) & np.isfinite(place).all(axis=1)
    place = np.where(fixed[:, None], place, 0.0)
    velocity = fix_velocity(log, table, rows, place, fixed)
    horizontal = vertical = np.full(len(rows), USUAL_ACCURACY_M)
    if "position_covariance" in table.columns and len(rows):
        variances = table.values("position_covariance", rows)[:, (0, 4, 8)].astype(np.float64)
        known = (variances > 0.0).all(axis=1) & np.isfinite(variances).all(axis=1)
        horizontal = np.where(known, np.sqrt(np.abs(variances[:, 0] + variances[:, 1])), horizontal)
        vertical = np.where(known, np.sqrt(np.abs(variances[:, 2])), vertical)
    kind = np.where(fixed, _FIX_3D, _NO_FIX)
    satellites = np.where(fixed, USUAL_SATELLITES, 0)
    speed = np.array([USUAL_SPEED_ACCURACY_MPS])

    def sample(row: int) -> GnssSample:
        at = slice(row, row + 1)
        return GnssSample(
            place[at, 0], place[at, 1], place[at, 2], velocity[at], horizontal[at], vertical[at], speed,
            kind[at], satellites[at],
        )  # fmt: skip

    return sample


def fix_velocity(log: Log, table: Table, rows: NDArray[np.intp], place: Array, fixed: NDArray[np.bool_]) -> Array:
    """Return velocities (n, 3) NED in m/s, from a TwistStamped topic or between fixes.

    The topic is fix_velocity or MAVROS's gps_vel.
    """
    stamps = sample_stamps(table)[rows]
    for name in log.tables:
        if name.endswith(("fix_velocity", "gps_vel", "vel")) and "truth" not in name:
            twists = log.tables[name]
            enu = stacked_columns(twists, tuple(f"twist.linear.{axis}" for axis in _XYZ))
            if enu is None or not len(enu):
                continue
            at = np.clip(np.searchsorted(sample_stamps(twists), stamps), 0, len(enu) - 1)
            near: Array = np.stack([enu[at, 1], enu[at, 0], -enu[at, 2]], axis=1)
            return np.nan_to_num(near)
    velocity: Array = np.zeros((len(rows), 3))
    if fixed.any():
        frame = LocalFrame(*map(float, place[int(np.argmax(fixed))]))
        ned = frame.ned(*place.T)
        both = fixed[1:] & fixed[:-1] & (np.diff(stamps) > 0)
        steps_s = np.maximum(np.diff(stamps), 1)[:, None] * 1e-9
        velocity[1:] = np.where(both[:, None], np.diff(ned, axis=0) / steps_s, 0.0)
    return velocity


def _check_finite(log: Log, table: Table, values: Array) -> None:
    if not np.isfinite(values).all():
        raise UserError(f"{log.path}: {table.name} has samples that are not finite; remove them from the recording")


def _check_near(log: Log, table: Table, rows: NDArray[np.intp], frame: LocalFrame) -> None:
    latitude, longitude, altitude = _stacked(table, ("latitude", "longitude", "altitude"), rows).T
    known = np.isfinite(latitude) & np.isfinite(longitude) & ((latitude != 0.0) | (longitude != 0.0))
    if not known.any():
        return
    first = int(np.argmax(known))
    north_m, east_m, _ = frame.ned(latitude[first : first + 1], longitude[first : first + 1], np.zeros(1))[0]
    if np.hypot(north_m, east_m) > FARTHEST_M:
        raise UserError(
            f"{log.path}: its first fix is {np.hypot(north_m, east_m) / 1000:.0f} km from the site; set "
            f"site.latitude_deg: {latitude[first]:.5f}, site.longitude_deg: {longitude[first]:.5f} and "
            f"site.altitude_m: {altitude[first]:.1f}"
        )


_SAMPLES: Mapping[str, Callable[[Log, Table, NDArray[np.intp]], Callable[[int], Any]]] = {
    "imu": _imu,
    "gnss": _gnss,
    "magnetometer": _magnetometer,
    "barometer": _barometer,
}
