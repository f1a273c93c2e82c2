"""MicroStrain 3DM-GQ7, for ArduPilot with EAHRS_TYPE 7: its Linux builds too, on a BeagleBone for one.

There is no set-up: packets flow as soon as somebody is there, and the driver never answers. It hands its receiver's
last fix on again with every packet of the filter, fifty times a second: GPS1_DELAY_MS has to tell the EKF of half the
time between two fixes beside the latency of the receiver.
"""

from __future__ import annotations

from agent.bridges import microstrain_frames as frames
from agent.bridges.ahrs import Ahrs
from agent.bridges.samples import InertialSample, Navigation, ReceiverFix
from agent.bridges.sensor_line import LISTEN, open_line
from agent.bridges.vehicle_link import VehicleLink
from agent.options import Options, OptionsError


class MicroStrain7(Ahrs):
    """Its solution comes only once the receiver had a fix, as the driver takes height from there."""

    title = "MicroStrain 7"

    @classmethod
    def make(cls, options: Options, vehicle: VehicleLink) -> MicroStrain7:
        """Opens the line. Raises OptionsError and TransportError."""
        url = options.sensor_link
        if not url:
            raise OptionsError("sensor-link: microstrain7 needs the port of the autopilot, as udp://127.0.0.1:14800")
        if url.startswith("udp://") and url.endswith(LISTEN):
            raise OptionsError(
                f"sensor-link: {url}: this driver never speaks, so that its address stays unknown; "
                "start the autopilot with udpin:0.0.0.0:PORT and call it at udp://HOST:PORT"
            )
        return cls(open_line(url))

    def hear(self, chunk: bytes) -> bool:
        self.counts.junk += len(chunk)
        return False

    def taken(self) -> bool:
        return self._line.connected

    def absent(self) -> str:
        return "check EAHRS_TYPE 7, SERIALn_PROTOCOL 36, and that this is port n"

    def inertial(self, sample: InertialSample) -> bytes | None:
        return frames.inertial_frame(sample) if self._line.connected else None

    def solution(self, navigation: Navigation) -> bytes | None:
        return frames.solution_frame(navigation) if self._line.connected else None

    def fix(self, fix: ReceiverFix) -> bytes | None:
        return frames.receiver_frame(fix) if self._line.connected else None
