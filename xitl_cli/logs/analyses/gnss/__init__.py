"""Satellite navigation: fixes lost and found, how good they say they are, and whether positions and speeds agree."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.gnss.motion import motion
from xitl_cli.logs.analyses.gnss.outages import fixed_rows, fixes
from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.gaps import regularity
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.columns import numbers, told
from xitl_cli.logs.sensing.fixes import FIX_NAMES, Receiver, receivers
from xitl_cli.logs.sensing.pauses import pauses
from xitl_cli.logs.signals import texts

_TITLE = "GNSS"
_POOR_SHARE = 0.05
_FEW_SATELLITES = 6
_POOR_HDOP = 2.0
_POOR_HORIZONTAL_M, _POOR_SPEED_MPS = 5.0, 1.0  # EKF3 takes a receiver for good up to these
_APART_M = 5.0
_GLITCHING = 1 << 14  # XKF4.SS, as of ArduPilot's nav_filter_status
_ERR_GPS, _ERR_GLITCH = 11, 2


def analyse(log: Log) -> Section | None:
    """None where a recording holds no receiver; a vehicle's log without one is told so."""
    instants = Instants(log)
    found = receivers(log)
    if not found:
        if log.format == "mcap":
            return None
        return Section("gnss", _TITLE, lacks=("No satellite receiver is logged; set the bit GPS of LOG_BITMASK.",))
    pause = pauses(log)
    findings: list[Finding] = []
    for receiver in found:
        findings += fixes(log, receiver, pause, instants)
        findings += _quality(receiver)
    moved = [motion(receiver, instants) for receiver in found]
    findings += [finding for part in moved for finding in part.findings]
    findings += _two_receivers(found, instants)
    findings += _glitches(log, instants)
    return Section(
        "gnss",
        _TITLE,
        facts=tuple(fact for part in moved[:1] for fact in (*_facts(found[0]), *part.facts)),
        findings=tuple(findings),
        grids=(_grid(found), *(grid for part in moved for grid in part.grids)),
        plots=(*_plots(found, findings), *(plot for part in moved[:2] for plot in part.plots)),
        lacks=_lacks(found),
    )


def _quality(receiver: Receiver) -> list[Finding]:
    """Shares of the time with a fix in which the receiver itself says that it is poor."""
    fixed = fixed_rows(receiver)
    if np.count_nonzero(fixed) < 5:
        return []
    judged: list[tuple[str, NDArray[np.bool_], str, str, NDArray[np.int64]]] = []
    if receiver.satellites is not None and np.nan_to_num(receiver.satellites[fixed]).any():
        few = receiver.satellites[fixed] < _FEW_SATELLITES
        judged.append(
            (f"fewer than {_FEW_SATELLITES} satellites", few, receiver.message, receiver.fields["satellites"],
             receiver.stamp_ns[fixed])
        )  # fmt: skip
    if receiver.hdop is not None:
        poor = receiver.hdop[fixed] > _POOR_HDOP
        judged.append(
            (f"a horizontal dilution over {_POOR_HDOP:g}", poor, receiver.message, receiver.fields["hdop"],
             receiver.stamp_ns[fixed])
        )  # fmt: skip
    accuracy = receiver.accuracy
    if accuracy is not None:
        for values, limit, unit, field in (
            (accuracy.horizontal_m, _POOR_HORIZONTAL_M, "m horizontally", "HAcc"),
            (accuracy.speed_mps, _POOR_SPEED_MPS, "m/s in speed", "SAcc"),
        ):
            if values is not None:
                after = accuracy.stamp_ns >= receiver.stamp_ns[int(np.argmax(fixed))]
                judged.append(
                    (f"an accuracy worse than {limit:g} {unit}", values[after] > limit, accuracy.message, field,
                     accuracy.stamp_ns[after])
                )  # fmt: skip
    findings = []
    for what, bad, message, field, stamps in judged:
        if not len(bad) or bad.mean() <= _POOR_SHARE:
            continue
        at = np.flatnonzero(bad)
        findings.append(
            Finding(
                "gnss.poor",
                Severity.NOTICE,
                f"{receiver.name} had {what} for {100.0 * float(bad.mean()):.0f} % of the time with a fix",
                (Evidence(message, field, int(stamps[at[0]]), int(stamps[at[-1]])),),
                "Give the antenna more sky, away from radio and computer; expect the estimator to wander as much.",
            )
        )
    return findings


def _two_receivers(found: list[Receiver], instants: Instants) -> list[Finding]:
    """How far two receivers of one vehicle are apart, over what they usually are."""
    findings = []
    for one, other in combinations([each for each in found if fixed_rows(each).sum() >= 10], 2):
        if one.message.rpartition(":")[0] != other.message.rpartition(":")[0] or _units_differ(one, other):
            continue
        near = np.searchsorted(other.stamp_ns, one.stamp_ns).clip(1, len(other.stamp_ns) - 1)
        near -= (one.stamp_ns - other.stamp_ns[near - 1]) < (other.stamp_ns[near] - one.stamp_ns)
        at_once = np.abs(other.stamp_ns[near] - one.stamp_ns) < 200_000_000
        north = (other.lat_deg[near] - one.lat_deg) * 111_200.0
        east = (other.lon_deg[near] - one.lon_deg) * 111_200.0 * np.cos(np.radians(one.lat_deg))
        apart = np.where(at_once, np.hypot(north, east), np.nan)
        known = np.isfinite(apart)
        if np.count_nonzero(known) < 10:
            continue
        usual, far = float(np.median(apart[known])), float(np.percentile(apart[known], 99.0))
        if far - usual > _APART_M:
            worst = int(np.nanargmax(apart))
            findings.append(
                Finding(
                    "gnss.receivers_apart",
                    Severity.WARNING if far - usual > 3.0 * _APART_M else Severity.NOTICE,
                    f"{one.name} and {other.name} are {usual:.1f} m apart as a rule and {apart[worst]:.1f} m at "
                    f"{instants.text(int(one.stamp_ns[worst]))}",
                    (
                        Evidence(
                            one.message, one.fields["lat"], int(one.stamp_ns[worst]), None, f"{apart[worst]:.1f} m"
                        ),
                    ),
                    "Compare both with the estimate to see which one strayed.",
                )
            )
    return findings


def _units_differ(one: Receiver, other: Receiver) -> bool:
    """Telemetry of a receiver is no second receiver."""
    return {one.message.rpartition(":")[2], other.message.rpartition(":")[2]} == {"XITL_GNSS", "GPS_RAW_INT"}


def _glitches(log: Log, instants: Instants) -> list[Finding]:
    """What the autopilot itself took for a glitch: flags of the estimator, errors, sentences."""
    spans: list[tuple[int, int, str, str]] = []
    table = log.tables.get("XKF4")
    flags = None if table is None else numbers(table, "SS", raw=True)
    if table is not None and flags is not None:
        on = (np.nan_to_num(flags).astype(np.int64) & _GLITCHING) != 0
        if on.any():
            rows = np.flatnonzero(on)
            spans.append((int(table.stamp_ns[rows[0]]), int(table.stamp_ns[rows[-1]]), "XKF4", "SS"))
    table = log.tables.get("ERR")
    if table is not None:
        subsystems, codes = numbers(table, "Subsys", raw=True), numbers(table, "ECode", raw=True)
        if subsystems is not None and codes is not None:
            for row in np.flatnonzero((subsystems == _ERR_GPS) & (codes == _ERR_GLITCH)):
                spans.append((int(table.stamp_ns[row]), int(table.stamp_ns[row]), "ERR", "ECode"))
    for text in texts(log):
        words = text.text.lower()
        if "glitch" in words and "cleared" not in words and ("gps" in words or "compass" not in words):
            message, _, field = text.source.rpartition(".")
            spans.append((text.at_ns, text.at_ns, message, field))
    if not spans:
        return []
    spans.sort()
    return [
        Finding(
            "gnss.glitch",
            Severity.WARNING,
            f"The autopilot took positions for a glitch, first at {instants.text(spans[0][0])}",
            tuple(Evidence(message, field, a, b) for a, b, message, field in spans[:8]),
            "Compare the receiver's positions with the estimate then: interference, or an estimator that went astray.",
        )
    ]


def _facts(receiver: Receiver) -> tuple[Fact, ...]:
    fixed = fixed_rows(receiver)
    first_s = None
    if fixed.any():
        first_s = told((int(receiver.stamp_ns[int(np.argmax(fixed))]) - int(receiver.stamp_ns[0])) * 1e-9)
    return (
        Fact("fix_share_percent", "With a 3D fix or better", told(100.0 * float(fixed.mean())), "%"),
        Fact("first_fix_s", "First 3D fix, from the first message", first_s, "s"),
        Fact("satellites_median", "Satellites, median", _middle(receiver.satellites, fixed)),
        Fact("hdop_median", "Horizontal dilution, median", _middle(receiver.hdop, fixed)),
    )


def _middle(values: NDArray[np.float64] | None, rows: NDArray[np.bool_] | None = None) -> float | None:
    if values is None:
        return None
    chosen = values if rows is None else values[rows]
    chosen = chosen[np.isfinite(chosen)]
    return told(float(np.median(chosen))) if len(chosen) else None


def _grid(found: list[Receiver]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for receiver in found:
        regular, fixed, accuracy = regularity(receiver.sample_ns), fixed_rows(receiver), receiver.accuracy
        kinds = ", ".join(
            f"{FIX_NAMES.get(int(kind), f'status {int(kind)}')} {100.0 * float((receiver.fix == kind).mean()):.0f} %"
            for kind in np.unique(receiver.fix)
        )
        age_ms = None
        if accuracy is not None and accuracy.message_ms is not None:
            age_ms = _middle(accuracy.stamp_ns * 1e-6 - accuracy.message_ms)
        rows.append(
            (
                receiver.name,
                None if regular is None else told(regular.rate_hz),
                None if regular is None else regular.gaps,
                None if regular is None else told(regular.longest_gap_s),
                kinds,
                _middle(receiver.satellites, fixed),
                _middle(receiver.hdop, fixed),
                None if accuracy is None else _middle(accuracy.horizontal_m),
                None if accuracy is None else _middle(accuracy.vertical_m),
                None if accuracy is None else _middle(accuracy.speed_mps),
                None if accuracy is None else _middle(accuracy.interval_ms),
                age_ms,
            )
        )
    columns = (
        "receiver", "Hz", "gaps", "longest s", "fix", "satellites", "HDop", "horizontal ± m", "vertical ± m",
        "speed ± m/s", "interval ms", "logged after ms",
    )  # fmt: skip
    return Grid("receivers", "Receivers, medians", columns, tuple(rows))


def _plots(found: list[Receiver], findings: list[Finding]) -> tuple[Plot, ...]:
    marks = tuple(
        Mark(each.at_ns, finding.key, each.until_ns, finding.severity)
        for finding in findings
        if finding.key in ("gnss.fix_lost", "gnss.silent", "gnss.jump")
        for each in finding.evidence
        if each.at_ns is not None
    )
    view, trust = [], []
    for receiver in found[:3]:
        view.append(Trace(f"{receiver.name} fix type", receiver.stamp_ns, receiver.fix.astype(np.float64), "steps"))
        if receiver.satellites is not None:
            view.append(Trace(f"{receiver.name} satellites", receiver.stamp_ns, receiver.satellites, "steps"))
        if receiver.hdop is not None:
            view.append(Trace(f"{receiver.name} HDop", receiver.stamp_ns, receiver.hdop))
        if receiver.accuracy is not None:
            accuracy = receiver.accuracy
            for name, values in (
                ("horizontal m", accuracy.horizontal_m),
                ("vertical m", accuracy.vertical_m),
                ("speed m/s", accuracy.speed_mps),
            ):
                if values is not None:
                    trust.append(Trace(f"{receiver.name} {name}", accuracy.stamp_ns, values))
    plots = [Plot("gnss_view", "Fix, satellites, dilution", "", tuple(view), marks=marks)]
    if trust:
        plots.append(Plot("gnss_accuracy", "Accuracy as the receiver states it", "m, m/s", tuple(trust), marks=marks))
    return tuple(plots)


def _lacks(found: list[Receiver]) -> tuple[str, ...]:
    lacks = []
    for receiver in found:
        if receiver.accuracy is None or receiver.accuracy.horizontal_m is None:
            lacks.append(f"{receiver.name} states no accuracy (GPA.HAcc).")
        if receiver.week is not None and not (np.nan_to_num(receiver.week[fixed_rows(receiver)]) > 0).any():
            lacks.append(f"{receiver.name} tells no GPS time (week 0): the log cannot be placed in UTC by it.")
    return tuple(lacks)
