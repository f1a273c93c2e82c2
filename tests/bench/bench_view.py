"""What a view costs the run, and how fast a browser without a graphics card draws it.

`python -m tests.bench.bench_view`: pairs of runs with and without a view that nobody looks at, one after the other by
turns, and pictures a second of headless Chromium at 640 x 360 with the scene of `sitl`.
"""

from __future__ import annotations

import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.figure import Figure, scaled
from tests.chromium import CHROMIUM, launch_chromium

XITL = [sys.executable, "-c", "from xitl_cli.main import main; main()"]
COUNT_FRAMES = """(seconds) => new Promise((done) => {
  const draw = WebGL2RenderingContext.prototype.drawElements;
  let drawn = false, pictures = 0;
  WebGL2RenderingContext.prototype.drawElements = function (...all) { drawn = true; return draw.apply(this, all); };
  const until = performance.now() + 1000 * seconds;
  const look = () => {
    if (drawn) pictures += 1;
    drawn = false;
    if (performance.now() < until) requestAnimationFrame(look); else done(pictures / seconds);
  };
  requestAnimationFrame(look);
})"""


def run_once(folder: Path, duration_s: float, *arguments: str) -> tuple[float, float]:
    """Speed over real time of the run's loop, and processor seconds of its process."""
    before = os.times()
    command = [*XITL, "sim", "sitl", "--duration", f"{duration_s:g}", "--out", str(folder), "--overwrite", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    factor: float = json.loads((folder / "summary.json").read_text())["real_time_factor"]
    return factor, after.children_user - before.children_user + after.children_system - before.children_system


def view_ratios(pairs: int = 5, duration_s: float = 120.0) -> tuple[list[float], list[float]]:
    """Of pairs, with a view over without: speed, and processor time with that of the view's process."""
    with tempfile.TemporaryDirectory() as folder:
        speeds, seconds = [], []
        for number in range(scaled(pairs, 1)):
            found = {}
            for arguments in ((), ("--view",)) if number % 2 else (("--view",), ()):
                found[arguments] = run_once(Path(folder) / "run", scaled(duration_s, 1.0), *arguments)
            speeds.append(found[("--view",)][0] / found[()][0])
            seconds.append(found[("--view",)][1] / found[()][1])
    return speeds, seconds


def pictures_per_second(seconds: float = 8.0) -> float:
    """Of the scene of `sitl` at 640 x 360, drawn by the processor."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder:
        command = [*XITL, "sim", "sitl", "--view", "--out", f"{folder}/run"]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ | {"CI": "1"})
        try:
            assert run.stdout is not None
            address = next(found[0] for line in run.stdout if (found := re.findall(r"view: (http\S+)", line)))
            with sync_playwright() as driver:
                browser = launch_chromium(driver)
                page = browser.new_page(viewport={"width": 640, "height": 360})
                page.goto(address)
                page.locator("td", has_text="waypoint").wait_for(timeout=120_000)
                time.sleep(10.0)  # the first pictures are those of a page that is being built
                found = float(page.evaluate(COUNT_FRAMES, scaled(seconds, 1.0)))
                browser.close()
        finally:
            run.terminate()
            run.communicate()
    return found


FIGURES = [Figure("run with a view that nobody looks at, of one without", ">= 0.9", "x", lambda: view_ratios()[0])]
if CHROMIUM is not None:
    FIGURES.append(Figure("view at 640 x 360, drawn in software", ">= 15", "frames/s", lambda: [pictures_per_second()]))


if __name__ == "__main__":
    speed, processor = map(statistics.median, view_ratios())
    print(f"run with a view that nobody looks at, over the run without: speed {speed:.2f} (wanted 0.9)")
    print(f"processor time of both processes, over that of the run without: {processor:.2f}")
    if CHROMIUM is not None:
        print(f"pictures a second at 640 x 360 in software: {pictures_per_second():.1f} (wanted 15)")
