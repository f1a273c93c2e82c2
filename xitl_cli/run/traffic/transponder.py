"""A vessel's AIS transponder: report times (ITU-R M.1371-5, annex 1, tables 1 and 2) and content."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim_core.geodesy import LocalFrame
from xitl_cli.run.traffic.ais import (
    KNOT_MPS,
    MOORED,
    UNDER_WAY,
    AisPayload,
    AisPosition,
    AisStatic,
    class_a_position,
    class_a_static,
    class_b_position,
    class_b_static,
)
from xitl_cli.run.traffic.self_report import SelfReport

AisClass = Literal["class-a", "class-b"]
STATIC_S = 360.0  # between two static reports, class A and B
AT_REST_S, MOORED_AND_MOVING_S = 180.0, 10.0
HEADING_MEAN_S, TURNED_DEG, STRAIGHT_AGAIN_S = 30.0, 5.0, 20.0  # annex 2, 4.3.3: definition of a change of course
SLOW_MPS = 0.2  # below it the course over ground is noise


def reporting_interval_s(ais_class: AisClass, speed_mps: float, moored: bool = False, turning: bool = False) -> float:
    """Return the time between two position reports."""
    knots = speed_mps / KNOT_MPS
    if ais_class == "class-b":
        return 30.0 if knots > 2.0 else AT_REST_S
    if moored:
        return MOORED_AND_MOVING_S if knots > 3.0 else AT_REST_S
    if knots <= 14.0:
        return 10.0 / 3.0 if turning else 10.0
    if knots <= 23.0:
        return 2.0 if turning else 6.0
    return 2.0


@dataclass(frozen=True, slots=True)
class AisTransmission:
    """One transmission of a transponder: a position or static data."""

    ais_class: AisClass
    report: AisPosition | AisStatic
    place_ne_m: tuple[float, float]
    """Position of its antenna."""

    def payloads(self) -> tuple[AisPayload, ...]:
        """Return the payloads of the radio messages."""
        if isinstance(self.report, AisPosition):
            return ((class_a_position if self.ais_class == "class-a" else class_b_position)(self.report),)
        return (class_a_static(self.report),) if self.ais_class == "class-a" else class_b_static(self.report)


class CourseChange:
    """Whether a vessel turns: its heading differs from the mean of the last 30 s, or did less than 20 s ago."""

    def __init__(self) -> None:
        self._headings: deque[tuple[int, float, float]] = deque()
        self._north = self._east = 0.0  # sums over the headings
        self._straight_ns: int | None = None

    def update(self, now_ns: int, heading_rad: float) -> bool:
        """Update with the heading. Call it at every check."""
        headings = self._headings
        headings.append((now_ns, math.cos(heading_rad), math.sin(heading_rad)))
        self._north += headings[-1][1]
        self._east += headings[-1][2]
        while now_ns - headings[0][0] > HEADING_MEAN_S * 1e9:
            _, north, east = headings.popleft()
            self._north -= north
            self._east -= east
        mean_rad = math.atan2(self._east, self._north)
        off_deg = abs(math.degrees(math.remainder(heading_rad - mean_rad, 2.0 * math.pi)))
        if off_deg > TURNED_DEG:
            self._straight_ns = now_ns + round(STRAIGHT_AGAIN_S * 1e9)
        return self._straight_ns is not None and now_ns < self._straight_ns


class Transponder:
    """The transponder of one vessel.

    It starts at `first_s` of simulation time, or at the vessel's first report if that is later. It then sends a
    position and static data. vessel: static data; its MMSI is in every report.
    """

    def __init__(self, ais_class: AisClass, vessel: AisStatic, frame: LocalFrame, first_s: float = 0.0) -> None:
        self.vessel = vessel
        self.sent = 0
        self._class: AisClass = ais_class
        self._frame = frame
        self._first_ns = round(first_s * 1e9)
        self._turn = CourseChange()
        self._spoke_ns: int | None = None
        self._static_ns = 0

    def due(self, now_ns: int, report: SelfReport | None) -> list[AisTransmission]:
        """Return the transmissions that are due, from the vessel's report. Call it some ten times a second."""
        if report is None:
            return []
        turning = self._turn.update(now_ns, report.yaw_rad)
        if self._spoke_ns is None:
            if now_ns < self._first_ns:
                return []
        else:
            interval_s = reporting_interval_s(self._class, math.hypot(*report.vel_ne_mps), not report.armed, turning)
            if now_ns - self._spoke_ns < round(interval_s * 1e9):
                return []
        begins = self._spoke_ns is None
        self._spoke_ns = now_ns
        lat, lon, _ = self._frame.geodetic(np.array([[*report.pos_ne_m, 0.0]]))
        north_mps, east_mps = report.vel_ne_mps
        speed_mps = math.hypot(north_mps, east_mps)
        position = AisPosition(
            self.vessel.mmsi,
            float(lat[0]),
            float(lon[0]),
            speed_mps,
            math.degrees(math.atan2(east_mps, north_mps)) % 360.0 if speed_mps > SLOW_MPS else None,
            math.degrees(report.yaw_rad) % 360.0,
            math.degrees(report.yaw_rate_radps) * 60.0,
            report.accurate,
            now_ns // 1_000_000_000 % 60,
            UNDER_WAY if report.armed else MOORED,
        )
        sent = [AisTransmission(self._class, position, report.pos_ne_m)]
        if begins or now_ns - self._static_ns >= STATIC_S * 1e9:
            self._static_ns = now_ns
            sent.append(AisTransmission(self._class, self.vessel, report.pos_ne_m))
        self.sent += len(sent)
        return sent
