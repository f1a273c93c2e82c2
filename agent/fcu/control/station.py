"""Staying at a place and going to one, for whoever steers there: loitering, returning home, guided from outside."""

from __future__ import annotations

import math

from agent.fcu.control.guidance import GuidanceGains, GuidanceOutput, GuidanceState, Leg, guide, leg, wrapped
from agent.fcu.local_frame import LocalFrame

BOW_OR_STERN, BOW, STERN = 0, 1, 2  # LOIT_TYPE


class Station:
    """Keeps within LOIT_RADIUS of a place, as ArduRover's boats do: drift near it, beyond that drive back.

    ArduRover starts back at the radius and so stays a little outside of it in a current; here it is at half the radius.
    """

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg
        self._heading_rad: float | None = None

    def steer(
        self, gains: GuidanceGains, frame: LocalFrame, pos_ne_m: tuple[float, float], yaw_rad: float, most_mps: float
    ) -> GuidanceOutput:
        """Heading and speed, negative astern, no faster than `most_mps`."""
        north_m, east_m = frame.to_local(self.lat_deg, self.lon_deg)
        north_m, east_m = north_m - pos_ne_m[0], east_m - pos_ne_m[1]
        distance_m = math.hypot(north_m, east_m)
        bearing_rad = math.atan2(east_m, north_m)
        heading_rad = yaw_rad if self._heading_rad is None else self._heading_rad
        speed_mps = 0.0
        adrift_m = distance_m - 0.5 * gains.loiter_radius_m
        if adrift_m > 0.0:
            heading_rad = bearing_rad
            speed_mps = min(gains.loiter_per_s * adrift_m, most_mps)
            behind = abs(wrapped(bearing_rad - yaw_rad)) > 0.5 * math.pi
            if gains.loiter_type == STERN or (gains.loiter_type == BOW_OR_STERN and behind):
                heading_rad, speed_mps = wrapped(bearing_rad + math.pi), -speed_mps
            off = min(abs(wrapped(heading_rad - yaw_rad)) / (0.5 * math.pi), 1.0)
            speed_mps *= 1.0 - 0.5 * off
        self._heading_rad = heading_rad
        return GuidanceOutput(heading_rad, speed_mps, 0.0, distance_m, bearing_rad, False)


class Passage:
    """A straight way to a place from wherever the vessel is, then a Station there. `arrived` says which."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.station = Station(lat_deg, lon_deg)
        self.arrived = False
        self._frame: LocalFrame | None = None
        self._leg: Leg | None = None
        self._guidance = GuidanceState()

    @property
    def under_way(self) -> bool:
        """Whether it was steered along and is not there yet."""
        return self._leg is not None and not self.arrived

    def steer(
        self,
        gains: GuidanceGains,
        frame: LocalFrame,
        pos_ne_m: tuple[float, float],
        yaw_rad: float,
        speed_mps: float,
        desired_mps: float,
        dt_s: float,
    ) -> GuidanceOutput:
        """Heading and speed."""
        if self.arrived:
            return self.station.steer(gains, frame, pos_ne_m, yaw_rad, desired_mps)
        if self._leg is None or frame is not self._frame:
            self._frame = frame
            self._leg = leg(pos_ne_m, frame.to_local(self.station.lat_deg, self.station.lon_deg), None)
        self._guidance, output = guide(
            gains, self._guidance, self._leg, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s
        )
        self.arrived = output.reached
        return output
