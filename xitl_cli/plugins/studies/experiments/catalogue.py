"""The paper's experiments by the number of their section."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import cast

from xitl_cli.experiment.report import ExperimentReport
from xitl_cli.experiment.setup import ExperimentSetup

EXPERIMENTS: Mapping[str, str] = {
    "4.1": "xitl_cli.plugins.studies.experiments.section_4_1_recorded_outputs:recorded_outputs_report",
    "4.2": "xitl_cli.plugins.studies.experiments.section_4_2_departure:departure_report",
    "4.3": "xitl_cli.plugins.studies.experiments.section_4_3_sitl_hitl:sitl_hitl_report",
    "4.4": "xitl_cli.plugins.studies.experiments.section_4_4_lidar_sonar:lidar_sonar_report",
    "wdri": "xitl_cli.plugins.studies.experiments.wdri_indices:wdri_report",
}
"""Function of each experiment."""


def carry_out(section: str, setup: ExperimentSetup) -> ExperimentReport:
    """Carry out the runs and return their results. Raises UserError if this is impossible here, and
    InterruptedRunError.
    """
    module, _, name = EXPERIMENTS[section].partition(":")
    experiment = cast(Callable[[ExperimentSetup], ExperimentReport], getattr(import_module(module), name))
    return experiment(setup)
