"""Direct control without an autopilot: ideal control laws, a script, a recording or an operator command the vessel."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar

from agent.fcu.control.allocation import ThrustAllocator
from agent.fcu.control.controller import (
    ControllerError,
    ControllerGuard,
    ControllerOutput,
    MakeController,
    Motors,
    Order,
    load_controller,
)
from agent.fcu.control.guidance import GuidanceGains, GuidanceInput
from agent.fcu.control.heading_speed import HeadingSpeedController, ground_speed_mps
from agent.fcu.mission import MissionItem, make_mission
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.mission_progress import COMPLETE, MissionProgress
from agent.fcu.vehicle_state import EventQueue
from agent.navigation.geodetic import LocalProjection
from agent.navigation.measurements import StateEstimate
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.node import ControlNode, RunStep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.setup import embedded_parameters, mission_items
from xitl_cli.run.nodes.drivers import nobody
from xitl_cli.run.operator.actions import ActionError, CommandMotor, EndRun, SteerVelocity
from xitl_cli.run.operator.steering import SILENT_S, Say, Steering
from xitl_cli.run.world.world import local_frame

if TYPE_CHECKING:
    from xitl_cli.replay.motor_schedule import MotorSchedule


class IdealControl(ControlNode):
    """Guidance, control and allocation of the embedded autopilot, with the truth as the estimate.

    others: returns a text with the vessels to wait for; empty when this vessel may set out.
    """

    def __init__(self, profile: RunProfile, others: Callable[[], str] = nobody) -> None:
        parameters = Parameters(embedded_parameters(profile))
        self._allocator = ThrustAllocator(parameters)
        self.command = MotorCommand(self._allocator.neutral, armed=True)
        site = profile.site
        items = [
            MissionItem(item.command, item.lat_deg, item.lon_deg, item.alt_m, item.parameters, item.frame)
            for item in mission_items(profile, local_frame(site))
        ]
        self._mission = MissionProgress(make_mission(items), parameters["WP_SPEED"])
        self._course = tuple(profile.mission.course)
        self._reached: set[int] = set()
        self._gains = GuidanceGains.from_parameters(parameters, self._allocator.mixer.pivots)
        self._controller = DirectController(profile, parameters, len(self._allocator.neutral))
        self._frame = LocalProjection(site.latitude_deg, site.longitude_deg, site.altitude_m)
        self._dt_s = 1.0 / profile.clock.exchange_rate_hz
        self._others = others
        self._waits_for = others()
        self._stage: tuple[int, bool, int, str] | None = None
        self.progress = self._progress()

    def exchange(self, step: RunStep) -> None:
        if self._waits_for:
            self._waits_for = self._others()
        if not self._waits_for:
            self.command = MotorCommand(self._motors(step), armed=True)
        self.progress = self._progress()

    def _motors(self, step: RunStep) -> tuple[float, ...]:
        estimate = true_estimate(step.now_ns, step.motion)
        (north_m, east_m, _), (north_mps, east_mps, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        speed_mps = ground_speed_mps(estimate.yaw_rad, north_mps, east_mps)
        here, wanted_mps = (north_m, east_m), self._mission.default_speed_mps
        course = self._mission.steer(
            GuidanceInput(self._gains, self._frame, here, estimate.yaw_rad, speed_mps, wanted_mps, self._dt_s)
        )
        if course is None:
            return self._allocator.neutral
        last = self._allocator.last
        order = Order(course.heading_rad, 0.0, course.speed_mps, speed_mps, last.thrust_limited, last.steering_limited)
        answer = self._controller.control(order, estimate, self._dt_s)
        return allocated(self._allocator, answer, self._dt_s, speed_mps)

    def _progress(self) -> Progress:
        mission, finished = self._mission, self._mission.state == COMPLETE
        self._reached.update(seq for seq in mission.drain_reached() if seq in self._course)
        stage = mission.current, finished, len(self._reached), self._waits_for
        if stage == self._stage:
            return self.progress
        self._stage = stage
        return Progress(
            mode="IDEAL",
            armed=True,
            target=self._course.index(mission.current) if mission.current in self._course and not finished else None,
            reached=len(self._reached),
            finished=finished,
            completed=finished,
            waits_for=self._waits_for,
        )


class DirectController:
    """The profile's controller without an autopilot to replace it: its failure ends the run.

    commands: number of commands of the vessel. Each method raises UserError, with the controller's name, when it fails.
    """

    def __init__(self, profile: RunProfile, parameters: Parameters, commands: int) -> None:
        self._name = profile.autopilot.controller
        self._commands = commands
        make: MakeController = HeadingSpeedController
        if profile.autopilot.controller is not None:
            try:
                make = load_controller(profile.autopilot.controller)
            except ControllerError as error:
                raise UserError(f"autopilot.controller: {error}") from error
        self._guard = ControllerGuard(make, parameters, EventQueue())
        self._check("when it was made")

    def restart(self) -> None:
        """Restart for another order."""
        self._guard.restart()
        self._check("at its restart")

    def control(self, order: Order, estimate: StateEstimate, dt_s: float) -> ControllerOutput:
        """Return the controller's answer, limited to [-1, 1]."""
        answer = self._guard.control(order, estimate, dt_s, self._commands)
        self._check(f"at {estimate.stamp_ns / 1e9:.2f} s")
        return answer

    def _check(self, when: str) -> None:
        if self._guard.failures:
            raise UserError(
                f"autopilot.controller: {self._name} failed {when} ({self._guard.latest}); correct its code"
            )


def true_estimate(sim_ns: int, motion: Kinematics) -> StateEstimate:
    """Return the estimate of an estimator without errors."""
    rotation = motion.rot_ned_frd.tolist()[0]
    w, x, y, z = motion.quat_ned_frd.tolist()[0]
    p, q, r = motion.gyro_frd_radps.tolist()[0]
    north_m, east_m, down_m = motion.pos_ned_m.tolist()[0]
    vn, ve, vd = motion.vel_ned_mps.tolist()[0]
    return StateEstimate(
        sim_ns,
        (w, x, y, z),
        math.atan2(rotation[2][1], rotation[2][2]),
        -math.asin(min(max(rotation[2][0], -1.0), 1.0)),
        math.atan2(rotation[1][0], rotation[0][0]),
        (p, q, r),
        (north_m, east_m, down_m),
        (vn, ve, vd),
        True,
        True,
    )


class ScheduledControl(ControlNode):
    """Plays a script or a recording without waypoints. It is completed when it was played to its end."""

    def __init__(self, schedule: MotorSchedule, mode: str, commands: int) -> None:
        self.command = MotorCommand(schedule.motors_at(0) or (0.0,) * commands, armed=True)
        self._schedule = schedule
        self._mode = mode
        self.progress = self._progress(0)

    def exchange(self, step: RunStep) -> None:
        motors = self._schedule.motors_at(step.now_ns)
        if motors is not None and motors != self.command.motors:
            self.command = MotorCommand(motors, armed=True)
        self.progress = self._progress(step.now_ns)

    def _progress(self, now_ns: int) -> Progress:
        schedule = self._schedule
        return Progress(
            mode=self._mode,
            armed=True,
            finished=schedule.end_ns is not None and now_ns >= schedule.end_ns,
            completed=now_ns >= schedule.last_ns,
            waypoints=(),
        )


def allocated(allocator: ThrustAllocator, answer: ControllerOutput, dt_s: float, speed_mps: float) -> tuple[float, ...]:
    if isinstance(answer, Motors):
        return allocator.pass_through(answer)
    return allocator.allocate(answer, dt_s, speed_mps)


def direct_control(profile: RunProfile, others: Callable[[], str] = nobody) -> ControlNode:
    """Return the control of a vessel without an autopilot. Raises UserError for a file that cannot be replayed.

    others: returns a text with the vessels that a mission has to wait for.
    """
    driver, vessel = profile.driver, profile.vehicle
    if driver.kind not in ("script", "replay"):
        return IdealControl(profile, others)
    # The readers of recordings delay the start
    from xitl_cli.replay.motor_schedule import schedule_from_file, schedule_from_script

    if driver.kind == "script":
        return ScheduledControl(schedule_from_script(driver.script), "SCRIPT", vessel.commands)
    return ScheduledControl(schedule_from_file(profile, vessel), "REPLAY", vessel.commands)


T = TypeVar("T")


class _Repeated(Generic[T]):
    """A command and the time of its first check. begins: there was no command before it."""

    def __init__(self, value: T, begins: bool = False) -> None:
        self.value = value
        self.begins = begins
        self._since_ns: int | None = None

    def silent(self, now_ns: int, silent_ns: int) -> bool:
        """Whether the command is older than `silent_ns`."""
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns > silent_ns


class OperatedControl(ControlNode, Steering):
    """Executes an operator's orders: direct motor commands, or a speed and a turn rate by the embedded control laws.

    The control laws use the truth as the estimate. The latest of the two kinds of orders counts. A command that was not
    repeated for `silent_s` becomes neutral, for each motor separately. silences: number of such commands.
    """

    def __init__(self, profile: RunProfile, silent_s: float = SILENT_S) -> None:
        self.silences = 0
        self.asked_by: Counter[str] = Counter()
        self._vessel = profile.vehicle
        self._silent_ns = round(silent_s * 1e9)
        self._dt_s = 1.0 / profile.clock.exchange_rate_hz
        parameters = Parameters(embedded_parameters(profile))
        self._allocator = ThrustAllocator(parameters)
        self._controller = DirectController(profile, parameters, len(self._allocator.neutral))
        self._neutral = (0.0,) * self._vessel.commands
        self._motors: dict[int, _Repeated[float]] = {}
        self._velocity: _Repeated[SteerVelocity] | None = None
        self._ended = False
        self.command = MotorCommand(self._neutral, armed=True)
        self.progress = self._progress()

    # Orders, as in an operator's Steering

    def check(self, order: object) -> None:
        """Raise ActionError for an order that is not possible."""
        if isinstance(order, CommandMotor):
            if order.number >= self._vessel.commands:
                last = self._vessel.commands - 1
                raise ActionError(
                    f"motor: number = {order.number} is none of {self._vessel.command_kinds}; use 0 to {last}"
                )
        elif isinstance(order, SteerVelocity):
            if len(self._allocator.neutral) != self._vessel.commands:
                raise ActionError(f"velocity: the control laws cannot drive {self._vessel.command_kinds}; use motor")
        elif not isinstance(order, EndRun):
            raise ActionError(
                "the vessel has no autopilot and accepts only velocity, motor and end; use autopilot.kind: embedded"
            )

    def give(self, order: object) -> None:
        """Replace the active order; commands of other motors stay."""
        if isinstance(order, CommandMotor):
            self._velocity = None
            self._motors[order.number] = _Repeated(order.command)
        elif isinstance(order, SteerVelocity):
            self._motors = {}
            self._velocity = _Repeated(order, begins=self._velocity is None)
        else:
            self._ended = True

    def update(self, now_ns: int, say: Say) -> None:
        """Check for commands that have become silent."""
        for number, motor in list(self._motors.items()):
            if motor.silent(now_ns, self._silent_ns):
                del self._motors[number]
                self._fall_silent(f"no command for {self._vessel.command_names[number]}", say)
        velocity = self._velocity
        if velocity is not None and velocity.silent(now_ns, self._silent_ns):
            self._velocity = None
            self._fall_silent("no velocity", say)

    def _fall_silent(self, reason: str, say: Say) -> None:
        self.silences += 1
        say(f"{reason} for {self._silent_ns * 1e-9:g} s: neutral")

    # In the run

    def exchange(self, step: RunStep) -> None:
        motors, velocity = self._neutral, self._velocity
        if velocity is not None:
            if velocity.begins:
                velocity.begins = False
                self._controller.restart()
                self._allocator.restart()
            estimate, target, last = true_estimate(step.now_ns, step.motion), velocity.value, self._allocator.last
            speed_mps = ground_speed_mps(estimate.yaw_rad, *estimate.vel_ned_mps[:2])
            limited = last.thrust_limited, last.steering_limited
            order = Order(None, target.turn_rate_radps, target.speed_mps, speed_mps, *limited)
            answer = self._controller.control(order, estimate, self._dt_s)
            motors = allocated(self._allocator, answer, self._dt_s, speed_mps)
        elif self._motors:
            motors = tuple(self._motors[n].value if n in self._motors else 0.0 for n in range(len(motors)))
        self.command = MotorCommand(motors, armed=True)
        self.progress = self._progress()

    def _progress(self) -> Progress:
        return Progress(mode="ROS", armed=True, finished=self._ended, completed=True, waypoints=())
