"""Remote control and outputs: what came in, what went to the motors, and where either was at an end."""

from __future__ import annotations

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.radio.inputs import inputs
from xitl_cli.logs.analyses.radio.outputs import drives
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Section
from xitl_cli.logs.sensing.settings import settings
from xitl_cli.logs.signals import outputs, rc_inputs


def analyse(log: Log) -> Section | None:
    """None for a recording with neither inputs nor outputs."""
    instants = Instants(log)
    channels, driven = rc_inputs(log), outputs(log)
    if not channels and not driven and log.format == "mcap":
        return None
    parameters = settings(log)
    parts = (inputs(log, channels, parameters, instants), drives(log, driven, parameters, instants))
    return Section(
        "radio",
        "Remote control and outputs",
        facts=tuple(fact for part in parts for fact in part.facts),
        findings=tuple(finding for part in parts for finding in part.findings),
        grids=tuple(grid for part in parts for grid in part.grids),
        plots=tuple(plot for part in parts for plot in part.plots),
        lacks=tuple(lack for part in parts for lack in part.lacks),
    )
