"""A plan from its folder to its table: what the command and `xitl.campaign` do."""

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
    """Who is told how far it is."""

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """So many runs at once, here or on a scheduler, with the address of Dask's dashboard where there is one."""

    def __call__(self, progress: CampaignProgress) -> None:
        """Now and then."""


class NoWatch:
    """Nobody."""

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
    """All runs of a plan that its folder lacks, on this machine or on a scheduler; the table of all.

    tls: files for a scheduler at a `tls://` address; by default those of Dask's configuration.
    Raises UserError for what has to be put right; what ended until then is kept, also by a KeyboardInterrupt.
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
            with contextlib.suppress(FullDiskError):  # what is in the lines is told anyway
                folder.write_table()
    return folder.table()


def open_folder(plan: CampaignPlan, out: Path | None, resume: bool) -> CampaignFolder:
    """Where a campaign writes: a new folder, or the one that it goes on in. Raises UserError."""
    if not resume:
        return CampaignFolder.create(out or _default_path(plan), plan)
    before = folders_of(plan, out)
    if not before and out is None:
        where = f"{RUNS_FOLDER}/{plan.name}-…"
        raise UserError(f"{where}: there is no campaign of this plan; name it with --out")
    return CampaignFolder.resume(out or before[-1], plan)


def folders_of(plan: CampaignPlan, out: Path | None) -> list[Path]:
    """Folders of earlier campaigns with the plan's name, the latest one last: `out` alone, or those in `runs/`."""
    found = [out / CAMPAIGN] if out is not None else Path(RUNS_FOLDER).glob(f"{plan.name}-*/{CAMPAIGN}")
    existing = [path for path in found if path.is_file()]
    return [path.parent for path in sorted(existing, key=lambda path: path.stat().st_mtime)]


def _default_path(plan: CampaignPlan) -> Path:
    """`runs/<plan>-<UTC time>`, with a number behind it when it is taken."""
    base = Path(RUNS_FOLDER) / f"{plan.name}-{datetime.now(UTC).strftime('%Y%m%dT%H%M%SZ')}"
    path, number = base, 1
    while path.exists():
        number += 1
        path = base.with_name(f"{base.name}-{number}")
    return path
