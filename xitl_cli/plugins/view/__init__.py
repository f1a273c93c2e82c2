"""The 3D view: a scene and instants of it, drawn by viser; beside a run as it goes on, and of recordings afterwards.

model.py       ViewScene (once), ViewInstant (many): all that is drawn. Knows no viser, no run and no log
scene.py       the scene that a run records, and its profile, to a ViewScene
shapes.py      triangles: cylinders, boxes, arrows, propellers, a plain boat
water.py       the surface as a grid that the waves of the run move
drawing.py     SceneDrawing: a ViewScene and its instants as nodes of a viser server
recording.py   LogScene: logs of runs and vehicles on one time line and in one map -> ViewScene, ViewInstant at any time
tracks.py      what a log tells of one vessel over time
replay.py      a LogScene on a server; timeline.py: its page; replay_page: one file that plays it; pictures.py: PNG, GIF
"""

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
    """The 3D view of a run, for `view.show`."""
    from xitl_cli.plugins.view.live_view import ViewOutput

    return ViewOutput(profiles)


def live_foxglove(profiles: Sequence[RunProfile]) -> LiveOutput:
    """The recording over Foxglove's WebSocket, for `live.foxglove`."""
    from xitl_cli.plugins.view.live_foxglove import FoxgloveOutput

    return FoxgloveOutput(profiles)


def replay(report: Report, vessel: str | None) -> Replay:
    """The logs of a report in 3D, or a sentence on why there is none."""
    from xitl_cli.plugins.view.report_replay import report_replay

    return report_replay(report, vessel)
