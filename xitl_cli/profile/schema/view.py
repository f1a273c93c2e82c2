"""`view`: the 3D view beside a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sim_core.keys import Bounds, Positive, Specification


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSpec(Specification):
    """The 3D view in a browser during a run; this group enables it."""

    show: Annotated[bool, "`--view` and `--no-view` do the same for one run"] = True
    host: Annotated[str, "address to listen on; the printed address has a token"] = "127.0.0.1"
    port: Annotated[Annotated[int, Bounds(at_least=1, at_most=65535)] | None, "null: 8470, or the next free port"] = (
        None
    )
    open: Annotated[bool | None, "opens this machine's browser; null: on a desktop with an interactive terminal"] = None
    pace: Annotated[
        Positive | None, "times real time, in lockstep, while somebody watches; null: as fast as possible"
    ] = 1.0
    rate_hz: Annotated[
        Annotated[float, Bounds(at_least=1, at_most=60)], "largest number of pictures per second of wall clock"
    ] = 20.0
    dark: Annotated[bool, "night; every viewer can change it"] = False
