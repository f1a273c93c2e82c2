"""`live`: what is recorded, served while a run goes on, by xitl and by other packages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import Bounds, MoreChoices, Specification
from xitl_cli.registry import LIVE_OUTPUTS, names

OWN_KEYS = ("view", "ros")
"""Outputs of xitl that have their own group in a profile."""


def added_live_outputs() -> list[str]:
    """Return the names for `live.outputs`: all registered outputs without their own group."""
    return [name for name in names(LIVE_OUTPUTS) if name not in OWN_KEYS]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSpec(Specification):
    """The recorded topics, served to Foxglove during a run: [view.md](view.md). Other outputs by name."""

    foxglove: Annotated[
        bool | None, "`--live foxglove` does the same for one run; null: true, or false if `outputs` has names"
    ] = None
    outputs: Annotated[
        tuple[Annotated[Literal["foxglove"], MoreChoices(added_live_outputs)], ...],
        "live outputs of packages, by name: [plugins.md](plugins.md#a-live-output); `--live NAME` does the same",
    ] = ()
    port: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=65535)] | None,
        "port of this machine, 127.0.0.1; null: 8765, or the next free port",
    ] = None
    commands: Annotated[bool, "clients may act, as with `--live-commands`; otherwise they can only read"] = False

    @property
    def streams_foxglove(self) -> bool:
        """Whether the run streams to Foxglove."""
        return not self.outputs if self.foxglove is None else self.foxglove
