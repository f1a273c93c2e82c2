"""Sentences of an autopilot that tell of trouble, for logs that keep no error code of it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from xitl_cli.logs.sections import Severity
from xitl_cli.logs.signals import Text

_OVER = re.compile(r"\b(cleared|clear|over|off|recovered|resolved|ended|restored|back|healthy)\b", re.I)
_ROWS: tuple[tuple[str, str, Severity], ...] = (
    (r"^crash\b|crash: disarming", "crash", Severity.CRITICAL),
    (r"^WDG:|watchdog reset", "watchdog", Severity.CRITICAL),
    (r"internal errors? 0x|internal error", "internal_error", Severity.CRITICAL),
    (r"controller failed", "controller", Severity.CRITICAL),
    (r"radio failsafe|throttle failsafe|rc failsafe", "radio_failsafe", Severity.WARNING),
    (r"gcs failsafe", "gcs_failsafe", Severity.WARNING),
    (r"ekf failsafe", "ekf_failsafe", Severity.WARNING),
    (r"batt(ery)?\b.*(failsafe|low|critical)", "battery", Severity.WARNING),
    (r"fence breach", "fence", Severity.WARNING),
    (r"failsafe", "failsafe", Severity.WARNING),
    (r"ekf variance", "ekf_variance", Severity.WARNING),
    (r"potential thrust loss|yaw imbalance|vibration compensation on", "flight", Severity.WARNING),
    (r"gps( \d)? glitch|compass error|bad gyro|imu\d? .*fail", "sensor", Severity.WARNING),
    (r"no logging|logging failed|log: .*(slow|no space)|unable to (start|open) log", "logging", Severity.WARNING),
)
_PATTERNS = tuple((re.compile(pattern, re.I), key, severity) for pattern, key, severity in _ROWS)
_PLAIN = re.compile(r"\b(disabled|enabled|ready|config|param|pre-?arm|arm:)\b|^(PreArm|Arm)\s*:", re.I)


@dataclass(frozen=True, slots=True)
class Trouble:
    """until_ns: when the autopilot said that it is over; None where it never did."""

    key: str
    severity: Severity
    text: Text
    count: int
    until_ns: int | None


def troubles(texts: list[Text]) -> list[Trouble]:
    """One for each kind of trouble from its first sentence to the one that ends it, in the order of time."""
    open_ones: dict[str, Trouble] = {}
    done: list[Trouble] = []
    for text in texts:
        found = next(((key, severity) for pattern, key, severity in _PATTERNS if pattern.search(text.text)), None)
        if found is None or _PLAIN.search(text.text):
            continue
        key, severity = found
        before = open_ones.get(key)
        if _OVER.search(text.text):
            if before is not None:
                done.append(Trouble(key, before.severity, before.text, before.count, text.at_ns))
                del open_ones[key]
            continue
        first = text if before is None else before.text
        open_ones[key] = Trouble(key, severity, first, 1 if before is None else before.count + 1, None)
    return sorted([*done, *open_ones.values()], key=lambda trouble: trouble.text.at_ns)
