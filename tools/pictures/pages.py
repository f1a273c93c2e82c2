"""Pages that commands write, as a browser shows them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.geodesy import LocalFrame
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


def report_on_a_map(workplace: Workplace, path: Path) -> None:
    """The track of the first run on a made-up chart."""
    workplace.typed("xitl sim sitl --out runs/first")
    workplace.file("reach.geojson", json.dumps(made_up_chart(-8.8, -63.95)))
    logs = "runs/first/run.mcap runs/first/autopilot.bin"
    workplace.typed(f"xitl logs analyze {logs} --report on-a-map.html --map reach.geojson --no-replay")
    photograph(workplace.folder / "on-a-map.html", path, 1180, 1010)


def made_up_chart(latitude_deg: float, longitude_deg: float) -> dict[str, Any]:
    """Return GeoJSON about a place: shore, water, a shoal with an islet, a fairway and buoys."""
    frame = LocalFrame(latitude_deg, longitude_deg, 0.0)

    def degrees(places_en_m: list[tuple[float, float]]) -> list[list[float]]:
        east_m, north_m = np.array(places_en_m, dtype=np.float64).T
        latitude, longitude, _ = frame.geodetic(np.column_stack([north_m, east_m, np.zeros(len(east_m))]))
        return [[round(x, 7), round(y, 7)] for x, y in zip(longitude.tolist(), latitude.tolist(), strict=True)]

    def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
        style = {key.replace("_", "-"): value for key, value in properties.items()}
        return {"type": "Feature", "properties": style, "geometry": {"type": kind, "coordinates": coordinates}}

    def area(
        places_en_m: list[tuple[float, float]], *holes: list[tuple[float, float]], **properties: Any
    ) -> dict[str, Any]:
        rings = [degrees([*ring, ring[0]]) for ring in (places_en_m, *holes)]
        return feature("Polygon", rings, fill_opacity=0.9, stroke_width=1, **properties)

    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    shoal = [(90.0 + 28.0 * np.cos(t) + 5.0 * np.cos(3.0 * t), 40.0 + 20.0 * np.sin(t)) for t in turn.tolist()]
    islet = [(74.0 + 6.0 * np.cos(t), 42.0 + 4.5 * np.sin(t)) for t in turn.tolist()]
    shore = [(-30.0 + 7.0 * np.sin(0.03 * north), north) for north in np.arange(-200.0, 401.0, 10.0).tolist()]
    features = [
        area([(-300, -200), (400, -200), (400, 400), (-300, 400)], fill="#d3e9f5", stroke="#d3e9f5"),
        area([(-300, -200), *shore, (-300, 400)], fill="#efe3b8", stroke="#9a8a55"),
        area(shoal, islet, fill="#a9d0e6", stroke="#5b8fb0", name="2 m"),
        area(islet, fill="#efe3b8", stroke="#9a8a55"),
        feature("LineString", degrees([(-6, -100), (2, 60), (40, 220)]), stroke="#a0529a"),
        feature("Point", degrees([(22, 100)])[0], name="buoy 3", marker_color="#d02f2f"),
        feature("Point", degrees([(80, 76)])[0], name="buoy 4", marker_color="#23834a"),
    ]
    return {"type": "FeatureCollection", "features": features}


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
