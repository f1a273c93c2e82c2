"""`xitl.paper` of the public Python API."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast

from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from xitl_cli.experiment.report import ExperimentReport
    from xitl_cli.experiment.setup import ExperimentSetup

PathText = str | PathLike[str]
EXPERIMENTS: Mapping[str, str] = {
    "4.1": "xitl_cli.plugins.studies.experiments.section_4_1_recorded_outputs:recorded_outputs_report",
    "4.2": "xitl_cli.plugins.studies.experiments.section_4_2_departure:departure_report",
    "4.3": "xitl_cli.plugins.studies.experiments.section_4_3_sitl_hitl:sitl_hitl_report",
    "4.4": "xitl_cli.plugins.studies.experiments.section_4_4_lidar_sonar:lidar_sonar_report",
    "wdri": "xitl_cli.plugins.studies.experiments.wdri_indices:wdri_report",
}
"""Function of each experiment, by the section of the paper."""


def carry_out(section: str, setup: ExperimentSetup) -> ExperimentReport:
    """Carry out the runs of a section and return their results. Raises UserError if this is impossible here, and
    InterruptedRunError.
    """
    module, _, name = EXPERIMENTS[section].partition(":")
    experiment = cast("Callable[[ExperimentSetup], ExperimentReport]", getattr(import_module(module), name))
    return experiment(setup)


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

    if section not in EXPERIMENTS:
        raise UserError(f"{section!r} is not a section of the paper; use {', '.join(EXPERIMENTS)}")
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
