"""Estimate of a campaign's wall time and disk space, from rows of an earlier campaign or from two short runs."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.engine import try_first_run
from xitl_cli.plugins.campaign.execution import COMPLETED, INCOMPLETE, Row
from xitl_cli.plugins.campaign.plan import CampaignPlan
from xitl_cli.plugins.campaign.results import ResultTable, is_number
from xitl_cli.plugins.campaign.warden import TEMPORARY
from xitl_cli.profile.schema.agents import MissionSpec

FIRST_S, SECOND_S = 0.1, 10.0
"""Simulated time of the two short runs. The first shows that all figures exist, and the size of a run's fixed files."""
ROW_BYTES = 1000
"""Size of a row with a dozen figures in results.jsonl and results.parquet."""


@dataclass(frozen=True, slots=True)
class RunCost:
    """Cost of one run. None for an unknown value."""

    wall_s: float | None
    """Wall time."""
    folder_bytes: float | None
    """Size of its folder, if it is kept."""
    basis: str
    """Source of the estimate."""
    at_most: bool = False
    """The estimate assumes the profile's time limit, so the run may be shorter."""


def run_cost(plan: CampaignPlan, folders: Sequence[Path]) -> RunCost:
    """Return the cost of the plan's runs. folders: campaigns, the latest last. Only those of the same plan count.

    Without a row there, the first run is carried out for two short times. Raises UserError if it does not run, or lacks
    a figure of the plan.
    """
    first = _short(plan, FIRST_S)
    if (known := _earlier(plan, folders)) is not None:
        return known
    point = next(plan.points())
    runs = plan.base.check(point, {axis.key: axis.origin for axis in plan.axes}).profile.run_profiles()
    limit_s = runs[0].clock.duration_s
    longest_s = max((course_s(run.mission) for run in runs if run.driver.kind == "mission"), default=0.0)
    at_most = not 0.0 < longest_s < limit_s
    simulated_s = limit_s if at_most else longest_s
    source = "clock.duration_s at most" if at_most else "course length over speed"
    length = f"{simulated_s:.3g} s of a run ({source})"
    if first is None:
        if plan.base.loaded.profile.run_profiles()[0].clock.mode == "realtime":
            return RunCost(simulated_s, None, f"{length} in real time", at_most)
        return RunCost(None, None, "a short trial of the first run is not possible here; run one and read its wall_s")
    second = _short(plan, SECOND_S)
    if second is None or second.simulated_s <= first.simulated_s:
        return RunCost(None, None, "the first run ends too soon to be measured; run one and read its wall_s")
    start_s = second.wall_s - second.loop_wall_s
    speed = second.simulated_s / max(second.loop_wall_s, 1e-3)
    bytes_a_s = (second.folder_bytes - first.folder_bytes) / (second.simulated_s - first.simulated_s)
    return RunCost(
        start_s + simulated_s / speed,
        first.folder_bytes + simulated_s * max(bytes_a_s, 0.0),
        f"{length} at {speed:.2g} times real time after {start_s:.2g} s to start, measured in "
        f"{second.simulated_s:.3g} s of the first run",
        at_most,
    )


def _earlier(plan: CampaignPlan, folders: Sequence[Path]) -> RunCost | None:
    """Return the means of the latest campaign of the same plan with rows."""
    for folder in reversed(folders):
        try:
            table = ResultTable.read(folder)
        except UserError:
            continue
        if table.about.get("digest") != plan.digest():
            continue
        walls = [float(row["wall_s"]) for row in table.rows if _ended(row) and is_number(row.get("wall_s"))]
        directories = [Path(row["directory"]) for row in table.rows if row.get("directory")]
        sizes = [folder_bytes(path) for path in directories if path.is_dir()]
        if walls:
            size = sum(sizes) / len(sizes) if sizes else None
            return RunCost(sum(walls) / len(walls), size, f"the mean of {len(walls)} runs in {folder}")
    return None


def _ended(row: Row) -> bool:
    return row.get("status") in (COMPLETED, INCOMPLETE)


@dataclass(frozen=True, slots=True)
class _ShortRun:
    """Result of a short run."""

    simulated_s: float
    wall_s: float
    loop_wall_s: float
    """Part of wall_s without process start and composition of the run."""
    folder_bytes: int


def _short(plan: CampaignPlan, duration_s: float) -> _ShortRun | None:
    """Carry out the first run up to a simulated time. Return None if it takes too long, or it failed."""
    with tempfile.TemporaryDirectory(prefix=TEMPORARY) as name:
        row = try_first_run(plan, duration_s, Path(name))
        if row is None or not _ended(row):
            return None
        summary = row["summary"]
        times_s = (float(summary["duration_s"]), float(row["wall_s"]), float(summary["wall_s"]))
        return _ShortRun(*times_s, folder_bytes(Path(name)))


def folder_bytes(folder: Path) -> int:
    """Return the size of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def course_s(mission: MissionSpec) -> float:
    """Return the length of the waypoints' course from the start over its speed; 0 without waypoints."""
    places = [(mission.start.north_m, mission.start.east_m), *(place[:2] for place in mission.waypoints_ned_m)]
    return sum(map(math.dist, places, places[1:])) / mission.speed_mps
