"""States reported by the autopilot: vehicle kind, parameters, events, errors, arming, modes, texts, RC, outputs.

Lanes of ArduPilot's estimator: the core in use over time.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

import xitl_cli.logs.signals.px4 as px4
from xitl_cli.logs.model.codes import (
    ARMED,
    DISARMED,
    MODES,
    VehicleKind,
    kind_from_build,
    kind_from_mav_type,
    kind_from_name,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Flags, Selection, Stamps, Table, first_of
from xitl_cli.logs.signals.series import Series, channel_series, first_instance, make_series, numbers, tables_of

CORE = "C"
_PRIMARY = "PI"


def lanes(log: Log, family: str) -> tuple[Stamps, Stamps] | None:
    """(N,) stamps, and the core in use by PI of a family ("XKF", "NKF"), in order of time; None if not logged."""
    table = log.tables.get(f"{family}4")
    if table is None or _PRIMARY not in table.columns or not len(table):
        return None
    order = np.argsort(table.stamp_ns, kind="stable")
    return table.stamp_ns[order], np.asarray(table.values(_PRIMARY, raw=True))[order].astype(np.int64)


def rows_in_use(log: Log, name: str) -> Table | None:
    """Rows of XKF1, XKF3, NKF1 … of the core in use at each row.

    Without a logged core in use, and for other messages, the result is that of `first_instance`.
    """
    table, known = log.tables.get(name), lanes(log, name[:-1])
    if table is None or CORE not in table.columns or known is None:
        return first_instance(log, name)
    stamps, numbers = known
    at = np.clip(np.searchsorted(stamps, table.stamp_ns, side="right") - 1, 0, None)
    own = np.asarray(table.values(CORE, raw=True)).astype(np.int64) == numbers[at]
    return Selection(table, own) if own.any() else first_instance(log, name)


_PREFIXES = ("", "/link/agent/rx:")
_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: a ground station, a gimbal, a camera …


def autopilot_heartbeats(log: Log) -> Table | None:
    """HEARTBEAT of the first autopilot in the log, without ground stations and payloads."""
    for prefix in _PREFIXES:
        table = log.tables.get(f"{prefix}HEARTBEAT")
        if table is None or not {"autopilot", "type", "custom_mode", "base_mode"} <= set(table.columns):
            continue
        pilots = np.asarray(table.values("autopilot", raw=True)) != _NO_AUTOPILOT
        if not pilots.any():
            continue
        if "_sysid" in table.columns:
            systems = np.asarray(table.values("_sysid", raw=True))
            pilots &= systems == systems[pilots][0]
        return Selection(table, pilots)
    return None


def autopilot_messages(log: Log, message: str) -> Table | None:
    """Rows of this message from the system of the autopilot; None if there are none.

    Without a heartbeat, which identifies that system, all rows.
    """
    table = next((log.tables[f"{prefix}{message}"] for prefix in _PREFIXES if f"{prefix}{message}" in log.tables), None)
    if table is None or "_sysid" not in table.columns:
        return table
    beats = autopilot_heartbeats(log)
    if beats is None:
        return table
    own = np.asarray(table.values("_sysid", raw=True)) == beats.values("_sysid", raw=True)[0]
    return Selection(table, own) if own.any() else None


_ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
_FIRMWARE = re.compile(r"^(?:APM:|Ardu)?(?:Rover|Copter|Plane|Sub|Heli)\b|^AntennaTracker|^Blimp|ArduRover V\d", re.I)
_FIRST_TEXTS = 200


def vehicle_kind(log: Log) -> VehicleKind:
    """Kind of vehicle by VER.BU, by the firmware's name in MSG, or by the type in its heartbeats."""
    if log.format == "ulog":
        return px4.vehicle_kind(log)
    version = log.tables.get("VER")
    if version is not None and "BU" in version.columns:
        found = kind_from_build(int(version.values("BU", raw=True)[-1]))
        if found != "unknown":
            return found
    name = firmware_text(log)
    if name is not None and (found := kind_from_name(name)) != "unknown":
        return found
    beats = autopilot_heartbeats(log)
    if beats is None or int(beats.values("autopilot", raw=True)[0]) != _ARDUPILOT:
        return "unknown"
    return kind_from_mav_type(int(beats.values("type", raw=True)[0]))


def firmware_text(log: Log) -> str | None:
    """Name of the firmware from its first texts: "ArduRover V4.7.0-dev (2598e9d4)"."""
    for table, field in (("MSG", "Message"), ("STATUSTEXT", "text"), ("/log", "message")):
        found = log.tables.get(table)
        if found is None or field not in found.columns:
            continue
        for text in found.values(field, slice(0, _FIRST_TEXTS)):
            if _FIRMWARE.search(str(text)):
                return str(text).strip()
    return None


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One value of one parameter."""

    at_ns: int
    name: str
    value: float
    default: float | None
    """Default of the firmware; None if not logged."""
    source: str
    """Message that contains the value."""


def parameter_rows(log: Log) -> list[ParameterRow]:
    """Parameter values in the log's order. Rows without a name or a number are omitted."""
    for source, name, value, table in (
        ("PARM", "Name", "Value", log.tables.get("PARM")),
        ("parameters", "name", "value", px4.topic(log, "parameters")),
        ("PARAM_VALUE", "param_id", "param_value", autopilot_messages(log, "PARAM_VALUE")),
    ):
        if table is None or name not in table.columns or value not in table.columns:
            continue
        names = table.values(name)
        values = np.asarray(table.values(value), dtype=np.float64)
        defaults = np.full(len(values), np.nan)
        if (default := first_of(table, ("Default", "default"))) is not None:
            defaults = np.asarray(table.values(default), dtype=np.float64)
        return [
            ParameterRow(at_ns, str(text), number, usual if np.isfinite(usual) else None, source)
            for at_ns, text, number, usual in zip(
                table.stamp_ns.tolist(), names, values.tolist(), defaults.tolist(), strict=True
            )
            if str(text) and np.isfinite(number)
        ]
    return []


def last_parameters(log: Log) -> dict[str, float]:
    """Last value of each parameter in the log."""
    return {row.name: row.value for row in parameter_rows(log)}


def error_rows(log: Log) -> list[tuple[int, int, int]]:
    """(stamp, subsystem, code) in order of time."""
    table = log.tables.get("ERR")
    names = ("Subsys", "ECode")
    if table is None or not all(name in table.columns and table.columns[name].kind == "number" for name in names):
        return []
    order = np.argsort(table.stamp_ns, kind="stable")
    columns = (np.asarray(table.values(name, raw=True))[order].astype(np.int64) for name in ("Subsys", "ECode"))
    return list(zip(table.stamp_ns[order].tolist(), *(column.tolist() for column in columns), strict=True))


def event_rows(log: Log) -> list[tuple[int, int]]:
    """(stamp, number) of EV, in the log's order."""
    table = log.tables.get("EV")
    if table is None or "Id" not in table.columns:
        return []
    numbers = np.asarray(table.values("Id", raw=True)).astype(np.int64).tolist()
    return list(zip(table.stamp_ns.tolist(), numbers, strict=True))


LOCKSTEP = "Lockstep:"
"""Beginning of the embedded autopilot's text about a lockstep run."""


def first_text(log: Log, beginning: str) -> tuple[int, str] | None:
    """Stamp and text of the first MSG with this beginning, among the first 50."""
    table = log.tables.get("MSG")
    if table is None or "Message" not in table.columns:
        return None
    said = zip(table.stamp_ns[:50].tolist(), map(str, table.values("Message", slice(0, 50))), strict=True)
    return next((row for row in said if row[1].startswith(beginning)), None)


_ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_ARMED_TEXTS = {"Throttle armed": True, "Arming motors": True, "Armed": True} | {
    "Throttle disarmed": False, "Disarming motors": False, "Disarmed": False
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class StateSpan:
    """A span with one state."""

    from_ns: int
    until_ns: int
    """Beginning of the next span, or end of the log."""
    text: str
    source: str


@dataclass(frozen=True, slots=True)
class LogText:
    """A logged text."""

    at_ns: int
    text: str
    severity: int | None
    """MAVLink severity, 0 emergency to 7 debug; None if not logged."""
    source: str


def armed(log: Log) -> list[StateSpan]:
    """Spans in which the motors were armed, in order of time."""
    states = _arm_states(log)
    if states is None:
        return []
    stamps, on, source = states
    # Old copters stop logging before they write the disarming, so two armings have a disarming in between.
    spans = _state_spans(log, stamps, on.astype(np.int64), source, {1: "armed"}, again=1 if source == "EV.Id" else None)
    return [span for span in spans if span.text == "armed"]


def modes(log: Log) -> list[StateSpan]:
    """Mode spans in order of time, with the vehicle's names of modes."""
    table = log.tables.get("MODE")
    column = None if table is None else first_of(table, ("ModeNum", "Mode"))
    if table is not None and column is not None and table.columns[column].kind == "number":
        numbers = table.values(column, raw=True)
        return _state_spans(log, table.stamp_ns, numbers, f"MODE.{column}", dict(MODES[vehicle_kind(log)]))
    if (states := px4.nav_states(log)) is not None:
        return _state_spans(log, *states, dict(px4.NAV_STATES))
    beats = autopilot_heartbeats(log)
    if beats is None:
        table = bridge_topic(log, "state", "mode")
        if table is None or table.columns["mode"].kind != "text" or not len(table):
            return []
        names, numbers_of = np.unique(table.values("mode"), return_inverse=True)
        return _state_spans(log, table.stamp_ns, numbers_of, f"{table.name}.mode", dict(enumerate(names.tolist())))
    return _state_spans(
        log,
        beats.stamp_ns,
        beats.values("custom_mode", raw=True),
        f"{beats.name}.custom_mode",
        dict(MODES[vehicle_kind(log)]),
    )


_SEVERITIES = {5: 2, 4: 3, 3: 4, 2: 6, 1: 7}
"""MAV_SEVERITY of a level of foxglove.Log."""


def texts(log: Log) -> list[LogText]:
    """Texts of the autopilot and of the run, in order of time."""
    found: list[LogText] = []
    sources = (
        ("MSG", "Message", None),
        ("STATUSTEXT", "text", "severity"),
        ("/log", "message", "level"),
        ("logged_messages", "message", "level"),
    )
    for name, field, level in sources:
        table = log.tables.get(name)
        if table is None or field not in table.columns:
            continue
        levels = None if level is None or level not in table.columns else table.values(level, raw=True)
        for row, (at_ns, text) in enumerate(zip(table.stamp_ns.tolist(), table.values(field), strict=True)):
            severity = None if levels is None else int(levels[row])
            if name == "/log" and severity is not None:
                severity = _SEVERITIES.get(severity)
            found.append(LogText(at_ns, str(text), severity, f"{name}.{field}"))
    return sorted(found, key=lambda text: text.at_ns)


def _arm_states(log: Log) -> tuple[Stamps, Flags, str] | None:
    if (states := px4.arm_states(log)) is not None:
        return states
    table = log.tables.get("ARM")
    if table is not None and "ArmState" in table.columns:
        return _from_start(log, table.stamp_ns, table.values("ArmState", raw=True) != 0, "ARM.ArmState")
    table = log.tables.get("EV")
    if table is not None and "Id" in table.columns:
        numbers = table.values("Id", raw=True)
        either = (numbers == ARMED) | (numbers == DISARMED)
        if either.any():
            return _from_start(log, table.stamp_ns[either], numbers[either] == ARMED, "EV.Id")
    if (states := _states_from_texts(log)) is not None:
        return states
    table = log.tables.get("STAT")  # from Plane
    if table is not None and "Armed" in table.columns:
        return table.stamp_ns, table.values("Armed", raw=True) != 0, "STAT.Armed"
    table = log.tables.get("/actuators")
    if table is not None and "armed" in table.columns:
        return table.stamp_ns, table.values("armed") != 0, "/actuators.armed"
    beats = autopilot_heartbeats(log)
    if beats is None:
        bridged = bridge_topic(log, "state", "armed")
        return None if bridged is None else (bridged.stamp_ns, bridged.values("armed") != 0, f"{bridged.name}.armed")
    return beats.stamp_ns, (beats.values("base_mode", raw=True) & _ARMED_FLAG) != 0, f"{beats.name}.base_mode"


def _from_start(log: Log, stamp_ns: Stamps, on: Flags, source: str) -> tuple[Stamps, Flags, str]:
    """Add the state at the start of the log. Only changes are logged: a vehicle that is first disarmed was armed
    before, unless that is its first row."""
    if len(on) and not on[np.argmin(stamp_ns)] and log.span_ns is not None and stamp_ns.min() > log.span_ns[0]:
        return np.append(stamp_ns, log.span_ns[0]), np.append(on, True), source
    return stamp_ns, on, source


def _states_from_texts(log: Log) -> tuple[Stamps, Flags, str] | None:
    """Arming from texts. A log that starts at the arming has no row of it, only the text just before."""
    table = log.tables.get("MSG")
    if table is None or "Message" not in table.columns:
        return None
    changes = [
        (at_ns, _ARMED_TEXTS[text])
        for at_ns, text in zip(table.stamp_ns.tolist(), table.values("Message").tolist(), strict=True)
        if text in _ARMED_TEXTS
    ]
    if not changes:
        return None
    stamps = np.array([at_ns for at_ns, _ in changes], dtype=np.int64)
    return _from_start(log, stamps, np.array([on for _, on in changes]), "MSG.Message")


def _state_spans(
    log: Log, stamp_ns: Stamps, numbers: Stamps, source: str, names: dict[int, str], again: int | None = None
) -> list[StateSpan]:
    """Spans of a number: a new span begins if the number changes, or is `again`. The last span ends with the log."""
    if not len(stamp_ns):
        return []
    order = np.argsort(stamp_ns, kind="stable")
    stamps, values = stamp_ns[order], np.asarray(numbers)[order].astype(np.int64)
    begins = np.flatnonzero(np.concatenate(([True], (values[1:] != values[:-1]) | (values[1:] == again))))
    span = log.span_ns
    ends = np.concatenate((stamps[begins[1:]], [stamps[-1] if span is None else max(span[1], int(stamps[-1]))]))
    return [
        StateSpan(int(stamps[begin]), int(end), names.get(int(values[begin]), f"mode {int(values[begin])}"), source)
        for begin, end in zip(begins, ends, strict=True)
    ]


_SIMULATOR_TABLES = ("SIM", "SIM2", "SIMSTATE", "/truth/state")


_PX4_PARAMETERS = ("parameters", "name", "value")


def parameter_values(log: Log) -> dict[str, float]:
    """Last logged value of each parameter (PARM, else PARAM_VALUE). Empty if the log has none."""
    found: dict[str, float] = {}
    for kind, name, value in (("PARAM_VALUE", "param_id", "param_value"), ("PARM", "Name", "Value"), _PX4_PARAMETERS):
        for table in tables_of(log, (kind,)):
            figures = numbers(table, value)
            if figures is None or name not in table.columns or table.columns[name].kind != "text":
                continue
            names = table.values(name)
            found.update(
                (str(key), float(figure)) for key, figure in zip(names, figures, strict=True) if math.isfinite(figure)
            )
    return found


def sensors_simulated(log: Log) -> bool:
    """Whether the log shows that its sensors were simulated: by SIM records of ArduPilot, or as a run of xitl."""
    return any(name in log.tables for name in _SIMULATOR_TABLES) or bool(tables_of(log, _SIMULATOR_TABLES))


def arming_known(log: Log) -> bool:
    """Whether the log would show an arming. If it would, and shows none, the vehicle was never armed.

    A DataFlash log that is written while disarmed (LOG_DISARMED) holds the arming itself, as a row or a text.
    """
    if any(name in log.tables for name in ("ARM", "/actuators", "vehicle_status")) or tables_of(log, ("HEARTBEAT",)):
        return True
    texts_kept = any(name in log.tables for name in ("EV", "MSG"))
    return log.format == "dataflash" and texts_kept and parameter_values(log).get("LOG_DISARMED", 0.0) > 0.0


def armed_rows(log: Log, stamp_ns: Stamps) -> Flags | None:
    """(N,) whether the motors were armed at each stamp; None if unknown."""
    spans = armed(log)
    if not spans and not arming_known(log):
        return None
    on = np.zeros(len(stamp_ns), dtype=np.bool_)
    for span in spans:
        on |= (stamp_ns >= span.from_ns) & (stamp_ns <= span.until_ns)
    return on


# C1 since 2015; before that Ch1 (Copter) and Chan1 (Plane, Rover).
_CHANNEL = re.compile(r"C(?:h|han)?([0-9]{1,2})|servo([0-9]{1,2})_raw|chan([0-9]{1,2})_raw")


def outputs(log: Log) -> dict[int, Series]:
    """Outputs by channel from 1: pulse widths (us), or commands from -1 to 1 (unit "") if an xitl recording has
    them."""
    commands = log.tables.get("/actuators")
    if commands is not None and "command" in commands.columns:
        values = np.asarray(commands.values("command"), dtype=np.float64)
        if values.ndim == 2:
            return channel_series(commands, values, "", "command", used_only=False)
    return pulses(log)


def output_names(log: Log) -> dict[int, str]:
    """Function of each output, if an xitl recording has it: `propeller 0`, `rudder 1`."""
    commands = log.tables.get("/actuators")
    if commands is None or "names" not in commands.columns or not len(commands.stamp_ns):
        return {}
    return dict(enumerate(str(commands.values("names")[-1]).split(", "), start=1))


def pulses(log: Log) -> dict[int, Series]:
    """Outputs by channel from 1; only pulse widths (us)."""
    if log.format == "ulog":
        return px4.outputs(log)
    return _pulses(log, ("RCOU", "RCO2", "RCO3"), "SERVO_OUTPUT_RAW", "rc/out")


def rc_inputs(log: Log) -> dict[int, Series]:
    """RC inputs by channel from 1: pulse widths (us)."""
    return _pulses(log, ("RCIN", "RCI2"), "RC_CHANNELS", "rc/in")


def _bridged_pulses(log: Log, ending: str) -> dict[int, Series]:
    table = bridge_topic(log, ending, "channels")
    channels = None if table is None else numbers(table, "channels", raw=True)
    if table is None or channels is None or channels.ndim != 2:
        return {}
    return channel_series(table, channels, "us", "channels", used_only=True)


def bridge_topic(log: Log, ending: str, column: str) -> Table | None:
    """A topic of MAVROS by its ending, such as `rc/out` of `/mavros/rc/out`."""
    for name, table in log.tables.items() if log.of_topics else ():
        if name.endswith(f"/{ending}") and column in table.columns:
            return table
    return None


def _pulses(log: Log, logged: tuple[str, ...], message: str, bridged: str) -> dict[int, Series]:
    """Pulse widths by channel. bridged: ending of the MAVROS topic that has them."""
    found = _bridged_pulses(log, bridged)
    for name in (*logged, message, f"/link/agent/rx:{message}"):
        table = first_instance(log, name)
        if table is None:
            continue
        for column in table.columns:
            match = _CHANNEL.fullmatch(column)
            if match is None:
                continue
            channel = int(match[1] or match[2] or match[3])
            if channel in found:
                continue
            pulse = make_series(table.stamp_ns, table.values(column, raw=True), "us", f"{name}.{column}")
            if pulse is not None and (pulse.values != 0.0).any():
                found[channel] = pulse
    return dict(sorted(found.items()))
