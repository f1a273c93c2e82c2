"""When the vehicle was armed, in which mode, and what it said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.words.heard import autopilot_heartbeats

_ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_ARMED_EVENT, _DISARMED_EVENT = 10, 11
_ARMED_TEXTS = {
    "Throttle armed": True,
    "Throttle disarmed": False,
    "Arming motors": True,
    "Disarming motors": False,
    "Armed": True,
    "Disarmed": False,
}


@dataclass(frozen=True, slots=True)
class Span:
    """until_ns: where the next one begins, or the log ends."""

    from_ns: int
    until_ns: int
    text: str
    source: str


@dataclass(frozen=True, slots=True)
class Text:
    """severity: MAVLink's, 0 emergency to 7 debug; None where the log does not keep it."""

    at_ns: int
    text: str
    severity: int | None
    source: str


def armed(log: Log) -> list[Span]:
    """While the motors were armed, in the order of time."""
    states = _arm_states(log)
    if states is None:
        return []
    stamps, on, source = states
    return [span for span in _spans(log, stamps, on.astype(np.int64), source, {1: "armed"}) if span.text == "armed"]


def modes(log: Log) -> list[Span]:
    """One after another, by the vehicle's names."""
    from xitl_cli.logs.words.modes import mode_names

    table = log.tables.get("MODE")
    if table is not None and "ModeNum" in table.columns:
        numbers = table.values("ModeNum", raw=True)
        return _spans(log, table.stamp_ns, numbers, "MODE.ModeNum", mode_names(log))
    beats = autopilot_heartbeats(log)
    if beats is None:
        return []
    return _spans(
        log, beats.stamp_ns, beats.values("custom_mode", raw=True), f"{beats.name}.custom_mode", mode_names(log)
    )


def texts(log: Log) -> list[Text]:
    """Sentences of the autopilot and of the run, in the order of time."""
    found: list[Text] = []
    for name, field, level in (
        ("MSG", "Message", None),
        ("STATUSTEXT", "text", "severity"),
        ("/log", "message", None),
    ):
        table = log.tables.get(name)
        if table is None or field not in table.columns:
            continue
        levels = None if level is None or level not in table.columns else table.values(level, raw=True)
        for row, (at_ns, text) in enumerate(zip(table.stamp_ns.tolist(), table.values(field), strict=True)):
            severity = None if levels is None else int(levels[row])
            found.append(Text(at_ns, str(text), severity, f"{name}.{field}"))
    return sorted(found, key=lambda each: each.at_ns)


def _arm_states(log: Log) -> tuple[NDArray[np.int64], NDArray[np.bool_], str] | None:
    table = log.tables.get("ARM")
    if table is not None and "ArmState" in table.columns:
        return _from_start(log, table.stamp_ns, table.values("ArmState", raw=True) != 0, "ARM.ArmState")
    table = log.tables.get("EV")
    if table is not None and "Id" in table.columns:
        numbers = table.values("Id", raw=True)
        either = (numbers == _ARMED_EVENT) | (numbers == _DISARMED_EVENT)
        if either.any():
            return _from_start(log, table.stamp_ns[either], numbers[either] == _ARMED_EVENT, "EV.Id")
    if (said := _said(log)) is not None:
        return said
    table = log.tables.get("/actuators")
    if table is not None and "armed" in table.columns:
        return table.stamp_ns, table.values("armed") != 0, "/actuators.armed"
    beats = autopilot_heartbeats(log)
    if beats is None:
        return None
    return beats.stamp_ns, (beats.values("base_mode", raw=True) & _ARMED_FLAG) != 0, f"{beats.name}.base_mode"


def _from_start(
    log: Log, stamp_ns: NDArray[np.int64], on: NDArray[np.bool_], source: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    """Only changes are written: what is disarmed first was armed when the log began, unless that is its first row."""
    if len(on) and not on[np.argmin(stamp_ns)] and log.span_ns is not None and stamp_ns.min() > log.span_ns[0]:
        return np.append(stamp_ns, log.span_ns[0]), np.append(on, True), source
    return stamp_ns, on, source


def _said(log: Log) -> tuple[NDArray[np.int64], NDArray[np.bool_], str] | None:
    """By its sentences: a log that arming began has no row of it, only what was said just before."""
    table = log.tables.get("MSG")
    if table is None or "Message" not in table.columns:
        return None
    said = [
        (at_ns, _ARMED_TEXTS[text])
        for at_ns, text in zip(table.stamp_ns.tolist(), table.values("Message").tolist(), strict=True)
        if text in _ARMED_TEXTS
    ]
    if not said:
        return None
    stamps = np.array([at_ns for at_ns, _ in said], dtype=np.int64)
    return _from_start(log, stamps, np.array([on for _, on in said]), "MSG.Message")


def _spans(
    log: Log, stamp_ns: NDArray[np.int64], numbers: NDArray[np.int64], source: str, names: dict[int, str]
) -> list[Span]:
    """Where a number changes a new span begins; the last one ends with the log."""
    if not len(stamp_ns):
        return []
    order = np.argsort(stamp_ns, kind="stable")
    stamps, values = stamp_ns[order], np.asarray(numbers)[order].astype(np.int64)
    begins = np.flatnonzero(np.concatenate(([True], values[1:] != values[:-1])))
    span = log.span_ns
    ends = np.concatenate((stamps[begins[1:]], [stamps[-1] if span is None else max(span[1], int(stamps[-1]))]))
    return [
        Span(int(stamps[begin]), int(end), names.get(int(values[begin]), f"mode {int(values[begin])}"), source)
        for begin, end in zip(begins, ends, strict=True)
    ]
