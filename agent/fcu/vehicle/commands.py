"""Operator commands in addition to arming and modes: mission, targets of GUIDED, sticks, servos, home, fence.

ACTIONS has a row for each mission item that is an action and not a stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Callable

from agent.fcu.control.allocation import NEUTRAL_US
from agent.fcu.control.manual_control import ManualControl
from agent.fcu.fence import Fence, FenceError, FenceItem
from agent.fcu.mission import (
    AUX_FUNCTION,
    FENCE_ENABLE,
    REPEAT_SERVO,
    SET_HOME,
    SET_REVERSE,
    SET_SERVO,
    MissionItem,
    MissionSequence,
)
from agent.fcu.parameters import OUTPUTS, Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.mission_progress import COMPLETE, LEAST_SPEED_MPS, passed_over
from agent.fcu.vehicle.navigation import (
    POSITION,
    GuidedTarget,
    Navigator,
    course_target,
    turn_target,
    velocity_target,
)
from agent.fcu.vehicle_state import INFO, NOTICE, EventQueue, VehicleState
from agent.navigation.estimator import Estimator
from agent.navigation.geodetic import Home, position_problem

_LOW, _MIDDLE, _HIGH = range(3)  # positions of an auxiliary switch
_FENCE, _MISSION_RESET, _CLEAR_MISSION, _DISARM, _ARM_DISARM = 11, 24, 58, 81, 153  # RCx_OPTION
_MODE_SWITCHES = {
    4: modes.RTL,
    16: modes.AUTO,
    42: modes.SMART_RTL,
    51: modes.MANUAL,
    52: modes.ACRO,
    53: modes.STEERING,
    54: modes.HOLD,
    55: modes.GUIDED,
    56: modes.LOITER,
    59: modes.SIMPLE,
    72: modes.CIRCLE,
}

_SERVO_WIDTHS_US = (500, 2500)


class ServoOutputs:
    """Other servo outputs than the motors: set by DO_SET_SERVO, or moved repeatedly by DO_REPEAT_SERVO.

    widths_us: pulse widths of outputs 1 to 16, 0 for unset ones. One output at a time moves repeatedly.
    driven: outputs that drive the vessel, which cannot be set.
    """

    def __init__(self, driven: Sequence[int] = ()) -> None:
        self.driven = driven
        self.widths_us = [0] * OUTPUTS
        self._moving = 0  # output, 0 for none
        self._width_us = 0
        self._moves_left = 0
        self._half_ns = 0
        self._moved_ns: int | None = None

    def set(self, output: int, width_us: int) -> str:
        """Set an output. Return the reason of a refusal, or an empty text."""
        problem = self._problem(output, width_us)
        if not problem:
            if output == self._moving:
                self._moves_left = 0
            self.widths_us[output - 1] = width_us
        return problem

    def repeat(self, output: int, width_us: int, times: int, period_s: float) -> str:
        """Move an output to `width_us` and back to 1500 us, `times` times.

        Return the reason of a refusal, or an empty text.
        """
        problem = self._problem(output, width_us)
        if not problem:
            self._moving, self._width_us, self._moves_left = output, width_us, 2 * max(times, 0)
            self._half_ns = round(0.5e9 * min(period_s, 3600.0)) if period_s > 0.0 else 0
            self._moved_ns = None
        return problem

    def update(self, now_ns: int) -> None:
        """Update the outputs each cycle."""
        if self._moves_left == 0:
            return
        if self._moved_ns is not None and 0 <= now_ns - self._moved_ns < self._half_ns:
            return
        self.widths_us[self._moving - 1] = NEUTRAL_US if self._moves_left % 2 else self._width_us
        self._moves_left -= 1
        self._moved_ns = now_ns

    def _problem(self, output: int, width_us: int) -> str:
        if not 1 <= output <= OUTPUTS:
            return f"Servo {output} does not exist; use 1 to {OUTPUTS}"
        if output in self.driven:
            return f"ServoRelayEvent: Channel {output} is already in use"
        low, high = _SERVO_WIDTHS_US
        fits = low <= width_us <= high or width_us == 0
        return "" if fits else f"Servo at {width_us} us; use {low} to {high}, 0 for none"


class OperatorCommands:
    """Commands of operators. Each returns the reason of a refusal, which is an event too, or an empty text."""

    def __init__(
        self,
        parameters: Parameters,
        state: VehicleState,
        estimator: Estimator,
        navigator: Navigator,
        fence: Fence,
        manual: ManualControl,
        servos: ServoOutputs,
        events: EventQueue,
        set_mode: Callable[[int], str],
        switch_mode: Callable[[int], None],
        arm: Callable[[], tuple[str, ...]],
        disarm: Callable[[], None],
    ) -> None:
        self._parameters = parameters
        self._state = state
        self._estimator = estimator
        self._navigator = navigator
        self._fence = fence
        self._manual = manual
        self._servos = servos
        self._events = events
        self._set_mode = set_mode
        self._switch_mode = switch_mode
        self._arm = arm
        self._disarm = disarm

    # -- mission

    def set_mission(self, mission: MissionSequence) -> None:
        """Replace the mission. In AUTO the new one starts from its first waypoint, and an empty one ends in HOLD."""
        self._navigator.load_mission(mission)
        if self._state.mode == modes.AUTO and not mission.items:
            self._events.add(NOTICE, "Mission cleared: HOLD")
            self._switch_mode(modes.HOLD)

    def start_mission(self) -> str:
        """Switch to AUTO from the first waypoint. The vessel moves once it is armed.

        A mission under way continues: ground stations repeat a command whose answer was lost.
        """
        progress = self._navigator.progress
        under_way = self._state.armed and self._state.mode == modes.AUTO and progress.state != COMPLETE
        refused = self._set_mode(modes.AUTO)
        if not refused and not under_way:
            progress.restart()
        return refused

    def set_current(self, seq: int) -> str:
        """Continue from mission item `seq`, 0 for the first."""
        mission = self._navigator.mission
        if not 0 <= seq < len(mission.items):
            return self._events.refuse(f"mission item {seq} does not exist; the mission has {len(mission.items)} items")
        if mission.next_waypoint(seq) is None:
            return self._events.refuse(f"mission item {seq}: no waypoint comes after it")
        self._navigator.progress.resume_from(max(seq, 1))
        return ""

    def jump_to_tag(self, tag: int) -> str:
        """Continue from the item with this tag."""
        seq = self._navigator.mission.tagged(tag)
        return self.set_current(seq) if seq else self._events.refuse(f"tag {tag} is not in the mission")

    def change_speed(self, speed_mps: float) -> str:
        """Set the speed over ground while the mode lasts, or of the mission in AUTO."""
        mode = modes.BY_NUMBER[self._state.mode]
        if not mode.has_speed:
            return self._events.refuse(f"{mode.name} has no speed to change")
        if not LEAST_SPEED_MPS <= speed_mps <= 100.0:
            return self._events.refuse(f"speed {speed_mps:g} m/s; use {LEAST_SPEED_MPS:g} to 100")
        if mode.number == modes.AUTO:
            self._navigator.progress.speed_mps = speed_mps
        else:
            self._navigator.asked_mps = speed_mps
        return ""

    def set_reverse(self, astern: bool) -> str:
        """Follow legs and circles stern first, or bow first again, until another autonomous mode is chosen."""
        self._navigator.astern = astern
        return ""

    def perform(self, item: MissionItem) -> str:
        """Execute a mission item that is not a stage. Return a text if it is skipped."""
        action = ACTIONS.get(item.command)
        if action is None:
            return passed_over(item)
        action(self, item)  # a refusal becomes an event
        return ""

    # -- servos and switches

    def set_servo(self, output: int, width_us: int) -> str:
        """DO_SET_SERVO."""
        problem = self._servos.set(output, width_us)
        return self._say(INFO, problem) if problem else ""

    def repeat_servo(self, output: int, width_us: int, times: int, period_s: float) -> str:
        """DO_REPEAT_SERVO."""
        problem = self._servos.repeat(output, width_us, times, period_s)
        return self._say(INFO, problem) if problem else ""

    def aux_function(self, function: int, position: int) -> str:
        """DO_AUX_FUNCTION: acts as a transmitter switch with that RCx_OPTION, 0 low, 1 middle, 2 high."""
        if position not in (_LOW, _MIDDLE, _HIGH):
            return self._events.refuse(f"switch position {position}; use 0 to 2")
        mode = _MODE_SWITCHES.get(function)
        if mode is not None:
            return self._set_mode(mode) if position == _HIGH else ""
        if function == _FENCE:
            return self.enable_fence(position == _HIGH)
        if function == _MISSION_RESET and position == _HIGH:
            self._navigator.progress.restart()
        elif function == _CLEAR_MISSION and position == _HIGH:
            self.set_mission(MissionSequence())
        elif function in (_DISARM, _ARM_DISARM) and position != _MIDDLE:
            if function == _ARM_DISARM and position == _HIGH:
                return "; ".join(self._arm())
            if function == _ARM_DISARM or position == _HIGH:
                self._disarm()
        elif function not in (_MISSION_RESET, _CLEAR_MISSION, _DISARM, _ARM_DISARM):
            return self._events.refuse(f"Invalid channel option ({function})")
        return ""

    def _say(self, severity: int, text: str) -> str:
        self._events.add(severity, text)
        return text

    # -- targets of GUIDED

    def go_to(self, lat_deg: float, lon_deg: float) -> str:
        """Go to a position and stay there."""
        problem = position_problem(lat_deg, lon_deg)
        frame = self._estimator.frame
        if not problem and frame is not None and self._fence.enabled:
            clearance_m = self._fence.clearance_m(frame, self._navigator.home, lat_deg, lon_deg)
            if clearance_m < self._parameters["FENCE_MARGIN"]:
                problem = f"position {lat_deg:g}, {lon_deg:g} is not inside the fence by FENCE_MARGIN"
        return self._guide(problem or GuidedTarget(POSITION, lat_deg, lon_deg))

    def go_to_local(self, north_m: float, east_m: float) -> str:
        """Go to a local position, in metres from the estimator's origin, as `go_to` does."""
        frame = self._estimator.frame
        if frame is None:
            return self._events.refuse("a local target needs a position")
        if not max(abs(north_m), abs(east_m)) < 1e6:
            return self._events.refuse(f"position {north_m:g}, {east_m:g} m; use less than 1000 km")
        return self.go_to(*frame.to_geodetic(north_m, east_m))

    def set_velocity(
        self, north_mps: float, east_mps: float, yaw_rad: float | None = None, yaw_rate_radps: float | None = None
    ) -> str:
        """Set a velocity over ground, with a heading or a turn rate, for GUID_TIMEOUT."""
        return self._guide(velocity_target(north_mps, east_mps, yaw_rad, yaw_rate_radps))

    def set_course(self, heading_rad: float, speed_mps: float) -> str:
        """Set heading and speed over ground, negative astern, for GUID_TIMEOUT."""
        return self._guide(course_target(heading_rad, speed_mps))

    def set_heading_and_thrust(self, heading_rad: float, thrust: float) -> str:
        """Set a heading, and a part of WP_SPEED in [-1, 1], for GUID_TIMEOUT: SET_ATTITUDE_TARGET."""
        return self.set_course(heading_rad, thrust * self._navigator.cruise_mps)

    def set_turn_rate_and_thrust(self, turn_rate_radps: float, thrust: float) -> str:
        """Set a turn rate, and a part of WP_SPEED in [-1, 1], for GUID_TIMEOUT."""
        return self.set_turn_rate(turn_rate_radps, thrust * self._navigator.cruise_mps)

    def set_turn_rate(self, turn_rate_radps: float, speed_mps: float) -> str:
        """Set turn rate and speed over ground, negative astern, for GUID_TIMEOUT."""
        return self._guide(turn_target(turn_rate_radps, speed_mps))

    def _guide(self, target: GuidedTarget | str) -> str:
        if isinstance(target, str):
            return self._events.refuse(target)
        by_mission = self._state.mode == modes.AUTO and self._navigator.progress.hands_over
        if not by_mission and self._state.mode != modes.GUIDED:
            return self._events.refuse(f"targets are for GUIDED; the mode is {modes.NAMES[self._state.mode]}")
        self._navigator.guided.set_target(target, self._state.now_ns)
        return ""

    # -- sticks, home, fence

    def rc_override(self, channels_us: tuple[int, ...], now_ns: int) -> str:
        """RC_CHANNELS_OVERRIDE."""
        problem = self._manual.override(channels_us, now_ns)
        return self._events.refuse(problem) if problem else ""

    def manual_control(self, x: int | None, y: int | None, z: int | None, r: int | None, now_ns: int) -> str:
        """MANUAL_CONTROL: y steers, z is the throttle. A boat ignores x and r, as in ArduRover."""
        problem = self._manual.set_axes(y, z, now_ns)
        return self._events.refuse(problem) if problem else ""

    def set_home(self, lat_deg: float, lon_deg: float, alt_m: float) -> str:
        """Set home. Arming no longer moves it."""
        problem = position_problem(lat_deg, lon_deg)
        if not problem and not abs(alt_m) < 1e5:
            problem = f"altitude {alt_m:g} m is not valid; use 0"
        if not problem and self._estimator.frame is None:
            problem = "home cannot be set before there is a position"
        if problem:
            return self._events.refuse(problem)
        self._navigator.home_is_set = True
        self._navigator.set_home(Home(lat_deg, lon_deg, alt_m))
        return ""

    def set_home_here(self) -> str:
        """Set home to the present position."""
        if not self._state.estimate.position_valid:
            return self._events.refuse("home cannot be set here: no position")
        self._navigator.home_is_set = True
        self._navigator.set_home_here(self._estimator.frame, self._state.estimate)
        return ""

    def set_origin(self, lat_deg: float, lon_deg: float, alt_m: float) -> str:
        """Set the origin of local positions, if no fix has defined it yet."""
        problem = position_problem(lat_deg, lon_deg)
        if not problem and not abs(alt_m) < 1e5:
            problem = f"altitude {alt_m:g} m is not valid; use 0"
        if not problem and not self._estimator.set_origin(lat_deg, lon_deg, alt_m):
            problem = "the origin is set already"
        return self._events.refuse(f"Origin refused: {problem}") if problem else ""

    def set_fence(self, items: Sequence[FenceItem]) -> str:
        """Replace the fence. A refused item refuses all of it."""
        try:
            self._fence.replace(items)
        except FenceError as error:
            return self._events.refuse(str(error))
        return ""

    def enable_fence(self, on: bool) -> str:
        """Set FENCE_ENABLE."""
        self._parameters.set("FENCE_ENABLE", float(on))
        self._events.add(NOTICE, f"{self._fence.names} {'enabled' if on else 'disabled'}")
        return ""


def _set_home(commands: OperatorCommands, item: MissionItem) -> str:
    if item.parameters[0] == 1.0 or item.place is None:
        return commands.set_home_here()
    return commands.set_home(item.lat_deg, item.lon_deg, item.alt_m)


def _enable_fence(commands: OperatorCommands, item: MissionItem) -> str:
    """Enable or disable the fence. A value of 2 disables the floor, which a boat ignores."""
    wanted = item.parameters[0]
    return commands.enable_fence(wanted == 1.0) if wanted != 2.0 else ""


def _repeat_servo(commands: OperatorCommands, item: MissionItem) -> str:
    output, width_us, times, period_s = item.parameters
    return commands.repeat_servo(int(output), int(width_us), int(times), period_s)


ACTIONS: Mapping[int, Callable[[OperatorCommands, MissionItem], str]] = {
    SET_HOME: _set_home,
    SET_REVERSE: lambda commands, item: commands.set_reverse(item.parameters[0] == 1.0),
    FENCE_ENABLE: _enable_fence,
    AUX_FUNCTION: lambda commands, item: commands.aux_function(*map(int, item.parameters[:2])),
    SET_SERVO: lambda commands, item: commands.set_servo(*map(int, item.parameters[:2])),
    REPEAT_SERVO: _repeat_servo,
}
