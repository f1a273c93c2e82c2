"""An operator's orders to a vessel: the interface of their receiver, and streams of velocity commands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from enum import Enum

from agent.mavlink.modes import shown_mode
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.operator.actions import Arm, ChangeMission, ChangeMode, CommandMotor, EndRun, GoTo, SteerVelocity

Order = Arm | ChangeMode | GoTo | SteerVelocity | CommandMotor | ChangeMission | EndRun


class Steering:
    """Receiver of an operator's orders to a vessel."""

    silences: int
    """Number of command streams that ended without a request."""
    asked_by: Counter[str]
    """Number of orders carried out, by client."""

    def check(self, order: Order) -> None:
        """Raise ActionError for an order that is not possible, or while no autopilot is present."""
        raise NotImplementedError

    def give(self, order: Order) -> None:
        """Replace the former order."""
        raise NotImplementedError

    def update(self, now_ns: int, say: Say) -> None:
        """Continue the order. Call it at every exchange, after the orders of that exchange."""
        raise NotImplementedError


SILENT_S = 1.0
TOLD_S = 10.0
RESENT_S = 0.5  # an autopilot behind a lossy link still receives each command
Say = Callable[[str], object]


class _State(Enum):
    IDLE = "nothing is commanded"
    ASKED = "the autopilot is asked for GUIDED"
    IN_FORCE = "the autopilot executes the command"
    OVERRULED = "another client has chosen another mode"


class VelocityStream:
    """Speed and turn rate to an autopilot in GUIDED. `update` is called at every exchange.

    The first command of a stream requests GUIDED, and the next commands replace it. When another client chooses a mode,
    it has the vessel. The stream is then ignored until it has paused for `silent_s`, or until GUIDED is requested.
    active: whether a stream is active.
    """

    def __init__(self, commands: AutopilotCommands, silent_s: float) -> None:
        self._commands = commands
        self._silent_ns = round(silent_s * 1e9)
        self._state = _State.IDLE
        self._wanted = (0.0, 0.0)
        self._fresh = self._seen = self._told = False
        self._since_ns = self._heard_ns = self._sent_ns = 0

    @property
    def active(self) -> bool:
        return self._state is not _State.IDLE

    def set(self, speed_mps: float, turn_rate_radps: float) -> None:
        """Set the command from the next `update` on. turn_rate_radps: to starboard."""
        self._wanted, self._fresh = (speed_mps, turn_rate_radps), True

    def stop(self) -> None:
        """End the stream for another order. A stream that continues begins again."""
        self._state = _State.IDLE

    def yield_to(self, mode: str) -> None:
        """React to a mode that another client requests."""
        if self._state is not _State.IDLE:
            self._state = _State.IDLE if mode == "GUIDED" else _State.OVERRULED

    def update(self, now_ns: int, say: Say, may_begin: bool = True) -> bool:
        """Send the command that is due. Returns True once, when an active stream has become silent.

        may_begin: False while the driver is still to get the vessel under way.
        """
        if self._fresh:
            self._heard_ns = now_ns
            if self._state is _State.IDLE:
                self._state, self._since_ns, self._seen, self._told = _State.ASKED, now_ns, False, False
        if self._state is _State.IDLE:
            return False
        if now_ns - self._heard_ns > self._silent_ns:
            was, self._state = self._state, _State.IDLE
            if was is _State.IN_FORCE:
                say(f"no velocity for {self._silent_ns * 1e-9:g} s: HOLD, outputs neutral")
            return was is _State.IN_FORCE
        if not may_begin:
            self._since_ns = now_ns
        elif self._state is _State.ASKED:
            if self._commands.set_mode(now_ns, "GUIDED"):
                self._state, self._fresh = _State.IN_FORCE, True
                say("velocity: in GUIDED")
            elif not self._told and now_ns - self._since_ns > TOLD_S * 1e9:
                self._told = True
                why = self._commands.view.why_not_armed()
                say(f"velocity: not in GUIDED after {TOLD_S:g} s{why}; the request is repeated")
        if self._state is _State.IN_FORCE:
            view = self._commands.view
            guided = view.mode == shown_mode("GUIDED", view.px4)
            self._seen = self._seen or guided
            if self._seen and not guided:
                self._state = _State.OVERRULED
                say(f"velocity: ignored, because {view.mode} was chosen; request GUIDED, or pause the stream")
            elif self._fresh or now_ns - self._sent_ns >= RESENT_S * 1e9:
                self._sent_ns = now_ns
                self._commands.steer(now_ns, *self._wanted)
        self._fresh = False
        return False
