"""The instruments over the picture: their values with units, their legend, and when they change."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from xitl_cli.plugins.view.drawing import ESTIMATE, GUIDED, OBSTACLE, TARGET
from xitl_cli.plugins.view.instruments import InstrumentPanel, legend, readings
from xitl_cli.plugins.view.model import SceneThruster, SceneVessel, VesselInstant, ViewInstant, ViewScene

AHEAD = (1.0, 0.0, 0.0)
BOAT = SceneVessel(
    (),
    thrusters=(SceneThruster((-0.8, 0.5, 0.0), AHEAD, 0.2, 0), SceneThruster((-0.8, -0.5, 0.0), AHEAD, 0.2, 1)),
    wdri=1.0 / 6.0,
)
EASTWARD = VesselInstant(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), motors=(0.5, -0.25), mode="AUTO", armed=True)


@dataclass
class Scene:
    """Stands in for viser's scene; keeps the labels."""

    labels: dict[str, Any] = field(default_factory=dict)

    def add_label(self, path: str, text: str, *, visible: bool) -> Any:
        assert not visible
        self.labels[path] = SimpleNamespace(text=text)
        return self.labels[path]

    def read(self, path: str) -> Any:
        return json.loads(self.labels[path].text)


def of_rows(values: dict[str, Any]) -> dict[str, tuple[str | None, str]]:
    return {name: (value, unit) for name, value, unit in values["rows"]}


def test_values_have_units_and_unknown_ones_are_none() -> None:
    numbers = {
        "speed m/s": 2.345,
        "speed through water m/s": 2.0,
        "desired heading °": float("nan"),
        "cross-track m": -0.4,
        "battery V": 24.04,
        "wind m/s": 5.0,
        "clock drift ppm": 3.0,
    }
    instant = ViewInstant(12.3, {}, wind_en_mps=(3.0, 4.0), current_en_mps=(0.0, -0.5), paused=True)
    values = readings(instant, replace(EASTWARD, numbers=numbers), BOAT)
    rows = of_rows(values)
    assert rows["over ground"] == ("2.35", "m/s") or rows["over ground"] == ("2.34", "m/s")
    assert rows["through water"] == ("2.00", "m/s")
    assert rows["heading"] == ("90", "°")
    assert rows["desired"] == (None, "°")
    assert rows["cross-track"] == ("-0.40", "m")
    assert rows["battery"] == ("24.0", "V")
    assert rows["clock drift"] == ("3.00", "ppm")
    assert rows["WDRI"] == ("0.17", "")
    assert not {"wind", "wind m/s"} & set(rows)  # the dial has it
    assert (values["wind"], values["current"]) == ([5.0, 37], [0.5, 180])
    assert values["motors"] == [["1 port", 0.5], ["2 starboard", -0.25]]
    assert (values["heading_deg"], values["desired_deg"], values["pace"]) == ("90", None, None)
    assert (values["mode"], values["armed"], values["time_s"], values["paused"]) == ("AUTO", True, 12.3, True)


def test_the_legend_has_the_colours_that_are_drawn() -> None:
    track = {"": (1, 2, 3)}
    plain = [(entry.name, entry.colour) for entry in legend(ViewInstant(0.0, {"": EASTWARD}), BOAT, track)]
    assert ("track", (1, 2, 3)) in plain
    marks = {"next waypoint": TARGET, "GUIDED target": GUIDED, "estimate": ESTIMATE, "obstacle": OBSTACLE}
    assert not set(marks) & {name for name, _ in plain}
    place = np.zeros(3)
    full = replace(
        EASTWARD,
        target_enu_m=place,
        guided_enu_m=place,
        estimate_position_enu_m=place,
        obstacles_enu_m=np.zeros((1, 3)),
        clouds={"lidar": np.zeros((1, 3), dtype=np.float32)},
    )
    names = {entry.name: entry.colour for entry in legend(ViewInstant(0.0, {"": full}), BOAT, track)}
    assert marks.items() <= names.items()
    assert "lidar" in names
    classified = replace(full, obstacle_classes=("buoy 92 %",))
    texts = [
        {entry.name: entry.scale for entry in legend(ViewInstant(0.0, {"": vessel}), BOAT, track)}["obstacle"]
        for vessel in (full, classified)
    ]
    assert texts == ["", "class, share of evidence"]


@pytest.mark.parametrize(("every_s", "shown_s"), [(0.0, 0.2), (0.5, 0.0)])
def test_labels_change_at_their_interval_and_at_once_after_a_pause_or_a_jump_back(
    every_s: float, shown_s: float
) -> None:
    scene = Scene()
    server = cast(Any, SimpleNamespace(scene=scene))
    instruments = InstrumentPanel(server, ViewScene("test", vessels={"a": BOAT}), every_s=every_s)
    instruments.update(ViewInstant(0.0, {"a": EASTWARD}))
    instruments.update(ViewInstant(0.2, {"a": EASTWARD}))
    assert scene.read("/instruments/a")["time_s"] == shown_s
    assert scene.read("/instruments")["vessels"] == ["a"]
    instruments.update(ViewInstant(0.3, {"a": EASTWARD}, paused=True))
    assert scene.read("/instruments/a")["paused"]
    instruments.update(ViewInstant(0.1, {"a": EASTWARD}, paused=True))
    assert scene.read("/instruments/a")["time_s"] == 0.1
