"""A plan from its folder to its table, for the command and `xitl.campaign`."""

from __future__ import annotations

import contextlib
import uuid
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.cluster import TlsFiles, local_workers, workers_at
from xitl_cli.plugins.campaign.engine import Campaign, CampaignProgress, try_first_run
from xitl_cli.plugins.campaign.plan import CampaignPlan
from xitl_cli.plugins.campaign.results import CAMPAIGN, CampaignFolder, FullDiskError, ResultTable
from xitl_cli.plugins.campaign.search import carry_out as carry_out_search

RUNS_FOLDER = "runs"


class CampaignWatch(Protocol):
    """Receives the progress of a campaign."""

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """Called at the start with the number of parallel runs, the scheduler, and the address of Dask's dashboard if
        any.
        """

    def __call__(self, progress: CampaignProgress) -> None:
        """Called at intervals."""


class NoWatch:
    """Ignores the progress."""

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """See CampaignWatch."""

    def __call__(self, progress: CampaignProgress) -> None:
        """See CampaignWatch."""


def carry_out(
    plan: CampaignPlan,
    folder: CampaignFolder,
    on: str | None = None,
    workers: int | None = None,
    total: int | None = None,
    watch: CampaignWatch | None = None,
    tls: TlsFiles | None = None,
) -> ResultTable:
    """Carry out the runs of a plan that its folder lacks, here or on a scheduler. Return the table of all runs.

    tls: files for a scheduler at a `tls://` address; by default those of Dask's configuration.
    Raises UserError for a problem that the user has to fix. Completed runs are kept, also after a KeyboardInterrupt.
    """
    watch = watch or NoWatch()
    name = uuid.uuid4().hex[:12]
    kept = None if plan.spec.recordings == "none" else folder.path
    if not folder.done:
        try_first_run(plan)
    try:
        with workers_at(on, name, kept, tls) if on is not None else local_workers(workers, name) as found:
            watch.began(found.threads, on, found.dashboard)
            campaign = Campaign(plan, folder, found, total, watch, name)
            if plan.search is not None:
                carry_out_search(plan.search, campaign.submit)
            else:
                for _ in campaign.run():
                    pass
    finally:
        folder.close()
        if folder.done:
            with contextlib.suppress(FullDiskError):  # the table is returned anyway
                folder.write_table()
    return folder.table()


def open_folder(plan: CampaignPlan, out: Path | None, resume: bool) -> CampaignFolder:
    """Return the folder of a campaign: a new folder, or the one to resume. Raises UserError."""
    if not resume:
        return CampaignFolder.create(out or _default_path(plan), plan)
    before = folders_of(plan, out)
    if not before and out is None:
        where = f"{RUNS_FOLDER}/{plan.name}-…"
        raise UserError(f"{where}: there is no campaign of this plan; name it with --out")
    return CampaignFolder.resume(out or before[-1], plan)


def folders_of(plan: CampaignPlan, out: Path | None) -> list[Path]:
    """Return folders of earlier campaigns with the plan's name, the latest last: only `out`, or those in `runs/`."""
    found = [out / CAMPAIGN] if out is not None else Path(RUNS_FOLDER).glob(f"{plan.name}-*/{CAMPAIGN}")
    existing = [path for path in found if path.is_file()]
    return [path.parent for path in sorted(existing, key=lambda path: path.stat().st_mtime)]


def _default_path(plan: CampaignPlan) -> Path:
    """Return `runs/<plan>-<UTC time>`, with a number appended if the name is taken."""
    base = Path(RUNS_FOLDER) / f"{plan.name}-{datetime.now(UTC).strftime('%Y%m%dT%H%M%SZ')}"
    path, number = base, 1
    while path.exists():
        number += 1
        path = base.with_name(f"{base.name}-{number}")
    return path
