"""The page of a campaign in headless Chromium: on any screen every column of its tables can be read."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).parents[1] / "unit" / "plugins" / "campaign"))
from conftest import patient
from imagined_runs import imagined
from test_campaign_search import BISECTION, planned, track

from tests.chromium import launch_chromium, needs_chromium
from xitl_cli.plugins.campaign.report import write_report

FLAT = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking")
UNREACHABLE = """() => {
  const found = [];
  for (const box of document.querySelectorAll(".scroll")) {
    const heads = box.querySelector("thead").offsetHeight ? box.querySelectorAll("th") : [];
    const row = [...box.querySelector("tbody tr").cells, ...heads];
    for (const cell of row.filter((cell) => cell.textContent)) {
      cell.scrollIntoView({ block: "nearest", inline: "nearest" });
      const [at, frame] = [cell.getBoundingClientRect(), box.getBoundingClientRect()];
      const [left, right] = [Math.max(frame.left, 0) - 1, Math.min(frame.right, innerWidth) + 1];
      if (at.left < left || at.right > right) found.push(cell.textContent);
    }
    box.scrollLeft = 0;
  }
  return found;
}"""
WIDTHS = """() => document.documentElement.scrollWidth - innerWidth"""
COMMANDS = """() => {
  const box = document.querySelector('.scroll[aria-label="Worst runs first"]');
  const frame = box.getBoundingClientRect();
  return [...box.querySelectorAll("tbody tr")].map((row) => {
    const cell = [...row.cells].at(-1), range = document.createRange();
    range.selectNodeContents(cell);
    const text = range.getBoundingClientRect();
    const inSight = text.left >= frame.left && text.right <= frame.right;
    return [cell.textContent, inSight, getComputedStyle(cell, "::before").content];
  });
}"""

playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser; pip install playwright")
pytest.importorskip("scipy")
pytestmark = [pytest.mark.slow, needs_chromium]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    folder = tmp_path_factory.mktemp("campaign")
    table, _ = imagined(planned(folder, BISECTION), folder / "out", track)
    path = write_report(table)
    with playwright.sync_playwright() as driver:
        browser = launch_chromium(driver, FLAT)
        opened = patient(browser.new_page())
        opened.goto(path.as_uri())
        yield opened
        browser.close()


@pytest.mark.nightly
@pytest.mark.parametrize("width", [1440, 1280, 1024, 800, 390])
def test_every_column_of_every_table_can_be_reached(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 844})
    assert page.evaluate(WIDTHS) == 0
    assert page.evaluate(UNREACHABLE) == []


@pytest.mark.parametrize("width", [1280, 1024, 800, 390])
def test_commands_that_repeat_runs_are_in_sight_without_scrolling_sideways(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 844})
    commands = page.evaluate(COMMANDS)
    assert len(commands) == 10
    for text, in_sight, label in commands:
        assert text.startswith("xitl sim mitl --set ")
        assert in_sight, text
        assert label == '"repeat with"'


def test_a_wide_screen_has_the_table(page: Any) -> None:
    page.set_viewport_size({"width": 1600, "height": 900})
    header = page.get_by_role("columnheader", name="repeat with")
    assert header.is_visible()
    assert all(in_sight for _, in_sight, _ in page.evaluate(COMMANDS))
