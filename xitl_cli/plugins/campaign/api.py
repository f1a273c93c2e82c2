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
    """Carry out a plan of many runs, as `xitl campaign` does, and keep the campaign in a folder.

    plan: a YAML file, or the name of a shipped one. out: the folder, `runs/<plan>-<time>` in the working directory by
    default. on: the address of a Dask scheduler, this machine by default; for `tls://`, Dask's configuration names the
    files (`distributed.comm.tls`). workers: runs at once on this machine, as many as it has cores by default. resume:
    go on with what an earlier one in `out` lacks.

    `len(table)`, `table.column("seed")` and `table.to_pandas()` (needs pandas) say what came out. Raises UserError for
    what is wrong in the plan, and when it cannot go on; what ended until then is kept.
    """
    from xitl_cli.plugins.campaign.cluster import check_installed
    from xitl_cli.plugins.campaign.plan import find_plan, read_plan

    check_installed()
    from xitl_cli.plugins.campaign.carry_out import carry_out, open_folder

    found = read_plan(find_plan(fspath(plan)))
    return carry_out(found, open_folder(found, None if out is None else Path(out), resume), on, workers)
