"""Sensor injectors: ways to feed simulated sensors into an autopilot. The bridge role drives any number of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Callable

from agent.bridges.counts import BridgeCounts
from agent.timing.clock import Clock
from agent.wire.codec import Message


@dataclass
class InjectorCounters(BridgeCounts):
    """Counts of one injector since the run began. The role fills in the counts that no injector has.

    `imu_out`, `solution_out` and `gnss_out` leave out the frames that are counted as `unsent`.
    """

    refused: int = 0
    """Messages of the host that were not valid measurements. XITL_NODE_STATUS reports them."""
    script_answers: bool = False
    """The script on the autopilot answers."""
    taken: bool = False
    """The autopilot accepts the samples."""


class InjectorError(ValueError):
    """Raised when an injector cannot be opened. The message names the wrong option, the cause and the remedy."""


class Injector:
    """Interface that the role calls. Instants are on the clock of the run.

    Nothing here raises for bytes from the autopilot.
    """

    title: str
    """Name for people."""
    counts: InjectorCounters
    """New with every `reset`."""

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        """Start a run on this clock. `say` sends a sentence with a MAV_SEVERITY to the host."""
        raise NotImplementedError

    def handle(self, message: Message, now_ns: int) -> None:
        """Handle a sensor sample or the ground truth from the host.

        An injector ignores messages that it does not use.
        """
        raise NotImplementedError

    def repeat(self, now_ns: int) -> None:
        """Send the newest sample again, for an autopilot that reads commands only while samples arrive. Never waits."""

    def serve(self, now_ns: int) -> None:
        """Receive from the autopilot and answer its requests. Called at every poll, in runs and between.

        Never waits.
        """

    def advance(self, now_ns: int) -> bool:
        """Lockstep: let the autopilot run up to this instant.

        Return False when it has not followed after a short wait.
        """
        return True

    def run_on(self, now_ns: int) -> bool:
        """Lockstep, after the run: let the autopilot run up to this instant, without waiting.

        It still has commands to read and a log to write. Return whether it has received all data that it needs until
        then.
        """
        return True

    def pulses(self) -> Sequence[int] | None:
        """Latest pulse widths in us, by output from 1 on. None when the outputs do not return through this injector."""
        return None

    def commands(self) -> Sequence[float] | None:
        """Latest normalised outputs, which the role limits to [-1, 1]. None when there are none."""
        return None

    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable with data from the autopilot."""
        return ()

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses where it listens or connects to, for people."""
        return ()

    def close(self) -> None:
        """Close all open resources."""
