"""A boat under an autopilot: set out in a mode, steered for a time, and its readings."""

from __future__ import annotations

import math
from collections.abc import Callable

from boat import DECLINATION_RAD, Boat, Noise, Sensors, sail

from agent.fcu.control.controller import MakeController
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import Actuators

LEVEL_S = 12.0
QUIET = Noise(gnss_drift_m=0.0)


class SteeredBoat:
    """A boat with its autopilot under way. `say` are the events so far."""

    def __init__(
        self,
        boat: Boat | None = None,
        make_controller: MakeController | None = None,
        noise: Noise = QUIET,
        **parameters: float,
    ) -> None:
        self.boat = Boat() if boat is None else boat
        self.sensors = Sensors(7, noise)
        self.autopilot = Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD, **parameters}), make_controller)
        self.command: tuple[float, ...] = (0.0, 0.0)
        self.said: list[str] = []

    def sail(self, seconds: float, look: Callable[[], bool] | None = None) -> None:
        """So long, or until `look` says so."""

        def each(actuators: Actuators) -> bool:
            assert all(abs(command) <= 1.0 for command in actuators.command)
            self.command = actuators.command
            self.said += [event.text for event in self.autopilot.events.drain()]
            return look is not None and look()

        sail(self.boat, self.sensors, self.autopilot, seconds, each)

    def set_out(self, mode: int) -> SteeredBoat:
        """Level, choose a mode, arm."""
        self.sail(LEVEL_S)
        assert self.autopilot.set_mode(mode) == ""
        assert self.autopilot.arm() == ()
        return self

    def hold_sticks(self, seconds: float, steering: int, throttle: int) -> None:
        """MANUAL_CONTROL at 10 Hz; deflections in thousandths."""
        for _ in range(round(10 * seconds)):
            assert self.autopilot.commands.manual_control(0, steering, throttle, 0, self.boat.time_ns) == ""
            self.sail(0.1)

    def repeat(self, seconds: float, order: Callable[[], str]) -> None:
        """An order at 10 Hz."""
        for _ in range(round(10 * seconds)):
            assert order() == ""
            self.sail(0.1)

    def distance_m(self, north_m: float, east_m: float) -> float:
        return math.hypot(self.boat.north_m - north_m, self.boat.east_m - east_m)

    @property
    def speed_mps(self) -> float:
        return math.hypot(*self.boat.vel_ne_mps)

    @property
    def mode(self) -> str:
        return modes.NAMES[self.autopilot.state.mode]
