"""The `sensors` block of a vessel from the log of a boat at rest, with manoeuvres for the delay of the receiver.

Noise densities and bias instabilities are read off the Allan deviation (`xitl_cli/logs/signals/allan.py`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from sim_core.frames import euler_to_quat, quat_to_matrix
from xitl_cli.errors import UserError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals import allan
from xitl_cli.logs.signals.receivers import GnssReceiver, gnss_receivers
from xitl_cli.logs.signals.sensors import InertialUnit, RestPeriods, find_rest, inertial_units
from xitl_cli.logs.signals.series import numbers, stacked_columns
from xitl_cli.plugins.identify.recording import Floats

LEAST_REST_S = 30.0
_DRIFT_REST_S = 600.0
_DELAYS_S = np.arange(-0.1, 0.501, 0.02)
_DELAY_WINDOW_S = 5.0
_LEAST_CHANGE_MPS = 0.3
_ONE_CLOCK_NS = 1_000_000_000
"""Times of samples that are further from the stamps belong to another clock."""
_METRES_PER_DEG = 111_194.9


@dataclass(frozen=True, slots=True)
class SensorValue:
    """A key of `sensors` and its value."""

    key: str
    value: float
    sigma: float | None
    """Standard error, None if unknown."""
    note: str = ""


@dataclass(frozen=True, slots=True)
class SensorEstimate:
    """What a log shows of the sensors."""

    rest_s: float
    values: tuple[SensorValue, ...]
    lacks: tuple[str, ...]
    """What the log cannot show, each a sentence with what to record."""


def identify_sensors(log: Log) -> SensorEstimate:
    """Raises UserError for a log without samples of an IMU, or without rest."""
    units = [unit for unit in inertial_units(log) if unit.gyro_radps is not None and unit.accel_mps2 is not None]
    if not units:
        raise UserError(f"{log.path} has no samples of an IMU; record IMU (bit 18 of LOG_BITMASK)")
    unit, rest = units[0], find_rest(log, units)
    if rest.longest_s < LEAST_REST_S:
        raise UserError(
            f"{log.path}: the boat is at rest for {rest.longest_s:.0f} s at most; record {LEAST_REST_S:g} s or more on "
            f"land or moored in calm water, with {_DRIFT_REST_S / 60:g} min for the stability of the biases"
        )
    values, lacks = list(_inertial(unit, rest)), []
    if rest.longest_s < _DRIFT_REST_S:
        lacks.append(
            f"the stability of the biases and the drift of the receiver need {_DRIFT_REST_S / 60:g} min of rest, and "
            f"this log has {rest.longest_s / 60:.1f}"
        )
    receivers = gnss_receivers(log)
    if receivers:
        values += _receiver(receivers[0], rest)
        delay = receiver_delay(log, unit, receivers[0])
        values += [delay] if delay is not None else []
    if not receivers or delay is None:
        lacks.append(
            "the latency of the receiver needs changes of speed: accelerate and stop some times, with GPS, ATT and IMU"
        )
    values += _barometer(log, rest)
    return SensorEstimate(rest.longest_s, tuple(values), tuple(lacks))


# IMU
def _inertial(unit: InertialUnit, rest: RestPeriods) -> Iterator[SensorValue]:
    from_ns, until_ns = rest.stretches[0]
    rows = (unit.stamp_ns >= from_ns) & (unit.stamp_ns < until_ns)
    period_s = float(np.median(np.diff(unit.sample_ns[rows]))) * 1e-9
    yield SensorValue("imu.rate_hz", float(round(1.0 / period_s)), None)
    assert unit.gyro_radps is not None
    assert unit.accel_mps2 is not None
    for name, unit_name, samples in (("gyro", "radps", unit.gyro_radps), ("accel", "mps2", unit.accel_mps2)):
        still = samples[rows]
        still = still[np.isfinite(still).all(axis=1)]
        curves = [allan.overlapping(still[:, axis], period_s) for axis in range(3)]
        white = [found for curve in curves if (found := allan.white_noise_density(curve)) is not None]
        key = f"imu.{name}_noise_density_{unit_name}prthz"
        if white:
            level = float(np.sqrt(np.mean([found.value**2 for found in white])))
            error = float(np.mean([found.relative_error for found in white])) / np.sqrt(len(white))
            yield SensorValue(key, level, level * float(error))
        else:
            scatter = float(np.sqrt(np.mean(np.diff(still, axis=0) ** 2) / 2.0 * period_s))
            yield SensorValue(key, scatter, None, "from sample to sample; the log is too short for a slope of -1/2")
        flat = [found for curve in curves if (found := allan.bias_instability(curve)) is not None]
        if flat and rest.longest_s >= _DRIFT_REST_S:
            level = float(np.sqrt(np.mean([found.value**2 for found in flat])))
            note = "at most: the curve still falls at its end" if all(found.bound for found in flat) else ""
            error = float(np.mean([found.relative_error for found in flat])) / np.sqrt(len(flat))
            yield SensorValue(f"imu.{name}_bias_instability_{unit_name}", level, level * float(error), note)
        if name == "gyro":
            bias = float(np.sqrt(np.mean(still.mean(axis=0) ** 2)))
            yield SensorValue("imu.gyro_turn_on_bias_radps", bias, bias / np.sqrt(6.0), "of this start alone")


# Receiver
def _receiver(receiver: GnssReceiver, rest: RestPeriods) -> Iterator[SensorValue]:
    from_ns, until_ns = rest.stretches[0]
    rows = (receiver.stamp_ns >= from_ns) & (receiver.stamp_ns < until_ns) & np.isfinite(receiver.lat_deg)
    count = int(np.count_nonzero(rows))
    if count < 20:
        return
    rate_hz = 1e9 / float(np.median(np.diff(receiver.stamp_ns[rows])))
    yield SensorValue("gnss.rate_hz", float(round(rate_hz)), None)
    lat, lon = receiver.lat_deg[rows], receiver.lon_deg[rows]
    scale = _METRES_PER_DEG * np.array([1.0, np.cos(np.radians(lat[0]))])
    place = np.stack([lat - lat[0], lon - lon[0]], axis=1) * scale
    error = 1.0 / np.sqrt(2.0 * count)
    noise = float(np.sqrt(np.mean(np.diff(place, axis=0) ** 2) / 2.0))
    yield SensorValue("gnss.horizontal_noise_m", noise, noise * error)
    if rest.longest_s >= _DRIFT_REST_S:
        smooth = place[: count // 10 * 10].reshape(-1, 10, 2).mean(axis=1)
        drift = float(np.sqrt(max(np.var(smooth, axis=0).mean() - noise**2 / 10.0, 0.0)))
        yield SensorValue("gnss.horizontal_drift_m", drift, None, "of this rest alone")
    speed = receiver.vel_ned_mps[rows][:, :2]
    speed = speed[np.isfinite(speed).all(axis=1)]
    if len(speed) > 20:
        scatter = float(np.sqrt(np.mean(np.var(speed, axis=0))))
        yield SensorValue("gnss.velocity_noise_mps", scatter, scatter * error)


def receiver_delay(log: Log, unit: InertialUnit, receiver: GnssReceiver) -> SensorValue | None:
    """Return the delay at which the receiver's changes of velocity fit the integrated accelerometer best.

    The antenna is elsewhere than the unit, so it also moves by `omega x r`. Its place r is free, the same for the whole
    log. In each window of 5 s, a constant bias of the acceleration and the first velocity are free.
    None if the speed hardly changes, or without attitude.
    """
    angles = [getattr(signals, name)(log) for name in ("roll", "pitch", "yaw")]
    good = np.isfinite(receiver.vel_ned_mps[:, :2]).all(axis=1)
    if any(angle is None for angle in angles) or np.count_nonzero(good) < 50:
        return None
    if unit.accel_mps2 is None or unit.gyro_radps is None:
        return None
    # In lockstep, the clock of the embedded autopilot stands still between two exchanges. Records have the time of the
    # exchange before they arrived. The samples of the unit also have their own times, which show the difference.
    sample_ns = unit.sample_ns
    if np.max(np.abs(sample_ns - unit.stamp_ns)) > _ONE_CLOCK_NS:
        sample_ns = unit.stamp_ns
    behind_ns = max(float(np.percentile(sample_ns - unit.stamp_ns, 99)), 0.0)
    fix_s = (receiver.stamp_ns[good] + behind_ns - sample_ns[0]) * 1e-9
    fix_mps = receiver.vel_ned_mps[good, :2]
    euler = np.stack([angle.interpolated(sample_ns) for angle in angles], axis=1)
    rows = np.isfinite(euler).all(axis=1) & np.isfinite(unit.accel_mps2).all(axis=1)
    rows &= np.isfinite(unit.gyro_radps).all(axis=1)
    time_s = ((sample_ns - sample_ns[0]) * 1e-9)[rows]
    to_ned = quat_to_matrix(euler_to_quat(np.radians(euler[rows])))[:, :2]
    accel = (to_ned @ unit.accel_mps2[rows][:, :, None])[:, :, 0]
    # Trapezoids: rectangles would be half a step late.
    changes = 0.5 * (accel[:-1] + accel[1:]) * np.diff(time_s)[:, None]
    integral = np.concatenate([np.zeros((1, 2)), np.cumsum(changes, axis=0)])
    # Velocity of the antenna for one metre of its place along each axis of the body, (N, 2 NE, 3)
    swing = to_ned @ np.cross(unit.gyro_radps[rows][:, None, :], np.eye(3)).swapaxes(1, 2)
    signals_at = np.concatenate([integral, swing.reshape(-1, 6)], axis=1)
    windows = []
    for start_s in np.arange(time_s[0] + 1.0, time_s[-1] - _DELAY_WINDOW_S, _DELAY_WINDOW_S):
        inside = (fix_s >= start_s) & (fix_s < start_s + _DELAY_WINDOW_S)
        if np.count_nonzero(inside) >= 8 and np.ptp(fix_mps[inside], axis=0).max() > _LEAST_CHANGE_MPS:
            windows.append(inside)
    if len(windows) < 5:
        return None
    # Sums of products (delay, window, 4, 4) of the difference of velocity and of the three columns of the place
    products = np.zeros((len(_DELAYS_S), len(windows), 4, 4))
    for number, delay_s in enumerate(_DELAYS_S):
        moved = np.stack([np.interp(fix_s - delay_s, time_s, column) for column in signals_at.T], axis=1)
        columns = np.concatenate([(fix_mps - moved[:, :2])[:, :, None], moved[:, 2:].reshape(-1, 2, 3)], axis=2)
        for place, inside in enumerate(windows):
            at = np.stack([np.ones(np.count_nonzero(inside)), fix_s[inside]], axis=1)
            apart = columns[inside].reshape(len(at), 8)
            apart = (apart - at @ np.linalg.lstsq(at, apart, rcond=None)[0]).reshape(-1, 4)
            products[number, place] = apart.T @ apart
    lowest = _lowest(_costs(products.sum(axis=1)))
    if lowest is None:
        return None
    draws = [np.delete(products, left, axis=1).sum(axis=1) for left in range(len(windows))]
    others = np.array([value for draw in draws if (value := _lowest(_costs(draw))) is not None])
    sigma = float(np.sqrt((len(others) - 1) * np.var(others))) if len(others) > 1 else None
    return SensorValue("gnss.latency_s", lowest, sigma)


def _costs(products: Floats) -> Floats:
    """Return what is left of the velocity's square at each delay, with the place of the antenna that fits best."""
    place = np.linalg.pinv(products[:, 1:, 1:], rcond=1e-9, hermitian=True) @ products[:, 1:, :1]
    costs: Floats = products[:, 0, 0] - (products[:, :1, 1:] @ place)[:, 0, 0]
    return costs


def _lowest(costs: Floats) -> float | None:
    """Return the delay at the lowest point of a parabola through the three lowest costs; None at an end."""
    place = int(np.argmin(costs))
    if place in (0, len(costs) - 1):
        return None
    before, here, after = costs[place - 1 : place + 2]
    shift = 0.5 * (before - after) / (before - 2.0 * here + after)
    return float(_DELAYS_S[place] + shift * (_DELAYS_S[1] - _DELAYS_S[0]))


# Barometer
def _barometer(log: Log, rest: RestPeriods) -> Iterator[SensorValue]:
    table = log.tables.get("BARO")
    pressure = None if table is None else numbers(table, "Press")
    if table is None or pressure is None or stacked_columns(table, ("Press",)) is None:
        return
    from_ns, until_ns = rest.stretches[0]
    rows = (table.stamp_ns >= from_ns) & (table.stamp_ns < until_ns) & np.isfinite(pressure)
    if np.count_nonzero(rows) < 50:
        return
    noise = float(np.sqrt(np.mean(np.diff(pressure[rows]) ** 2) / 2.0))
    rate_hz = 1e9 / float(np.median(np.diff(table.stamp_ns[rows])))
    yield SensorValue("barometer.rate_hz", float(round(rate_hz)), None)
    yield SensorValue("barometer.noise_pa", noise, noise / np.sqrt(2.0 * np.count_nonzero(rows)))


def sensors_text(found: SensorEstimate, source: str) -> str:
    """Return the block as YAML, with errors in comments."""
    lines = [f"# Identified by `xitl identify sensors` from {source}, {found.rest_s:.0f} s at rest.", "sensors:"]
    group = ""
    for own in found.values:
        name, _, key = own.key.partition(".")
        if name != group:
            lines.append(f"  {name}:")
            group = name
        error = "" if own.sigma is None else f"± {own.sigma:.2g}"
        remark = ", ".join(part for part in (error, own.note) if part)
        lines.append(f"    {key}: {own.value:.4g}" + (f" # {remark}" if remark else ""))
    return "\n".join([*lines, ""])
