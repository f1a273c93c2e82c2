"""Allocation (LA): thrust and steering demands to the commands of two propellers, port and starboard."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.control.controller import Demand, Motors
from agent.fcu.parameters import Parameters

NEUTRAL = (0.0, 0.0)


def pulse_width_us(command: float) -> int:
    """A motor command in [-1, 1] as a servo's pulse width: 1500 is neutral, 1100 full astern, 1900 full ahead."""
    return 1500 + round(400.0 * command)


class AllocationGains(NamedTuple):
    """`astern` is full thrust astern as part of full thrust ahead; `slew_per_s` 0 means no limit."""

    astern: float
    expo: float
    slew_per_s: float

    @classmethod
    def from_parameters(cls, p: Parameters) -> AllocationGains:
        """From the table."""
        return cls(astern=1.0 / p["MOT_THST_ASYM"], expo=p["MOT_THST_EXPO"], slew_per_s=p["MOT_SLEWRATE"] / 100.0)


class Allocation(NamedTuple):
    """Commands (port, starboard) in [-1, 1], and whether each demand had to be cut."""

    command: tuple[float, float] = NEUTRAL
    thrust_limited: bool = False
    steering_limited: bool = False


def allocate(gains: AllocationGains, last: Allocation, thrust: float, steering: float, dt_s: float) -> Allocation:
    """Share the demands out; steering goes first when both do not fit.

    `thrust` 1 is both propellers full ahead; `steering` 1 is port ahead and starboard astern by full thrust each, which
    the weaker thrust astern may cut.
    """
    widest = 0.5 * (1.0 + gains.astern)
    turn = min(max(steering, -widest), widest)
    surge = min(max(thrust, abs(turn) - gains.astern), 1.0 - abs(turn))
    wanted = (_command(gains, surge + turn), _command(gains, surge - turn))
    command = wanted
    if gains.slew_per_s > 0.0:
        step = gains.slew_per_s * dt_s
        command = (_stepped(last.command[0], wanted[0], step), _stepped(last.command[1], wanted[1], step))
    return Allocation(command, surge != thrust, turn != steering)


def _command(gains: AllocationGains, thrust: float) -> float:
    """Invert the thrust curve: thrust = (1 - expo) c + expo c², as ArduPilot's MOT_THST_EXPO has it."""
    part = min(thrust if thrust >= 0.0 else -thrust / gains.astern, 1.0)
    if part <= 0.0:
        return 0.0
    linear = 1.0 - gains.expo
    # The root in the form that also holds for an exponent near zero.
    part = 2.0 * part / (linear + math.sqrt(max(0.0, linear * linear + 4.0 * gains.expo * part)))
    return min(part, 1.0) if thrust >= 0.0 else -min(part, 1.0)


def _stepped(last: float, wanted: float, step: float) -> float:
    return min(max(wanted, last - step), last + step)


class ThrustAllocator:
    """Allocation of demands with what it remembers. `efforts` counts them."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.efforts = 0
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Take changed parameters over."""
        self._gains = AllocationGains.from_parameters(self._parameters)

    def restart(self) -> None:
        """The last command was neutral."""
        self.last = Allocation()

    def pass_through(self, motors: Motors) -> tuple[float, float]:
        """Commands that were made elsewhere."""
        self.efforts += 1
        self.last = Allocation((motors.port, motors.starboard))
        return self.last.command

    def allocate(self, demand: Demand, dt_s: float) -> tuple[float, float]:
        """Commands (port, starboard) in [-1, 1]."""
        self.efforts += 1
        self.last = allocate(self._gains, self.last, demand.thrust, demand.steering, dt_s)
        return self.last.command
