"""Plain data of the embedded autopilot, without MAVLink: measurements, state estimate, actuators, vehicle state,
events.

`stamp_ns` is the instant of a measurement, on the sensors' clock. These are named tuples, because a tuple has a third
of the cost of a dataclass. A slow board creates 200 measurements a second.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
CRITICAL, ERROR, WARNING, NOTICE, INFO = 2, 3, 4, 5, 6  # MAV_SEVERITY
_MOST_WAITING = 64


class ImuMeasurement(NamedTuple):
    """Angular rate and specific force in body FRD."""

    stamp_ns: int
    gyro_frd_radps: Vector3
    accel_frd_mps2: Vector3
    temperature_degc: float = 20.0


class GnssMeasurement(NamedTuple):
    """Position and velocity of the antenna, with accuracies as a receiver reports them."""

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    horizontal_accuracy_m: float = 1.0
    """RMS error of both horizontal axes together."""
    vertical_accuracy_m: float = 1.0
    """RMS error of the vertical axis."""
    speed_accuracy_mps: float = 0.2
    """RMS error of all three axes of the velocity together."""
    fix_type: int = 3
    """3 is a three-dimensional fix."""
    satellites: int = 10


class MagnetometerMeasurement(NamedTuple):
    """Magnetic field in body FRD."""

    stamp_ns: int
    field_frd_gauss: Vector3


class BarometerMeasurement(NamedTuple):
    """Static pressure."""

    stamp_ns: int
    pressure_pa: float
    temperature_degc: float = 20.0


class StateEstimate(NamedTuple):
    """Estimate of the body origin."""

    stamp_ns: int
    """Sensors' clock."""
    quat_ned_frd: Quaternion
    """(w, x, y, z), body FRD to NED."""
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    gyro_frd_radps: Vector3
    """Angular rate without the estimated bias."""
    pos_ned_m: Vector3
    """From the estimator's origin."""
    vel_ned_mps: Vector3
    attitude_valid: bool
    position_valid: bool
    """Whether position and velocity are good enough for steering."""


class Actuators(NamedTuple):
    """Commands in [-1, 1]: first the throttles, full astern to full ahead, such as port and starboard.

    Then the steering.
    """

    command: tuple[float, ...] = (0.0, 0.0)
    armed: bool = False
    failsafe: bool = False


class ArmingProblem(NamedTuple):
    """Reason against arming."""

    check: str
    """Part that was checked."""
    text: str
    """ArduPilot's words."""


@dataclass
class VehicleState:
    """Shared state of the parts of the autopilot. Only `Autopilot` changes it."""

    mode: int
    """ArduRover's number."""
    estimate: StateEstimate
    """Estimate of this control cycle."""
    armed: bool = False
    now_ns: int = 0
    """Start of this control cycle on the agent's clock."""
    speed_error_mps: float = 0.0
    """Desired minus measured speed over ground."""


class Event(NamedTuple):
    """A sentence for the user of the ground station, with a MAV_SEVERITY."""

    severity: int
    text: str


class EventQueue:
    """Events that wait to be drained. Beyond the limit, the oldest are lost and counted."""

    def __init__(self) -> None:
        self.lost = 0
        self._waiting: deque[Event] = deque(maxlen=_MOST_WAITING)

    def add(self, severity: int, text: str) -> None:
        """Queue an event."""
        if len(self._waiting) == _MOST_WAITING:
            self.lost += 1
        self._waiting.append(Event(severity, text))

    def refuse(self, reason: str) -> str:
        """Queue the reason of a refused command, and return it."""
        self.add(WARNING, reason)
        return reason

    def drain(self) -> list[Event]:
        """Return all events since the last call, oldest first."""
        events = list(self._waiting)
        self._waiting.clear()
        return events
