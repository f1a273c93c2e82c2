"""The 3D replay on the page of `xitl logs analyze --report`."""

from __future__ import annotations

from xitl_cli.errors import UserError
from xitl_cli.extras import VIEW
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.report.model import Report
from xitl_cli.logs.report.page import Replay

MOST_REPLAY_BYTES = 12_000_000
"""Maximum size of a replay on the page of a report."""


def report_replay(found: Report, vessel: str | None) -> Replay:
    """Return the 3D replay of a report's logs, or the reason why there is none."""
    if VIEW.missing:
        return Replay(note=f"the 3D replay needs {', '.join(VIEW.missing)}, which is not installed: {VIEW.pip_line}")
    from xitl_cli.plugins.view.recording import open_scene
    from xitl_cli.plugins.view.replay_page import replay_html

    by_path = {file.path: file for file in found.files}
    recordings = [file.path for file in found.files if file.format == "mcap"][:1]  # other logs are of the same run
    try:
        with open_scene(recordings or list(by_path)[:1], vessel) as scene:
            page = replay_html(scene, findings=scene.findings_of(found), at_s=scene.span_s[0])
            path, second = scene.lead_second(0)
    except (LogError, UserError) as error:
        return Replay(note=f"there is no 3D replay: {error}")
    if len(page) > MOST_REPLAY_BYTES:
        size = f"{len(page) / 1e6:.0f} MB, more than {MOST_REPLAY_BYTES / 1e6:.0f}"
        return Replay(note=f"the 3D replay is left out: it has {size}; `xitl view LOG --html FILE` writes it")
    return Replay(page, late_s=second - by_path[path].time_line.second(0))
