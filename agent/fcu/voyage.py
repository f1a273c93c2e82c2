"""Where the modes keep what they steer by: the mission, targets from outside, the station, the way home."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.control.guidance import GuidanceGains, GuidanceOutput
from agent.fcu.control.guided import Guided
from agent.fcu.control.manual import Sticks
from agent.fcu.control.station import Passage, Station
from agent.fcu.events import NOTICE, Events
from agent.fcu.local_frame import LocalFrame
from agent.fcu.mission import Mission
from agent.fcu.parameters import Parameters
from agent.fcu.pilot import Pilot
from agent.fcu.samples import Estimate


class Situation(NamedTuple):
    """One cycle as a mode sees it; `speed_mps` is over ground, negative astern."""

    now_ns: int
    dt_s: float
    estimate: Estimate
    frame: LocalFrame
    pos_ne_m: tuple[float, float]
    speed_mps: float
    sticks: Sticks


class Voyage:
    """`home` is (latitude, longitude); `output` is the guidance of the mode in force, None when it has none;
    `asked_mps` is a speed asked for while it is.
    """

    def __init__(self, mission: Mission, parameters: Parameters, events: Events) -> None:
        self.pilot = Pilot(mission, parameters["WP_SPEED"])
        self.guided = Guided()
        self.station: Station | None = None
        self.homeward: Passage | None = None
        self.home: tuple[float, float] | None = None
        self.output: GuidanceOutput | None = None
        self.asked_mps: float | None = None
        self._events = events
        self.configure(parameters)

    def configure(self, p: Parameters) -> None:
        """Take changed parameters over."""
        self.gains = GuidanceGains.of(p)
        self.cruise_mps = p["WP_SPEED"]
        self.homeward_mps = p["RTL_SPEED"] or p["WP_SPEED"]
        # Drag, and with it thrust, grows with the square of the speed.
        self.speed_max_mps = p["SPEED_MAX"] or p["CRUISE_SPEED"] / math.sqrt(p["CRUISE_THROTTLE"] / 100.0)
        self.acro_radps = math.radians(p["ACRO_TURN_RATE"])
        self.turn_radius_m = p["TURN_RADIUS"]
        self.guided_timeout_ns = int(p["GUID_TIMEOUT"] * 1e9)
        self.pilot.default_speed_mps = p["WP_SPEED"]

    def notice(self, text: str) -> None:
        """Say it to the ground station."""
        self._events.say(NOTICE, text)

    def load(self, mission: Mission) -> None:
        """A new mission, from its start."""
        self.pilot = Pilot(mission, self.cruise_mps)

    def depart(self) -> None:
        """AUTO: the next leg starts where the vessel is."""
        self.pilot.depart()

    def leave_station(self) -> None:
        """LOITER: stay where the vessel comes to rest next."""
        self.station = None

    def turn_home(self) -> None:
        """RTL: the way home starts where the vessel is."""
        self.homeward = None

    def await_target(self) -> None:
        """GUIDED: stay where the vessel comes to rest, until a target comes."""
        self.guided.drop()

    def stopping_place(self, now: Situation) -> tuple[float, float]:
        """Latitude and longitude of where the vessel comes to rest at ATC_DECEL_MAX."""
        (vn, ve, _), (north_m, east_m) = now.estimate.vel_ned_mps, now.pos_ne_m
        slowing_s = 0.5 * math.hypot(vn, ve) / self.gains.deceleration_mps2
        return now.frame.to_geodetic(north_m + slowing_s * vn, east_m + slowing_s * ve)
