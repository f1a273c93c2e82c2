"""The picture of a search in docs/campaigns.md: runs that pass by chance, the boundary known. Needs Chromium.

python tools/draw_boundary.py
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from xitl_cli.campaign import pictures
from xitl_cli.campaign.bisection import BoundaryFinding, bisect
from xitl_cli.campaign.report import write_sections
from xitl_cli.campaign.search import bisection
from xitl_cli.campaign.search_spec import AxisRange, Search, SearchSpec
from xitl_cli.campaign.statistics import monotone_rates
from xitl_cli.logs.model.sections import Section

PICTURE = Path(__file__).parents[1] / "docs/img/boundary.png"
BOUNDARY_MPS, SCALE_MPS = 11.0, 0.8
SEARCH = Search(SearchSpec(width=1.5), (AxisRange("environment.wind.mean_mps", 2.0, 20.0),), ({},), (), 1, 1)
WIDTH, HEIGHT = 1180, 660


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


def main() -> None:
    browser = next((one for name in ("chromium", "google-chrome", "chrome") if (one := shutil.which(name))), None)
    if browser is None:
        sys.exit("draw_boundary: needs Chromium on the PATH")
    found = searched()
    plot = pictures.boundary("boundary", SEARCH, found, monotone_rates(found.counts, found.rising), "")
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        write_sections(page, "Where it begins to fail", "", [Section("boundary", "A search", plots=(plot,))])
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        size = [f"--window-size={WIDTH},{HEIGHT}", "--virtual-time-budget=8000", f"--user-data-dir={folder}/browser"]
        PICTURE.parent.mkdir(exist_ok=True)
        subprocess.run([browser, *options, *size, f"--screenshot={PICTURE}", page.as_uri()], check=True, stderr=-3)
    print(f"{PICTURE}: {found.outcome}, {found.estimate}")


if __name__ == "__main__":
    main()
