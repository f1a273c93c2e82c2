"""Entry points of the plug-in `view`, and `xitl.replay_html` and `xitl.picture` of the public Python API.

Functions import lazily, so that loading is cheap.
"""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
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
    from xitl_cli.plugins.view.replay_page import report_replay

    return report_replay(report, vessel)


PathText = str | PathLike[str]


def replay_html(
    *logs: PathText, vessel: str | None = None, from_s: float | None = None, to_s: float | None = None
) -> str:
    """Return a page that replays logs in 3D, as `xitl view --html` writes it. It opens from the disk without a network.

    vessel: one vessel of a fleet's recording. from_s, to_s: start and end of the part to replay, in seconds.

    Raises UserError without the extra `view` and for an empty span. Raises LogError for a file that is not a log, or
    has no positions or attitudes.
    """
    from xitl_cli.plugins.view.recording import open_scene
    from xitl_cli.plugins.view.replay_page import replay_html as page_of

    with open_scene([Path(log) for log in logs], vessel) as recording:
        return page_of(recording, from_s=from_s, to_s=to_s)


def picture(*logs: PathText, at_s: float, size: tuple[int, int] = (1280, 720), vessel: str | None = None) -> bytes:
    """Return one instant of logs in 3D as PNG, as `xitl view --png` writes it.

    at_s: the instant, in seconds. size: width and height in pixels. vessel: the vessel to look at.

    Raises UserError without the extra `view`, without Chromium, Chrome or Edge, and for an instant outside of the
    recording. Raises LogError as `replay_html` does.
    """
    from xitl_cli.plugins.view.pictures import picture as picture_of

    return picture_of([Path(log) for log in logs], at_s, size=size, vessel=vessel)
