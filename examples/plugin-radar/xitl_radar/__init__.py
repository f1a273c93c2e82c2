"""A marine radar: once a scan, the nearest echo of each beam, joined into targets."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from foxglove import messages

from sim_core.frames import Array
from sim_core.keys import Bounds, NonNegative, Positive, Specification, SpecificationError
from sim_core.world.debris import capsules_of
from sim_core.world.plan import Capsules, box_capsules
from xitl_cli.plugin import NodeContext, NodeKind
from xitl_cli.record.cdr import Float64, Int64
from xitl_cli.record.recorder import timestamp
from xitl_cli.record.topics import MAP_FRAME, Topic, vessel_name
from xitl_cli.run.core.node import RunContext, RunNode, RunStep

XITL_INTERFACE = 1
CELL_M = 1.0
"""Resolution in range. Echoes of neighbouring beams are one target when their ranges differ by less than two cells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RadarKeys(Specification):
    """A marine radar."""

    scan_s: Annotated[Positive, "time of one turn"] = 2.0
    range_m: Annotated[Positive, Bounds(at_most=5000), "largest range"] = 200.0
    minimum_range_m: Annotated[NonNegative, "nearer echoes are lost in the transmitted pulse"] = 5.0
    beam_deg: Annotated[float, Bounds(at_least=0.5, at_most=20), "horizontal width of the beam"] = 4.0
    range_noise_m: Annotated[NonNegative, "standard deviation"] = 0.5
    bearing_noise_deg: Annotated[NonNegative, "standard deviation"] = 0.5
    guard_m: Annotated[Positive, "radius of the guard zone; the log analysis warns of targets inside"] = 20.0

    def check(self) -> None:
        if self.minimum_range_m >= self.range_m:
            raise SpecificationError(("minimum_range_m",), "is not below range_m; use a smaller value")


@dataclass(frozen=True, slots=True)
class RadarTarget:
    """A target of a scan, relative to the vessel."""

    scan: Int64
    range_m: Float64
    bearing_deg: Annotated[float, "float64", "from the bow, -180 to 180, positive to starboard"]
    guard_m: Annotated[float, "float64", "radius of the guard zone"]


class Radar(RunNode):
    """Measures and records the targets of one vessel."""

    def __init__(self, keys: RadarKeys, context: NodeContext) -> None:
        self._keys, self._context = keys, context
        self._every = max(round(keys.scan_s * context.profile.clock.physics_rate_hz), 1)
        self._beams = round(360.0 / keys.beam_deg)
        scenery = context.scenery
        still = [] if scenery.boom is None else scenery.boom.capsules(scenery.water_down_m)
        for box in scenery.boxes:
            centre, size = box.centre_m.tolist(), box.size_m.tolist()
            heading_rad = math.atan2(box.rotation[1, 0], box.rotation[0, 0])
            still.append(box_capsules("", (centre[0], centre[1]), (size[0], size[1]), heading_rad))
        self._still = _outline(Capsules.joined(still))
        self._scans = 0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def sense(self, step: RunStep) -> None:
        if step.number % self._every:
            return
        keys, rng = self._keys, self._context.rng
        forward_ned, place_ne_m = step.motion.rot_ned_frd[0, :, 0], step.motion.pos_ned_m[0, :2]
        heading_rad = math.atan2(forward_ned[1], forward_ned[0])
        self._scans += 1
        drawn = []
        for exact_m, exact_rad in self._echoes(place_ne_m, heading_rad):
            range_m = exact_m + keys.range_noise_m * rng.standard_normal()
            bearing_rad = exact_rad + math.radians(keys.bearing_noise_deg) * rng.standard_normal()
            bearing_deg = math.degrees(math.remainder(bearing_rad, math.tau))
            self._recorder.write(step.now_ns, RadarTarget(self._scans, range_m, bearing_deg, keys.guard_m))
            toward = np.array([math.cos(heading_rad + bearing_rad), math.sin(heading_rad + bearing_rad)])
            drawn.append(place_ne_m + range_m * toward)
        self._recorder.scene(self._drawing(drawn, step.now_ns), step.now_ns)

    def report(self) -> dict[str, Any]:
        return {"scans": self._scans}

    def _echoes(self, place_ne_m: Array, heading_rad: float) -> Iterator[tuple[float, float]]:
        """Range, and bearing from the bow, of each target, without noise."""
        keys, plant = self._keys, self._context.plant
        parts = [self._still, _outline(capsules_of(plant.state.debris))]
        if plant.hulls is not None:
            sides = plant.hulls(keys.range_m)
            thin = np.zeros(len(sides.from_ne_m))
            parts.append(_outline(Capsules(sides.from_ne_m, sides.from_ne_m + sides.span_ne_m, thin, ())))
        points = np.concatenate(parts)
        north_m, east_m = (points[:, :2] - place_ne_m).T
        range_m = np.hypot(north_m, east_m) - points[:, 2]
        bearing_rad = (np.arctan2(east_m, north_m) - heading_rad) % math.tau
        # The nearest echo of each beam: of the banks, then of the points, the farthest first.
        nearest_m, toward_rad = self._banks(place_ne_m, heading_rad)
        beam = (bearing_rad * self._beams / math.tau).astype(int) % self._beams
        seen = (range_m >= keys.minimum_range_m) & (range_m <= keys.range_m) & (range_m < nearest_m[beam])
        order = np.flatnonzero(seen)[np.argsort(-range_m[seen])]
        nearest_m[beam[order]], toward_rad[beam[order]] = range_m[order], bearing_rad[order]
        # Neighbouring beams with an echo at one range are one target, at its nearest point.
        lit = np.isfinite(nearest_m)
        flat = np.where(lit, nearest_m, -10.0 * CELL_M)
        joined = lit & np.roll(lit, 1) & (np.abs(flat - np.roll(flat, 1)) < 2.0 * CELL_M)
        target = np.cumsum(~joined)
        if joined[0]:  # across the bow
            target[target == target[0]] = target[-1]
        for number in np.unique(target[lit]):
            beams = np.flatnonzero(lit & (target == number))
            best = beams[np.argmin(nearest_m[beams])]
            yield float(nearest_m[best]), float(toward_rad[best])

    def _banks(self, place_ne_m: Array, heading_rad: float) -> tuple[Array, Array]:
        """(B,) range to dry ground in the middle of each beam, inf for none, and (B,) bearing of the beam."""
        scenery = self._context.scenery
        toward_rad = (np.arange(self._beams) + 0.5) * math.tau / self._beams
        range_m = np.arange(self._keys.minimum_range_m, self._keys.range_m, CELL_M)
        ahead = np.stack([np.cos(toward_rad + heading_rad), np.sin(toward_rad + heading_rad)], axis=-1)
        places = place_ne_m + range_m[None, :, None] * ahead[:, None]
        dry = scenery.bed.bed_down_m(places) < scenery.water_down_m
        return np.where(dry.any(axis=1), range_m[dry.argmax(axis=1)], np.inf), toward_rad

    def _drawing(self, places_ne_m: list[Array], now_ns: int) -> messages.SceneUpdate:
        """A ball at each target until the next scan, in the map (east, north, up)."""
        size, colour = messages.Vector3(x=1.5, y=1.5, z=1.5), messages.Color(r=1.0, g=0.3, b=0.1, a=0.8)
        balls = []
        for north_m, east_m in places_ne_m:
            place = messages.Vector3(x=float(east_m), y=float(north_m), z=1.0 - self._context.scenery.water_down_m)
            pose = messages.Pose(position=place, orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
            balls.append(messages.SpherePrimitive(pose=pose, size=size, color=colour))
        entity = messages.SceneEntity(
            timestamp=timestamp(now_ns),
            frame_id=MAP_FRAME,
            id=vessel_name("radar", self._context.profile.vessel),
            lifetime=messages.Duration.from_secs(self._keys.scan_s),
            spheres=balls,
        )
        return messages.SceneUpdate(entities=[entity])


def _outline(shapes: Capsules) -> Array:
    """(P, 3) points on the axes of shapes, half a cell apart: north, east, radius."""
    points = [np.empty((0, 3))]
    for start, end, radius_m in zip(shapes.from_ne_m, shapes.to_ne_m, shapes.radius_m, strict=True):
        share = np.linspace(0.0, 1.0, 2 + int(np.hypot(*(end - start)) / (0.5 * CELL_M)))[:, None]
        points.append(np.column_stack([start + share * (end - start), np.full(len(share), radius_m)]))
    return np.concatenate(points)


TARGETS = Topic("/radar/targets", "xitl_radar_msgs/msg/Target", "each target", "targets of the radar", RadarTarget)
KIND = NodeKind(RadarKeys, Radar, (TARGETS,))
