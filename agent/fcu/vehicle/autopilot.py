"""The embedded autopilot: estimator (LS), modes and controller (LC) and allocation (LA) behind one interface.

Sensors in, actuators out. Two clocks meet here and are never mixed: measurements carry the sensors' clock, `now_ns` is
the agent's. Times on the agent's clock are only ever compared with each other.

What a mode asks of the controller is in `modes`, what the modes steer by in `navigation`, what operators may ask for in
`commands`, and what is done about failures and the fence in `failsafes`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from agent.fcu.control.allocation import NEUTRAL, ThrustAllocator
from agent.fcu.control.controller import STILL, ControllerGuard, Demand, MakeController, Motors, Order
from agent.fcu.control.heading_speed import HeadingSpeedController, ground_speed_mps
from agent.fcu.control.manual_control import ManualControl
from agent.fcu.estimation.estimator import Estimator
from agent.fcu.fence import Fence, FenceBreach
from agent.fcu.geodetic import LocalProjection
from agent.fcu.mission import MissionSequence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.commands import OperatorCommands
from agent.fcu.vehicle.failsafes import FailsafeHandler
from agent.fcu.vehicle.navigation import GuidedTarget, ModeInput, Navigator
from agent.fcu.vehicle_state import ERROR, INFO, NOTICE, WARNING, Actuators, EventQueue, VehicleState

LOOP_HZ = 50
_LOOP_S = 1.0 / LOOP_HZ
_NO_ORIGIN = LocalProjection(0.0, 0.0, 0.0)

# Pre-arm checks: names as ArduPilot has them, and the bits of ARMING_CHECK that switch them on.
_ALL_CHECKS = 1
_CHECK_BITS = {
    "Baro": 2,
    "Compass": 4,
    "GPS": 8,
    "EKF": 8,
    "IMU": 16,
    "AHRS": 16,
    "RC": 64,
    "Mission": 16384,
}
_POSITION_CHECKS = ("GPS", "EKF")


class Autopilot:
    """The parts of an autopilot and its control loop. Feed `estimator` and call `control` at LOOP_HZ.

    make_controller: builds what replaces HeadingSpeedController. estimates_used: by control (LC), of the estimator's
    (LS). What can be refused returns the reason, empty when done.
    """

    def __init__(self, parameters: Parameters | None = None, make_controller: MakeController | None = None) -> None:
        self.parameters = Parameters() if parameters is None else parameters
        self.fence = Fence(self.parameters)
        self._make_controller: MakeController = HeadingSpeedController if make_controller is None else make_controller
        self._start_over(MissionSequence())

    def reset(self) -> None:
        """Fresh state for a new run: disarmed, not aligned, no events. Parameters, mission and fence are kept."""
        self._start_over(self.navigator.mission)

    def _start_over(self, mission: MissionSequence) -> None:
        p = self.parameters
        self.events = EventQueue()
        self.estimator = Estimator(p)
        initial_mode = int(p["INITIAL_MODE"])
        self.state = VehicleState(
            mode=initial_mode if initial_mode in modes.BY_NUMBER else modes.HOLD, estimate=self.estimator.estimate()
        )
        self.manual = ManualControl(p)
        self.navigator = Navigator(mission, p, self.events)
        self.controller = ControllerGuard(self._make_controller, p, self.events)
        self.allocator = ThrustAllocator(p)
        self.fence.breach = FenceBreach()
        self.failsafes = FailsafeHandler(
            p,
            self.state,
            self.estimator,
            self.navigator,
            self.fence,
            self.manual,
            self.events,
            mode_problem=self.mode_problem,
            switch_mode=self.switch_mode,
            disarm=self.disarm,
        )
        self.commands = OperatorCommands(
            p,
            self.state,
            self.estimator,
            self.navigator,
            self.fence,
            self.manual,
            self.events,
            set_mode=self.set_mode,
            switch_mode=self.switch_mode,
        )
        self.estimates_used = 0
        self._parameters_version = p.version
        self._last_control_ns: int | None = None

    def _configure(self) -> None:
        """Take changed parameters over."""
        self._parameters_version = self.parameters.version
        self.estimator.configure()
        self.manual.configure()
        self.navigator.configure(self.parameters)
        self.controller.configure()
        self.allocator.configure()
        self.failsafes.configure()

    # -- the loop

    def control(self, now_ns: int) -> Actuators:
        """One cycle at LOOP_HZ on the agent's clock."""
        state = self.state
        dt_s = _LOOP_S
        if self._last_control_ns is not None:
            elapsed_s = (now_ns - self._last_control_ns) * 1e-9
            if 0.2 * _LOOP_S < elapsed_s < 10.0 * _LOOP_S:
                dt_s = elapsed_s
        self._last_control_ns = state.now_ns = now_ns
        if self.parameters.version != self._parameters_version:
            self._configure()
        estimate = state.estimate = self.estimator.estimate()
        if self.navigator.home is None and estimate.position_valid:
            self.navigator.set_home_here(self.estimator.frame, estimate)
        self.failsafes.update(now_ns)
        if not state.armed or self.failsafes.imu_lost:
            self._restart_control()
            return Actuators(NEUTRAL, state.armed, self.failsafes.imu_lost)
        return Actuators(self._steer(now_ns, dt_s), True, False)

    def _steer(self, now_ns: int, dt_s: float) -> tuple[float, float]:
        """Motor commands (port, starboard) for what the mode asks for."""
        self.estimates_used += 1
        state, estimate = self.state, self.state.estimate
        mode = modes.BY_NUMBER[state.mode]
        if mode.needs_position and not estimate.position_valid:
            return self.allocator.allocate(STILL, dt_s)
        (north_m, east_m, _), (vn, ve, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        speed_mps = ground_speed_mps(estimate.yaw_rad, vn, ve)
        asked = mode.steer(
            self.navigator,
            ModeInput(
                now_ns,
                dt_s,
                estimate,
                self.estimator.frame or _NO_ORIGIN,
                (north_m, east_m),
                speed_mps,
                self.manual.sticks(now_ns),
            ),
        )
        if asked is None:
            self._end_mission()
            return NEUTRAL
        if isinstance(asked, Demand):
            self.controller.restart()
            return self.allocator.allocate(asked, dt_s)
        return self._run_controller(asked, speed_mps, dt_s)

    def _run_controller(self, order: Order, speed_mps: float, dt_s: float) -> tuple[float, float]:
        last = self.allocator.last
        self.state.speed_error_mps = order.speed_mps - speed_mps
        output = self.controller.control(
            order._replace(
                ground_speed_mps=speed_mps, thrust_limited=last.thrust_limited, steering_limited=last.steering_limited
            ),
            self.state.estimate,
            dt_s,
        )
        if isinstance(output, Motors):
            return self.allocator.pass_through(output)
        return self.allocator.allocate(output, dt_s)

    def _restart_control(self) -> None:
        self.controller.restart()
        self.allocator.restart()
        self.state.speed_error_mps = 0.0

    def _end_mission(self) -> None:
        number = modes.LOITER if self.parameters["MIS_DONE_BEHAVE"] >= 1.0 else modes.HOLD
        self.events.add(NOTICE, f"Mission complete: {modes.NAMES[number]}")
        self.switch_mode(number)

    # -- arming

    def prearm_problems(self) -> tuple[str, ...]:
        """Why arming is refused, each as `Name: what`; empty when ready."""
        checks = int(self.parameters["ARMING_CHECK"])
        if checks == 0:
            return ()
        found = list(self.estimator.problems())
        if self.failsafes.imu_lost or self.estimator.imu_accepted == 0:
            found.insert(0, "IMU: no data")
        if self.state.mode == modes.AUTO and not self.navigator.mission.waypoints():
            found.append("Mission: no waypoint")
        found += self.failsafes.fence_problems()
        found += self.manual.problems(self.state.now_ns)
        if self.controller.problem:
            found.append(f"Controller: {self.controller.problem}")
        return tuple(_enabled_checks(found, checks, modes.BY_NUMBER[self.state.mode].needs_position))

    def arm(self, force: bool = False) -> tuple[str, ...]:
        """Arm, or return why not; by force without the checks. Home moves to the vessel, unless it was set."""
        state = self.state
        if state.armed:
            return ()
        problems = () if force else self.prearm_problems()
        if problems:
            for problem in problems:
                self.events.add(ERROR, f"PreArm: {problem}")
            return problems
        state.armed = True
        self._restart_control()
        if state.mode != modes.GUIDED:  # a target that was given already is kept
            modes.BY_NUMBER[state.mode].enter(self.navigator)
        if state.estimate.position_valid and not self.navigator.home_is_set:
            self.navigator.set_home_here(self.estimator.frame, state.estimate)
        self.failsafes.restart_fence()
        if force:
            self.events.add(WARNING, "Armed by force, checks skipped")
        else:
            self.events.add(INFO, "Armed")
        return ()

    def disarm(self) -> None:
        """Outputs are neutral from now on."""
        if self.state.armed:
            self.state.armed = False
            self.navigator.output = None
            self.events.add(INFO, "Disarmed")

    # -- modes

    def set_mode(self, mode: int) -> str:
        """Change the mode by its ArduRover number."""
        problem = self.mode_problem(mode)
        if problem:
            return self.events.refuse(problem)
        if mode != self.state.mode:
            self.switch_mode(mode)
            self.events.add(INFO, f"Mode {modes.NAMES[mode]}")
        return ""

    def mode_problem(self, mode: int) -> str:
        """Why a mode cannot be had now, or nothing."""
        if mode not in modes.BY_NUMBER:
            known = ", ".join(f"{number} {name}" for number, name in modes.NAMES.items())
            return f"mode {mode} is not supported; use {known}"
        wanted = modes.BY_NUMBER[mode]
        if mode == modes.AUTO and not self.navigator.mission.waypoints():
            return "AUTO needs a mission with a waypoint"
        needs_position = self.state.armed and wanted.needs_position and mode != self.state.mode
        if needs_position and not self.estimator.position_valid():
            return f"{wanted.name} needs a position: {', '.join(self.estimator.problems())}"
        return ""

    def switch_mode(self, mode: int) -> None:
        """Change to a mode that can be had; a mode in force goes on as it is."""
        if mode != self.state.mode:
            self.state.mode = mode
            self.navigator.output = None
            self.navigator.asked_mps = None
            self._restart_control()
            modes.BY_NUMBER[mode].enter(self.navigator)

    @property
    def guided_target(self) -> GuidedTarget | None:
        """The target of GUIDED in force."""
        return self.navigator.guided.target if self.state.mode == modes.GUIDED else None


def _enabled_checks(problems: Iterable[str], checks: int, needs_position: bool) -> Iterator[str]:
    """Problems, each `Name: what`, that ARMING_CHECK looks for. A mode without a position does not need GNSS.

    Problems without a bit, such as those of the fence, count as long as anything is checked.
    """
    for problem in problems:
        name = problem.split(":", 1)[0]
        if name in _POSITION_CHECKS and not needs_position:
            continue
        if checks & _ALL_CHECKS or checks & _CHECK_BITS.get(name, checks):
            yield problem
