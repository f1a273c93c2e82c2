"""Recordings in a browser: the page from the disk, the served one, and pictures. Chromium without a window."""

from __future__ import annotations

import io
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import unhurried

from tests.chromium import launch_chromium, needs_chromium
from tests.recorded_run import recorded_run
from xitl_cli.plugins.view.pictures import picture
from xitl_cli.plugins.view.recording import open_scene
from xitl_cli.plugins.view.replay_page import replay_html

playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser; pip install playwright")
pytest.importorskip("viser")
Image = pytest.importorskip("PIL.Image")
pytestmark = [
    pytest.mark.slow,
    needs_chromium,
]


@pytest.fixture(scope="module")
def run() -> Path:
    """30 s with a fault at 14 s, so that there is a finding in the middle of the run."""
    fault = "faults={gap: {from_s: 14, until_s: 18, gnss: {dropout: 1.0}}}"
    return recorded_run("sitl", 30.0, fault) / "run.mcap"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        started = launch_chromium(driver)
        yield started
        started.close()


def opened(browser: Any, url: str, offline: bool) -> tuple[Any, list[str]]:
    """The page, and what it asked for elsewhere or complained about."""
    page = unhurried(browser.new_context(viewport={"width": 800, "height": 500}, offline=offline).new_page())
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda said: wrong.append(said.text) if BROKEN_LOOK.search(said.text) else None)
    page.on("request", lambda request: wrong.append(request.url) if elsewhere(request.url, url) else None)
    page.goto(url + "?look=full")
    page.wait_for_function("window.__viserMutable && window.__viserMutable.nodePoseData['/vessels/vessel']")
    page.wait_for_function("window.xitlLook && window.xitlLook.water && window.xitlLook.sky")
    return page, wrong


BROKEN_LOOK = re.compile("Shader Error|xitl look")


def elsewhere(url: str, own: str) -> bool:
    return not url.startswith((own, own.replace("http", "ws"), "data:", "blob:"))


def place(page: Any) -> list[float]:
    found: list[float] = page.evaluate("window.__viserMutable.nodePoseData['/vessels/vessel'].position")
    return found


def wait_for_place(page: Any, wanted: list[float], within_m: float) -> None:
    page.wait_for_function(
        "([wanted, within]) => Math.hypot(...wanted.map((each, axis) => "
        "window.__viserMutable.nodePoseData['/vessels/vessel'].position[axis] - each)) < within",
        arg=[wanted, within_m],
    )


def shot(page: Any) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), dtype=np.int16)


def test_a_page_from_the_disk_plays_and_goes_where_it_is_told(browser: Any, run: Path, tmp_path: Path) -> None:
    file = tmp_path / "replay.html"
    with open_scene([run]) as recording:
        file.write_text(replay_html(recording, at_s=12.0), encoding="utf-8")
        assert file.stat().st_size < 3e6
        mark = next(mark for mark in recording.marks if mark.text == "waypoint 1 reached")
        early, there = (recording.instant(at_s).vessels[""].position_enu_m for at_s in (12.0, mark.time_s))
        found = recording.findings()
    page, wrong = opened(browser, file.as_uri(), offline=True)
    wait_for_place(page, early.tolist(), 0.5)
    before = shot(page)
    page.get_by_text("Events (").click()
    page.get_by_role("button", name="waypoint 1 reached").click()
    wait_for_place(page, there.tolist(), 0.5)  # at 10 instants a second and 3 m/s
    assert (np.abs(shot(page) - before).max(axis=2) > 40).mean() > 0.01
    at_finding = next(each for each in found if each.time_s is not None and each.time_s < 29.0)  # the end starts anew
    page.get_by_role("button", name=at_finding.sentence[:40]).click()
    field = page.locator(".mantine-NumberInput-input").first
    playwright.expect(field).to_have_value(re.compile(rf"{at_finding.time_s:.1f}"))
    assert wrong == []


@pytest.mark.nightly
def test_a_served_recording_stands_plays_and_jumps(browser: Any, run: Path) -> None:
    command = [sys.executable, "-m", "xitl_cli.main", "view", str(run), "--at", "12", "--no-open"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as served:
        try:
            assert served.stdout is not None
            address = re.search(r"http://\S+", served.stdout.readline())
            assert address is not None
            page, wrong = opened(browser, address[0], offline=False)
            with open_scene([run]) as recording:
                event = next(mark for mark in recording.marks if mark.time_s > 12.1)
                early, there, end = (
                    recording.instant(at_s).vessels[""].position_enu_m for at_s in (12.0, event.time_s, 30.0)
                )
            wait_for_place(page, early.tolist(), 0.05)
            before = shot(page)
            page.get_by_role("button", name="event ▶").click()
            wait_for_place(page, there.tolist(), 0.05)
            assert (np.abs(shot(page) - before).max(axis=2) > 40).mean() > 0.01
            page.get_by_role("button", name="Play").click()
            wait_for_place(page, end.tolist(), 0.05)
            assert page.get_by_text(re.compile(r"^Findings \(\d+\)")).is_visible()
            assert wrong == []
        finally:
            served.send_signal(signal.SIGINT)
    assert served.returncode == 0


def test_pictures_show_an_instant(run: Path) -> None:
    with open_scene([run]) as recording:
        early, late = (
            np.asarray(Image.open(io.BytesIO(picture(recording, at_s, size=(320, 180)))), dtype=np.int16)
            for at_s in (12.0, 25.0)
        )
    assert early.shape == (180, 320, 3)
    assert (np.abs(early - late).max(axis=2) > 40).mean() > 0.005
    sky, water = early[2].mean(axis=0), early[-2].mean(axis=0)
    assert sky[2] > water[2] + 40, json.dumps([sky.tolist(), water.tolist()])
