"""The page in headless Chromium: it opens from disk without a network, draws, links, prints."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

sys.path.append(str(Path(__file__).parents[1] / "unit" / "logs"))
from conftest import patient, unhurried
from expression_cases import made_signals
from report_samples import SECONDS, sample_report

from tests.chromium import launch_chromium, needs_chromium
from tests.recorded import LINUX
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.report import html
from xitl_cli.logs.report.page import Replay
from xitl_cli.logs.report.signal_data import held_log
from xitl_cli.plugins.logs import analyze_command

SCREEN = {"width": 1280, "height": 2600}
FLAT = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking")

playwright = pytest.importorskip("playwright.sync_api", reason="playwright drives the browser; pip install playwright")
pytestmark = [
    pytest.mark.slow,
    needs_chromium,
]


@dataclass
class Opened:
    """A page, and what it complained about or asked for."""

    page: Any
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def draw_all(self) -> None:
        for index in range(self.page.locator("figure.plot").count()):
            self.page.locator("figure.plot").nth(index).scroll_into_view_if_needed()
            self.page.locator("figure.plot").nth(index).locator(".main-svg").first.wait_for()

    def followed(self) -> list[float]:
        """The one range of all plots over time; those out of view follow when they come into it."""
        self.draw_all()
        self.page.wait_for_function(
            """() => new Set([...document.querySelectorAll("figure.time .canvas")]
            .map((canvas) => String(canvas.layout.xaxis.range))).size == 1"""
        )
        return self.ranges()[0]

    def ranges(self) -> list[list[float]]:
        """Of the time axis of every plot over time that is in view."""
        found: list[list[float]] = self.page.evaluate(
            """() => [...document.querySelectorAll("figure.time .canvas")]
            .filter((canvas) => canvas.layout).map((canvas) => canvas.layout.xaxis.range)"""
        )
        return found


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(driver: Any) -> Iterator[Any]:
    started = launch_chromium(driver, FLAT)
    yield started
    started.close()


@pytest.fixture(scope="module")
def report_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    html.write(sample_report(), path)
    return path


@pytest.fixture(scope="module")
def page(browser: Any, report_file: Path) -> Iterator[Opened]:
    context = browser.new_context(offline=True, viewport=SCREEN, color_scheme="light")
    shown = Opened(patient(context.new_page()))
    shown.page.on("console", lambda message: shown.said.append(message.text))
    shown.page.on("pageerror", lambda error: shown.said.append(str(error)))
    shown.page.on("request", lambda request: shown.asked.append(request.url))
    shown.page.goto(report_file.as_uri())
    yield shown
    context.close()


@pytest.fixture
def opened(page: Opened) -> Opened:
    """The one page (it takes seconds to load), as it was when it came."""
    page.page.set_viewport_size(SCREEN)
    page.page.emulate_media(color_scheme="light")
    page.page.locator("#filter").fill("")
    if page.page.locator("#whole").is_visible():
        page.page.locator("#whole").click()
    return page


def test_it_draws_every_plot_without_a_network_or_a_complaint(opened: Opened, report_file: Path) -> None:
    opened.draw_all()
    assert opened.page.locator("figure.plot").count() == 6  # track, bands, speed, longest loop, rates, Allan
    assert opened.page.locator("figure.plot[data-drawn]").count() == 6
    assert opened.said == []
    assert opened.asked == [report_file.as_uri()]


def test_text_of_a_log_stays_text(opened: Opened) -> None:
    opened.draw_all()
    assert opened.page.locator("img").count() == 0
    assert "taken" in opened.page.title()  # as text, between the tags that were meant to do it
    assert opened.page.title().startswith("boat<_script><script>")
    assert opened.page.locator("script").count() == 3 + 6  # data of the page, two scripts, data of the plots


def test_evidence_leads_to_its_instant_in_all_plots(opened: Opened) -> None:
    opened.draw_all()
    whole = opened.ranges()
    opened.page.locator("ol.findings button.at", has_text="PM.MaxT").click()
    opened.page.locator("#whole").wait_for(state="visible")
    assert len(whole) == 3
    low, high = opened.followed()
    assert whole[0][0] < low < 43.2
    assert 53.2 < high <= SECONDS + 1e-6
    assert "0:43.2" in opened.page.locator("#now").inner_text()
    opened.page.locator("#whole").click()
    assert opened.followed() == whole[0]


def test_a_zoom_of_one_plot_is_followed_by_the_others(opened: Opened) -> None:
    opened.draw_all()
    box = opened.page.locator("figure.time .canvas").first.bounding_box()
    y = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + box["width"] * 0.4, y)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + box["width"] * 0.6, y, steps=5)
    opened.page.mouse.up()
    opened.page.locator("#whole").wait_for(state="visible")
    low, high = opened.followed()
    assert high - low == pytest.approx(0.2 * SECONDS, rel=0.1)  # a fifth of the width, less margins


def test_the_cursor_tells_time_mode_and_values(opened: Opened) -> None:
    opened.draw_all()
    box = opened.page.locator("figure.time .canvas").first.bounding_box()
    opened.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    opened.page.wait_for_function("() => document.querySelector('#now').textContent.includes('armed')")
    assert opened.page.locator("#now").inner_text().startswith("0:")
    assert opened.page.locator("figure.track .spot").is_visible()
    value = opened.page.locator("figure.time .chip b").first.inner_text()
    assert 1.0 <= float(value) <= 3.0  # 2 + sin t


def test_keys_move_in_time(opened: Opened) -> None:
    opened.draw_all()
    opened.page.locator("figure.time").first.focus()
    opened.page.keyboard.press("+")
    half = opened.ranges()[0]
    assert half[1] - half[0] == pytest.approx(SECONDS / 2, rel=1e-3)
    opened.page.keyboard.press("ArrowRight")
    assert opened.ranges()[0][0] > half[0]
    opened.page.keyboard.press("0")
    assert opened.ranges()[0] == pytest.approx([0.0, SECONDS], abs=1e-6)


def test_dark_follows_the_system_and_the_switch(opened: Opened) -> None:
    def ground() -> str:
        return str(opened.page.evaluate("getComputedStyle(document.body).backgroundColor"))

    light = ground()
    opened.page.emulate_media(color_scheme="dark")
    opened.page.wait_for_function("() => document.documentElement.dataset.theme === 'dark'")
    dark = ground()
    opened.page.locator("#theme").click()
    assert ground() == light != dark
    opened.page.locator("#theme").click()
    assert ground() == dark
    opened.page.locator("#theme").click()
    assert opened.page.locator("#theme").inner_text() == "Auto"


def test_the_filter_leaves_what_it_names(opened: Opened) -> None:
    opened.page.locator("h1").click()
    opened.page.keyboard.press("/")
    opened.page.keyboard.type("gyroscope")
    assert opened.page.locator("ol.findings > li:visible").count() == 1
    assert not opened.page.get_by_role("heading", name="Scheduler").is_visible()
    opened.page.locator("#filter").fill("no such thing anywhere")
    assert opened.page.locator("#none").is_visible()


def test_paper_gets_every_plot_in_light_colours(browser: Any, report_file: Path, tmp_path: Path) -> None:
    page = patient(browser.new_page(viewport={"width": 1000, "height": 300}, color_scheme="dark"))
    page.goto(report_file.as_uri())
    paper = tmp_path / "report.pdf"
    page.pdf(path=str(paper), format="A4")
    assert paper.read_bytes().startswith(b"%PDF")
    assert page.locator("figure.plot[data-drawn]").count() == 6  # although most were never in view
    page.close()


def test_nothing_is_wider_than_a_telephone(opened: Opened) -> None:
    opened.page.set_viewport_size({"width": 360, "height": 2600})
    opened.draw_all()
    assert opened.page.evaluate("document.documentElement.scrollWidth") == 360


EXPRESSION = "hypot(XKF1[1].VN, XKF1[0].VE) - GPS.Spd"


def test_the_picker_draws_what_the_log_says(browser: Any, tmp_path: Path) -> None:
    """Typed expressions against `Log.signal` on the same rows; what is wrong is said, what is chosen can go again."""
    log, path = made_signals(), tmp_path / "picker.html"
    html.write(replace(sample_report(), signals=(held_log(log, TimeLine(), ""),)), path)
    page = patient(browser.new_page(viewport=SCREEN, color_scheme="dark"))
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(path.as_uri())
    page.locator("#pick").scroll_into_view_if_needed()
    page.wait_for_function("() => document.querySelector('#messages').options.length === 7")
    assert "hypot(XKF1.VN, XKF1.VE)" in page.locator("#suggested").inner_text()
    for text in (EXPRESSION, "ATT.Yew", "GPS.Spd"):
        page.locator("#picking").fill(text)
        page.keyboard.press("Enter")
        assert ("did you mean Yaw?" in page.locator("#refused").inner_text()) == (text == "ATT.Yew")
    assert page.locator("#picking").input_value() == ""
    page.locator("#messages").select_option("ATT")
    page.locator("#columns button", has_text="DesYaw").click()
    assert page.locator("#picked figure").count() == 2  # m/s, and degrees
    page.locator("#picked figure .main-svg").first.wait_for()
    drawn = page.evaluate(
        "() => { const [one] = document.querySelector('#picked .canvas').data; return [[...one.x], [...one.y]]; }"
    )
    there = log.signal(EXPRESSION)
    assert drawn[0] == pytest.approx(there.time_s.tolist(), abs=1e-6)
    assert drawn[1] == pytest.approx(there.values.tolist(), abs=1e-5)  # float32 in the page
    assert "GPS resampled" in page.locator("#said").inner_text()
    page.locator("#chosen button", has_text="DesYaw").click()
    assert page.locator("#picked figure").count() == 1
    assert complaints == []
    page.close()


FOREIGN = """<!doctype html><html><head><title>x</title></head><body><p id="shown">none</p><script>
const made = document.createElement("script");
made.type = "module";
made.textContent = `addEventListener("message", (event) => {
  document.querySelector("#shown").textContent = String(event.data.replayGoesTo);
}); parent.postMessage({ replayShows: 21.5 }, "*");`;
document.head.append(made);
</script></body></html>"""


@pytest.mark.nightly
def test_the_replay_plays_in_a_frame_and_keeps_step_with_the_page(browser: Any, tmp_path: Path) -> None:
    """Its scripts, and those that they make, run under the page's policy; hostile text of a log still does not."""
    path = tmp_path / "replay.html"
    html.write(sample_report(), path, Replay(FOREIGN, late_s=1.5))
    page = patient(browser.new_page(viewport=SCREEN))
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(path.as_uri())
    assert page.locator("iframe").count() == 0  # until it is asked for
    page.locator("#play").click()
    page.wait_for_function("() => document.querySelector('#now').textContent.startsWith('0:20.0')")
    page.locator("ol.findings button.at", has_text="PM.MaxT").click()
    shown = page.frame_locator("#replay iframe").locator("#shown")
    playwright.expect(shown).to_have_text("44.7")  # 43.2 s of the page
    assert page.title().startswith("boat<_script><script>")
    page.locator("#play").click()
    assert page.locator("iframe").count() == 0
    assert complaints == []
    page.close()


@pytest.mark.nightly
def test_a_log_is_replayed_in_its_report(driver: Any, tmp_path: Path) -> None:
    """ArduRover's log in viser's player, from the disk and without a network, by drawing in software."""
    pytest.importorskip("viser", reason="draws the replay; pip install 'xitl[view]'")
    path = tmp_path / "report.html"
    command = typer.Typer()
    command.command()(analyze_command.analyze)
    told = CliRunner().invoke(command, [str(LINUX), "--section", "overview", "--report", str(path)])
    assert told.exit_code == 0, told.output
    started = launch_chromium(driver)
    page = unhurried(started.new_context(offline=True, viewport={"width": 640, "height": 480}).new_page())
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(path.as_uri())
    page.locator("#play").click()
    frame = page.frame_locator("#replay iframe")
    playwright.expect(frame.locator(".replay-now")).to_have_text(re.compile(r"\d+:\d\d\.\d"))
    frame.locator("canvas").first.wait_for()
    page.wait_for_function("() => document.querySelector('#now').textContent !== ''")
    assert errors == []
    started.close()
