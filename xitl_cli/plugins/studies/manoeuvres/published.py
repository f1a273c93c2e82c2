"""Published figures of the shipped vessels, as data, each with its source and its tolerance.

Runs are of the published equations, with the same thrust as from these commands: tests/oracles/ integrates them.
"""

from __future__ import annotations

import math

from sim_core.dataclass import dataclass
from xitl_cli.plugins.studies.manoeuvres.references import ReferenceKind, Source

HOERNER = (
    (0.0109, 1.9661), (0.1766, 1.9657), (0.3530, 1.8976), (0.4519, 1.7872), (0.4728, 1.5837), (0.4929, 1.2786),
    (0.4933, 1.2108), (0.5585, 1.0836), (0.6464, 0.9986), (0.8336, 0.8796), (0.9880, 0.8284), (1.3081, 0.7599),
    (1.6392, 0.6914), (1.8600, 0.6571), (2.3129, 0.6307), (2.6000, 0.5962), (3.0088, 0.5868), (3.4508, 0.5859),
    (3.7379, 0.5599), (4.0031, 0.5593),
)  # fmt: skip
"""Cross-flow drag of a section over half its width by its draft: Hoerner 1965, digitised in Fossen 2021, fig 6.13."""
SAME_MODEL = 0.03
"""Tolerance of surge, sway and rate of turn if the reference is the published model of the same vessel."""
SAME_HEADING_DEG = 3.0
DATA_SHEET = 0.10
"""Tolerance of a data sheet's speed: one or two digits, without load and batteries of the boat."""
RECORDED = 0.10
"""Tolerance of recordings: the speeds of one boat under one command differ by 5 to 10 % between runs."""


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
    source: Source

    @property
    def turns(self) -> bool:
        """Whether it leaves the straight course: otherwise sway and rate of turn are 0 by symmetry."""
        return bool(self.rate_degps)


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """Run of a real boat from rest under held commands, until it is steady."""

    key: str
    name: str
    commands: tuple[float, ...]
    figures: tuple[str, ...]
    """`speed_mps`, `rate_degps`."""


@dataclass(frozen=True, slots=True)
class PublishedFigure:
    """A figure of a manoeuvre."""

    key: str
    """Key in the manoeuvre."""
    value: float
    tolerance: float
    """Tolerance as a share of the value."""
    source: Source
    disputed: str = ""
    """Reason why the vessel does not follow it, if its sources contradict each other."""


_OTTER_AHEAD = math.sqrt(0.5 * 24.4 * 9.81 / (0.5 * 0.02216))
_OTTER_ASTERN = math.sqrt(0.5 * 13.6 * 9.81 / (0.5 * 0.01289))
"""Fastest shafts of otter.py, rad/s."""
_HERON = "Clearpath's own simulation, which the vessel is made after, has thrust and drag for 2.7 m/s"
_OTTER = Source(ReferenceKind.PUBLISHED, "Fossen's Otter (PythonVehicleSimulator), its equations run")
_CYBERSHIP = Source(ReferenceKind.PUBLISHED, "Skjetne, Smogeli & Fossen 2004 (CyberShip II), their equations run")
_WAMV = Source(ReferenceKind.PUBLISHED, "VRX 2.4's WAM-V plugins, their equations run")
_TRONDHEIM = Source(
    ReferenceKind.MEASURED, "recordings of a BlueBoat at Trondheim (BlueBoatSystemIdentification), used to fit it"
)


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
        PublishedRun("80 and 80 rad/s", _otter(80, 80), 1.8287, 0.0, 0.0, 0.0, _OTTER),
        PublishedRun("60 and 100 rad/s", _otter(60, 100), 1.84917, 0.18814, -15.3171, -139.648, _OTTER),
    ),
    "wamv16": (
        PublishedRun("500 and 500 N", _wamv(500, 500), 2.27007, 0.0, 0.0, 0.0, _WAMV),
        PublishedRun("500 and 300 N", _wamv(500, 300), 1.9484, -0.61538, 13.8541, 126.179, _WAMV),
        PublishedRun("800 and 0 N", _wamv(800, 0), 1.70105, -1.1361, 38.7398, 367.376, _WAMV),
        PublishedRun("2300 and 2300 N", _wamv(2300, 2300), 5.21348, 0.0, 0.0, 0.0, _WAMV),
        PublishedRun("1500 and 500 N", _wamv(1500, 500), 2.97898, -1.83451, 47.394, 449.67, _WAMV),
        PublishedRun("800 and 200 N", _wamv(800, 200), 2.05866, -1.14002, 32.1795, 302.394, _WAMV),
        PublishedRun("500 and -500 N", _wamv(500, -500), -0.12273, 0.1636, 42.1209, 405.442, _WAMV),
    ),
    "cybership2": (
        PublishedRun("25 and 25 turns/s", (0.75, 0.75, 0.0, 0.0, 0.0), 0.8082, 0.0, 0.0, 0.0, _CYBERSHIP),
        PublishedRun("20 and 20 turns/s", (0.6, 0.6, 0.0, 0.0, 0.0), 0.6724, 0.0, 0.0, 0.0, _CYBERSHIP),
        PublishedRun("10 and 10 turns/s", (0.3, 0.3, 0.0, 0.0, 0.0), 0.29426, 0.0, 0.0, 0.0, _CYBERSHIP),
    ),
}
RECORDED_S = 30.0
_SPOT = math.sqrt(18.0 / 40.2)
"""Share of full speed ahead that gives the thrust of full astern, as the BlueBoat turns on the spot."""
RECORDED_RUNS = {
    "blueboat": (
        RecordedRun("astern", "full astern", (-1.0, -1.0), ("speed_mps",)),
        RecordedRun("one_propeller", "port propeller alone", (1.0, 0.0), ("speed_mps", "rate_degps")),
        RecordedRun("spot_turn", "on the spot", (_SPOT, -1.0), ("rate_degps",)),
    ),
}


def _data_sheet(speed_mps: float, text: str, disputed: str = "") -> PublishedFigure:
    return PublishedFigure("top_speed_mps", speed_mps, DATA_SHEET, Source(ReferenceKind.PUBLISHED, text), disputed)


FIGURES: dict[str, tuple[PublishedFigure, ...]] = {
    "otter": (_data_sheet(6 * 0.5144, "Maritime Robotics' data sheet: 6 knots"),),
    "heron": (_data_sheet(1.7, "Clearpath's data sheet: 1.7 m/s", _HERON),),
    "blueboat": (
        _data_sheet(3.0, "Blue Robotics' data sheet: 3 m/s"),
        PublishedFigure("top_speed_mps", 3.05, RECORDED, _TRONDHEIM),
        PublishedFigure("astern_speed_mps", -2.15, RECORDED, _TRONDHEIM),
        PublishedFigure("one_propeller_speed_mps", 2.075, RECORDED, _TRONDHEIM),
        PublishedFigure("one_propeller_rate_degps", math.degrees(0.2225), RECORDED, _TRONDHEIM),
        PublishedFigure("spot_turn_rate_degps", math.degrees(0.93), RECORDED, _TRONDHEIM),
    ),
}
