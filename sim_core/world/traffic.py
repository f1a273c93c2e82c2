"""Scripted vessels: along a track at a speed, in closed form, whatever is in the way.

    vessel = ScriptedVessel.from_spec("barge", spec, water_level_m)
    motion = scripted_motion([vessel], time_s)

A track goes straight from place to place and rounds its corners by arcs: of one radius up to a right angle, smaller the
sharper the corner is and the less room there is, down to a turn on the spot at a reversal. Arcs tighter than half of
that radius are gone through in the time that half of it would take. So place and heading are continuous in time, and
the heading is that of the way over ground.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_core.frames import Array, euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.world.contact import Outline
from sim_core.world.geometry import STEEL, Mesh, prism
from sim_core.world.plan import Point, inset
from sim_core.world.spec import TrafficSpec

BOW_SHARE, BOW_BEAM = 0.15, 0.5
"""The share of its length over which a scripted vessel narrows, to this share of its beam."""
_TIGHTEST = 0.5  # of the turning radius: what is tighter takes longer
_ROUNDED_M, _ROUNDED_SHARE = 0.5, 0.25  # corners, for contact: at most, and of the beam


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight or an arc from begin_s on: from a place and a heading over a length, turning clockwise."""

    begin_s: float
    duration_s: float
    from_ne_m: Point
    heading_rad: float
    length_m: float
    turn_rad: float = 0.0

    def after(self, share: float) -> tuple[Point, float]:
        """Place and heading after a share of it; the chord of an arc a is sin(a / 2) / (a / 2) of its length."""
        half = 0.5 * share * self.turn_rad
        chord_m = share * self.length_m * (math.sin(half) / half if half else 1.0)
        course = self.heading_rad + half
        north, east = self.from_ne_m
        return (north + chord_m * math.cos(course), east + chord_m * math.sin(course)), course + half


@dataclass(frozen=True, slots=True)
class ScriptedTrack:
    """Pieces one after the other, the first at start_s, at rest before and after.

    lap_s: from the first piece's begin to where a way round joins it that is gone again and again, None for none.
    """

    pieces: tuple[Piece, ...]
    start_s: float
    lap_s: float | None

    @classmethod
    def at_rest(cls, place_ne_m: Point, heading_rad: float) -> ScriptedTrack:
        """Of what lies still."""
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
        """Through two places or more, each elsewhere than the one before; loop: from the last to the first, and on."""
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
        """From start_s to the end of the last piece."""
        return self.pieces[-1].begin_s + self.pieces[-1].duration_s

    def at(self, time_s: float) -> tuple[Point, float, float, float]:
        """Place, heading, speed and turning rate at an instant."""
        since_s = time_s - self.start_s
        if self.lap_s is not None and since_s >= self.end_s:
            since_s = self.lap_s + math.fmod(since_s - self.lap_s, self.end_s - self.lap_s)
        under_way = 0.0 <= since_s < self.end_s
        since_s = min(max(since_s, 0.0), self.end_s)
        piece = self.pieces[max(bisect_right(self.pieces, since_s, key=lambda each: each.begin_s) - 1, 0)]
        if not piece.duration_s:
            return *piece.after(1.0), 0.0, 0.0
        place, heading = piece.after(min((since_s - piece.begin_s) / piece.duration_s, 1.0))
        if not under_way:
            return place, heading, 0.0, 0.0
        return place, heading, piece.length_m / piece.duration_s, piece.turn_rad / piece.duration_s


def _corner(turn_rad: float, turn_radius_m: float, room_m: float) -> tuple[float, float]:
    """How far before and behind a corner its arc begins and ends, and the radius of the arc."""
    if not turn_rad:
        return 0.0, 0.0
    tangent = math.tan(0.5 * turn_rad)
    cut_m = min(turn_radius_m * (tangent if turn_rad < 0.5 * math.pi else math.sin(turn_rad)), room_m)
    return cut_m, cut_m / tangent


@dataclass(frozen=True, slots=True, eq=False)
class ScriptedVessel:
    """A vessel that keeps to its track: a pontoon as long, wide, deep and high as it says, with a narrower bow.

    In its own axes, forward, right and down about its middle at the waterline: mesh, plan_m (P, 2) forward and right of
    its corners clockwise, and the outline that is run into. down_m: of the still water.
    """

    name: str
    track: ScriptedTrack
    mesh: Mesh
    plan_m: Array
    outline: Outline
    down_m: float

    @classmethod
    def from_spec(cls, name: str, spec: TrafficSpec, water_level_m: float = 0.0) -> ScriptedVessel:
        """Rounds corners by an arc of its length."""
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


def scripted_motion(vessels: Sequence[ScriptedVessel], time_s: float) -> Kinematics:
    """Of T vessels, upright on the still water."""
    count = len(vessels)
    place, velocity, change, euler, gyro, turning = np.zeros((6, count, 3))
    for row, vessel in enumerate(vessels):
        (north_m, east_m), heading, speed_mps, rate_radps = vessel.track.at(time_s)
        ahead = np.array([math.cos(heading), math.sin(heading)])
        place[row] = north_m, east_m, vessel.down_m
        velocity[row, :2] = speed_mps * ahead
        change[row, :2] = speed_mps * rate_radps * np.array([-ahead[1], ahead[0]])
        euler[row, 2], gyro[row, 2] = heading, rate_radps
    quat = euler_to_quat(euler)
    return Kinematics(place, velocity, change, quat, quat_to_matrix(quat), gyro, turning)
