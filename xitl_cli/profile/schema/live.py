"""`live`: what is recorded, served while a run goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sim_core.keys import Bounds, Specification


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSpec(Specification):
    """What is recorded, served to Foxglove while a run goes on: [view.md](view.md)."""

    foxglove: Annotated[bool, "`--live foxglove` says the same for a run"] = True
    port: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=65535)] | None,
        "of this machine, 127.0.0.1; null: 8765, or the next one that is free",
    ] = None
    commands: Annotated[bool, "clients may act: `--live-commands` says the same; otherwise they only read"] = False
