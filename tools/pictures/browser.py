"""A page as a PNG with few colours, by the Chromium of this machine."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

COLOURS = 128


def photograph(page: Path, path: Path, width: int, height: int, anchor: str = "") -> None:
    """anchor: id of the part that is shown. Raises FileNotFoundError without Chromium."""
    program = next((one for name in ("chromium", "google-chrome", "chrome") if (one := shutil.which(name))), None)
    if program is None:
        raise FileNotFoundError("pictures of pages need Chromium on the PATH (apt install chromium)")
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        looks = [f"--window-size={width},{height}", "--virtual-time-budget=8000", "--hide-scrollbars"]
        address = page.resolve().as_uri() + (f"#{anchor}" if anchor else "")
        subprocess.run(
            [program, *options, *looks, f"--user-data-dir={profile}", f"--screenshot={path.resolve()}", address],
            check=True, stderr=subprocess.DEVNULL, timeout=300,
        )  # fmt: skip
    fewer_colours(path)


def fewer_colours(path: Path) -> None:
    """A PNG, in place."""
    from PIL import Image

    from xitl_cli.plugins.view.pictures import palette_of

    with Image.open(path) as image:
        whole = image.convert("RGB")
    whole.quantize(palette=palette_of(whole, COLOURS), dither=Image.Dither.NONE).save(path, optimize=True)
