"""A plan from its folder to its table, for the command and `xitl.campaign`."""

from __future__ import annotations

import contextlib
import uuid
from typing import Protocol

from xitl_cli.plugins.campaign.cluster import TlsFiles, local_workers, workers_at
from xitl_cli.plugins.campaign.engine import Campaign, CampaignProgress, try_first_run
from xitl_cli.plugins.campaign.plan import CampaignPlan
from xitl_cli.plugins.campaign.results import CampaignFolder, FullDiskError, ResultTable
from xitl_cli.plugins.campaign.search import carry_out as carry_out_search


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
