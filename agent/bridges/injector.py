"""Sensor injectors: ways to feed simulated sensors into an autopilot. The bridge role drives any number of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable

from agent.timing.clock import Clock
from agent.wire.codec import Message


class InjectorCounters:
    """Counts since the run began, as XITL_BRIDGE_STATUS tells them.

    imu_out, solution_out, gnss_out: frames that the line took, not those counted as `unsent`. refused: messages of the
    host that were no measurement, which XITL_NODE_STATUS tells.
    """

    def __init__(self) -> None:
        self.imu_out = 0
        self.solution_out = 0
        self.gnss_out = 0
        self.unsent = 0
        self.world_in = 0
        self.world_resent = 0
        self.world_lost = 0
        self.world_rate = 0
        self.restarts = 0
        self.outputs_in = 0
        self.commands_in = 0
        self.junk = 0
        self.refused = 0
        self.script_in = 0
        self.script_out = 0
        self.script_dropped = 0
        self.script_answers = False
        self.taken = False


class InjectorError(ValueError):
    """An injector cannot be opened; the message says which option is wrong, why and what to do."""


class Injector:
    """The role calls; instants are of the clock of the run. Nothing here raises for what the autopilot sends.

    title: for people. counts: fresh with every `reset`; `taken` says that the autopilot takes what is sent.
    """

    title: str
    counts: InjectorCounters

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        """A run starts on this clock; `say` brings a sentence, with a MAV_SEVERITY, to the host."""
        raise NotImplementedError

    def handle(self, message: Message, now_ns: int) -> None:
        """A sensor sample or the truth from the host; ignored where it is of no use here."""
        raise NotImplementedError

    def repeat(self, now_ns: int) -> None:
        """Send the newest sample again, for an autopilot that hears its orders only while samples come. Never waits."""

    def serve(self, now_ns: int) -> None:
        """With every poll, in runs and between: receive from the autopilot and answer its requests. Never waits."""

    def advance(self, now_ns: int) -> bool:
        """Lockstep: let the autopilot run up to this instant; False when it has not followed after a short wait."""
        return True

    def run_on(self, now_ns: int) -> bool:
        """Lockstep, after the run: let the autopilot run up to this instant, without waiting.

        It has orders to hear and a log to write. Returns whether it has taken all that it needs until then.
        """
        return True

    def pulses(self) -> Sequence[int] | None:
        """Latest pulse widths in us, by output from 1 on; None where the outputs do not come back this way."""
        return None

    def commands(self) -> Sequence[float] | None:
        """Latest outputs as they are already normalised to [-1, 1]; None where there are none such."""
        return None

    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable with data from the autopilot."""
        return ()

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where it listens or connects to, for people."""
        return ()

    def close(self) -> None:
        """Close what is open."""
