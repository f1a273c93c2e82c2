"""Recordings from logs: DataFlash, telemetry, recordings of xitl and bags of ROS."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.geodesy import LocalFrame
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.signals.motion import geodetic_series
from xitl_cli.logs.signals.series import Series, first_instance, make_series, stacked_columns
from xitl_cli.logs.signals.states import rows_in_use
from xitl_cli.plugins.identify.recording import Floats, Quantity, Recording, Samples, channel
from xitl_cli.profile.schema.agents import ReplaySpec
from xitl_cli.replay.motor_schedule import replayed_span_s, schedule_from_pulses
from xitl_cli.replay.pulse_log import read_pulse_log

_TWISTS = ("twist.twist.linear", "twist.linear")


def read_log(path: Path, vessel: VesselSpec, replay: ReplaySpec, source: str) -> Recording:
    """Read motion and commands of a log. source: "estimate", or "receiver" for the raw fixes of the GNSS receiver.

    Raises UserError, with what to record, for a log without outputs, position or heading.
    """
    pulses = read_pulse_log(path)
    schedule = schedule_from_pulses(pulses, replay, vessel)
    start_s, end_s = replayed_span_s(pulses, replay, vessel)
    command_s = start_s + 1e-9 * np.array([*schedule.at_ns, round((end_s - start_s) * 1e9)])
    commands = np.array([*schedule.motors, schedule.motors[-1]])
    keep = np.concatenate([np.diff(command_s) > 0.0, [True]])
    try:
        with open_log(path) as log:
            zero_ns = 0 if log.format == "dataflash" else log.zero_ns
            channels = _receiver_channels(log, zero_ns) if source == "receiver" else _estimated_channels(log, zero_ns)
    except LogError as error:
        raise UserError(str(error)) from error
    if "yaw" not in channels:
        raise UserError(f"{path} has no heading; record ATT (DataFlash), ATTITUDE (telemetry) or a pose (ROS)")
    if "north" not in channels:
        lacking = "GPS" if source == "receiver" else "POS or XKF1 (DataFlash), GLOBAL_POSITION_INT (telemetry)"
        raise UserError(f"{path} has no position; record {lacking} or a pose (ROS)")
    return Recording(str(path), channels, command_s[keep], commands[keep])


def _estimated_channels(log: Log, zero_ns: int) -> dict[Quantity, Samples]:
    """Channels of the autopilot's estimate."""
    channels = _attitude_channels(log, zero_ns)
    local = signals.position_ned(log)
    if local is not None:
        _add(channels, zero_ns, local.path, "north", "east")
    ground = _velocity_ned(log)
    if ground is not None:
        _add(channels, zero_ns, ground, "vel_north", "vel_east")
    elif (body := _velocity_frd(log)) is not None:
        _add(channels, zero_ns, body, "surge", "sway")
    return channels


def _receiver_channels(log: Log, zero_ns: int) -> dict[Quantity, Samples]:
    """Channels of the receiver's fixes, with the attitude of the autopilot."""
    channels = _attitude_channels(log, zero_ns)
    fixes, table = geodetic_series(log, "GPS", ("Lat", "Lng", "Alt")), first_instance(log, "GPS")
    if fixes is None or table is None:
        return channels
    path = LocalFrame(*map(float, fixes.values[0])).ned(*fixes.values.T)
    _add(channels, zero_ns, Series(fixes.stamp_ns, path, "m", "GPS"), "north", "east")
    speed = stacked_columns(table, ("Spd", "GCrs"))
    if speed is not None:
        course = np.radians(speed[:, 1])
        ground = speed[:, :1] * np.stack([np.cos(course), np.sin(course)], axis=1)
        series = make_series(table.stamp_ns, ground, "m/s", "GPS.Spd, GCrs")
        if series is not None:
            _add(channels, zero_ns, series, "vel_north", "vel_east")
    return channels


def _attitude_channels(log: Log, zero_ns: int) -> dict[Quantity, Samples]:
    channels: dict[Quantity, Samples] = {}
    if (yaw := signals.yaw(log)) is not None:
        channels["yaw"] = channel(_seconds(yaw, zero_ns), np.unwrap(np.radians(yaw.values)))
    if (rate := signals.yaw_rate(log)) is not None:
        channels["yaw_rate"] = channel(_seconds(rate, zero_ns), np.radians(rate.values), average=True)
    return channels


def _add(channels: dict[Quantity, Samples], zero_ns: int, series: Series, first: Quantity, second: Quantity) -> None:
    time_s = _seconds(series, zero_ns)
    channels[first] = channel(time_s, series.values[:, 0])
    channels[second] = channel(time_s, series.values[:, 1])


def _seconds(series: Series, zero_ns: int) -> Floats:
    return np.asarray((series.stamp_ns - zero_ns) * 1e-9, dtype=np.float64)


def _velocity_ned(log: Log) -> Series | None:
    """Velocity north and east (m/s) by the estimator's core in use, or from telemetry."""
    for name, columns in (
        ("XKF1", ("VN", "VE")),
        ("NKF1", ("VN", "VE")),
        ("LOCAL_POSITION_NED", ("vx", "vy")),
        ("GLOBAL_POSITION_INT", ("vx", "vy")),
    ):
        table = rows_in_use(log, name) if name.endswith("KF1") else first_instance(log, name)
        if table is not None and (values := stacked_columns(table, columns)) is not None:
            return make_series(table.stamp_ns, values, "m/s", name)
    return None


def _velocity_frd(log: Log) -> Series | None:
    """Velocity ahead and to starboard (m/s) of an odometry, whose twist is in body axes (REP 105)."""
    if not log.of_topics:
        return None
    names = [name for name in log.tables if "truth" not in name.lower()]
    for name in sorted(names, key=lambda name: name != "/estimate/odometry"):
        for twist in _TWISTS:
            linear = stacked_columns(log.tables[name], (f"{twist}.x", f"{twist}.y"))
            if linear is not None:
                return make_series(log.tables[name].stamp_ns, linear * [1.0, -1.0], "m/s", name)
    return None
