"""Pages that commands write, as a browser shows them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tools.pictures.browser import fewer_colours, photograph
from tools.pictures.plots import CUT
from tools.pictures.workplace import Workplace

ROOT = Path(__file__).parents[2]
BETTER = """base: sitl
axes:
  autopilot.controller: [null, "examples/sliding_mode_heading.py:SlidingModeHeading"] # null: the built-in one
seeds: 1-10
set: {mission.waypoints_ned_m: [[40, 30], [80, 60], [80, 20]]}
keep: [mission.cross_track_rms_m, mission.cross_track_max_m, duration_s]
verdicts: [driver.completed, mission.cross_track_max_m < 5]
recordings: none
"""


def first_report(workplace: Workplace, path: Path) -> None:
    """Of a run that went well."""
    workplace.typed("xitl sim sitl --out runs/first")
    workplace.typed("xitl logs analyze runs/first/run.mcap runs/first/autopilot.bin --report first.html")
    photograph(workplace.folder / "first.html", path, 1280, 1000)


def cut_report(workplace: Workplace, path: Path) -> None:
    """Of a run that did not."""
    workplace.file("cut.yaml", "extends: [sitl, faults/link-cut]\n")
    workplace.typed(CUT)
    workplace.typed("xitl logs analyze runs/cut/run.mcap runs/cut/autopilot.bin --report cut.html")
    photograph(workplace.folder / "cut.html", path, 1280, 1000)


def validation(workplace: Workplace, path: Path) -> None:
    """Of one vessel."""
    workplace.typed("xitl validate otter --out otter.html")
    photograph(workplace.folder / "otter.html", path, 1280, 1100)


def comparison(workplace: Workplace, path: Path) -> None:
    """Two controllers on the same seeds, of a short mission."""
    if not (workplace.folder / "examples").exists():
        (workplace.folder / "examples").symlink_to(ROOT / "examples")
    workplace.file("better.yaml", BETTER)
    workplace.typed("xitl campaign better.yaml --out runs/better")
    workplace.typed("xitl campaign compare runs/better --by autopilot.controller --report better.html")
    photograph(workplace.folder / "better.html", path, 1280, 1000)


def example(workplace: Workplace, path: Path) -> None:
    """What examples/plot_a_run.py draws."""
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(
        [sys.executable, str(ROOT / "examples/plot_a_run.py")], cwd=workplace.folder, env=environment,
        check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    path.write_bytes((workplace.folder / "plot_a_run.png").read_bytes())
    fewer_colours(path)
