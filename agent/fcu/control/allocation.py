"""Allocation (LA): converts demands of thrust, steering and lateral force to commands of the vessel's actuators.

SERVOn_FUNCTION defines the actuators, as in ArduRover:

- Throttle left and right (73, 74) steer by their difference.
- Throttle with ground steering (70, 26) is a rudder, or vectored thrust (MOT_VEC_ANGLEMAX).
- Motors 1 to 8 (33 to 40) have positions MOTn_, with rudders at RUDn_, and share the demand by least squares.

Commands are all throttles, then all steering.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from agent.fcu.control.controller import Demand, Motors
from agent.fcu.control.thrusters import ForceAllocation, RudderBlade, Share, Thruster
from agent.fcu.parameters import MOTORS, OUTPUTS, RUDDERS, Parameters

NEUTRAL = (0.0, 0.0)
NEUTRAL_US, _SPAN_US = 1500, 400.0
STEERING, THROTTLE, THROTTLE_LEFT, THROTTLE_RIGHT, FIRST_MOTOR = 26, 70, 73, 74, 33  # SERVOn_FUNCTION
_ROUNDING = 1e-9
_WORTH_THRUST, _HARD = 0.05, 0.25  # of full steering
_WAY_ON_MPS = 0.1
_MET = 1e-3  # of a full demand: a smaller residual counts as zero


def pulse_width_us(command: float) -> int:
    """Return a motor command in [-1, 1] as a pulse width in us: 1500 is neutral, 1100 full astern, 1900 full ahead."""
    return NEUTRAL_US + round(_SPAN_US * command)


def quantised(command: float) -> float:
    """Return the command that is output for a motor command: pulse widths are whole microseconds."""
    return (pulse_width_us(command) - NEUTRAL_US) / _SPAN_US


class AllocationGains(NamedTuple):
    """Gains of the allocation."""

    astern: float
    """Full thrust astern as a part of full thrust ahead."""
    expo: float
    slew_per_s: float
    """0 means no limit."""

    @classmethod
    def from_parameters(cls, p: Parameters) -> AllocationGains:
        """Read the gains from the parameters."""
        return cls(astern=1.0 / p["MOT_THST_ASYM"], expo=p["MOT_THST_EXPO"], slew_per_s=p["MOT_SLEWRATE"] / 100.0)


class GearGains(NamedTuple):
    """Gains of a steering gear."""

    vector_rad: float
    """Angle of the thrust at full steering, 0 for a rudder."""
    base_mps: float
    """Speed above which a rudder deflects less."""

    @classmethod
    def from_parameters(cls, p: Parameters) -> GearGains:
        """Read the gains from the parameters."""
        return cls(math.radians(p["MOT_VEC_ANGLEMAX"]), p["MOT_SPD_SCA_BASE"])


class Allocation(NamedTuple):
    """Commands in [-1, 1], and whether each demand was limited."""

    command: tuple[float, ...] = NEUTRAL
    thrust_limited: bool = False
    steering_limited: bool = False


def allocate(
    gains: AllocationGains, last: Allocation, thrust: float, steering: float, dt_s: float, steering_first: float = 1.0
) -> Allocation:
    """Allocate the demands to port and starboard.

    `thrust` 1 is both propellers full ahead. `steering` 1 is port full ahead and starboard full astern. The weaker
    thrust astern may limit it. steering_first applies when both do not fit: 1 gives steering its full demand, 0.5
    limits both equally, and less limits steering further.
    """
    widest = 0.5 * (1.0 + gains.astern)
    turn = min(max(steering, -widest), widest)
    if steering_first < 1.0:
        turn = _mixed(gains, thrust, turn, steering_first)
    surge = min(max(thrust, abs(turn) - gains.astern), 1.0 - abs(turn))
    wanted = (_command(gains, surge + turn), _command(gains, surge - turn))
    return Allocation(_slewed(gains, last.command, wanted, dt_s), surge != thrust, turn != steering)


def _mixed(gains: AllocationGains, thrust: float, turn: float, mix: float) -> float:
    """Return the steering that remains after thrust has its share: ArduRover's MOT_STR_THR_MIX."""
    surge = min(max(thrust, -gains.astern), 1.0)
    excess = max(surge + abs(turn), (abs(turn) - surge) / gains.astern)
    if excess <= 1.0:
        return turn
    fair = 1.0 / excess
    if mix >= 0.5:
        return turn * (fair + (1.0 - fair) * (mix - 0.5) / 0.5)
    surge *= fair + (1.0 - fair) * (0.5 - mix) / 0.5
    return math.copysign(min(1.0 - surge, surge + gains.astern), turn)


def vectored(
    gains: AllocationGains, vector_rad: float, thrust: float, steering: float, speed_mps: float = 0.0
) -> tuple[float, float, float]:
    """Vectored thrust: return the part of full thrust, the share of the full angle, and the achieved part of
    `steering`.

    thrust: in [-astern, 1].

    Steering is a lateral part of full thrust and has priority. If `thrust` is too small for the steering at full angle,
    it is raised, ahead. ArduRover leaves this to the pilot. Steering below a twentieth does not raise thrust. With way
    ahead and hard steering, thrust is not reversed to brake, because the vessel would fall off.
    """
    slope, widest, size = math.tan(vector_rad), math.sin(vector_rad), abs(steering)
    sign, most, ahead = (1.0, 1.0, thrust) if thrust >= 0.0 else (-1.0, gains.astern, -thrust)
    falls_short = size > _WORTH_THRUST and size > min(ahead * slope, most * widest)
    if falls_short or (thrust < 0.0 and turns_hard(steering, speed_mps)):
        sign, most, ahead = 1.0, 1.0, max(thrust, min(size, widest) / slope)
    least = min(ahead * slope, most * widest)
    turn = min(max(steering, -least), least)
    ahead = min(ahead, math.sqrt(most * most - turn * turn))
    angle = math.atan2(turn, ahead) / vector_rad
    return sign * math.hypot(ahead, turn), sign * angle, turn


def turns_hard(steering: float, speed_mps: float) -> bool:
    """Whether thrust astern would remove the turning moment."""
    return abs(steering) > _HARD and speed_mps > _WAY_ON_MPS


def rudder_angle(base_mps: float, thrust: float, steering: float, speed_mps: float) -> tuple[float, bool]:
    """Return the share of a rudder's full angle, and whether the demand is limited.

    The angle decreases with the speed above the base speed. Up to that speed, more angle does not help, which counts as
    limited. The angle is reversed astern, when the vessel makes sternway and does not push ahead.
    """
    angle, slow = steering, False
    if base_mps > 0.0:
        slow = abs(speed_mps) <= base_mps
        angle *= 1.0 if slow else base_mps / abs(speed_mps)
    angle = -angle if speed_mps < 0.0 and thrust <= 0.0 else angle
    within = min(max(angle, -1.0), 1.0)
    return within, slow or within != angle


def _command(gains: AllocationGains, thrust: float) -> float:
    """Invert the thrust curve of ArduPilot's MOT_THST_EXPO: thrust = (1 - expo) c + expo c²."""
    part = min(thrust if thrust >= 0.0 else -thrust / gains.astern, 1.0)
    if part <= 0.0:
        return 0.0
    linear = 1.0 - gains.expo
    # This form of the root also holds for an exponent near zero.
    part = 2.0 * part / (linear + math.sqrt(max(0.0, linear * linear + 4.0 * gains.expo * part)))
    return min(part, 1.0) if thrust >= 0.0 else -min(part, 1.0)


def _slewed(gains: AllocationGains, last: Sequence[float], wanted: Sequence[float], dt_s: float) -> tuple[float, ...]:
    """Limit the rate of change of the throttles."""
    if gains.slew_per_s <= 0.0:
        return tuple(wanted)
    step = gains.slew_per_s * dt_s
    return tuple([min(max(new, old - step), old + step) for old, new in zip(last, wanted)])


class Mixer(Protocol):
    """Mixer of demands to commands."""

    outputs: tuple[int, ...]
    """Servo output of each command, 0 for none; throttles first."""
    throttles: int
    """Number of throttles."""
    pivots: bool
    """Whether the vessel can turn on the spot."""

    def mix(self, last: Allocation, demand: Demand, speed_mps: float, by_hand: bool, dt_s: float) -> Allocation:
        """Return the commands for `demand`. by_hand: steering is an angle if the gear has one, as in MANUAL."""


class SkidMixer:
    """Port and starboard throttles, and rudders that turn with them."""

    pivots = True
    throttles = 2

    def __init__(self, p: Parameters, port: int, starboard: int, steering: Sequence[int]) -> None:
        self.outputs = (port, starboard, *steering)
        self._gains, self._gear = AllocationGains.from_parameters(p), GearGains.from_parameters(p)
        self._steering_first = p["MOT_STR_THR_MIX"]
        self._rudders = len(steering)

    def mix(self, last: Allocation, demand: Demand, speed_mps: float, by_hand: bool, dt_s: float) -> Allocation:
        result = allocate(self._gains, last, demand.thrust, demand.steering, dt_s, self._steering_first)
        if not self._rudders:
            return result
        angle, _ = rudder_angle(self._gear.base_mps, demand.thrust, demand.steering, speed_mps)
        return result._replace(command=(*result.command, *(angle,) * self._rudders))


class SteeringMixer:
    """Equal throttles, and equal rudders or gears."""

    pivots = False

    def __init__(self, p: Parameters, throttles: Sequence[int], steering: Sequence[int]) -> None:
        self.outputs = (*throttles, *steering)
        self.throttles = len(throttles)
        self._gains, self._gear = AllocationGains.from_parameters(p), GearGains.from_parameters(p)

    def mix(self, last: Allocation, demand: Demand, speed_mps: float, by_hand: bool, dt_s: float) -> Allocation:
        gains, gear, thrust, steering = self._gains, self._gear, demand.thrust, demand.steering
        part = surge = min(max(thrust, -gains.astern), 1.0)
        if by_hand:
            angle = min(max(-steering if thrust < 0.0 else steering, -1.0), 1.0)
            limited = abs(angle) != abs(steering)
        elif gear.vector_rad > 0.0:
            part, angle, met = vectored(gains, gear.vector_rad, surge, steering, speed_mps)
            limited = abs(met - steering) > _ROUNDING
            surge = math.copysign(math.sqrt(max(part * part - met * met, 0.0)), part)
        else:
            if turns_hard(steering, speed_mps):
                part = surge = max(surge, 0.0)
            angle, limited = rudder_angle(gear.base_mps, thrust, steering, speed_mps)
        throttle = _slewed(gains, last.command, (_command(gains, part),) * self.throttles, dt_s)
        turning = len(self.outputs) - self.throttles
        return Allocation((*throttle, *(angle,) * turning), abs(surge - thrust) > _MET, limited)


class MotorsMixer:
    """Motors and rudders at their positions, each with a separate command."""

    def __init__(self, p: Parameters, motors: dict[int, int], steering: Sequence[int]) -> None:
        """motors: output of each motor by its number."""
        self._slew = gains = AllocationGains.from_parameters(p)
        self._base_mps = p["MOT_SPD_SCA_BASE"]
        numbers = [number for number in sorted(motors) if p[f"MOT{number}_THRUST"] > 0.0]
        thrusters = [
            Thruster(
                x_m=p[f"MOT{number}_POS_X"],
                y_m=p[f"MOT{number}_POS_Y"],
                angle_rad=math.radians(p[f"MOT{number}_ANGLE"]),
                thrust_n=p[f"MOT{number}_THRUST"],
                astern=1.0 / p[f"MOT{number}_ASYM"] if p[f"MOT{number}_ASYM"] else gains.astern,
                most_rad=math.radians(p[f"MOT{number}_VEC_MAX"]),
            )
            for number in numbers
        ]
        propeller_index = {number: index for index, number in enumerate(numbers)}
        rudders = [
            RudderBlade(
                x_m=p[f"RUD{number}_POS_X"],
                force_n=p[f"RUD{number}_FORCE"],
                propeller=propeller_index.get(int(p[f"RUD{number}_MOT"])),
                race_mps=p[f"RUD{number}_RACE"],
            )
            for number in range(1, RUDDERS + 1)
            if p[f"RUD{number}_FORCE"] > 0.0
        ]
        self.force = ForceAllocation(thrusters, rudders, self._base_mps)
        self.throttles = len(numbers)
        self._gears = [index for index, thruster in enumerate(thrusters) if thruster.most_rad > 0.0]
        turning = len(self._gears) + len(self.force.rudders)
        self.outputs = (*(motors[number] for number in numbers), *[*steering, *[0] * turning][:turning])
        self.pivots = self.force.pivots
        self._gains = [gains._replace(astern=thruster.astern) for thruster in thrusters]
        self._shares = [Share()] * (self.throttles + len(self.force.rudders))

    def mix(self, last: Allocation, demand: Demand, speed_mps: float, by_hand: bool, dt_s: float) -> Allocation:
        speed_mps = self._base_mps if by_hand else speed_mps
        shares, met = self.force.solve(demand.thrust, demand.steering, demand.lateral, speed_mps, self._shares)
        self._shares = shares
        throttles, angles = [], []
        for index, (thruster, gains) in enumerate(zip(self.force.thrusters, self._gains)):
            part, angle = shares[index].along, 0.0
            if thruster.most_rad:
                part, angle = _directed(thruster, shares[index])
                gear = self.throttles + self._gears.index(index)
                angles.append(angle if abs(part) > _MET else last.command[gear])
            throttles.append(_command(gains, part))
        rudders = [share.along for share in shares[self.throttles :]]
        return Allocation(
            (*_slewed(self._slew, last.command, throttles, dt_s), *angles, *rudders),
            abs(met[1] - demand.thrust) > _MET,
            abs(met[0] - demand.steering) > _MET,
        )


def _directed(thruster: Thruster, share: Share) -> tuple[float, float]:
    """Return the thrust and the share of its gear's angle, which turns thrust to port.

    Thrust beyond the angle is astern.
    """
    part, to_starboard_rad = math.hypot(share.along, share.across), math.atan2(share.across, share.along)
    if abs(to_starboard_rad) > thruster.most_rad + 1e-9:
        part = -min(part, thruster.astern)
        to_starboard_rad = math.remainder(to_starboard_rad + math.pi, 2.0 * math.pi)
    return part, min(max(-to_starboard_rad / thruster.most_rad, -1.0), 1.0)


def make_mixer(p: Parameters) -> Mixer:
    """Return the mixer that the functions of the outputs define. Without any of these functions, nothing is driven."""
    functions = {output: int(p[f"SERVO{output}_FUNCTION"]) for output in range(1, OUTPUTS + 1)}
    steering, throttles, left, right = (
        [output for output, function in functions.items() if function == wanted]
        for wanted in (STEERING, THROTTLE, THROTTLE_LEFT, THROTTLE_RIGHT)
    )
    motors = {
        function - FIRST_MOTOR + 1: output
        for output, function in functions.items()
        if FIRST_MOTOR <= function < FIRST_MOTOR + MOTORS
    }
    if motors:
        return MotorsMixer(p, motors, steering)
    if left and right:
        return SkidMixer(p, left[0], right[0], steering)
    return SteeringMixer(p, throttles, steering)


class ThrustAllocator:
    """Allocates demands and stores the last allocation. `efforts` counts the allocations."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.efforts = 0
        self.configure()
        self.restart()

    def configure(self) -> None:
        """Apply changed parameters."""
        self.mixer = make_mixer(self._parameters)
        self.neutral = (0.0,) * len(self.mixer.outputs)
        if len(self.neutral) != len(getattr(self, "last", Allocation()).command):
            self.restart()

    def restart(self) -> None:
        """Reset the last command to neutral."""
        self.last = Allocation(self.neutral)

    def pass_through(self, motors: Motors) -> tuple[float, ...]:
        """Return commands from another source unchanged."""
        self.efforts += 1
        self.last = Allocation(tuple(motors))
        return self.last.command

    def allocate(self, demand: Demand, dt_s: float, speed_mps: float = 0.0, by_hand: bool = False) -> tuple[float, ...]:
        """Return commands in [-1, 1]. speed_mps: over ground, negative astern. by_hand: see Mixer."""
        self.efforts += 1
        self.last = self.mixer.mix(self.last, demand, speed_mps, by_hand, dt_s)
        return self.last.command
