"""Mode changes and failsafes of an autopilot, from its heartbeats, its sentences and its fence status."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from agent.mavlink.commands import StatusTextReceiver
from agent.mavlink.modes import MISSION_MODE
from agent.wire import dialect
from xitl_cli.record.topics import AutopilotEvent
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.connection import NOTICE, WARNING

CAUSE_NS = 2_000_000_000
"""Largest time between a failsafe's sentence and the heartbeat with its mode, in either order.

Heartbeats arrive at 1 Hz. ArduPilot sends one at once at a mode change, and names some failsafes after it.
"""
LIMIT_OVER_NS = 3_000_000_000
"""Time after the last status with a speed limit at which the fence's limit counts as over. Avoidance acts in bursts."""
VELOCITY_LIMITED = 2  # FENCE_MITIGATE_VEL_LIMIT
FAILED = (dialect.MAV_STATE_CRITICAL, 6)  # and MAV_STATE_EMERGENCY, which the dialect leaves out

BREACHED = "fence breached"
"""Reason of a breach that only the fence status reports. ArduPilot Rover sends no sentence for it."""

_FAILSAFE = re.compile(
    r"failsafe|\bbreach|\bgeofence .*violat|^crash: |^battery .* is (low|critical)|^ekf variance", re.IGNORECASE
)
_OVER = re.compile(r"\b(over|cleared|deactivated|recovered)\b", re.IGNORECASE)
_FENCE_OVER = re.compile(r"\bfences? cleared", re.IGNORECASE)
_PREARM = re.compile(r"^(prearm|arm|preflight fail)\b", re.IGNORECASE)


class AutopilotEventNode(RunNode):
    """Records the mode changes and failsafes of an autopilot, and reports them in their order.

    Call `handle` with each message after `view` has handled it. When an armed vessel leaves a mode, the event is
    recorded once its cause is known. That is at once after a failsafe's sentence, otherwise after CAUSE_NS without one.
    """

    def __init__(self, view: AgentView) -> None:
        self.events: list[AutopilotEvent] = []
        self._view = view
        self._text = StatusTextReceiver()
        self._context: RunContext | None = None
        self._mode: str | None = None
        self._armed = False
        self._failed = False
        self._waiting: list[tuple[int, AutopilotEvent]] = []
        self._cause: tuple[int, str] | None = None
        self._limited_ns: int | None = None
        self._breached = False

    def begin(self, context: RunContext) -> None:
        self._context = context

    def handle(self, message: Any) -> None:
        """Handle one message of the autopilot."""
        if self._context is None:
            return
        number, now_ns = message.get_msgId(), self._context.clock.now_ns()
        if number == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._heartbeat(message, now_ns)
        elif number == dialect.MAVLINK_MSG_ID_STATUSTEXT:
            text = self._text.handle(message)
            if text is not None:
                self._sentence(text, now_ns)
        elif number == dialect.MAVLINK_MSG_ID_FENCE_STATUS:
            self._fence(message, now_ns)

    def exchange(self, step: RunStep) -> None:
        self._write_until(step.now_ns - CAUSE_NS)
        if self._limited_ns is not None and step.now_ns - self._limited_ns > LIMIT_OVER_NS:
            self._limited_ns = None
            self._write(self._event(step.now_ns, "fence limit over"))

    def end(self) -> None:
        self._write_until(None)

    def report(self) -> dict[str, Any]:
        return {"autopilot_events": self.events}

    def _heartbeat(self, message: Any, now_ns: int) -> None:
        before, self._mode = self._mode, self._view.mode
        was_armed, self._armed = self._armed, self._view.armed
        failed, self._failed = self._failed, message.system_status in FAILED and self._armed
        if was_armed != self._armed:
            event = "armed" if self._armed else "disarmed"
            self._wait(now_ns, replace(self._event(now_ns, event), mode_before=before or self._mode))
        if before is not None and before != self._mode:
            self._wait(now_ns, AutopilotEvent(now_ns / 1e9, "mode", self._mode, before))
        if self._failed and not failed and not self._in_force():
            self._write(self._event(now_ns, "failsafe", "its heartbeat reports a failsafe"))
        elif failed and not self._failed and self._in_force():
            self._write(self._event(now_ns, "failsafe over"))

    def _sentence(self, text: str, now_ns: int) -> None:
        if _FENCE_OVER.search(text) or (_FAILSAFE.search(text) and _OVER.search(text)):
            if self._in_force():
                self._write(self._event(now_ns, "failsafe over", text))
        elif _FAILSAFE.search(text) and not _PREARM.search(text) and self._armed:
            self._write(self._event(now_ns, "failsafe", text))
            self._cause = now_ns, text
            if "breach" in text.lower():  # the sentence says more than the status
                self._waiting = [(at_ns, each) for at_ns, each in self._waiting if each.event != "failsafe"]
            self._write_until(None)

    def _fence(self, message: Any, now_ns: int) -> None:
        breached, self._breached = self._breached, bool(message.breach_status) and self._armed
        if self._breached and not breached and not self._in_force():
            self._waiting.append((now_ns, self._event(now_ns, "failsafe", BREACHED)))
        elif breached and not self._breached and self._in_force() and self._last_failsafe().reason == BREACHED:
            self._write(self._event(now_ns, "failsafe over"))
        if message.breach_mitigation != VELOCITY_LIMITED or not self._armed:
            return
        if self._limited_ns is None:
            self._write(self._event(now_ns, "fence limits speed"))
        self._limited_ns = now_ns

    def _in_force(self) -> bool:
        """Whether the last failsafe is still active."""
        return any(event.event == "failsafe" for event in self.events) and self._last_failsafe().event == "failsafe"

    def _last_failsafe(self) -> AutopilotEvent:
        return next(event for event in reversed(self.events) if event.event.startswith("failsafe"))

    def _event(self, now_ns: int, event: str, reason: str = "") -> AutopilotEvent:
        mode = self._view.mode
        return AutopilotEvent(now_ns / 1e9, event, mode, mode, reason)

    def _wait(self, now_ns: int, event: AutopilotEvent) -> None:
        """Queue the event until its sentence arrives.

        Write it at once if the sentence is known or none can explain the change.
        """
        self._waiting.append((now_ns, event))
        known = self._cause is not None and now_ns - self._cause[0] <= CAUSE_NS
        if known or event.event == "armed" or event.mode == MISSION_MODE or not self._armed:
            self._write_until(None)

    def _write_until(self, until_ns: int | None) -> None:
        """Write the queued changes up to an instant, or all of them. A breach that waits explains the changes."""
        breach = next((placed for placed in self._waiting if placed[1].event == "failsafe"), None)
        if self._cause is None and breach is not None:
            self._cause = breach[0], breach[1].reason
        while self._waiting and (until_ns is None or self._waiting[0][0] <= until_ns):
            at_ns, event = self._waiting.pop(0)
            cause = self._cause
            if cause is not None and abs(at_ns - cause[0]) <= CAUSE_NS and event.event in ("mode", "disarmed"):
                event = replace(event, reason=cause[1])
                self._cause = None  # the next change has another cause
            self._write(event)

    def _write(self, event: AutopilotEvent) -> None:
        self.events.append(event)
        if self._context is None:
            return
        now_ns = self._context.clock.now_ns()
        self._context.recorder.write(now_ns, event)
        self._context.recorder.log(now_ns, WARNING if event.reason else NOTICE, "run", event_text(event))


def event_text(event: AutopilotEvent) -> str:
    """Return the event in one line, for a log and for users."""
    change = f"mode {event.mode} after {event.mode_before}" if event.event == "mode" else event.event
    where = "" if event.event == "mode" else f" in mode {event.mode}"
    reason = f": {event.reason}" if event.reason else ""
    return f"{change}{where} at {event.at_s:.1f} s{reason}"
