"""What goes down the pipe between a run and the process of its view, beside a ViewInstant: what is to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

from xitl_cli.plugins.view.server import ViewAddress
from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True)
class ViewStart:
    """The first thing down the pipe. updates: SceneUpdates as they are recorded. profiles: of each vessel.

    operated: the run does what is asked of it at the page, and `faults` names what can be switched there by vessel.
    lockstep: it can pause, step and change its pace, which is `pace` times real time while somebody looks.
    """

    title: str
    address: ViewAddress
    dark: bool
    updates: tuple[bytes, ...]
    profiles: tuple[RunProfile, ...]
    operated: bool = False
    lockstep: bool = True
    faults: tuple[tuple[str, tuple[str, ...]], ...] = ()
    pace: float | None = None


@dataclass(frozen=True, slots=True)
class ViewUpdate:
    """Something new to draw, as a SceneUpdate: debris, or a drawing that lasts a moment."""

    update: bytes


@dataclass(frozen=True, slots=True)
class ViewRefusal:
    """Why an action that was asked for at the page is not carried out."""

    text: str


@dataclass(frozen=True, slots=True)
class ViewEnd:
    """The run is over, and how."""

    text: str
