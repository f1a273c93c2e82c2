"""Channels of the remote control: failsafes, a link that holds its last values, signal strength."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.columns import numbers, some, tables_of, told
from xitl_cli.logs.sensing.holding import holding
from xitl_cli.logs.sensing.settings import armed_rows
from xitl_cli.logs.signals import Series

_IN_FAILSAFE = 2  # RCI2.Flags
_ERR_RADIO = 5
_HELD_S = 5.0
_WEAK, _WEAK_SHARE = 0.3, 0.05
_TITLE = "Remote control"
_NO_RSSI = 255


def inputs(log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float], instants: Instants) -> Section:
    findings = _failsafe(log, channels, parameters, instants)
    if channels:
        findings += _held(channels, instants)
    findings += _strength(log)
    lacks = [] if channels else ["No remote control input is logged; none is connected, or the bit RCIN is not set."]
    return Section(
        "radio",
        _TITLE,
        facts=(Fact("input_channels", "Input channels in use", len(channels)),),
        findings=tuple(findings),
        grids=(_grid(channels),) if channels else (),
        plots=_plots(channels),
        lacks=tuple(lacks),
    )


def _failsafe(
    log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float], instants: Instants
) -> list[Finding]:
    """From the receiver's flag, the throttle channel under FS_THR_VALUE, or the error that was logged."""
    for stamps, lost, message, field in _losses(log, channels, parameters):
        if not lost.any():
            continue
        edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(np.int8)))
        spans = [
            (int(stamps[a]), int(stamps[min(b, len(stamps) - 1)]))
            for a, b in zip(edges[0::2], edges[1::2], strict=True)
        ]
        armed = armed_rows(log, stamps)
        sailing = lost if armed is None else lost & armed
        if lost.all():
            return [
                Finding(
                    "radio.none",
                    Severity.NOTICE,
                    "No remote control was heard in this log",
                    (Evidence(message, field, spans[0][0], spans[0][1]),),
                    "As intended without a transmitter; else switch it on and check the receiver.",
                )
            ]
        times = some([f"{instants.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spans])
        return [
            Finding(
                "radio.failsafe",
                Severity.WARNING if sailing.any() else Severity.NOTICE,
                f"Remote control was lost {'once' if len(spans) == 1 else f'{len(spans)} times'}: at {times}"
                + ("" if sailing.any() else ", only while disarmed"),
                tuple(Evidence(message, field, a, b) for a, b in spans[:8]),
                "Check range, antennas and FS_THR_VALUE; see in the modes what the failsafe did.",
            )
        ]
    return []


def _losses(
    log: Log, channels: Mapping[int, Series], parameters: Mapping[str, float]
) -> list[tuple[NDArray[np.int64], NDArray[np.bool_], str, str]]:
    """Stamps, whether the remote control was lost at each, message and field: the best witness first."""
    found: list[tuple[NDArray[np.int64], NDArray[np.bool_], str, str]] = []
    table = log.tables.get("RCI2")
    flags = None if table is None else numbers(table, "Flags", raw=True)
    if table is not None and flags is not None:
        found.append((table.stamp_ns, (np.nan_to_num(flags).astype(np.int64) & _IN_FAILSAFE) != 0, "RCI2", "Flags"))
    table = log.tables.get("ERR")
    if table is not None:
        subsystems, codes = numbers(table, "Subsys", raw=True), numbers(table, "ECode", raw=True)
        if subsystems is not None and codes is not None and (rows := subsystems == _ERR_RADIO).any():
            found.append((table.stamp_ns[rows], codes[rows] > 0, "ERR", "ECode"))
    throttle = channels.get(int(parameters.get("RCMAP_THROTTLE", 3)))
    limit = parameters.get("FS_THR_VALUE", 0.0)
    if throttle is not None and limit > 0.0 and parameters.get("FS_THR_ENABLE", 1.0) > 0.0:
        message, _, field = throttle.source.rpartition(".")
        found.append((throttle.stamp_ns, throttle.values < limit, message, field))
    return found


def _held(channels: Mapping[int, Series], instants: Instants) -> list[Finding]:
    """Channels that otherwise tremble all the time, and then all stand still: the receiver holds its last values."""
    shortest = min(len(each.values) for each in channels.values())
    first = next(iter(channels.values()))
    rows = np.stack([each.values[:shortest] for each in channels.values()], axis=1)
    steps = np.diff(first.stamp_ns[:shortest])
    if shortest < 20 or not (steps > 0).any():
        return []
    found = holding(rows, float(np.median(steps)) * 1e-9, shortest_s=_HELD_S)
    if found.usual >= 1.5 or not found.holds or found.repeated > 0.8:
        return []
    message = first.source.rpartition(".")[0]
    spans = [(int(first.stamp_ns[hold.first]), int(first.stamp_ns[hold.last])) for hold in found.holds]
    times = some([f"from {instants.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in spans])
    return [
        Finding(
            "radio.held",
            Severity.NOTICE,
            f"All channels of the remote control stood still {times}, though they tremble otherwise",
            tuple(Evidence(message, None, a, b) for a, b in spans[:8]),
            "A receiver set to hold hides a lost link: set it to send no pulses, so that the failsafe sees it.",
        )
    ]


def _strength(log: Log) -> list[Finding]:
    """Share of the time with little signal; 255 of telemetry is unknown."""
    findings = []
    for table in tables_of(log, ("RSSI", "RC_CHANNELS")):
        for field, scale, what in (("RXRSSI", 1.0, "signal strength"), ("RXLQ", 100.0, "link quality"),
                                   ("rssi", 254.0, "signal strength")):  # fmt: skip
            values = numbers(table, field, raw=True)
            if values is None:
                continue
            known = np.isfinite(values) & (values >= 0.0) & (values != _NO_RSSI if field == "rssi" else True)
            level, stamps = values[known] / scale, table.stamp_ns[known]
            if len(level) < 5 or not level.any():
                continue
            weak = level < _WEAK
            if float(weak.mean()) > _WEAK_SHARE:
                at = np.flatnonzero(weak)
                findings.append(
                    Finding(
                        "radio.weak",
                        Severity.NOTICE,
                        f"The {what} of the remote control was under {100.0 * _WEAK:.0f} % for "
                        f"{100.0 * float(weak.mean()):.0f} % of the time, at least {100.0 * float(level.min()):.0f} %",
                        (Evidence(table.name, field, int(stamps[at[0]]), int(stamps[at[-1]])),),
                        "Check antennas and range before the link is lost.",
                    )
                )
    return findings


def _grid(channels: Mapping[int, Series]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for channel, each in channels.items():
        low, high = float(each.values.min()), float(each.values.max())
        moves = "constant" if low == high else f"{100.0 * float((np.diff(each.values) != 0.0).mean()):.0f} % of rows"
        rows.append((channel, told(low), told(float(np.median(each.values))), told(high), moves))
    return Grid("inputs", "Remote control, µs", ("channel", "least", "median", "most", "changes"), tuple(rows))


def _plots(channels: Mapping[int, Series]) -> tuple[Plot, ...]:
    """Of the channels that move."""
    traces = [
        Trace(f"channel {channel}", each.stamp_ns, each.values, "steps")
        for channel, each in channels.items()
        if np.ptp(each.values) > 0.0
    ]
    return (Plot("inputs", "Remote control", "µs", tuple(traces[:8])),) if traces else ()
