"""Roles of a node: the embedded autopilot, a bridge to another one, or a companion computer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable, NamedTuple

from agent.timing.clock import Clock
from agent.timing.tasks import Executor, TaskMiss, TaskStats
from agent.wire.codec import Message


class Traffic(NamedTuple):
    """Traffic between the node's own parts since the run began, refused messages, and losses."""

    estimates: int = 0
    efforts: int = 0
    messages_refused: int = 0
    log_dropped: int = 0
    stations_missed: int = 0
    """Everything that ground stations did not receive or sent without effect."""
    events_lost: int = 0
    """Events dropped before they were sent, and AIS vessels beyond the size of the table."""
    controller_failures: int = 0
    """Steps at which the user's controller raised or returned an invalid output."""


class Role:
    """Interface that the node calls. Instants are on the clock of the run, or of this machine between runs."""

    title: str
    """Name for people."""
    peers = "ground stations"
    """Kind of the peers at `addresses`, other than the host."""
    nodes: str
    """Node kinds, for instance LS,LC,LA."""
    telemetry_hz: float
    """Rate of the calls of `telemetry`."""

    def reset(self, clock: Clock, lockstep: bool) -> None:
        """Reset the state for a run on this clock. The run has not started yet."""
        raise NotImplementedError

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        """Start a run: add its tasks, in the order in which they run when due together.

        silent_s: returns the time since the host's last message, 0 in lockstep.
        """
        raise NotImplementedError

    def handle(self, message: Message, now_ns: int) -> Sequence[Message]:
        """Handle a message that is not the node's own. Return the replies."""
        raise NotImplementedError

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        """Return the messages that are due."""
        raise NotImplementedError

    def end_tick(self, tick: int, now_ns: int) -> Sequence[Message]:
        """Lockstep: return the messages that end a tick.

        Called again for the same tick while `has_followed` is False.
        """
        return ()

    @property
    def has_followed(self) -> bool:
        """Whether the last `end_tick` answered its tick.

        False while an autopilot behind the role has not reached it.
        """
        return True

    def end_run(self, now_ns: int) -> Sequence[Message]:
        """End the run, whatever the reason. Return the last messages to the host."""
        return ()

    def add_event(self, severity: int, text: str) -> None:
        """Send a sentence to the user, with a MAV_SEVERITY."""

    # -- records

    def log_task_stats(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        """Log the task statistics since the start. Called once a second."""

    def log_missed_deadlines(self, now_ns: int, misses: Sequence[TaskMiss]) -> None:
        """Log missed deadlines."""

    @property
    def traffic(self) -> Traffic:
        """Counts so far."""
        return Traffic()

    # -- peers other than the host

    def add_peer_tasks(self, executor: Executor) -> None:
        """Add the tasks that serve the peers, in runs and between."""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses of the peers, or addresses that they may connect to."""
        return ()

    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable when peers have sent something."""
        return ()

    def serve_peers(self, now: Callable[[], int]) -> None:
        """Serve the peers. Called with every poll, in runs and between."""
