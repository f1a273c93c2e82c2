"""What goes down the pipe between a run and the process of its bridge to ROS.

Up go JSON objects: {"opened": NAME}, {"failed": SENTENCE}, {"action": {...}, "request": N}, {"ready": {"node": NAME,
"stamp_ns": N}}, {"counts": {"published": {...}, "received": {...}, "refused": {...}}}, {"problem": SENTENCE}.
"""

from __future__ import annotations

from dataclasses import dataclass

from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True)
class RosStart:
    """The first thing down the pipe. profiles: of each vessel. operated: the run does what nodes ask of it."""

    profiles: tuple[RunProfile, ...]
    operated: bool = False


@dataclass(frozen=True, slots=True)
class RosChannel:
    """A topic of the recording, by the number that batches have for it. topic: as in the file."""

    number: int
    topic: str


@dataclass(frozen=True, slots=True)
class RosBatch:
    """What was recorded since the last one. messages: number of the channel, instant and payload."""

    messages: tuple[tuple[int, int, bytes], ...]


@dataclass(frozen=True, slots=True)
class RosClockAgain:
    """The run stands still: the latest /clock once more, for a node that has missed it."""


@dataclass(frozen=True, slots=True)
class RosAnswer:
    """What became of an action: why it is not carried out, or None. request: None where nobody waits for it."""

    request: int | None
    refusal: str | None


@dataclass(frozen=True, slots=True)
class RosEnd:
    """The run is over."""
