"""Scripted vessels: motion along a track at a speed, in closed form, regardless of obstacles.

    vessel = ScriptedVessel.from_spec("barge", spec, water_level_m)
    motion = scripted_motion([vessel], time_s)

A track goes straight between places and rounds its corners by arcs. The arcs have one radius up to a right angle.
Sharper corners and shorter pieces have smaller radii, down to a turn on the spot at a reversal. Arcs tighter than half
of the radius take the time of half the radius. Position and heading are therefore continuous in time. The heading is
the course over ground.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array, euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.world.contact import Outline
from sim_core.world.geometry import STEEL, Mesh, prism
from sim_core.world.plan import Point, inset
from sim_core.world.spec import TrafficSpec

BOW_SHARE, BOW_BEAM = 0.15, 0.5
"""Share of a scripted vessel's length over which it narrows, and the bow's share of its beam."""
_TIGHTEST = 0.5  # of the turning radius: tighter arcs take longer
_ROUNDED_M, _ROUNDED_SHARE = 0.5, 0.25  # corners, for contact: at most, and of the beam


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight piece or an arc of a track."""

    begin_s: float
    duration_s: float
    from_ne_m: Point
    """Start of the piece."""
    heading_rad: float
    """Heading at the start."""
    length_m: float
    turn_rad: float = 0.0
    """Change of heading over the piece, positive clockwise."""

    def after(self, share: float) -> tuple[Point, float]:
        """Return place and heading after a share of the piece. The chord of an arc a is sin(a / 2) / (a / 2) of its
        length.
        """
        half = 0.5 * share * self.turn_rad
        chord_m = share * self.length_m * (math.sin(half) / half if half else 1.0)
        course = self.heading_rad + half
        north, east = self.from_ne_m
        return (north + chord_m * math.cos(course), east + chord_m * math.sin(course)), course + half


@dataclass(frozen=True, slots=True)
class ScriptedTrack:
    """Consecutive pieces, the first at start_s, at rest before and after."""

    pieces: tuple[Piece, ...]
    start_s: float
    lap_s: float | None
    """Time from the begin of the first piece to the begin of the repeated loop, None for no loop."""

    @classmethod
    def at_rest(cls, place_ne_m: Point, heading_rad: float) -> ScriptedTrack:
        """Return the track of a vessel at rest."""
        return cls((Piece(0.0, 0.0, place_ne_m, heading_rad, 0.0),), 0.0, None)

    @classmethod
    def through(
        cls,
        places_ne_m: Sequence[Point],
        speed_mps: float,
        turn_radius_m: float,
        loop: bool = False,
        start_s: float = 0.0,
    ) -> ScriptedTrack:
        """Return a track through two or more places, each different from the previous one. loop: from the last to the
        first, repeatedly.
        """
        places = [*places_ne_m, *(places_ne_m[:1] if loop else ())]
        legs = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(places)]
        lengths = [math.hypot(*leg) for leg in legs]
        courses = [math.atan2(east, north) for north, east in legs]
        pieces: list[Piece] = []
        place, begin_s, behind_m = places[0], 0.0, 0.0

        def go(heading: float, length_m: float, turn: float, duration_s: float) -> None:
            nonlocal place, begin_s
            pieces.append(Piece(begin_s, duration_s, place, heading, length_m, turn))
            begin_s += duration_s
            place, _ = pieces[-1].after(1.0)

        for number, (course, length_m) in enumerate(zip(courses, lengths, strict=True)):
            following = (number + 1) % len(legs)
            turn = math.remainder(courses[following] - course, math.tau) if loop or following else 0.0
            cut_m, radius_m = _corner(abs(turn), turn_radius_m, 0.5 * min(length_m, lengths[following]))
            go(course, length_m - behind_m - cut_m, 0.0, (length_m - behind_m - cut_m) / speed_mps)
            if turn:
                round_s = abs(turn) * max(radius_m, _TIGHTEST * turn_radius_m) / speed_mps
                go(course, radius_m * abs(turn), turn, round_s)
            behind_m = cut_m
        return cls(tuple(pieces), start_s, behind_m / speed_mps if loop else None)

    @property
    def end_s(self) -> float:
        """Time from start_s to the end of the last piece."""
        return self.pieces[-1].begin_s + self.pieces[-1].duration_s

    def at(self, time_s: float) -> tuple[Point, float, float, float]:
        """Return place, heading, speed and turning rate at an instant."""
        since_s = time_s - self.start_s
        if self.lap_s is not None and since_s >= self.end_s:
            since_s = self.lap_s + math.fmod(since_s - self.lap_s, self.end_s - self.lap_s)
        under_way = 0.0 <= since_s < self.end_s
        since_s = min(max(since_s, 0.0), self.end_s)
        piece = self.pieces[max(bisect_right(self.pieces, since_s, key=lambda piece: piece.begin_s) - 1, 0)]
        if not piece.duration_s:
            return *piece.after(1.0), 0.0, 0.0
        place, heading = piece.after(min((since_s - piece.begin_s) / piece.duration_s, 1.0))
        if not under_way:
            return place, heading, 0.0, 0.0
        return place, heading, piece.length_m / piece.duration_s, piece.turn_rad / piece.duration_s


def _corner(turn_rad: float, turn_radius_m: float, room_m: float) -> tuple[float, float]:
    """Return the distance of an arc's ends from its corner, and the radius of the arc."""
    if not turn_rad:
        return 0.0, 0.0
    tangent = math.tan(0.5 * turn_rad)
    cut_m = min(turn_radius_m * (tangent if turn_rad < 0.5 * math.pi else math.sin(turn_rad)), room_m)
    return cut_m, cut_m / tangent


@dataclass(frozen=True, slots=True, eq=False)
class ScriptedVessel:
    """A vessel that keeps to its track: a pontoon of given length, beam, draft and height, with a narrower bow.

    Its axes are forward, right and down about its middle at the waterline.
    """

    name: str
    track: ScriptedTrack
    mesh: Mesh
    """In its axes."""
    plan_m: Array
    """Corners in plan, forward and right, (P, 2), clockwise."""
    outline: Outline
    """Outline for contact."""
    down_m: float
    """Down coordinate of the mean level of the still water."""

    @classmethod
    def from_spec(cls, name: str, spec: TrafficSpec, water_level_m: float = 0.0) -> ScriptedVessel:
        """Return the vessel of a specification. It rounds corners by arcs with a radius of its length."""
        length_m, beam_m = spec.length_m, spec.beam_m
        if spec.speed_mps is None:
            track = ScriptedTrack.at_rest(spec.track_ned_m[0], math.radians(spec.heading_deg or 0.0))
        else:
            track = ScriptedTrack.through(spec.track_ned_m, spec.speed_mps, length_m, spec.loop, spec.start_s)
        half, side, shoulder = 0.5 * length_m, 0.5 * beam_m, (0.5 - BOW_SHARE) * length_m
        bow = BOW_BEAM * side
        plan_m = np.array(
            [(-half, -side), (shoulder, -side), (half, -bow), (half, bow), (shoulder, side), (-half, side)]
        )
        radius_m = min(_ROUNDED_SHARE * beam_m, _ROUNDED_SHARE * length_m, _ROUNDED_M)
        corners = np.column_stack([inset(plan_m, radius_m), np.zeros(len(plan_m))])
        ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        none = np.empty(0)
        outline = Outline(
            ends_frd_m=ends.reshape(-1, 3),
            radius_m=np.full(len(plan_m), radius_m),
            mass_kg=math.inf,
            reach_m=math.hypot(half, side),
            spheres_frd_m=none.reshape(0, 3),
            sphere_radius_m=none,
        )
        mesh = prism(plan_m, -spec.height_m, spec.draft_m, STEEL)
        return cls(name, track, mesh, plan_m, outline, -water_level_m)


def scripted_motion(vessels: Sequence[ScriptedVessel], time_s: float, tide_m: float = 0.0) -> Kinematics:
    """Return the motion of T vessels, upright on the still water. tide_m: its height above the mean level."""
    count = len(vessels)
    place, velocity, change, euler, gyro, turning = np.zeros((6, count, 3))
    for row, vessel in enumerate(vessels):
        (north_m, east_m), heading, speed_mps, rate_radps = vessel.track.at(time_s)
        ahead = np.array([math.cos(heading), math.sin(heading)])
        place[row] = north_m, east_m, vessel.down_m - tide_m
        velocity[row, :2] = speed_mps * ahead
        change[row, :2] = speed_mps * rate_radps * np.array([-ahead[1], ahead[0]])
        euler[row, 2], gyro[row, 2] = heading, rate_radps
    quat = euler_to_quat(euler)
    return Kinematics(place, velocity, change, quat, quat_to_matrix(quat), gyro, turning)
