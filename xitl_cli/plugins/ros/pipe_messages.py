"""Messages in the pipe between a run and its bridge process to ROS.

The process sends JSON objects: {"opened": NAME}, {"failed": SENTENCE}, {"action": {...}, "request": N}, {"ready":
{"node": NAME, "stamp_ns": N}}, {"counts": {"published": {...}, "received": {...}, "refused": {...}}}, {"problem":
SENTENCE}.
"""

from __future__ import annotations

from sim_core.dataclass import dataclass
from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True)
class RosStart:
    """The first message to the process."""

    profiles: tuple[RunProfile, ...]
    """One per vessel."""
    operated: bool = False
    """True if the run carries out requests of nodes."""


@dataclass(frozen=True, slots=True)
class RosChannel:
    """A topic of the recording."""

    number: int
    """Number of the topic in batches."""
    topic: str
    """Name as in the file."""


@dataclass(frozen=True, slots=True)
class RosBatch:
    """Recorded messages since the last batch."""

    messages: tuple[tuple[int, int, bytes], ...]
    """Number of the channel, instant and payload."""


@dataclass(frozen=True, slots=True)
class RosClockAgain:
    """During a standstill: the latest /clock once more, for a node that has missed it."""


@dataclass(frozen=True, slots=True)
class RosAnswer:
    """Result of an action."""

    request: int | None
    """None if nobody waits for it."""
    refusal: str | None
    """Reason of a refusal, or None."""


@dataclass(frozen=True, slots=True)
class RosEnd:
    """The run has ended."""
