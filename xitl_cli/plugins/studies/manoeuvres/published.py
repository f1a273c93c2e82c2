"""Published figures of the shipped vessels, as data, each with its source and its tolerance.

Runs are of the published equations, with the same thrust as from these commands: tests/oracles/ integrates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SAME_MODEL = 0.03
"""Tolerance of surge, sway and rate of turn if the reference is the published model of the same vessel."""
SAME_HEADING_DEG = 3.0
DATA_SHEET = 0.10
"""Tolerance of a data sheet's speed: one or two digits, without load and batteries of the boat."""


@dataclass(frozen=True, slots=True)
class PublishedRun:
    """Run from rest under held commands."""

    name: str
    commands: tuple[float, ...]
    """Fractions of full speed of the propellers, and of the full angle of the rudders."""
    surge_mps: float
    """After `RUNS_S`."""
    sway_mps: float
    """After `RUNS_S`."""
    rate_degps: float
    """After `RUNS_S`."""
    heading_10_s_deg: float
    """Heading after 10 s."""
    source: str


@dataclass(frozen=True, slots=True)
class PublishedFigure:
    """A figure of a manoeuvre."""

    key: str
    """Key in the manoeuvre."""
    value: float
    tolerance: float
    """Tolerance as a share of the value."""
    source: str
    disputed: str = ""
    """Reason why the vessel does not follow it, if its sources contradict each other."""


_OTTER_AHEAD = math.sqrt(0.5 * 24.4 * 9.81 / (0.5 * 0.02216))
_OTTER_ASTERN = math.sqrt(0.5 * 13.6 * 9.81 / (0.5 * 0.01289))
"""Fastest shafts of otter.py, rad/s."""
_HERON = "Clearpath's own simulation, which the vessel is made after, has thrust and drag for 2.7 m/s"
_OTTER = "Fossen's Otter (PythonVehicleSimulator), its equations run"
_CYBERSHIP = "Skjetne, Smogeli & Fossen 2004 (CyberShip II), their equations run"
_WAMV = "VRX 2.4's WAM-V plugins, their equations run"


def _otter(port_radps: float, starboard_radps: float) -> tuple[float, float]:
    both = (shaft / (_OTTER_AHEAD if shaft >= 0 else _OTTER_ASTERN) for shaft in (port_radps, starboard_radps))
    port, starboard = both
    return port, starboard


def _wamv(port_n: float, starboard_n: float) -> tuple[float, float]:
    port, starboard = (math.copysign(math.sqrt(abs(newton) / 2353.53), newton) for newton in (port_n, starboard_n))
    return port, starboard


RUNS_S = 15.0
"""Time of the comparison: the motion is steady, and an unstable course is not yet lost by asymmetry."""
RUNS_WATER_KGPM3 = {"otter": 1025.0, "wamv16": 997.7735, "cybership2": 1000.0}
"""Environment of the published models; none has air drag."""
RUNS: dict[str, tuple[PublishedRun, ...]] = {
    "otter": (
        PublishedRun("100 and 100 rad/s", _otter(100, 100), 2.85734, 0.0, 0.0, 0.0, _OTTER),
        PublishedRun("100 and 80 rad/s", _otter(100, 80), 2.23782, -0.21635, 14.6144, 125.815, _OTTER),
        PublishedRun("100 and -60 rad/s", _otter(100, -60), 1.06615, -0.12281, 17.5072, 167.894, _OTTER),
        PublishedRun("50 and -50 rad/s", _otter(50, -50), 0.14997, -0.01, 8.5979, 82.381, _OTTER),
    ),
    "wamv16": (
        PublishedRun("500 and 500 N", _wamv(500, 500), 2.27007, 0.0, 0.0, 0.0, _WAMV),
        PublishedRun("500 and 300 N", _wamv(500, 300), 1.9484, -0.61538, 13.8541, 126.179, _WAMV),
        PublishedRun("800 and 0 N", _wamv(800, 0), 1.70105, -1.1361, 38.7398, 367.376, _WAMV),
    ),
    "cybership2": (PublishedRun("25 and 25 turns/s", (0.75, 0.75, 0.0, 0.0, 0.0), 0.8082, 0.0, 0.0, 0.0, _CYBERSHIP),),
}
FIGURES: dict[str, tuple[PublishedFigure, ...]] = {
    "otter": (PublishedFigure("top_speed_mps", 6 * 0.5144, DATA_SHEET, "Maritime Robotics' data sheet: 6 knots"),),
    "heron": (PublishedFigure("top_speed_mps", 1.7, DATA_SHEET, "Clearpath's data sheet: 1.7 m/s", _HERON),),
    "blueboat": (PublishedFigure("top_speed_mps", 3.0, DATA_SHEET, "Blue Robotics' data sheet: 3 m/s"),),
}
