"""Plain data of the embedded autopilot: measurements, state estimate, actuators, vehicle state and events; no MAVLink.

`stamp_ns` is the instant a measurement was taken, on the sensors' clock. Named tuples and not dataclasses, because a
measurement is made 200 times a second on a slow board and a tuple costs a third.
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
    """Position and velocity of the antenna; `fix_type` 3 is a three-dimensional fix.

    The accuracies are RMS errors as a receiver reports them: of both horizontal axes, of the vertical, of all three
    axes of the velocity.
    """

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    vel_ned_mps: Vector3
    horizontal_accuracy_m: float = 1.0
    vertical_accuracy_m: float = 1.0
    speed_accuracy_mps: float = 0.2
    fix_type: int = 3
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
    """What the estimator believes about the body origin at `stamp_ns` (sensors' clock).

    Position is relative to the estimator's origin; `quat_ned_frd` is (w, x, y, z), body FRD to NED; the gyro has its
    estimated bias removed. `position_valid` says whether position and velocity may be steered by.
    """

    stamp_ns: int
    quat_ned_frd: Quaternion
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    gyro_frd_radps: Vector3
    pos_ned_m: Vector3
    vel_ned_mps: Vector3
    attitude_valid: bool
    position_valid: bool


class Actuators(NamedTuple):
    """Commands in [-1, 1]: throttles, full astern to full ahead, such as port and starboard, then all that steers."""

    command: tuple[float, ...] = (0.0, 0.0)
    armed: bool = False
    failsafe: bool = False


class ArmingProblem(NamedTuple):
    """Why the vessel is not to be armed. check: the part that is checked; text: ArduPilot's words for it."""

    check: str
    text: str


@dataclass
class VehicleState:
    """What the parts of the autopilot share. It is changed by `Autopilot` alone.

    mode: by ArduRover's number. estimate: of this control cycle, which began at `now_ns` on the agent's clock.
    speed_error_mps: desired less measured speed over ground.
    """

    mode: int
    estimate: StateEstimate
    armed: bool = False
    now_ns: int = 0
    speed_error_mps: float = 0.0


class Event(NamedTuple):
    """A sentence for the person at the ground station, with a MAV_SEVERITY."""

    severity: int
    text: str


class EventQueue:
    """Events that wait to be drained; when nobody does, the oldest are lost and counted."""

    def __init__(self) -> None:
        self.lost = 0
        self._waiting: deque[Event] = deque(maxlen=_MOST_WAITING)

    def add(self, severity: int, text: str) -> None:
        """Queue an event."""
        if len(self._waiting) == _MOST_WAITING:
            self.lost += 1
        self._waiting.append(Event(severity, text))

    def refuse(self, reason: str) -> str:
        """Queue why a command was refused, and return it."""
        self.add(WARNING, reason)
        return reason

    def drain(self) -> list[Event]:
        """All since the last call, oldest first."""
        events = list(self._waiting)
        self._waiting.clear()
        return events
