"""Faults detected from contradicting signals: GNSS position and velocity, battery voltage and current, commands and
motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding, Section
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.receivers import gnss_receivers, injected_receivers
from xitl_cli.logs.signals.series import numbers
from xitl_cli.plugins.logs.analyses.actuator_faults import actuator_findings
from xitl_cli.plugins.logs.analyses.gnss_drift import gnss_drifts, velocity_jumped, wrong_velocity
from xitl_cli.plugins.logs.analyses.power import batteries

DROP_SHARE = 0.015
"""Least fall of the voltage that exceeds noise, as share of its median."""
BATTERY_WINDOW_S = 8.0
_COARSE_SHARE, _FINE_SHARE = 0.5, 0.25
"""Most share of the squared residual that a step leaves, near its instant and at it: the rows between the two are on
the wrong side of the step."""


@dataclass(frozen=True, slots=True)
class BatterySag:
    """A lasting fall of a battery's voltage, from an instant to the end of the log."""

    from_ns: int
    until_ns: int
    drop_v: float


def analyse(log: Log) -> Section | None:
    """Section on actuation. None if nothing was found, or if neither commands with motion, a receiver nor a battery is
    logged."""
    clock = LogClock(log)
    findings = [*_gnss_findings(log, clock), *_battery_findings(log, clock), *actuator_findings(log, clock)]
    return Section("actuation", "Actuators and power", findings=tuple(findings)) if findings else None


def _gnss_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    measured = gnss_receivers(log)
    for receiver in measured or injected_receivers(log):
        for drift in gnss_drifts(receiver):
            if velocity_jumped(receiver, drift):
                if not measured:  # the section on GNSS has those of receivers that the autopilot has logged
                    yield wrong_velocity(receiver, drift, clock)
                continue
            size = f"{drift.speed_mps:.2f} m/s"
            yield Finding.warning(
                "actuation.gnss_drift",
                f"From {clock.text(drift.from_ns)} to {clock.text(drift.until_ns)} the position of {receiver.name} "
                f"drifts by {size} towards {drift.bearing_deg:.0f} degrees against its own velocity",
                (Evidence(receiver.message, receiver.fields.get("lat"), drift.from_ns, drift.until_ns, size),),
                "Do not trust the position in this time: look for reflected signals, interference or spoofing.",
            )


def _battery_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    for name, stamp_ns, voltage_v, current_a in _batteries(log):
        for sag in battery_sags(stamp_ns, voltage_v, current_a):
            yield Finding.warning(
                "actuation.battery_sag",
                f"At {clock.text(sag.from_ns)} the voltage of the battery falls by {sag.drop_v:.2f} V more than its "
                "current explains",
                (Evidence(name, "voltage_v", sag.from_ns, sag.until_ns, f"{sag.drop_v:.2f} V"),),
                "Look at the cells, the contacts and the wires of the battery; the motors turn more slowly from then.",
            )


def _batteries(log: Log) -> Iterator[tuple[str, Stamps, Floats, Floats]]:
    """The simulated battery of a recording, else measured batteries."""
    table = log.tables.get("/battery")
    if table is not None and {"voltage_v", "current_a"} <= set(table.columns):
        voltage_v, current_a = numbers(table, "voltage_v"), numbers(table, "current_a")
        if voltage_v is not None and current_a is not None:
            yield "/battery", table.stamp_ns, voltage_v, current_a
        return
    for battery in batteries(log):
        if battery.current_a is not None:
            yield battery.message, battery.stamp_ns, battery.voltage_v, battery.current_a


def battery_sags(stamp_ns: Stamps, voltage_v: Floats, current_a: Floats) -> list[BatterySag]:
    """Instants at which the voltage falls permanently, by more than charge and resistance explain.

    Around each instant, a level, a slope and a resistance are fitted, with a step or with a step of the resistance.
    """
    good = np.isfinite(voltage_v) & np.isfinite(current_a) & (voltage_v > 0.0)
    stamp_ns, voltage_v, current_a = stamp_ns[good], voltage_v[good], current_a[good]
    if len(stamp_ns) < 40:
        return []
    time_s = (stamp_ns - stamp_ns[0]) * 1e-9
    least_v = DROP_SHARE * float(np.median(voltage_v))
    period_s = float(np.median(np.diff(time_s)))
    half = max(round(BATTERY_WINDOW_S / max(period_s, 1e-3)), 5)
    drop_v = np.zeros(len(time_s))
    for at in range(half, len(time_s) - half, max(round(0.5 / max(period_s, 1e-3)), 1)):
        size_v, share = _step(time_s, voltage_v, current_a, at, half)
        drop_v[at] = size_v if share < _COARSE_SHARE else 0.0
    found: list[BatterySag] = []
    while drop_v.max() > least_v:
        coarse = int(np.argmax(drop_v))
        near = range(max(coarse - half // 4, half), min(coarse + half // 4 + 1, len(time_s) - half))
        steps = [(*_step(time_s, voltage_v, current_a, at, half), at) for at in near]
        size_v, share, at = min(steps, key=lambda step: step[1])
        if share < _FINE_SHARE and size_v > least_v:
            found.append(BatterySag(int(stamp_ns[at]), int(stamp_ns[-1]), size_v))
            drop_v[max(at - 2 * half, 0) : at + 2 * half] = 0.0
        else:
            drop_v[near.start : near.stop] = 0.0
    return sorted(found, key=lambda each: each.from_ns)


def _step(time_s: Floats, voltage_v: Floats, current_a: Floats, at: int, half: int) -> tuple[float, float]:
    """Fall of the voltage at row `at`, 0 in the noise, and the share of the squared residual that this step leaves."""
    rows = slice(at - half, at + half)
    after = (np.arange(at - half, at + half) >= at).astype(np.float64)
    current, voltage = current_a[rows], voltage_v[rows]
    plain = np.stack([np.ones(2 * half), time_s[rows] - time_s[at], current], axis=1)
    step = np.concatenate([plain, np.stack([after, after * current], axis=1)], axis=1)
    without, *_ = np.linalg.lstsq(plain, voltage, rcond=None)
    if without[2] > 0.0:  # no battery has a negative resistance: motors draw less because the voltage fell
        plain = plain[:, :2]
        without, *_ = np.linalg.lstsq(plain, voltage, rcond=None)
    left = voltage - plain @ without
    fitted, *_ = np.linalg.lstsq(step, voltage, rcond=None)
    rest = voltage - step @ fitted
    size_v = -float(fitted[3] + fitted[4] * current[half:].mean())
    noise_v = float(np.sqrt(rest @ rest / len(rest)))
    return size_v if size_v > 3.0 * noise_v else 0.0, float(rest @ rest) / max(float(left @ left), 1e-12)
