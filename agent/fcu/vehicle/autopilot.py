"""Embedded autopilot: estimator (LS), modes and controller (LC) and allocation (LA) with one interface.

It reads sensors and commands actuators. It uses two clocks and never mixes them: measurements have stamps of the
sensors' clock, and `now_ns` is the agent's clock. Times of the agent's clock are compared only with each other.

`modes` defines the orders of each mode, and `navigation` the state of the modes. `commands` contains the operators'
commands, and `failsafes` the reaction to failures and the fence.
"""

from __future__ import annotations

from agent.fcu.control.allocation import ThrustAllocator, quantised
from agent.fcu.control.controller import STILL, ControllerGuard, Demand, MakeController, Motors
from agent.fcu.control.heading_speed import HeadingSpeedController, ground_speed_mps
from agent.fcu.control.manual_control import ManualControl
from agent.fcu.fence import Fence, FenceBreach
from agent.fcu.mission import MissionSequence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.commands import OperatorCommands, ServoOutputs
from agent.fcu.vehicle.failsafes import FailsafeHandler
from agent.fcu.vehicle.navigation import GuidedTarget, ModeInput, Navigator
from agent.fcu.vehicle_state import CRITICAL, INFO, NOTICE, WARNING, Actuators, EventQueue, VehicleState
from agent.mavlink.modes import ROVER_MODES
from agent.navigation.estimator import Estimator
from agent.navigation.geodetic import LocalProjection
from agent.navigation.gps_time import GpsTime
from agent.navigation.measurements import ArmingProblem

LOOP_HZ = 50
_LOOP_S = 1.0 / LOOP_HZ
_NO_ORIGIN = LocalProjection(0.0, 0.0, 0.0)

# Pre-arm checks, and the bits of ARMING_CHECK that enable them.
_ALL_CHECKS = 1
_CHECK_BITS = {
    "Baro": 2,
    "Compass": 4,
    "GPS": 8,
    "EKF": 8,
    "INS": 16,
    "AHRS": 16,
    "RC": 64,
    "Mission": 16384,
}
_POSITION_CHECKS = ("GPS", "EKF")
_PREARM_REPEATED_NS = 30_000_000_000
_PREARM_AGAIN_NS = 4_000_000_000  # after a check that passed before fails
_PATH_EVERY = 10  # cycles between two points of the return path


class Autopilot:
    """Parts of an autopilot and its control loop. Feed `estimator` and call `control` at LOOP_HZ.

    make_controller: builds a replacement of HeadingSpeedController.

    Methods that can refuse return the reason, which is empty on success.
    """

    def __init__(self, parameters: Parameters | None = None, make_controller: MakeController | None = None) -> None:
        self.parameters = Parameters() if parameters is None else parameters
        self.fence = Fence(self.parameters)
        self._make_controller: MakeController = HeadingSpeedController if make_controller is None else make_controller
        self._start_over(MissionSequence())

    def reset(self) -> None:
        """Reset the state for a new run: disarmed, not aligned, no events. Parameters, mission and fence remain."""
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
        self.allocator = ThrustAllocator(p)
        mixer = self.allocator.mixer
        self.navigator = Navigator(
            mission, p, self.events, lambda item: self.commands.perform(item), self._utc_s, mixer.pivots
        )
        self.gps_time: GpsTime | None = None
        """Date, None until a receiver provides it."""
        self.controller = ControllerGuard(self._make_controller, p, self.events)
        self.servos = ServoOutputs(mixer.outputs)
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
            self.servos,
            self.events,
            set_mode=self.set_mode,
            switch_mode=self.switch_mode,
            arm=self.arm,
            disarm=self.disarm,
        )
        self.estimates_used = 0
        """Number of estimates (LS) that control (LC) has used."""
        self._cycle = 0
        self._prearm_said_ns: int | None = None
        self._prearm_passed = False
        self._parameters_version = p.version
        self._last_control_ns: int | None = None

    # -- the loop

    def control(self, now_ns: int) -> Actuators:
        """Run one cycle at LOOP_HZ on the agent's clock."""
        state = self.state
        dt_s = _LOOP_S
        if self._last_control_ns is not None:
            elapsed_s = (now_ns - self._last_control_ns) * 1e-9
            if 0.2 * _LOOP_S < elapsed_s < 10.0 * _LOOP_S:
                dt_s = elapsed_s
        self._last_control_ns = state.now_ns = now_ns
        if self.parameters.version != self._parameters_version:
            self._parameters_version = self.parameters.version
            self.estimator.configure()
            self.manual.configure()
            self.allocator.configure()
            self.servos.driven = self.allocator.mixer.outputs
            self.navigator.configure(self.parameters, self.allocator.mixer.pivots)
            self.controller.configure()
            self.failsafes.configure()
        estimate = state.estimate = self.estimator.estimate()
        if self.navigator.home is None and estimate.position_valid:
            self.navigator.set_home_here(self.estimator.frame, estimate)
        self.failsafes.update(now_ns)
        self.servos.update(now_ns)
        self._cycle = (self._cycle + 1) % LOOP_HZ
        if self._cycle % _PATH_EVERY == 0:
            self._save_place()
        if self._cycle == 0 and not state.armed:
            self._repeat_prearm_problems(now_ns)
        if not state.armed or self.failsafes.imu_lost:
            self._restart_control()
            return Actuators(self.allocator.neutral, state.armed, self.failsafes.imu_lost)
        return Actuators(tuple(map(quantised, self._steer(now_ns, dt_s))), True, False)

    def _steer(self, now_ns: int, dt_s: float) -> tuple[float, ...]:
        """Return the commands for the order of the mode."""
        self.estimates_used += 1
        state, estimate = self.state, self.state.estimate
        mode = modes.BY_NUMBER[state.mode]
        if mode.needs_position and not estimate.position_valid:
            return self.allocator.allocate(STILL, dt_s)
        (north_m, east_m, _), (vn, ve, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        speed_mps = ground_speed_mps(estimate.yaw_rad, vn, ve)
        # The mode: an order for the controller, a demand that bypasses it, or None at the end of the mission.
        frame, sticks = self.estimator.frame or _NO_ORIGIN, self.manual.sticks(now_ns)
        asked = mode.steer(
            self.navigator, ModeInput(now_ns, dt_s, estimate, frame, (north_m, east_m), speed_mps, sticks)
        )
        if asked is None:
            number = modes.LOITER if self.parameters["MIS_DONE_BEHAVE"] >= 1.0 else modes.HOLD
            self.events.add(NOTICE, f"Mission complete: {modes.NAMES[number]}")
            self.switch_mode(number)
            return self.allocator.neutral
        if isinstance(asked, Demand):
            self.controller.restart()
            return self.allocator.allocate(asked, dt_s, speed_mps, by_hand=True)
        # The controller (LC), and the allocation (LA).
        state.speed_error_mps = asked.speed_mps - speed_mps
        last = self.allocator.last
        order = asked._replace(
            ground_speed_mps=speed_mps, thrust_limited=last.thrust_limited, steering_limited=last.steering_limited
        )
        output = self.controller.control(order, estimate, dt_s, len(self.allocator.neutral))
        if isinstance(output, Motors):
            return self.allocator.pass_through(output)
        return self.allocator.allocate(output, dt_s, speed_mps)

    def _save_place(self) -> None:
        state = self.state
        place = state.estimate.pos_ned_m[:2] if state.estimate.position_valid else None
        saves = state.mode != modes.SMART_RTL
        self.navigator.return_path.update(self.estimator.frame, place, state.now_ns, saves)

    def _restart_control(self) -> None:
        self.controller.restart()
        self.allocator.restart()
        self.state.speed_error_mps = 0.0

    # -- arming

    def prearm_problems(self) -> tuple[str, ...]:
        """Return the reasons why arming is refused, in ArduPilot's words. Empty when ready.

        ARMING_CHECK enables the checks. A mode without a position does not need GNSS. Problems without a bit, such as
        those of the fence, count if any check is enabled.
        """
        checks = int(self.parameters["ARMING_CHECK"])
        if checks == 0:
            return ()
        problems = list(self.estimator.problems())
        if self.failsafes.imu_lost or self.estimator.imu_accepted == 0:
            problems.insert(0, ArmingProblem("INS", "Gyros not healthy"))
        if self.state.mode == modes.AUTO and not self.navigator.mission.items:
            problems.append(ArmingProblem("Mission", "Mode requires mission"))
        problems += self.failsafes.fence_problems()
        problems += self.manual.problems(self.state.now_ns)
        if self.controller.problem:
            problems.append(ArmingProblem("Controller", f"Controller: {self.controller.problem}"))
        needs_position = modes.BY_NUMBER[self.state.mode].needs_position
        return tuple(
            problem.text
            for problem in problems
            if (needs_position or problem.check not in _POSITION_CHECKS)
            and (checks & _ALL_CHECKS or checks & _CHECK_BITS.get(problem.check, checks))
        )

    def say_prearm_problems(self) -> None:
        """Add each pre-arm problem as an event."""
        for problem in self.prearm_problems():
            self.events.add(CRITICAL, f"PreArm: {problem}")
        self._prearm_said_ns = self.state.now_ns

    def _repeat_prearm_problems(self, now_ns: int) -> None:
        """Repeat the pre-arm problems every 30 s, and soon after a check begins to fail, as ArduPilot does."""
        if self._prearm_said_ns is None or now_ns < self._prearm_said_ns:
            self._prearm_said_ns = now_ns
        passed = not self.prearm_problems()
        wait_ns = _PREARM_AGAIN_NS if self._prearm_passed else _PREARM_REPEATED_NS
        if passed:
            self._prearm_passed = True
        elif now_ns - self._prearm_said_ns > wait_ns:
            self.say_prearm_problems()
            self._prearm_passed = False

    def arm(self, force: bool = False) -> tuple[str, ...]:
        """Arm, or return the reasons of a refusal.

        force: skip the checks.

        Home moves to the vessel, unless it was set.
        """
        state = self.state
        if state.armed:
            return ()
        problems = () if force else self.prearm_problems()
        if problems:
            for problem in problems:
                self.events.add(CRITICAL, f"Arm: {problem}")
            return problems
        state.armed = True
        self._restart_control()
        if state.mode != modes.GUIDED:  # an existing target is kept
            modes.BY_NUMBER[state.mode].enter(self.navigator)
        if state.estimate.position_valid and not self.navigator.home_is_set:
            self.navigator.set_home_here(self.estimator.frame, state.estimate)
        self.navigator.return_path.restart()
        self._save_place()
        self.navigator.simple_heading_rad = state.estimate.yaw_rad
        self.failsafes.restart_fence()
        if force:
            self.events.add(WARNING, "Armed by force, checks skipped")
        else:
            self.events.add(INFO, "Armed")
        return ()

    def disarm(self) -> None:
        """Disarm. Outputs are neutral from now on."""
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
        """Return the reason why a mode is unavailable now, or an empty text."""
        if mode not in modes.BY_NUMBER:
            known = ", ".join(f"{number} {name}" for number, name in modes.NAMES.items())
            return f"mode {ROVER_MODES.get(mode, mode)} is not supported; use {known}"
        wanted = modes.BY_NUMBER[mode]
        if mode == modes.AUTO and not self.navigator.mission.items:
            return "No Mission. Can't set AUTO."
        if mode == modes.SMART_RTL and self.navigator.return_path.problem:
            return f"SMART_RTL needs a path home: {self.navigator.return_path.problem}"
        needs_position = self.state.armed and wanted.needs_position and mode != self.state.mode
        if needs_position and not self.estimator.position_valid():
            why = ", ".join(problem.text for problem in self.estimator.problems())
            return f"{wanted.name} needs a position: {why}"
        return ""

    def switch_mode(self, mode: int) -> None:
        """Change to an available mode. The present mode continues unchanged."""
        if mode != self.state.mode:
            self.state.mode = mode
            self.navigator.output = None
            self.navigator.asked_mps = None
            self.navigator.astern = self.navigator.astern and not modes.BY_NUMBER[mode].steers_itself
            self._restart_control()
            modes.BY_NUMBER[mode].enter(self.navigator)

    @property
    def in_guided(self) -> bool:
        """Whether targets are followed: in GUIDED, and when a mission hands control to them."""
        by_mission = self.state.mode == modes.AUTO and self.navigator.progress.hands_over
        return by_mission or self.state.mode == modes.GUIDED

    @property
    def guided_target(self) -> GuidedTarget | None:
        """Present target of GUIDED, None outside GUIDED."""
        return self.navigator.guided.target if self.in_guided else None

    @property
    def utc_us(self) -> int | None:
        """UTC in microseconds since 1970, None while no receiver has provided the date."""
        return None if self.gps_time is None else self.gps_time.unix_us(self.state.estimate.stamp_ns)

    def _utc_s(self) -> float | None:
        utc_us = self.utc_us
        return None if utc_us is None else utc_us * 1e-6
