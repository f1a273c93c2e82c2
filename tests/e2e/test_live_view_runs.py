"""A run with its view: by a browser, by many that vanish, without any, and after its process was killed."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from conftest import newest_time_s, unhurried

from tests.bench.soak_clients import VIEWER_CAMERA
from tests.chromium import CHROMIUM, launch_chromium
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.plugins.view.server import USUAL_PORT

viser = pytest.importorskip("viser")
msgspec = pytest.importorskip("msgspec")
zstandard = pytest.importorskip("zstandard")
connect = pytest.importorskip("websockets.sync.client").connect

pytestmark = pytest.mark.slow


class Viewed:
    """A run of `xitl sim` with a view. address: of its page."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        self._log = folder.with_suffix(".txt")
        command = ["-c", "from xitl_cli.main import main; main()", "sim", "--out", str(folder), *arguments]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, *command], stdout=log, stderr=subprocess.STDOUT, env=os.environ | {"CI": "1"}
            )
        self.address = self._wait_for(r"view: (http://\S+)")

    @property
    def said(self) -> str:
        return self._log.read_text()

    def _wait_for(self, pattern: str) -> str:
        wait_until(lambda: bool(re.search(pattern, self.said)) or self.process.poll() is not None)
        found = re.findall(pattern, self.said)
        assert found, self.said
        return found[0]

    def summary(self) -> dict[str, Any]:
        self.process.wait(PATIENCE_S)
        found: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return found

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(PATIENCE_S)

    def goes_on_and_is_ended(self) -> dict[str, Any]:
        """Its summary."""
        before_s = newest_time_s(self.said)
        wait_until(lambda: newest_time_s(self.said) > before_s, "it does not go on")
        self.end()
        summary = self.summary()
        assert self.process.returncode == 130
        assert (summary["ended"], summary["error"]) == ("interrupted", None)
        return summary

    def page_process(self) -> int:
        """Number of the process that serves the page."""
        (child,) = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        command = Path(f"/proc/{child}/cmdline")  # empty while it begins
        wait_until(lambda: b"xitl_cli.plugins.view.process" in command.read_bytes(), "it serves no page")
        return int(child)


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., Viewed]]:
    runs: list[Viewed] = []

    def start(*arguments: str) -> Viewed:
        runs.append(Viewed(tmp_path / f"run{len(runs)}", *arguments))
        return runs[-1]

    yield start
    for run in runs:
        run.end()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("needs Chromium; apt install chromium")
    with playwright.sync_playwright() as driver:
        made = launch_chromium(driver)
        yield made
        made.close()


def inflated(message: bytes) -> bytes:
    """The MessagePack of a message to a browser: behind two lengths of 8 bytes, the second its own as compressed."""
    (length,) = struct.unpack_from("<Q", message, 8)
    found: bytes = zstandard.decompress(message[16 : 16 + length])
    return found


def picture(page: Any) -> np.ndarray:
    """(H, W, 3) of the part of the page beside the panel."""
    image = pytest.importorskip("PIL.Image")
    shown = image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return np.asarray(shown, dtype=np.float64)[:, : 5 * shown.width // 8]


def summary(page: Any) -> str:
    """Mode, armed, time and pace, as the instruments have them."""
    return str(page.locator(".xitl-instruments summary").first.inner_text())


def seconds(page: Any) -> float:
    found = re.search(r"([\d.]+) s", summary(page))
    assert found is not None
    return float(found[1])


@pytest.mark.nightly
def test_a_browser_sees_the_vessel_move_by_day_and_by_night(started: Callable[..., Viewed], browser: Any) -> None:
    run = started("sitl", "--pace", "0.5", "--set", "view.rate_hz=5", "--view")  # on its way for a slow browser, too
    page = unhurried(browser.new_page(viewport={"width": 960, "height": 540}))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))

    def click(name: str) -> None:
        page.get_by_role("button", name=name, exact=True).click()

    page.goto(run.address)
    page.locator("td", has_text="waypoint").wait_for()
    assert page.title() == "sitl"
    wait_until(lambda: summary(page).startswith("AUTO armed"))
    page.get_by_role("combobox", name="Camera").click()
    page.get_by_role("option", name="free").click()
    click("Pause")  # it would sail out of the picture before a slow browser has drawn it
    wait_until(lambda: "paused" in summary(page))
    wait_until(lambda: picture(page).std() > 10.0)
    before, at_s = picture(page), seconds(page)
    click("Resume")
    wait_until(lambda: seconds(page) > at_s + 1.0)
    wait_until(lambda: bool((np.abs(picture(page) - before).max(axis=2) > 40.0).mean() > 0.001))
    click("Pause")
    page.get_by_text("Show", exact=True).click()
    page.get_by_label("Night").click()
    wait_until(lambda: bool(picture(page).mean() < 0.6 * before.mean()))
    assert all(url.startswith((run.address, "data:", "blob:")) for url in asked)
    page.close()
    run.end()
    view = run.summary()["view"]
    assert view["browsers"] == 1
    assert view["shown"] > 5


@pytest.mark.nightly
def test_a_pause_stays_when_the_last_browser_closes(started: Callable[..., Viewed], browser: Any) -> None:
    run = started("sitl", "--pace", "0.5", "--set", "view.rate_hz=5", "--view")

    def opened() -> Any:
        page = unhurried(browser.new_page(viewport={"width": 900, "height": 540}))
        page.goto(run.address)
        page.locator("td", has_text="waypoint").wait_for()
        return page

    page = opened()
    page.get_by_role("button", name="Pause", exact=True).click()
    wait_until(lambda: "paused" in summary(page))
    stood_s = seconds(page)
    page.close()
    wait_until(lambda: "the last browser has closed and the run stays paused" in run.said)
    assert run.address in run.said.rpartition("stays paused")[2]
    page = opened()
    wait_until(lambda: "paused" in summary(page))
    assert seconds(page) == stood_s
    page.get_by_role("button", name="Resume", exact=True).click()
    wait_until(lambda: seconds(page) > stood_s)
    page.close()
    run.end()
    assert run.summary()["operator"]["actions"] == {"pause": 1, "resume": 1}


@pytest.mark.parametrize(("width", "height"), [(390, 844), pytest.param(844, 390, marks=pytest.mark.nightly)])
def test_on_a_phone_the_controls_begin_closed_and_open(
    started: Callable[..., Viewed], browser: Any, width: int, height: int
) -> None:
    run = started("sitl", "--pace", "0.5", "--set", "view.rate_hz=5", "--view")
    page = unhurried(browser.new_page(viewport={"width": width, "height": height}))
    page.goto(run.address)
    pause = page.get_by_role("button", name="Pause", exact=True)

    def pause_is_in_sight() -> bool:
        page.wait_for_timeout(500)
        box = pause.bounding_box() if pause.count() and pause.is_visible() else None
        if box is None:
            return False
        middle = [box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]]
        hit = "([x, y]) => document.elementFromPoint(x, y)?.closest('button')?.textContent === 'Pause'"
        return bool(page.evaluate(hit, middle))

    if width < height:
        controls = page.get_by_role("button", name="Controls")
        controls.wait_for()
        wait_until(lambda: controls.get_attribute("aria-expanded") == "false")
        wait_until(lambda: not pause_is_in_sight())
        sheet = page.locator(".mantine-Paper-root", has=controls).first.bounding_box()
        assert sheet["width"] * sheet["height"] < width * height / 3
        controls.focus()
        page.keyboard.press("Enter")
        assert controls.get_attribute("aria-expanded") == "true"
    else:
        page.get_by_text("sitl", exact=True).wait_for()
        wait_until(lambda: not pause_is_in_sight())
        page.get_by_text("sitl", exact=True).click()
    wait_until(pause_is_in_sight)
    page.close()


def test_browsers_that_do_not_read_and_vanish_change_nothing(started: Callable[..., Viewed]) -> None:
    run = started("sitl", "--view", "--pace", "0.5")  # its mission takes 5 minutes: ten may be slow to come
    address = run.address.replace("http", "ws", 1)
    joined = []
    for _ in range(10):
        one = connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, proxy=None)
        one.send(msgspec.msgpack.encode(VIEWER_CAMERA))
        joined.append(one)
        # One that vanishes before its camera was read never looked; one that does not read for 40 s is closed.
        while b"GuiDropdownMessage" not in inflated(one.recv(timeout=PATIENCE_S)):
            pass
    for _ in range(40):
        joined[-1].recv(timeout=PATIENCE_S)
    for one in joined:
        one.socket.close()
    summary = run.goes_on_and_is_ended()
    assert summary["view"]["browsers"] == 10
    assert summary["view"]["shown"] > 0


def test_a_view_that_is_killed_is_told_once(started: Callable[..., Viewed]) -> None:
    run = started("sitl", "--view", "--pace", "1")
    os.kill(run.page_process(), signal.SIGKILL)
    wait_until(lambda: "the 3D view has ended" in run.said)
    summary = run.goes_on_and_is_ended()
    assert run.said.count("the 3D view has ended") == 2  # when it did, and among the warnings at the end
    assert sum("the 3D view has ended" in text for text in summary["warnings"]) == 1


def test_a_view_that_hangs_holds_nothing_up(started: Callable[..., Viewed]) -> None:
    run = started("sitl", "--view", "--pace", "1")
    page = run.page_process()
    os.kill(page, signal.SIGSTOP)
    run.goes_on_and_is_ended()
    assert not Path(f"/proc/{page}").exists()


def test_another_address_has_a_token(started: Callable[..., Viewed]) -> None:
    run = started("sitl", "--duration", "1", "--view-host", "0.0.0.0")
    assert re.fullmatch(r"http://[^/]+:\d+/[\w-]{20,}/", run.address)
    token = run.address.rstrip("/").rpartition("/")[2]
    assert token not in json.dumps(run.summary())


def test_a_port_that_is_taken_is_an_error_before_anything_runs(started: Callable[..., Viewed], tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        taken = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = taken.getsockname()[1]
        arguments = ["sim", "sitl", "--view-port", f"{port}", "--out", str(tmp_path / "other")]
        other = subprocess.run(
            [sys.executable, "-c", "from xitl_cli.main import main; main()", *arguments], capture_output=True, text=True
        )
        assert other.returncode == 2
        assert f"view.port = {port}: another program listens there" in other.stderr
        assert not (tmp_path / "other").exists()
        with contextlib.suppress(OSError):  # another run has it
            stack.enter_context(socket.create_server(("127.0.0.1", USUAL_PORT)))
        free = started("sitl", "--duration", "1", "--view")
        assert f"port {USUAL_PORT} is taken" in free.said
        assert urlsplit(free.address).port != USUAL_PORT
