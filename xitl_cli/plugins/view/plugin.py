"""Entry points of the plug-in `view`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from xitl_cli.plugin import Command

if TYPE_CHECKING:
    import typer

    from xitl_cli.logs.report.model import Report
    from xitl_cli.logs.report.page import Replay
    from xitl_cli.profile.schema import RunProfile
    from xitl_cli.run.core.live_output import LiveOutput


def _add(app: typer.Typer, name: str) -> None:
    from xitl_cli.plugins.view.command import view

    app.command(name)(view)


COMMAND = Command("Play recordings of runs and vehicles in 3D, or write them as a page or pictures.", _add)


def live_view(profiles: Sequence[RunProfile]) -> LiveOutput:
    """Return the live 3D view of a run, for `view.show`."""
    from xitl_cli.plugins.view.live_view import ViewOutput

    return ViewOutput(profiles)


def live_foxglove(profiles: Sequence[RunProfile]) -> LiveOutput:
    """Return the live output over Foxglove's WebSocket, for `live.foxglove`."""
    from xitl_cli.plugins.view.live_foxglove import FoxgloveOutput

    return FoxgloveOutput(profiles)


def replay(report: Report, vessel: str | None) -> Replay:
    """Return the 3D replay of a report's logs, or the reason why there is none."""
    from xitl_cli.plugins.view.report_replay import report_replay

    return report_replay(report, vessel)
