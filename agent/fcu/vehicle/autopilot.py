"""The embedded autopilot: estimator (LS), modes and controller (LC) and allocation (LA) behind one interface.

Sensors in, actuators out. Two clocks meet here and are never mixed: samples carry the sensors' clock, `now_ns` is the
agent's. Times on the agent's clock are only ever compared with each other.

What a mode asks for is in `modes`, what is done about failures and the fence in `watchkeeper`, and who turns a heading
and a speed into demands in `controller` and `helm`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from agent.fcu.control.allocation import NEUTRAL
from agent.fcu.control.controller import STILL, Demand, Motors, Order
from agent.fcu.control.heading_speed import ground_speed_mps
from agent.fcu.geodetic import Home, LocalProjection
from agent.fcu.mission import MissionSequence
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.commands import VehicleCommands
from agent.fcu.vehicle.failsafes import FailsafeHandler, fence_problems
from agent.fcu.vehicle.navigation import ModeInput
from agent.fcu.vehicle_state import (
    CRITICAL,
    ERROR,
    INFO,
    NOTICE,
    WARNING,
    Actuators,
    Event,
    StateEstimate,
)

__all__ = ["CRITICAL", "ERROR", "INFO", "LOOP_HZ", "NOTICE", "WARNING", "Autopilot", "Event", "Home"]

LOOP_HZ = 50
_LOOP_S = 1.0 / LOOP_HZ
_NOWHERE = LocalProjection(0.0, 0.0, 0.0)
_MOST_REACHED = 64
_ALL = 1
_BITS = {
    "Baro": 2,
    "Compass": 4,
    "GPS": 8,
    "EKF": 8,
    "IMU": 16,
    "AHRS": 16,
    "RC": 64,
    "Mission": 16384,
}
_OF_POSITION = ("GPS", "EKF")


class Autopilot(VehicleCommands):
    """Feed it samples, call `control` at LOOP_HZ. Commands return the reason when refused, empty when done."""

    def reset(self) -> None:
        """Fresh state for a new run: disarmed, not aligned, no events. Parameters, mission and fence are kept."""
        super().reset()
        self._watchkeeper = FailsafeHandler(self, self.parameters, self.fence, self._failsafes)

    # -- the loop

    def control(self, now_ns: int) -> Actuators:
        """One cycle at LOOP_HZ on the agent's clock."""
        dt_s = _LOOP_S
        if self._last_control_ns is not None:
            elapsed_s = (now_ns - self._last_control_ns) * 1e-9
            if 0.2 * _LOOP_S < elapsed_s < 10.0 * _LOOP_S:
                dt_s = elapsed_s
        self._last_control_ns = self._now_ns = now_ns
        if self.parameters.version != self._version:
            self._configure()
        estimate = self.estimate = self.estimator.estimate()
        if self.home is None and estimate.position_valid:
            self._home_is_here()
        self._watchkeeper.look(self._imu_accepted, now_ns)
        if not self.armed or self.failsafe:
            self._restart()
            return Actuators(NEUTRAL, self.armed, self.failsafe)
        return Actuators(self._outputs(estimate, now_ns, dt_s), True, False)

    def _outputs(self, estimate: StateEstimate, now_ns: int, dt_s: float) -> tuple[float, float]:
        self.estimates_used += 1
        mode = modes.BY_NUMBER[self.mode]
        if mode.needs_position and not estimate.position_valid:
            return self.propellers.drive(STILL, dt_s)
        (north_m, east_m, _), (vn, ve, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        speed_mps = ground_speed_mps(estimate.yaw_rad, vn, ve)
        now = ModeInput(
            now_ns,
            dt_s,
            estimate,
            self.estimator.frame or _NOWHERE,
            (north_m, east_m),
            speed_mps,
            self.manual.sticks(now_ns),
        )
        wish = mode.steer(self.voyage, now)
        if mode.number == modes.AUTO:
            self._note_reached()
        if wish is None:
            self._end_mission()
            return NEUTRAL
        if isinstance(wish, Demand):
            self.controller.restart()
            return self.propellers.drive(wish, dt_s)
        return self._obey(wish, estimate, speed_mps, dt_s)

    def _obey(self, order: Order, estimate: StateEstimate, speed_mps: float, dt_s: float) -> tuple[float, float]:
        """What the controller makes of an order."""
        last = self.propellers.last
        self.speed_error_mps = order.speed_mps - speed_mps
        answer = self.controller.control(
            order._replace(
                ground_speed_mps=speed_mps, thrust_limited=last.thrust_limited, steering_limited=last.steering_limited
            ),
            estimate,
            dt_s,
        )
        if isinstance(answer, Motors):
            return self.propellers.take(answer)
        return self.propellers.drive(answer, dt_s)

    def _note_reached(self) -> None:
        for seq in self.pilot.take_reached():
            self.reached.append(seq)
            self.events.say(INFO, f"Reached waypoint {seq}")

    def _end_mission(self) -> None:
        number = modes.LOITER if self.parameters["MIS_DONE_BEHAVE"] >= 1.0 else modes.HOLD
        self.events.say(NOTICE, f"Mission complete: {modes.NAMES[number]}")
        self.switch(number)

    # -- arming

    def prearm_problems(self) -> tuple[str, ...]:
        """Why arming is refused, each by name; empty when ready."""
        checks = int(self.parameters["ARMING_CHECK"])
        if checks == 0:
            return ()
        found = list(self.estimator.problems())
        if self.failsafe or self._imu_accepted == 0:
            found.insert(0, "IMU: no data")
        if self.mode == modes.AUTO and not self.mission.waypoints():
            found.append("Mission: no waypoint")
        found += fence_problems(self.fence, self.fence_clearance_m(), self.estimate.position_valid)
        found += self.manual.problems(self._now_ns)
        if self.controller.problem:
            found.append(f"Controller: {self.controller.problem}")
        return tuple(in_force(found, checks, modes.BY_NUMBER[self.mode].needs_position))

    def arm(self, force: bool = False) -> tuple[str, ...]:
        """Arm, or say why not; by force without the checks. Home moves to where the vessel is, unless it was set."""
        if self.armed:
            return ()
        problems = () if force else self.prearm_problems()
        if problems:
            for problem in problems:
                self.events.say(ERROR, f"PreArm: {problem}")
            return problems
        self.armed = True
        self._restart()
        if self.mode != modes.GUIDED:  # a target that was given already is kept
            modes.BY_NUMBER[self.mode].enter(self.voyage)
        if self.estimate.position_valid and not self._home_is_set:
            self._home_is_here()
        self._watchkeeper.armed()
        if force:
            self.events.say(WARNING, "Armed by force, checks skipped")
        else:
            self.events.say(INFO, "Armed")
        return ()

    def disarm(self) -> None:
        """Outputs are neutral from now on."""
        if self.armed:
            self.armed = False
            self.voyage.output = None
            self.events.say(INFO, "Disarmed")

    # -- modes and mission

    def set_mode(self, mode: int) -> str:
        """Change the mode by its ArduRover number."""
        problem = self.mode_problem(mode)
        if problem:
            return self._refused(problem)
        if mode != self.mode:
            self.switch(mode)
            self.events.say(INFO, f"Mode {modes.NAMES[mode]}")
        return ""

    def mode_problem(self, mode: int) -> str:
        """Why a mode cannot be had now, or nothing."""
        if mode not in modes.BY_NUMBER:
            known = ", ".join(f"{number} {name}" for number, name in modes.NAMES.items())
            return f"mode {mode} is not supported; use {known}"
        wanted = modes.BY_NUMBER[mode]
        if mode == modes.AUTO and not self.mission.waypoints():
            return "AUTO needs a mission with a waypoint"
        if self.armed and wanted.needs_position and mode != self.mode and not self.estimator.position_valid():
            return f"{wanted.name} needs a position: {', '.join(self.estimator.problems())}"
        return ""

    def switch(self, mode: int) -> None:
        """Change to a mode that can be had; a mode in force goes on as it is."""
        if mode != self.mode:
            self.mode = mode
            self.voyage.output = None
            self.voyage.asked_mps = None
            self._restart()
            modes.BY_NUMBER[mode].enter(self.voyage)

    def set_mission(self, mission: MissionSequence) -> None:
        """Replace the mission; in AUTO the new one starts from its first waypoint, an empty one ends in HOLD."""
        self.mission = mission
        self.voyage.load(mission)
        if self.mode == modes.AUTO and not mission.waypoints():
            self.events.say(NOTICE, "Mission cleared: HOLD")
            self.switch(modes.HOLD)

    def start_mission(self) -> str:
        """AUTO from the first waypoint; sails once armed."""
        refused = self.set_mode(modes.AUTO)
        if not refused:
            self.pilot.restart()
        return refused

    def set_current(self, seq: int) -> str:
        """Go on from mission item `seq`, 0 for the first."""
        if not 0 <= seq < len(self.mission.items):
            return self._refused(f"mission item {seq} is not there; the mission has {len(self.mission.items)} items")
        if self.mission.next_waypoint(seq) is None:
            return self._refused(f"mission item {seq}: no waypoint comes after it")
        self.pilot.go_on_from(max(seq, 1))
        return ""

    def change_speed(self, speed_mps: float) -> str:
        """Speed over ground from now on: of the mission, or of RTL and GUIDED while they last."""
        if not 0.0 < speed_mps <= 100.0:
            return self._refused(f"speed {speed_mps:g} m/s; use more than 0, at most 100")
        if self.mode in (modes.RTL, modes.GUIDED):
            self.voyage.asked_mps = speed_mps
        else:
            self.pilot.speed_mps = speed_mps
        return ""


def in_force(problems: Iterable[str], checks: int, needs_position: bool) -> Iterator[str]:
    """Problems, each `Name: what`, that ARMING_CHECK looks for. A mode without a position does not need GNSS.

    Problems without a bit, such as those of the fence, count as long as anything is checked.
    """
    for problem in problems:
        name = problem.split(":", 1)[0]
        if name in _OF_POSITION and not needs_position:
            continue
        if checks & _ALL or checks & _BITS.get(name, checks):
            yield problem
