"""Instruments over the picture: the values of each vessel, and the legend of the colours. instruments.js draws them.

Invisible labels of the scene carry the data as JSON, because a page that was saved as a file has labels but no panel.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from sim_core.dataclass import dataclass
from xitl_cli.plugins.view.drawing import CLOUDS, ESTIMATE, GUIDED, MISSION, OBSTACLE, TARGET, TRACK, stream_arrows
from xitl_cli.plugins.view.model import Colour, SceneVessel, VesselInstant, ViewInstant, ViewScene
from xitl_cli.plugins.view.scene import plain_vessel
from xitl_cli.plugins.view.tracks import heading_deg

if TYPE_CHECKING:
    import viser

SHOWN = {
    "speed m/s": ("over ground", 2),
    "speed through water m/s": ("through water", 2),
    "heading °": ("heading", 0),
    "desired heading °": ("desired", 0),
    "cross-track m": ("cross-track", 2),
    "estimate off m": ("estimate off", 2),
    "battery V": ("battery", 1),
    "battery used Ah": ("battery used", 2),
    "deadline misses": ("deadline misses", 0),
    "links lost": ("frames lost", 0),
}
"""Name and decimals of the usual values by their label, in the order of the display. Other values follow."""
DRAWN = ("wind m/s", "current m/s")
"""Labels of values that the dial shows with their directions."""


CLASSES = "class, share of evidence"
"""Meaning of the texts at obstacles."""


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """A colour of the picture and its meaning."""

    colour: Colour
    name: str
    scale: str = ""


def legend(instant: ViewInstant, lead: SceneVessel, tracks: Mapping[str, Colour]) -> list[LegendEntry]:
    """Return the legend of an instant. lead: vessel with the arrows. tracks: colours of the tracks by vessel."""
    vessels = instant.vessels.values()
    classified = any(any(vessel.obstacle_classes) for vessel in vessels)
    entries = [LegendEntry(colour, f"track {name}".rstrip()) for name, colour in tracks.items()]
    parts: list[tuple[Colour, str, bool]] = [
        (MISSION, "mission", bool(len(lead.mission_enu_m)) or any(vessel.waypoints_total for vessel in vessels)),
        (TARGET, "next waypoint", any(vessel.target_enu_m is not None for vessel in vessels)),
        (GUIDED, "GUIDED target", any(vessel.guided_enu_m is not None for vessel in vessels)),
        (ESTIMATE, "estimate", any(vessel.estimate_position_enu_m is not None for vessel in vessels)),
        (OBSTACLE, "obstacle", any(len(vessel.obstacles_enu_m) for vessel in vessels)),
        *((colour, name, any(name in vessel.clouds for vessel in vessels)) for name, colour in CLOUDS.items()),
    ]
    entries += [
        LegendEntry(colour, name, CLASSES if name == "obstacle" and classified else "")
        for colour, name, shown in parts
        if shown
    ]
    return entries + [
        LegendEntry(arrow.colour, arrow.name, f"1 m = {1.0 / arrow.m_per_mps:.2g} m/s")
        for arrow in stream_arrows(lead.length_m)
    ]


def readings(instant: ViewInstant, vessel: VesselInstant, scene: SceneVessel) -> dict[str, Any]:
    """Return the values of a vessel for the display. Values that are not known are None."""
    numbers = {"heading °": heading_deg(vessel.attitude_wxyz), **vessel.numbers}
    rows = [
        [name, _rounded(numbers[label], decimals), _unit(label)]
        for label, (name, decimals) in SHOWN.items()
        if label in numbers
    ]
    rows += [
        [label.removesuffix(_unit(label)).rstrip(), _rounded(value, 2), _unit(label)]
        for label, value in numbers.items()
        if label not in SHOWN and label not in DRAWN
    ]
    if scene.wdri is not None:
        rows.append(["WDRI", f"{scene.wdri:.2f}", ""])
    motors = [[_actuator(scene, number), round(command, 2)] for number, command in enumerate(vessel.motors)]
    return {
        "time_s": round(instant.time_s, 2),
        "paused": instant.paused,
        "pace": _rounded(instant.pace, 1),
        "mode": vessel.mode or "–",
        "armed": vessel.armed,
        "waypoint": [vessel.waypoints_reached, vessel.waypoints_total],
        "heading_deg": _rounded(numbers["heading °"], 0),
        "desired_deg": _rounded(numbers.get("desired heading °", math.nan), 0),
        "wind": _stream(instant.wind_en_mps),
        "current": _stream(instant.current_en_mps),
        "rows": rows,
        "motors": motors,
    }


UNITS = ("m/s", "Ah", "ms", "µs", "ppm", "Hz", "°", "m", "s", "V")


def _unit(label: str) -> str:
    unit = label.rpartition(" ")[2]
    return unit if unit in UNITS else ""


def _rounded(value: float, decimals: int) -> str | None:
    return f"{value:.{decimals}f}" if math.isfinite(value) else None


def _stream(en_mps: tuple[float, float]) -> list[float]:
    """Return the speed in m/s, and the direction in degrees from north that the stream flows to."""
    east, north = en_mps
    return [round(math.hypot(east, north), 2), round(math.degrees(math.atan2(east, north)) % 360.0)]


def _actuator(vessel: SceneVessel, number: int) -> str:
    """Return the name of an actuator: its number, with its side if it is a propeller off the centre line."""
    sides = [thruster.place_flu_m[1] for thruster in vessel.thrusters if thruster.motor == number]
    if not sides or abs(sides[0]) < 0.02 * vessel.length_m:
        return f"{number + 1}"
    return f"{number + 1} {'port' if sides[0] > 0.0 else 'starboard'}"


class InstrumentPanel:
    """The instruments of a server's page. tracks: colours of the tracks by vessel, one for all under "" by default.

    every_s: scene time between two changes of the values.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: ViewScene,
        tracks: Mapping[str, Colour] | None = None,
        every_s: float = 0.0,
    ) -> None:
        self._api = server.scene
        self._scene = scene
        self._tracks = {"": TRACK} if tracks is None else tracks
        self._every_s = every_s
        self._shown: tuple[float, bool] = (-math.inf, False)
        self._labels: dict[str, Any] = {}

    def update(self, instant: ViewInstant) -> None:
        """Show the values of an instant."""
        shown_s, paused = self._shown
        if 0.0 <= instant.time_s - shown_s < self._every_s and instant.paused == paused:
            return
        self._shown = instant.time_s, instant.paused
        vessels = {name: self._scene.vessels.get(name) or plain_vessel() for name in instant.vessels}
        if not vessels:
            return
        entries = legend(instant, next(iter(vessels.values())), self._tracks)
        colours = [[f"rgb{entry.colour}", entry.name, entry.scale] for entry in entries]
        self._write("/instruments", {"vessels": list(vessels), "legend": colours})
        for name, vessel in vessels.items():
            self._write(f"/instruments/{name or 'vessel'}", readings(instant, instant.vessels[name], vessel))

    def _write(self, path: str, values: Mapping[str, Any]) -> None:
        text = json.dumps(values, ensure_ascii=False, separators=(",", ":"))
        label = self._labels.get(path)
        if label is None:
            self._labels[path] = self._api.add_label(path, text, visible=False)
        elif label.text != text:
            label.text = text


def instruments_html() -> str:
    """Return script and style of the instruments, for the head of a page."""
    here = files("xitl_cli.plugins.view")
    script, style = ((here / f"instruments.{kind}").read_text(encoding="utf-8") for kind in ("js", "css"))
    return f"<style>{style}</style><script>{script}</script>"
