"""Timing of a run as diagnostic_msgs: deadlines, links, clocks, the host's pace and boards.

A status is a warning if a count increased since the previous array: a missed deadline, a lost frame, a stall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from xitl_cli.plugins.ros import msg
from xitl_cli.record.topics import TOPICS

_PERIOD_NS = 1_000_000_000
_HOTTEST_C = 85.0
_MOST_DRIFT_PPM = 100.0
_NAMED = {
    "/tasks": ("deadlines", ("node", "task"), ("missed",), "deadlines missed"),
    "/links": ("link", ("name",), ("lost", "gaps", "dropped", "refused"), "frames lost or refused"),
    "/clocks": ("clock", ("node",), ("steps",), "the clock was set"),
    "/pace": ("host", (), ("stalls", "slips"), "did not keep up with the wall clock"),
    "/nodes": ("node", ("node",), (), ""),
}
"""By recorded topic: name of its statuses, identifying fields, error counts and the meaning of an increase."""


class Diagnostics:
    """Diagnostics of one vessel: the latest recorded messages, published once a second."""

    def __init__(self) -> None:
        self._latest: dict[tuple[str, str], Any] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._next_ns = 0

    def note(self, topic: str, message: Any) -> None:
        """Note a message of a diagnosed topic."""
        named, parts, _, _ = _NAMED[topic]
        name = " ".join([named, *(str(getattr(message, part)) for part in parts)])
        self._latest[topic, name] = message

    def due(self, stamp_ns: int, header: Any) -> Any:
        """Return the array, once a second; None in between."""
        if stamp_ns < self._next_ns or not self._latest:
            return None
        self._next_ns = (stamp_ns // _PERIOD_NS + 1) * _PERIOD_NS
        return msg.DiagnosticArray(header=header, status=[self._status(*key) for key in sorted(self._latest)])

    def _status(self, topic: str, name: str) -> Any:
        message = self._latest[topic, name]
        _, _, counts, meaning = _NAMED[topic]
        count = sum(max(int(getattr(message, field)), 0) for field in counts)
        grown = count - self._counts.get((topic, name), 0)
        self._counts[topic, name] = count
        level, text = msg.DiagnosticStatus.OK, "ok"
        if grown > 0:
            level, text = msg.DiagnosticStatus.WARN, f"{grown} more: {meaning}" if topic != "/pace" else meaning
        elif topic == "/clocks" and abs(message.drift_ppm) > _MOST_DRIFT_PPM:
            level, text = msg.DiagnosticStatus.WARN, f"drifts {message.drift_ppm:+.0f} ppm from the host"
        elif topic == "/nodes" and message.temperature_c > _HOTTEST_C:
            level, text = msg.DiagnosticStatus.WARN, f"has a temperature of {message.temperature_c:.0f} °C"
        values = [msg.KeyValue(key=key, value=value) for key, value in _values(topic, message)]
        return msg.DiagnosticStatus(level=level, name=f"xitl: {name}", message=text, hardware_id="xitl", values=values)


def _values(topic: str, message: Any) -> Iterator[tuple[str, str]]:
    """Yield every known field: neither NaN nor -1, and no histogram."""
    for field in TOPICS[topic].message_type().fields:
        value = getattr(message, field.name)
        if field.type.endswith("]") or value == "" or value == -1:
            continue
        if isinstance(value, float):
            if not math.isnan(value):
                yield field.name, f"{value:.6g}"
        else:
            yield field.name, str(value)
