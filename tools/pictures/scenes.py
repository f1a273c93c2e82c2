"""Pictures of recordings in 3D, as `xitl view --png` and `--gif` make them."""

from __future__ import annotations

from pathlib import Path

from tools.pictures.workplace import Workplace

FROM_S, TO_S = 56.0, 83.0
"""Of the first run: along the boom, and into the turn at its end."""


def first_run(workplace: Workplace, path: Path) -> None:
    """The moving picture at the top of README."""
    from xitl_cli.plugins.view.pictures import moving_picture

    workplace.typed("xitl sim sitl --out runs/first")
    recording = workplace.folder / "runs/first/run.mcap"
    path.write_bytes(moving_picture([recording], FROM_S, TO_S, size=(720, 405), speed=3.0, kind="webp"))


def view(workplace: Workplace, path: Path) -> None:
    """What a view shows of a vessel."""
    from tools.pictures.browser import fewer_colours
    from xitl_cli.plugins.view.pictures import picture

    workplace.typed("xitl sim sitl --out runs/first")
    recording = workplace.folder / "runs/first/run.mcap"
    path.write_bytes(picture([recording], 60.0, size=(960, 540)))
    fewer_colours(path)
