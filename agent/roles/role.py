"""What a node is there for: the embedded autopilot, a bridge to another one, or a companion computer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable, NamedTuple

from agent.timing.clock import Clock
from agent.timing.tasks import Executor, TaskMiss, TaskStats
from agent.wire.codec import Message


class Traffic(NamedTuple):
    """What has passed between the node's own parts since the run began, what was refused, and what got lost.

    stations_missed: what ground stations did not get, or said in vain. events_lost: dropped before they were sent,
    and vessels heard by AIS beyond what the table holds. controller_failures: steps at which the user's
    controller raised or gave no usable answer.
    """

    estimates: int = 0
    efforts: int = 0
    messages_refused: int = 0
    log_dropped: int = 0
    stations_missed: int = 0
    events_lost: int = 0
    controller_failures: int = 0


class Role:
    """The node calls; instants are of the clock of the run, which between runs is this machine's.

    title: for people. nodes: node kinds, for instance LS,LC,LA. telemetry_hz: how often `telemetry` is asked.
    peers: who is at `addresses`, beside the host.
    """

    title: str
    peers = "ground stations"
    nodes: str
    telemetry_hz: float

    def reset(self, clock: Clock, lockstep: bool) -> None:
        """Fresh, as for a run on this clock; the run itself is not on yet."""
        raise NotImplementedError

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        """A run starts: add the tasks it needs, in the order in which they run when due together.

        `silent_s` tells how long nothing has come from the host, 0 in lockstep.
        """
        raise NotImplementedError

    def handle(self, message: Message, now_ns: int) -> Sequence[Message]:
        """A message that is not the node's own; returns the replies."""
        raise NotImplementedError

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        """What is due to be sent."""
        raise NotImplementedError

    def end_tick(self, tick: int, now_ns: int) -> Sequence[Message]:
        """Lockstep: what ends a tick. Called again for the same tick while `has_followed` is False."""
        return ()

    @property
    def has_followed(self) -> bool:
        """Whether the last `end_tick` answered its tick; False while an autopilot behind the role is not there yet."""
        return True

    def end_run(self, now_ns: int) -> Sequence[Message]:
        """The run is over, whoever ended it; returns the last word to the host."""
        return ()

    def add_event(self, severity: int, text: str) -> None:
        """A sentence for people, with a MAV_SEVERITY."""

    # -- records

    def log_task_stats(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        """Once a second: how the tasks did since the start."""

    def log_missed_deadlines(self, now_ns: int, misses: Sequence[TaskMiss]) -> None:
        """Deadlines that were missed."""

    @property
    def traffic(self) -> Traffic:
        """Counts so far."""
        return Traffic()

    # -- peers beside the host

    def add_peer_tasks(self, executor: Executor) -> None:
        """Add what has to be done for them, in runs and between."""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Where they are sent to, or may call."""
        return ()

    def descriptors(self) -> Sequence[int]:
        """What becomes readable when peers have sent something."""
        return ()

    def serve_peers(self, now: Callable[[], int]) -> None:
        """Called with every poll, in runs and between them."""
