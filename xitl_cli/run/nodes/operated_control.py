"""A vessel without an autopilot that an operator drives, by motor commands or by a speed and a turn rate."""

from __future__ import annotations

from collections import Counter
from typing import Generic, TypeVar

from agent.fcu.control.allocation import ThrustAllocator
from agent.fcu.control.controller import Order
from agent.fcu.control.heading_speed import ground_speed_mps
from agent.fcu.parameters import Parameters
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.node import ControlNode, RunStep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.nodes.direct_control import DirectController, allocated, true_estimate
from xitl_cli.run.operator.actions import ActionError, CommandMotor, EndRun, SteerVelocity
from xitl_cli.run.operator.steering import SILENT_S, Say, Steering

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
