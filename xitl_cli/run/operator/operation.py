"""Operation of a run: who may act in it, which actions are repeated, and its pace."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.profile.schema import Profile
from xitl_cli.run.operator.actions import ActionError, read_action
from xitl_cli.run.operator.replay import TimedAction, read_events


@dataclass(frozen=True, slots=True)
class Operation:
    """Options for the operation of a run."""

    people: tuple[Callable[[Any], object], ...] = ()
    """Sources of actions during the run. Each gets the `OperatorNode` before the run begins."""
    events: tuple[TimedAction, ...] = ()
    """Actions that are repeated."""
    pace: float | None = None
    """Multiple of real time in lockstep; None for as fast as possible."""
    viewed: bool = False
    """The run has a view with a page for actions."""
    ros: bool = False
    """ROS nodes may act."""
    live: bool = False
    """Users may act from Foxglove."""

    @property
    def operated(self) -> bool:
        """Whether the run has an operator."""
        return self._attended or bool(self.events)

    @property
    def paced(self) -> bool:
        """Whether the run may pause or have a pace."""
        return self._attended or self.pace is not None

    @property
    def _attended(self) -> bool:
        return bool(self.people or self.viewed or self.live or self.ros)


UNATTENDED = Operation()


def operation_of(profile: Profile, replay_events: Path | None = None, pace: float | None = None) -> Operation:
    """Return the operation for the options of `xitl sim`. Raises UserError for an invalid file or pace."""
    if pace is not None:
        try:
            read_action({"action": "pace", "factor": pace})
        except ActionError as error:
            raise UserError(f"--{error}") from None
        if profile.clock is not None and profile.clock.mode == "realtime":
            raise UserError("--pace: time goes by with the clock on the wall; use --clock lockstep, or leave it out")
    events = () if replay_events is None else read_events(replay_events)
    return Operation(events=events, pace=pace)
