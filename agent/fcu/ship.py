"""The ship: what an autopilot is made of, what it knows and what it has to say."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.fcu import modes
from agent.fcu.control.controller import Guard, MakeController
from agent.fcu.control.guidance import GuidanceOutput
from agent.fcu.control.guided import GuidedTarget
from agent.fcu.control.helm import Helm, Propellers
from agent.fcu.control.manual import Manual
from agent.fcu.events import WARNING, Event, Events
from agent.fcu.failsafe import Failsafes
from agent.fcu.fence import Fence, FenceBreach
from agent.fcu.mission import Mission
from agent.fcu.parameters import Parameters
from agent.fcu.pilot import Pilot
from agent.fcu.samples import BarometerSample, Estimate, GnssSample, ImuSample, MagnetometerSample
from agent.fcu.sensing.estimator import Estimator
from agent.fcu.voyage import Voyage

_MOST_REACHED = 64


class Home(NamedTuple):
    """Where the vessel was armed, or first knew where it was, or was told to call home."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class Ship:
    """The parts, fed with samples. `make_controller` builds what replaces the built-in Helm."""

    def __init__(self, parameters: Parameters | None = None, make_controller: MakeController | None = None) -> None:
        self.parameters = Parameters() if parameters is None else parameters
        self.mission = Mission()
        self.fence = Fence(self.parameters)
        self._make_controller: MakeController = Helm if make_controller is None else make_controller
        self.reset()

    def reset(self) -> None:
        """Fresh state for a new run: disarmed, not aligned, no events. Parameters, mission and fence are kept."""
        p = self.parameters
        self.estimator = Estimator(p)
        self.estimate: Estimate = self.estimator.estimate()
        self.armed = False
        self.home: Home | None = None
        self._home_is_set = False
        self.mode = int(p["INITIAL_MODE"]) if int(p["INITIAL_MODE"]) in modes.BY_NUMBER else modes.HOLD
        self.events = Events()
        self.reached: deque[int] = deque(maxlen=_MOST_REACHED)
        self.manual = Manual(p)
        self.voyage = Voyage(self.mission, p, self.events)
        self.controller = Guard(self._make_controller, p, self.events)
        self.propellers = Propellers(p)
        self.fence.breach = FenceBreach()
        self._failsafes = Failsafes(p)
        self.speed_error_mps = 0.0  # desired less measured speed over ground
        self.estimates_used = 0  # by control (LC), of the estimator's (LS)
        self._version = p.version
        self._now_ns = 0
        self._last_control_ns: int | None = None
        self._imu_accepted = 0

    def _configure(self) -> None:
        """Take changed parameters over."""
        self._version = self.parameters.version
        self.estimator.configure()
        self.manual.configure()
        self.voyage.configure(self.parameters)
        self.controller.configure()
        self.propellers.configure()
        self._failsafes.configure()

    # -- sensors

    def on_imu(self, sample: ImuSample) -> bool:
        """Returns False when the sample was refused, as do the other three."""
        accepted = self.estimator.on_imu(sample)
        self._imu_accepted += accepted
        return accepted

    def on_gnss(self, sample: GnssSample) -> bool:
        return self.estimator.on_gnss(sample)

    def on_magnetometer(self, sample: MagnetometerSample) -> bool:
        return self.estimator.on_magnetometer(sample)

    def on_barometer(self, sample: BarometerSample) -> bool:
        return self.estimator.on_barometer(sample)

    # -- reading

    @property
    def efforts(self) -> int:
        """Of control, that were allocated to the propellers (LA)."""
        return self.propellers.efforts

    @property
    def failsafe(self) -> bool:
        """Whether outputs are neutral for want of an IMU."""
        return self._failsafes.imu.active

    @property
    def failsafes(self) -> tuple[str, ...]:
        """Names of the failsafes in force: IMU, EKF, GCS, Fence."""
        return (*self._failsafes.active, *(("Fence",) if self.fence.breach.outside else ()))

    @property
    def pilot(self) -> Pilot:
        """Who sails the mission."""
        return self.voyage.pilot

    @property
    def navigation(self) -> GuidanceOutput | None:
        """What the mode in force steers by, None when it does not navigate."""
        return self.voyage.output

    @property
    def guided_target(self) -> GuidedTarget | None:
        """The target of GUIDED in force."""
        return self.voyage.guided.target if self.mode == modes.GUIDED else None

    @property
    def rc_channels(self) -> tuple[int, ...]:
        """Pulse widths in force of 18 channels, us, 0 where nobody overrides."""
        return self.manual.widths_us(self._now_ns)

    def fence_clearance_m(self) -> float:
        """How far inside of the fence the vessel is, negative outside, infinite without fence or position."""
        frame = self.estimator.frame
        if frame is None or not self.fence.enabled:
            return math.inf
        north_m, east_m, _ = self.estimate.pos_ned_m
        return self.fence.clearance_m(frame, self.voyage.home, *frame.to_geodetic(north_m, east_m))

    # -- what is said

    def take_events(self) -> list[Event]:
        """Events since the last call, oldest first."""
        return self.events.take()

    def take_reached(self) -> list[int]:
        """Sequence numbers of the waypoints reached since the last call."""
        taken = list(self.reached)
        self.reached.clear()
        return taken

    @property
    def events_lost(self) -> int:
        """Events that nobody took in time."""
        return self.events.lost

    def say(self, event: Event) -> None:
        """Queue an event."""
        self.events.say(event.severity, event.text)

    def _refused(self, reason: str) -> str:
        self.events.say(WARNING, reason)
        return reason

    def _restart(self) -> None:
        self.controller.restart()
        self.propellers.restart()
        self.speed_error_mps = 0.0

    def _home_is_here(self) -> None:
        frame = self.estimator.frame
        if frame is not None:
            north_m, east_m, down_m = self.estimate.pos_ned_m
            self._move_home(Home(*frame.to_geodetic(north_m, east_m), frame.alt_m - down_m))

    def _move_home(self, home: Home) -> None:
        self.home = home
        self.voyage.home = (home.lat_deg, home.lon_deg)
        self.voyage.homeward = None
