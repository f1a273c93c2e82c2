"""Make the pictures of README and docs/ from runs: `make pictures`, or some: python -m tools.pictures report wdri.

Needs Chromium for pages and 3D pictures.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from tools.pictures.table import IMAGES, PICTURES
from tools.pictures.workplace import Workplace


def main() -> None:
    wanted = sys.argv[1:]
    unknown = [name for name in wanted if not any(Path(file).stem == name for file in PICTURES)]
    if unknown:
        sys.exit(
            f"no picture {', '.join(unknown)}; there are {', '.join(sorted(Path(file).stem for file in PICTURES))}"
        )
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="xitl-pictures-") as folder:
        workplace = Workplace(Path(folder))
        for file, make in PICTURES.items():
            if not wanted or Path(file).stem in wanted:
                began = time.monotonic()
                make(workplace, IMAGES / file)
                print(
                    f"{file}: {(IMAGES / file).stat().st_size / 1e3:.0f} kB, {time.monotonic() - began:.0f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
