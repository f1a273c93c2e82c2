"""How a run is to be operated: who may act in it, what is given again, and how fast it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from xitl_cli.errors import UserError
from xitl_cli.profile.schema import Profile
from xitl_cli.run.operator.actions import ActionError, read_action
from xitl_cli.run.operator.replay import TimedAction, read_events

if TYPE_CHECKING:
    from xitl_cli.run.operator.node import OperatorNode


@dataclass(frozen=True, slots=True)
class Operation:
    """people: who may act as it goes on; each is given the operator before the run begins. events: actions that are
    given again. pace: times real time in lockstep, None for as fast as it can. viewed: it has a view, at whose page
    people act. ros: nodes of ROS do. live: people act from Foxglove.
    """

    people: tuple[Callable[[OperatorNode], object], ...] = ()
    events: tuple[TimedAction, ...] = ()
    pace: float | None = None
    viewed: bool = False
    ros: bool = False
    live: bool = False

    @property
    def operated(self) -> bool:
        """Whether the run has an operator at all."""
        return self._attended or bool(self.events)

    @property
    def paced(self) -> bool:
        """Whether time may stand still or go by at a pace."""
        return self._attended or self.pace is not None

    @property
    def _attended(self) -> bool:
        return bool(self.people or self.viewed or self.live or self.ros)


UNATTENDED = Operation()


def operation_of(profile: Profile, replay_events: Path | None = None, pace: float | None = None) -> Operation:
    """What the options of `xitl sim` ask for. Raises UserError for a file or a pace that cannot be."""
    if pace is not None:
        try:
            read_action({"action": "pace", "factor": pace})
        except ActionError as error:
            raise UserError(f"--{error}") from None
        if profile.clock is not None and profile.clock.mode == "realtime":
            raise UserError("--pace: time goes by with the clock on the wall; use --clock lockstep, or leave it out")
    events = () if replay_events is None else read_events(replay_events)
    return Operation(events=events, pace=pace)
