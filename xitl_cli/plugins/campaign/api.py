"""`xitl.campaign` of the public Python API."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xitl_cli.plugins.campaign.results import ResultTable

PathText = str | PathLike[str]


def campaign(
    plan: PathText,
    *,
    out: PathText | None = None,
    on: str | None = None,
    workers: int | None = None,
    resume: bool = False,
) -> ResultTable:
    """Run the plan of a campaign, as `xitl campaign` does, and keep the campaign in a folder.

    plan: a YAML file, or the name of a shipped plan. out: the folder, by default `runs/<plan>-<time>` in the working
    directory. on: the address of a Dask scheduler, by default this machine; for `tls://`, Dask's configuration names
    the certificate files (`distributed.comm.tls`). workers: parallel runs on this machine, by default one per core.
    resume: continue an earlier campaign in `out` with its missing runs.

    `len(table)`, `table.column("seed")` and `table.to_pandas()` (needs pandas) give the results. Raises UserError for
    errors in the plan, and when the campaign cannot continue. Finished runs are kept.
    """
    from xitl_cli.plugins.campaign.cluster import check_installed
    from xitl_cli.plugins.campaign.plan import find_plan, read_plan

    check_installed()
    from xitl_cli.plugins.campaign.engine import carry_out
    from xitl_cli.plugins.campaign.results import open_folder

    checked = read_plan(find_plan(fspath(plan)))
    return carry_out(checked, open_folder(checked, None if out is None else Path(out), resume), on, workers)
