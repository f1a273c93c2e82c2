"""`xitl.paper` of the public Python API."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.experiment.report import ExperimentReport

PathText = str | PathLike[str]


def paper(
    section: Literal["4.1", "4.2", "4.3", "4.4", "wdri"],
    *,
    out: PathText | None = None,
    seed: int = 1,
    duration_s: float | None = None,
    real: PathText | None = None,
    board: str | None = None,
    firmware: PathText | None = None,
    overwrite: bool = False,
) -> ExperimentReport:
    """Repeat one of the paper's experiments, as `xitl paper` does: a table of both results, and the figures.

    out: the directory of its runs, by default `runs/paper-<section>-<time>` in the working directory. duration_s:
    largest duration of each run. real: a log of a real boat (4.1). board: the URL of an agent on a board (4.3).
    firmware: an ardurover to start (4.2, 4.3), by default the one that is installed.

    `report.rows` have `quantity`, `paper`, `ours`, `unit` and `difference`. Raises UserError if this machine lacks
    something that the experiment needs.
    """
    from xitl_cli.experiment.setup import ExperimentSetup, default_directory
    from xitl_cli.plugins.studies.experiments.catalogue import EXPERIMENTS, carry_out

    if section not in EXPERIMENTS:
        raise UserError(f"{section!r} is no section of the paper; use {', '.join(EXPERIMENTS)}")
    setup = ExperimentSetup(
        default_directory(section) if out is None else Path(out),
        seed,
        duration_s,
        overwrite,
        firmware=None if firmware is None else fspath(firmware),
        real=None if real is None else Path(real),
        board=board,
    )
    return carry_out(section, setup)
