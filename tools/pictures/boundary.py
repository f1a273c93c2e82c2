"""The picture of a search: runs that pass by chance, the boundary known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.pictures.browser import photograph
from xitl_cli.logs.model.sections import Section
from xitl_cli.logs.report.html import write_sections
from xitl_cli.plugins.campaign import pictures
from xitl_cli.plugins.campaign.bisection import BoundaryFinding, bisect
from xitl_cli.plugins.campaign.search import bisection
from xitl_cli.plugins.campaign.search_spec import AxisRange, Search, SearchSpec
from xitl_cli.plugins.campaign.statistics import monotone_rates

BOUNDARY_MPS, SCALE_MPS = 11.0, 0.8
SEARCH = Search(SearchSpec(width=1.5), (AxisRange("environment.wind.mean_mps", 2.0, 20.0),), ({},), (), 1, 1)


def searched() -> BoundaryFinding:
    """A search in a world where the rate falls as a logistic curve."""
    rng, search = np.random.default_rng(7), bisect(bisection(SEARCH))
    places = next(search)
    while True:
        rates = 1.0 / (1.0 + np.exp((np.array(places) - BOUNDARY_MPS) / SCALE_MPS))
        try:
            places = search.send([bool(one) for one in rng.random(len(places)) < rates])
        except StopIteration as end:
            found: BoundaryFinding = end.value
            return found


def draw(folder: Path, path: Path) -> None:
    """folder: where its page may go."""
    found = searched()
    plot = pictures.boundary("boundary", SEARCH, found, monotone_rates(found.counts, found.rising), "")
    page = folder / "boundary.html"
    write_sections(page, "Where it begins to fail", "", [Section("boundary", "A search", plots=(plot,))])
    photograph(page, path, 1180, 660)
