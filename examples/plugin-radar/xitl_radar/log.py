"""The radar in a log: an analysis for `xitl logs analyze`, and the command `xitl radar`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Section
from xitl_cli.plugin import Command

TOPIC, COLUMNS = "/radar/targets", ("scan", "range_m", "bearing_deg")


def analyse(log: Log) -> Section | None:
    """Targets of the radar, and whether one was inside the guard zone."""
    if TOPIC not in log.tables:
        return None
    table = log.tables[TOPIC]
    if not len(table):
        return Section("radar", "Radar", lacks=("the radar saw no target",))
    range_m, guard_m = table.values("range_m"), float(table.values("guard_m")[0])
    nearest = int(np.argmin(range_m))
    facts = (Fact("targets", "Targets", len(table)),)
    at = Evidence(TOPIC, "range_m", int(table.stamp_ns[nearest]), value=f"{range_m[nearest]:.1f} m")
    text = f"The nearest target was {range_m[nearest]:.1f} m away; the guard zone is {guard_m:g} m."
    if range_m[nearest] >= guard_m:
        finding = Finding.ok("radar.guard_zone", text, (at,))
    else:
        finding = Finding.warning("radar.guard_zone", text, (at,), "Look at this time in the 3D view: xitl view")
    return Section("radar", "Radar", facts=facts, findings=(finding,))


def _add(app: typer.Typer, name: str) -> None:
    @app.command(name)
    def radar(run: Annotated[Path, typer.Argument(help="Directory of a run.")], vessel: str = "") -> None:
        """List the targets of the radar, one line for each."""
        with open_log(run / "run.mcap", vessel) as log:
            if TOPIC not in log.tables:
                raise UserError(f"{run}: has no {TOPIC}; add plugins.radar to the profile of the run")
            table = log.tables[TOPIC]
            for scan, range_m, bearing_deg in zip(*map(table.values, COLUMNS), strict=True):
                typer.echo(f"scan {scan:4d}  {range_m:7.1f} m  {bearing_deg:+7.1f} deg")


COMMAND = Command("List the targets of the radar, one line for each.", _add)
