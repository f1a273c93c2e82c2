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
    people act. ros: nodes of ROS do. live: what it is served to as well, at live_port of this machine, None for the
    usual one or a free one.
    """

    people: tuple[Callable[[OperatorNode], object], ...] = ()
    events: tuple[TimedAction, ...] = ()
    pace: float | None = None
    viewed: bool = False
    ros: bool = False
    live: str | None = None
    live_port: int | None = None

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


LIVE = ("foxglove",)


def operation_of(
    profile: Profile,
    replay_events: Path | None = None,
    pace: float | None = None,
    live: str | None = None,
    live_port: int | None = None,
) -> Operation:
    """What the options of `xitl sim` ask for. Raises UserError for a file, a pace or a server that cannot be."""
    if live is not None and live not in LIVE:
        raise UserError(f"--live {live}: is not known; use {' or '.join(LIVE)}, or --view for a page of xitl's own")
    if live_port is not None and (live is None or not 1 <= live_port <= 65535):
        why = "is of --live foxglove; add that" if live is None else "is no port; use 1 to 65535"
        raise UserError(f"--live-port {live_port}: {why}")
    if pace is not None:
        try:
            read_action({"action": "pace", "factor": pace})
        except ActionError as error:
            raise UserError(f"--{error}") from None
        if profile.clock is not None and profile.clock.mode == "realtime":
            raise UserError("--pace: time goes by with the clock on the wall; use --clock lockstep, or leave it out")
    events = () if replay_events is None else read_events(replay_events)
    return Operation(events=events, pace=pace, live=live, live_port=live_port)
