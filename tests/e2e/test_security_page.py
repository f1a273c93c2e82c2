"""The table of docs/security.md against the sockets that commands open."""

from __future__ import annotations

import re
import threading
from ipaddress import ip_address, ip_network
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest

from tests.patience import wait_until
from xitl_cli.plugins.campaign import cluster
from xitl_cli.profile import load_profile
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.session import run
from xitl_cli.run.status_display import NoDisplay

pytestmark = pytest.mark.slow
PAGE = Path(__file__).parents[2] / "docs/security.md"
ROWS = {
    cells[0]: cells
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and len(cells := [cell.strip() for cell in line.strip("|").split("|")]) == 6
}
FOXGLOVE, INNER, VIEW = "`xitl sim --live foxglove`", "server of foxglove-sdk behind it", "`xitl sim --view`"
CLUSTER, STATUS = "`xitl campaign`, scheduler and workers", "`xitl campaign`, Dask's status pages"


def address_of(surface: str) -> str:
    """The default address or network of a row."""
    found = re.match(r"[\d./]+", ROWS[surface][2])
    assert found, surface
    return found.group()


def listening() -> set[tuple[str, int]]:
    """Addresses and ports at which this process and its children accept connections."""
    own = psutil.Process()
    found = set()
    for process in (own, *own.children(recursive=True)):
        found |= {
            (one.laddr.ip, one.laddr.port)
            for one in process.net_connections(kind="tcp")
            if one.status == psutil.CONN_LISTEN
        }
    return found


def test_the_rows_that_are_tested_are_those_of_these_tests() -> None:
    assert {surface for surface, cells in ROWS.items() if cells[5] == "tested"} == {
        VIEW,
        FOXGLOVE,
        INNER,
        CLUSTER,
        STATUS,
    }


def test_a_run_listens_as_the_page_says(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    before = listening()
    settings = ["clock.duration_s=15.0", "live.foxglove=true", "view.show=true"]
    told: list[str] = []
    operation = Operation(pace=1.0)
    profile = load_profile("sitl", settings)
    sailing = threading.Thread(
        target=lambda: run(profile, tmp_path / "run", False, NoDisplay, operation=operation, tell=told.append)
    )
    sailing.start()
    try:
        wait_until(lambda: {"view", "foxglove"} <= {text.partition(":")[0] for text in told})
        opened = listening() - before
    finally:
        sailing.join()
    links = {text.partition(":")[0]: urlsplit(text.split()[1]) for text in told}
    known = {(address_of(VIEW), links["view"].port), (address_of(FOXGLOVE), links["foxglove"].port)}
    assert known <= opened
    (inner,) = opened - known
    assert ip_address(inner[0]) in ip_network(address_of(INNER))
    usual = {name: int(ROWS[row][1].split(",")[0]) for name, row in (("view", VIEW), ("foxglove", FOXGLOVE))}
    assert all(usual[name] <= (links[name].port or 0) < usual[name] + 50 for name in usual)


def test_a_campaign_listens_as_the_page_says() -> None:
    before = listening()
    with cluster.local_workers(1, "page"):
        opened = listening() - before
    assert len(opened) == 4  # scheduler and worker, each with a port for work and one for status
    assert {address for address, _ in opened} == {address_of(CLUSTER)} == {address_of(STATUS)}
