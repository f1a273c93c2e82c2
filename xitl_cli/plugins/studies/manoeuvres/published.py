"""Published figures of the shipped vessels, as data: each with its source and how near the vessel has to come.

Runs are of the published equations, with the same thrust as the commands here make: tests/oracles/ integrates them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SAME_MODEL = 0.03
"""Of surge, sway and rate of turn where the reference is the same vessel's published model."""
SAME_HEADING_DEG = 3.0
DATA_SHEET = 0.10
"""A data sheet's speed has one digit or two, of a boat whose load and batteries it does not tell."""


@dataclass(frozen=True, slots=True)
class PublishedRun:
    """From rest under held commands: surge, sway and rate of turn after `RUNS_S`, and the heading after 10 s.

    commands: fractions of full speed of the propellers, and of the full angle of the rudders.
    """

    name: str
    commands: tuple[float, ...]
    surge_mps: float
    sway_mps: float
    rate_degps: float
    heading_10_s_deg: float
    source: str


@dataclass(frozen=True, slots=True)
class PublishedFigure:
    """A figure of a manoeuvre, by the key that it has there; tolerance: as a share of it.

    disputed: why it is not what the vessel is made after, where its sources contradict each other.
    """

    key: str
    value: float
    tolerance: float
    source: str
    disputed: str = ""


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
"""After which they are compared: steady, and too short for an unstable course to be left for want of symmetry."""
RUNS_WATER_KGPM3 = {"otter": 1025.0, "wamv16": 997.7735, "cybership2": 1000.0}
"""Of the published models; none has air that drags."""
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
