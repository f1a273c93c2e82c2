"""`live`: what is recorded, served while a run goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sim_core.keys import Bounds, Specification


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSpec(Specification):
    """The recorded topics, served to Foxglove during a run: [view.md](view.md)."""

    foxglove: Annotated[bool, "`--live foxglove` does the same for one run"] = True
    port: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=65535)] | None,
        "port of this machine, 127.0.0.1; null: 8765, or the next free port",
    ] = None
    commands: Annotated[bool, "clients may act, as with `--live-commands`; otherwise they can only read"] = False
