"""Satellite navigation: fixes lost and found, stated accuracy, and agreement of positions and speeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import EKF_GPS_GLITCHING, ERR_GPS
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.signals import texts
from xitl_cli.logs.signals.gaps import regularity
from xitl_cli.logs.signals.receivers import FIX_3D, FIX_NAMES, GnssReceiver, gnss_receivers
from xitl_cli.logs.signals.series import listed, numbers, significant
from xitl_cli.logs.signals.spans import covered_share, dense_end_ns, find_holds, log_pauses, spells
from xitl_cli.logs.signals.states import armed_rows, error_rows, rows_in_use
from xitl_cli.plugins.logs.analyses.arming import shut_down
from xitl_cli.plugins.logs.analyses.gnss_drift import GnssDrift, gnss_drifts, velocity_jumped, wrong_velocity
from xitl_cli.plugins.logs.analyses.sensor_faults import switched_off

_RTK = 5
_SILENT_S = 1.0


def fixed_rows(receiver: GnssReceiver) -> Flags:
    good: Flags = receiver.fix >= FIX_3D
    return good


def fix_findings(log: Log, receiver: GnssReceiver, pause: Stamps, clock: LogClock) -> Iterator[Finding]:
    """Fixes lost after the first one, and a first fix that never occurred."""
    fixed = fixed_rows(receiver)
    field = receiver.fields["fix"]
    if not fixed.any():
        best = FIX_NAMES.get(int(receiver.fix.max()), f"status {int(receiver.fix.max())}")
        yield Finding.warning(
            "gnss.no_fix",
            f"{receiver.name} never had a 3D fix; the best was: {best}",
            (Evidence(receiver.message, field, int(receiver.stamp_ns[0]), int(receiver.stamp_ns[-1])),),
            "Check antenna and sky; disable a receiver that is not fitted.",
        )
        return
    yield from _outages(log, receiver, fixed, pause, clock)
    fell = np.flatnonzero((receiver.fix[:-1] >= _RTK) & (receiver.fix[1:] < receiver.fix[:-1]) & fixed[1:])
    if len(fell):
        times = listed([clock.text(int(receiver.stamp_ns[row + 1])) for row in fell])
        yield Finding.notice(
            "gnss.rtk_lost",
            f"{receiver.name} lost its RTK solution {_times(len(fell))}: at {times}",
            tuple(Evidence(receiver.message, field, int(receiver.stamp_ns[row + 1])) for row in fell[:8]),
            "Look at the link that carries the corrections, and at the satellites then.",
        )


def _outages(log: Log, receiver: GnssReceiver, fixed: Flags, pause: Stamps, clock: LogClock) -> Iterator[Finding]:
    """Times between two fixes in which messages report no fix, or in which no message arrived.

    Without messages, a time counts from over a second and five periods. At the end of the log, it lasts to its end.
    Silence from disarming to the end of the log is a receiver that is switched off.
    """
    good = np.flatnonzero(fixed)
    regular = regularity(receiver.sample_ns[good])
    if regular is None:
        return
    reached = np.maximum.accumulate(receiver.sample_ns[good])
    length_ns = np.diff(reached)
    between = np.diff(good) - 1
    from_ns = receiver.stamp_ns[good[:-1]]
    whole = covered_share(from_ns, from_ns + length_ns, pause) >= 0.5
    long = np.flatnonzero(length_ns > _SILENT_S * 1e9)
    whole[long] |= switched_off(log, np.stack([from_ns[long], (from_ns + length_ns)[long]], axis=1))
    silent = (between == 0) & (length_ns > max(_SILENT_S, 5.0 * regular.period_s) * 1e9) & ~whole
    spans = {
        "gnss.fix_lost": _outage_spans(from_ns, length_ns, between > 0),
        "gnss.silent": _outage_spans(from_ns, length_ns, silent),
    }
    last = int(receiver.stamp_ns[good[-1]])
    end = max(last, dense_end_ns(log) or last)
    if end - last > max(_SILENT_S, 5.0 * regular.period_s) * 1e9:
        if good[-1] < len(fixed) - 1:
            spans["gnss.fix_lost"].append((last, end))
        elif not shut_down(log, last, end):
            spans["gnss.silent"].append((last, end))
    for key, found in spans.items():
        if not found:
            continue
        armed = armed_rows(log, np.array([b for _, b in found], dtype=np.int64))
        times = listed([f"{clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b in found])
        did = "lost its fix" if key == "gnss.fix_lost" else "said nothing"
        ended = ", to the end of the log" if found[-1] == (last, end) else ""
        yield Finding(
            key,
            Severity.WARNING if armed is None or armed.any() else Severity.NOTICE,
            f"{receiver.name} {did} {_times(len(found))} (it comes every {regular.period_s * 1e3:.0f} ms): "
            f"at {times}{ended}",
            tuple(Evidence(receiver.message, receiver.fields["fix"], a, b) for a, b in found[:8]),
            "Look at satellites and interference then, at wiring and baud rate, and at the estimator without it.",
        )


def _outage_spans(from_ns: Stamps, length_ns: Stamps, chosen: Flags) -> list[tuple[int, int]]:
    return [(int(a), int(a) + int(d)) for a, d in zip(from_ns[chosen], length_ns[chosen], strict=True)]


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


_LONGEST_STEP_S = 3.0
_JUMP_M, _JUMP_WARNING_M = 2.0, 3.0
_SIGMAS = 8.0
_MOVING_MPS = 0.5
_BIAS_MPS = 0.5
_WINDOW_S = 10.0


def motion_section(receiver: GnssReceiver, clock: LogClock) -> Section:
    """Changes of position from fix to fix against the mean of the two velocities, in the horizontal."""
    good = np.flatnonzero((receiver.fix >= FIX_3D) & np.isfinite(receiver.lat_deg) & np.isfinite(receiver.lon_deg))
    if len(good) < 10:
        return Section("gnss", "GNSS")
    lat, lon = receiver.lat_deg[good], receiver.lon_deg[good]
    # Use the median as origin, so that one outlier does not move the frame.
    frame = LocalFrame(float(np.median(lat)), float(np.median(lon)), 0.0)
    north_east = frame.ned(lat, lon, np.zeros(len(good)))[:, :2]
    step_s = np.diff(receiver.sample_ns[good]) * 1e-9
    usable = (step_s > 0.0) & (step_s <= _LONGEST_STEP_S)
    moved = np.diff(north_east, axis=0)
    findings = list(_frozen(receiver, good, step_s, clock))
    facts: list[Fact] = []
    plots: list[Plot] = []
    velocity = receiver.vel_ned_mps[good][:, :2]
    if np.isfinite(velocity).all(axis=1).sum() >= 10:
        expected = 0.5 * (velocity[1:] + velocity[:-1]) * step_s[:, None]
        strayed = np.where(usable[:, None], moved - expected, np.nan)
        known = np.asarray(np.isfinite(strayed).all(axis=1))
        if np.count_nonzero(known) >= 10:
            length = np.where(known, np.hypot(strayed[:, 0], strayed[:, 1]), np.nan)
            if not findings:  # a constant position contradicts any velocity
                drifts = gnss_drifts(receiver)
                wrong = (drift for drift in drifts if velocity_jumped(receiver, drift))
                findings += [wrong_velocity(receiver, drift, clock) for drift in wrong]
                findings += _bias(receiver, good, strayed, step_s, known, drifts, clock)
            findings += _jumps(receiver, good, length, moved, step_s, clock)
            noise = np.sqrt(np.nanmedian(np.diff(velocity, axis=0)[known] ** 2) / 2.0) / 0.6745
            off_m, noise_mps = significant(float(np.nanmedian(length))), significant(float(noise))
            facts = [
                Fact("position_step_error_m", "Position against velocity, median a fix", off_m, "m"),
                Fact("speed_noise_mps", "Velocity from fix to fix, one sigma an axis", noise_mps, "m/s"),
            ]
            name = f"{receiver.name} position against velocity"
            title = "Distance of each position from the place to which the velocity leads"
            trace = Trace(name, receiver.stamp_ns[good[1:]], length, "points")
            plots.append(Plot(f"gnss_motion_{receiver.name}", title, "m", (trace,)))
    return Section("gnss", "GNSS", facts=tuple(facts), findings=tuple(findings), plots=tuple(plots))


def _jumps(
    receiver: GnssReceiver, good: NDArray[np.intp], length_m: Floats, moved: Floats, step_s: Floats, clock: LogClock
) -> Iterator[Finding]:
    usual = 1.4826 * float(np.nanmedian(length_m))
    rows = np.flatnonzero(np.nan_to_num(length_m) > max(_JUMP_M, _SIGMAS * usual))
    if not len(rows):
        return
    largest = int(rows[np.argmax(length_m[rows])])
    # Horizontal accuracy that the receiver reported at about that time; 0: unknown.
    at_ns = int(receiver.stamp_ns[good[largest + 1]])
    accuracy = receiver.accuracy
    if accuracy is None or accuracy.horizontal_m is None or not len(accuracy.stamp_ns):
        trusted_m = 0.0
    else:
        row = min(int(np.searchsorted(accuracy.stamp_ns, at_ns)), len(accuracy.stamp_ns) - 1)
        trusted_m = float(np.nan_to_num(accuracy.horizontal_m[row]))
    beyond = length_m[largest] > max(_JUMP_WARNING_M, 2.0 * trusted_m)
    speed = float(np.hypot(*moved[largest]) / step_s[largest])
    stamps_ns = receiver.stamp_ns[good[rows + 1]].tolist()
    times = listed([clock.text(at_ns) for at_ns in stamps_ns])
    reported_mps = None if receiver.speed_mps is None else receiver.speed_mps[good[largest + 1]]
    reported = "" if reported_mps is None else f", where it reported {reported_mps:.1f} m/s"
    yield Finding(
        "gnss.jump",
        Severity.WARNING if beyond else Severity.NOTICE,
        f"The position of {receiver.name} jumped {_times(len(rows))}, by up to {length_m[largest]:.1f} m (as if at "
        f"{speed:.0f} m/s{reported}): at {times}",
        tuple(
            Evidence(receiver.message, receiver.fields["lat"], at_ns, None, f"{length_m[row]:.1f} m")
            for row, at_ns in zip(rows[:8], stamps_ns, strict=False)
        ),
        "Look at satellites and surroundings then (bridge, wall, interference): did the estimator follow?",
    )


def _bias(
    receiver: GnssReceiver,
    good: NDArray[np.intp],
    strayed: Floats,
    step_s: Floats,
    known: Flags,
    drifts: Sequence[GnssDrift],
    clock: LogClock,
) -> Iterator[Finding]:
    """Velocities that differ from the positions for ten seconds; jumps and drifts are omitted."""
    usual = 1.4826 * float(np.nanmedian(np.hypot(strayed[:, 0], strayed[:, 1])))
    calm = known & (np.nan_to_num(np.hypot(strayed[:, 0], strayed[:, 1])) < max(_JUMP_M, _SIGMAS * usual))
    for drift in drifts:
        calm &= (receiver.stamp_ns[good[1:]] < drift.from_ns) | (receiver.stamp_ns[good[1:]] > drift.until_ns)
    stamps = receiver.stamp_ns[good[1:]][calm]
    if len(stamps) < 10:
        return
    window = (stamps - stamps[0]) // int(_WINDOW_S * 1e9)
    numbers, place, count = np.unique(window, return_inverse=True, return_counts=True)
    time_s = np.bincount(place, step_s[calm])
    off = np.stack([np.bincount(place, strayed[calm, axis]) for axis in (0, 1)], axis=1) / time_s[:, None]
    speed = np.where((time_s > 0.5 * _WINDOW_S) & (count >= 5), np.hypot(off[:, 0], off[:, 1]), 0.0)
    limit = _BIAS_MPS
    if receiver.accuracy is not None and receiver.accuracy.speed_mps is not None:
        limit = max(limit, 2.0 * float(np.nanmedian(receiver.accuracy.speed_mps)))
    if speed.max() <= limit:
        return
    worst = int(np.argmax(speed))
    at_ns = int(stamps[0] + numbers[worst] * int(_WINDOW_S * 1e9))
    yield Finding.warning(
        "gnss.velocity_off",
        f"The velocity of {receiver.name} is {speed[worst]:.1f} m/s off the change of its positions, over ten seconds "
        f"from {clock.text(at_ns)}",
        (Evidence(receiver.message, receiver.fields.get("speed"), at_ns, at_ns + int(_WINDOW_S * 1e9)),),
        "Check the receiver's dynamic model and configuration; the estimator trusts both.",
    )


def _frozen(receiver: GnssReceiver, good: NDArray[np.intp], step_s: Floats, clock: LogClock) -> Iterator[Finding]:
    """A position that repeats while the receiver reports motion."""
    if receiver.speed_mps is None or not (step_s > 0.0).any():
        return
    period_s = float(np.median(step_s[step_s > 0.0]))
    place = np.stack([receiver.lat_deg[good], receiver.lon_deg[good]], axis=1)
    spans = []
    for hold in find_holds(place, period_s, shortest_s=1.5).holds:
        speed = receiver.speed_mps[good[hold.first : hold.last + 1]]
        if np.isfinite(speed).any() and float(np.nanmedian(speed)) > _MOVING_MPS:
            spans.append((int(receiver.stamp_ns[good[hold.first]]), int(receiver.stamp_ns[good[hold.last]]), speed))
    if not spans:
        return
    times = listed([f"from {clock.text(a)} for {(b - a) * 1e-9:.1f} s" for a, b, _ in spans])
    yield Finding.warning(
        "gnss.frozen",
        f"{receiver.name} repeats one position while it reports {float(np.nanmedian(spans[0][2])):.1f} m/s: {times}",
        tuple(Evidence(receiver.message, receiver.fields["lat"], a, b) for a, b, _ in spans[:8]),
        "Check the receiver and its driver: a device that no longer measures may repeat its last fix.",
    )


_TITLE = "GNSS"
_POOR_SHARE = 0.05
_FEW_SATELLITES = 6
_POOR_HDOP = 2.0
_POOR_HORIZONTAL_M, _POOR_SPEED_MPS = 5.0, 1.0  # EKF3 accepts a receiver up to these
_APART_M = 5.0
_ERR_GLITCH = 2


def analyse(log: Log) -> Section | None:
    """Section on receivers; None for a recording without one. For a vehicle's log, the lack is reported."""
    clock = LogClock(log)
    found = gnss_receivers(log)
    if not found:
        if log.of_topics:
            return None
        return Section("gnss", _TITLE, lacks=("No satellite receiver is logged; set the bit GPS of LOG_BITMASK.",))
    pause = log_pauses(log)
    findings: list[Finding] = []
    for receiver in found:
        findings += fix_findings(log, receiver, pause, clock)
        findings += _quality(receiver)
    moved = [motion_section(receiver, clock) for receiver in found]
    findings += [finding for part in moved for finding in part.findings]
    findings += _two_receivers(found, clock)
    findings += _glitches(log, clock)
    lacks: list[str] = []
    for receiver in found:
        if receiver.accuracy is None or receiver.accuracy.horizontal_m is None:
            lacks.append(f"{receiver.name} states no accuracy (GPA.HAcc).")
        if receiver.week is not None and not (np.nan_to_num(receiver.week[fixed_rows(receiver)]) > 0).any():
            lacks.append(f"{receiver.name} logs no GPS time (week 0), so it gives no UTC for this log.")
    return Section(
        "gnss",
        _TITLE,
        facts=tuple(fact for part in moved[:1] for fact in (*_facts(found[0]), *part.facts)),
        findings=tuple(findings),
        grids=(_grid(found), *(grid for part in moved for grid in part.grids)),
        plots=(*_plots(found, findings), *(plot for part in moved[:2] for plot in part.plots)),
        lacks=tuple(lacks),
    )


def _quality(receiver: GnssReceiver) -> Iterator[Finding]:
    """Shares of the time with a fix in which the receiver itself reports a poor quality."""
    fixed = fixed_rows(receiver)
    if np.count_nonzero(fixed) < 5:
        return
    judged: list[tuple[str, Flags, str, str, Stamps]] = []
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
    for what, bad, message, field, stamps in judged:
        if not len(bad) or bad.mean() <= _POOR_SHARE:
            continue
        yield Finding.notice(
            "gnss.poor",
            f"{receiver.name} had {what} for {100.0 * float(bad.mean()):.0f} % of the time with a fix",
            tuple(Evidence(message, field, begin, end) for begin, end in spells(stamps, bad)),
            "Give the antenna more sky, away from radio and computer. The estimator drifts as much.",
        )


def _two_receivers(found: list[GnssReceiver], clock: LogClock) -> Iterator[Finding]:
    """Distance between two receivers of one vehicle, compared with their usual distance."""
    for one, other in combinations([each for each in found if fixed_rows(each).sum() >= 10], 2):
        # Whether two tables are different receivers. Telemetry of a receiver is not a second receiver.
        if one.message.rpartition(":")[0] != other.message.rpartition(":")[0] or (
            {one.message.rpartition(":")[2], other.message.rpartition(":")[2]} == {"XITL_GNSS", "GPS_RAW_INT"}
        ):
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
            yield Finding(
                "gnss.receivers_apart",
                Severity.WARNING if far - usual > 3.0 * _APART_M else Severity.NOTICE,
                f"{one.name} and {other.name} are {usual:.1f} m apart as a rule and {apart[worst]:.1f} m at "
                f"{clock.text(int(one.stamp_ns[worst]))}",
                (Evidence(one.message, one.fields["lat"], int(one.stamp_ns[worst]), None, f"{apart[worst]:.1f} m"),),
                "Compare both with the estimate to see which one is wrong.",
            )


def _glitches(log: Log, clock: LogClock) -> Iterator[Finding]:
    """Glitches reported by the autopilot itself: estimator flags, errors, texts."""
    spans: list[tuple[int, int, str, str]] = []
    table = rows_in_use(log, "XKF4")  # a core that is not in use refers to its own sensors
    flags = None if table is None else numbers(table, "SS", raw=True)
    if table is not None and flags is not None:
        on = (np.nan_to_num(flags).astype(np.int64) & EKF_GPS_GLITCHING) != 0
        spans += [(begin, end, "XKF4", "SS") for begin, end in spells(table.stamp_ns, on)]
    spans += [
        (at_ns, at_ns, "ERR", "ECode")
        for at_ns, subsystem, code in error_rows(log)
        if (subsystem, code) == (ERR_GPS, _ERR_GLITCH)
    ]
    for text in texts(log):
        words = text.text.lower()
        if "glitch" in words and "cleared" not in words and ("gps" in words or "compass" not in words):
            message, _, field = text.source.rpartition(".")
            spans.append((text.at_ns, text.at_ns, message, field))
    if not spans:
        return
    spans.sort()
    yield Finding.warning(
        "gnss.glitch",
        f"The autopilot judged positions to be a glitch, first at {clock.text(spans[0][0])}",
        tuple(Evidence(message, field, a, b) for a, b, message, field in spans[:8]),
        "Compare the receiver's positions with the estimate then: look for interference, or for an estimator "
        "that diverged.",
    )


def _facts(receiver: GnssReceiver) -> tuple[Fact, ...]:
    fixed = fixed_rows(receiver)
    first_s = None
    if fixed.any():
        first_s = significant((int(receiver.stamp_ns[int(np.argmax(fixed))]) - int(receiver.stamp_ns[0])) * 1e-9)
    return (
        Fact("fix_share_percent", "With a 3D fix or better", significant(100.0 * float(fixed.mean())), "%"),
        Fact("first_fix_s", "First 3D fix, from the first message", first_s, "s"),
        Fact("satellites_median", "Satellites, median", _middle(receiver.satellites, fixed)),
        Fact("hdop_median", "Horizontal dilution, median", _middle(receiver.hdop, fixed)),
    )


def _middle(values: Floats | None, rows: Flags | None = None) -> float | None:
    if values is None:
        return None
    chosen = values if rows is None else values[rows]
    chosen = chosen[np.isfinite(chosen)]
    return significant(float(np.median(chosen))) if len(chosen) else None


def _grid(found: list[GnssReceiver]) -> Grid:
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
                None if regular is None else significant(regular.rate_hz),
                None if regular is None else regular.gaps,
                None if regular is None else significant(regular.longest_gap_s),
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


def _plots(found: list[GnssReceiver], findings: list[Finding]) -> tuple[Plot, ...]:
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
        plots.append(Plot("gnss_accuracy", "Accuracy that the receiver reports", "m, m/s", tuple(trust), marks=marks))
    return tuple(plots)
