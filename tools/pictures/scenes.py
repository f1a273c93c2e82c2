"""Pictures of recordings in 3D: as `xitl view --gif` makes them, and its page in a browser."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from tools.pictures.workplace import Workplace

FROM_S, TO_S = 56.0, 83.0
"""Of the first run: along the boom, and into the turn at its end."""
PATIENCE_MS, SETTLED_MS = 300_000, 8_000


def first_run(workplace: Workplace, path: Path) -> None:
    """The moving picture at the top of README."""
    from xitl_cli.plugins.view.pictures import moving_picture

    workplace.typed("xitl sim sitl --out runs/first")
    recording = workplace.folder / "runs/first/run.mcap"
    path.write_bytes(moving_picture([recording], FROM_S, TO_S, size=(720, 405), speed=3.0, kind="webp"))


def view(workplace: Workplace, path: Path) -> None:
    """The page of `xitl view` with its instruments, in a browser."""
    from playwright.sync_api import sync_playwright

    from tools.pictures.browser import fewer_colours
    from xitl_cli.plugins.view.pictures import SOFTWARE, find_browser

    workplace.typed("xitl sim sitl --out runs/first")
    served = subprocess.Popen(
        [sys.executable, "-m", "xitl_cli.main", "view", "runs/first/run.mcap", "--no-open", "--at", "60"],
        cwd=workplace.folder, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert served.stdout is not None
        address = next(found[0] for line in served.stdout if (found := re.search(r"http://\S+", line)))
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=find_browser(), args=["--no-sandbox", *SOFTWARE])
            page = browser.new_page(viewport={"width": 1180, "height": 700})
            page.set_default_timeout(PATIENCE_MS)
            page.goto(f"{address}?look=full")
            page.wait_for_function("window.xitlLook && window.xitlLook.water")
            page.locator(".xitl-instruments svg").wait_for()
            page.locator(".mantine-Notification-closeButton").first.click()  # of the note on drawing in software
            page.wait_for_timeout(SETTLED_MS)
            page.screenshot(path=path)
            browser.close()
    finally:
        served.terminate()
        served.wait()
    fewer_colours(path)
