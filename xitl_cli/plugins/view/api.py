"""`xitl.replay_html` and `xitl.picture` of the public Python API."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

PathText = str | PathLike[str]


def replay_html(
    *logs: PathText, vessel: str | None = None, from_s: float | None = None, to_s: float | None = None
) -> str:
    """A page that replays logs in 3D, as `xitl view --html` writes it: opens from the disk and needs no network.

    vessel: one vessel of a fleet's recording. from_s, to_s: start and end of the part to replay, in seconds.

    Raises UserError without the extra `view` and for an empty span. Raises LogError for a file that is not a log, or
    has no positions or attitudes.
    """
    from xitl_cli.plugins.view.recording import open_scene
    from xitl_cli.plugins.view.replay_page import replay_html as page_of

    with open_scene([Path(log) for log in logs], vessel) as recording:
        return page_of(recording, from_s=from_s, to_s=to_s)


def picture(*logs: PathText, at_s: float, size: tuple[int, int] = (1280, 720), vessel: str | None = None) -> bytes:
    """One instant of logs in 3D as PNG, as `xitl view --png` writes it.

    at_s: the instant, in seconds. size: width and height in pixels. vessel: the vessel to look at.

    Raises UserError without the extra `view`, without Chromium, Chrome or Edge, and for an instant outside of the
    recording. Raises LogError as `replay_html` does.
    """
    from xitl_cli.plugins.view.pictures import picture as picture_of

    return picture_of([Path(log) for log in logs], at_s, size=size, vessel=vessel)
