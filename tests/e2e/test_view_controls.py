"""The page of a run in headless Chromium: what is clicked there is done, recorded, and given again."""

from __future__ import annotations

import io
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import differences, payloads, unhurried

from tests.chromium import launch_chromium, needs_chromium
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.operator.operation import Operation, read_events
from xitl_cli.run.session import Result, run

LAUNCHES = "launches debris"


@contextmanager
def page_at(url: str) -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = launch_chromium(playwright)
        page = unhurried(browser.new_page(viewport={"width": 900, "height": 600}))
        page.goto(url)
        yield page
        browser.close()


def time_shown_s(page: Any) -> tuple[float, bool]:
    """As the instruments have it, and whether they say that the run stands still."""
    found = re.search(r"(\d+\.\d) s( · paused)?", page.locator(".xitl-instruments summary").first.inner_text())
    return (float(found[1]), found[2] is not None) if found else (0.0, False)


def water(page: Any) -> np.ndarray:
    """(H, W, 3) of the picture around the place of the click, clear of panels."""
    image = pytest.importorskip("PIL.Image")
    page.wait_for_timeout(500)
    around = {"x": 320, "y": 165, "width": 80, "height": 50}
    return np.asarray(image.open(io.BytesIO(page.screenshot(clip=around))).convert("RGB"), dtype=np.float64)


def share_changed(before: np.ndarray, after: np.ndarray) -> float:
    """Of the pixels, by more than a camera that settles changes them."""
    return float((np.abs(after - before).max(axis=2) > 30.0).mean())


@pytest.mark.nightly
@pytest.mark.slow
@needs_chromium
def test_a_person_plays_with_a_run_at_its_page(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    pytest.importorskip("playwright")
    profile = load_profile("sitl", ["view.show=true", "view.open=false", "clock.duration_s=40.0"])
    told: list[str] = []
    results: list[Result] = []

    def sail() -> None:
        operation = Operation(pace=0.1)  # there is somebody before it is over, however slow the browser
        results.append(run(profile, tmp_path / "run", False, NoDisplay, operation=operation, tell=told.append))

    sailing = threading.Thread(target=sail)
    sailing.start()
    try:
        wait_until(lambda: any(text.startswith("view: ") for text in told))
        with page_at(told[-1].removeprefix("view: ")) as page:

            def click(name: str) -> None:
                page.get_by_role("button", name=name, exact=True).click()

            click("Pause")
            wait_until(lambda: time_shown_s(page)[1])
            stood_s, _ = time_shown_s(page)
            click("Step 0.1 s")
            wait_until(lambda: time_shown_s(page)[0] >= round(stood_s + 0.1, 1))
            assert time_shown_s(page) == (pytest.approx(stood_s + 0.1, abs=0.051), True)

            page.get_by_text("Debris and orders", exact=True).click()
            page.get_by_label("A click on the water").click()
            page.get_by_role("option", name=LAUNCHES).click()
            refused = page.get_by_text("the click is not on the water")

            def click_on_the_sky() -> bool:
                """Until the page listens for clicks on the picture."""
                page.mouse.click(450, 60)
                page.wait_for_timeout(500)
                return bool(refused.is_visible())

            wait_until(click_on_the_sky)
            free_water, stood = water(page), time_shown_s(page)

            def click_on_the_water() -> bool:
                """A busy browser may lose a click. One that was not lost is drawn in much less time."""
                page.mouse.click(345, 190)  # above the instruments, and ahead of the vessel
                until_s = time.monotonic() + 0.3 * PATIENCE_S
                while time.monotonic() < until_s:
                    if share_changed(free_water, water(page)) > 0.05:
                        return True
                return False

            wait_until(click_on_the_water, "no body is drawn while it is paused")
            assert time_shown_s(page) == stood
            click("Arm")
            click("Resume")
            wait_until(lambda: not time_shown_s(page)[1])
            page.get_by_text("trunk 0 of 4.0 m in the water").first.wait_for()
            before = page.screenshot()
            shown_s, _ = time_shown_s(page)
            wait_until(lambda: time_shown_s(page)[0] > shown_s + 1.0)
            assert page.screenshot() != before
            page.get_by_label("Pace").click()
            page.get_by_role("option", name="as fast as possible").click()
            wait_until(lambda: not sailing.is_alive(), patience_s=3 * PATIENCE_S)
    finally:
        sailing.join(3 * PATIENCE_S)
    result = results[0]
    summary = result.summary
    actions = summary["operator"]["actions"]
    once = ("pause", "step", "resume", "launch", "arm")
    assert {name: actions[name] for name in once} == dict.fromkeys(once, 1)
    assert summary["debris"]["by"] == {"trunk": 1}
    assert summary["view"]["actions"] == sum(actions.values())
    recorded = payloads(result.recording)
    assert any(b'"launch"' in payload and b"view" in payload for _, payload in recorded["/operator/action"])
    assert len(recorded["/truth/bodies"]) > 10

    operation = Operation(events=read_events(result.directory))
    unseen = load_profile("sitl", ["clock.duration_s=40.0"])
    again = run(unseen, tmp_path / "again", False, NoDisplay, operation=operation)
    repeated = payloads(again.recording)
    assert differences(recorded, repeated) == {}
