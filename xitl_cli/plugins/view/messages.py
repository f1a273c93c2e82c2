"""Messages that a run sends to its view process, in addition to ViewInstant."""

from __future__ import annotations

from sim_core.dataclass import dataclass
from xitl_cli.logs.charts.chart import Chart
from xitl_cli.plugins.view.server import ViewAddress
from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True)
class ViewStart:
    """The first message."""

    title: str
    address: ViewAddress
    dark: bool
    updates: tuple[bytes, ...]
    """Encoded SceneUpdates, as the run records them."""
    profiles: tuple[RunProfile, ...]
    """Profiles of all vessels."""
    operated: bool = False
    """True if the run carries out actions from the page."""
    lockstep: bool = True
    """True if the run can pause, step and change its pace."""
    faults: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Names of the faults that the page can switch, by vessel."""
    pace: float | None = None
    """Multiple of real time while a browser is connected; None for no limit."""
    chart: Chart | None = None
    """Chart on the water."""


@dataclass(frozen=True, slots=True)
class ViewUpdate:
    """New debris or a new temporary drawing."""

    update: bytes
    """Encoded SceneUpdate."""


@dataclass(frozen=True, slots=True)
class ViewRefusal:
    """Reason why the run does not carry out an action from the page."""

    text: str


@dataclass(frozen=True, slots=True)
class ViewEnd:
    """End of the run."""

    text: str
    """Message to the user about the end."""
