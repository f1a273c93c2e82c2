"""`view`: the 3D view beside a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sim_core.keys import Bounds, Positive, Specification


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSpec(Specification):
    """The 3D view in a browser while a run goes on; a profile with this group has one."""

    show: Annotated[bool, "`--view` and `--no-view` say the same for a run"] = True
    host: Annotated[str, "where it listens; the printed address has a token"] = "127.0.0.1"
    port: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=65535)] | None, "null: 8470, or the next one that is free"
    ] = None
    open: Annotated[
        bool | None, "in this machine's browser; null: where there is a desktop and somebody at a terminal"
    ] = None
    pace: Annotated[Positive | None, "times real time, in lockstep, while somebody looks; null: as fast as it goes"] = (
        1.0
    )
    rate_hz: Annotated[Annotated[float, Bounds(at_least=1, at_most=60)], "pictures a second of wall clock, at most"] = (
        20.0
    )
    dark: Annotated[bool, "by night; everybody who looks can change it"] = False
