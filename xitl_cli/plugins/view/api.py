"""`xitl.replay_html` and `xitl.picture` of the public Python API."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

PathText = str | PathLike[str]


def replay_html(
    *logs: PathText, vessel: str | None = None, from_s: float | None = None, to_s: float | None = None
) -> str:
    """A page that plays logs in 3D, as `xitl view --html` writes it: opens from the disk, asks for nothing outside.

    vessel: of a fleet's recording this one alone. from_s, to_s: a part of it. Raises UserError without the extra `view`
    and for an empty span, LogError for a file that is no log, or without positions or attitudes.
    """
    from xitl_cli.plugins.view.recording import open_scene
    from xitl_cli.plugins.view.replay_page import replay_html as page_of

    with open_scene([Path(log) for log in logs], vessel) as recording:
        return page_of(recording, from_s=from_s, to_s=to_s)


def picture(*logs: PathText, at_s: float, size: tuple[int, int] = (1280, 720), vessel: str | None = None) -> bytes:
    """An instant of logs in 3D as PNG, as `xitl view --png` writes it; size: width and height.

    vessel: what is looked at. Raises UserError without the extra `view`, without Chromium, Chrome or Edge, and for an
    instant outside of the recording; LogError as `replay_html`.
    """
    from xitl_cli.plugins.view.pictures import picture as picture_of

    return picture_of([Path(log) for log in logs], at_s, size=size, vessel=vessel)
