"""The radar in a run: keeps the motion during a sector, scans it in a thread after its end, and draws the turn."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy import uint8
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from agent.wire.codec import Message
from sim_core.dataclass import dataclass
from sim_core.kinematics import Kinematics
from sim_core.sensors.lidar import BodyTrack
from sim_core.sensors.radar import FIRST_ANGLE_RAD, MarineRadar, RadarSector, RadarSurroundings
from sim_core.sensors.radar_clutter import sea_state
from sim_core.sensors.radar_plots import find_plots
from sim_core.sensors.radar_targets import ScatterPoints, mesh_points, reflector_points, vessel_points
from sim_core.sensors.spec import REFLECTOR_SECTIONS_M2, SECTORS, MarineRadarSpec
from sim_core.world.geometry import Mesh
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import PerceptionRecorder
from xitl_cli.record.topics import RadarPlot
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.world.plant import PlantView
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

_FASTEST = 1  # speckle compresses badly anyway


class RadarPicture:
    """Pictures of size_px by size_px pixels. The vessel is in the middle, and the range is half of the size."""

    def __init__(self, radar: MarineRadar, size_px: int) -> None:
        self._size_px = size_px
        across = np.arange(size_px) + 0.5 - 0.5 * size_px
        right, ahead = across[None, :], -across[:, None]
        number = np.hypot(right, ahead) / (0.5 * size_px) * radar.spec.bins
        spoke = np.rint((np.arctan2(right, ahead) - FIRST_ANGLE_RAD) % math.tau / radar.step_rad)
        self._outside = number >= radar.spec.bins
        self._number = np.where(self._outside, 0, number).astype(np.intp)
        self._spoke = spoke.astype(np.intp) % radar.spec.spokes

    def png(self, intensity: NDArray[uint8]) -> bytes:
        """Return the file of a turn with intensities (spokes, bins)."""
        pixels = np.where(self._outside, uint8(0), intensity[self._spoke, self._number])
        rows = np.pad(pixels, ((0, 0), (1, 0)))  # filter 0 before each row
        header = struct.pack(">IIBBBBB", self._size_px, self._size_px, 8, 0, 0, 0, 0)
        data = zlib.compress(rows.astype(uint8).tobytes(), _FASTEST)
        return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


FIXED_SPACING_M, BODY_SPACING_M = 2.0, 0.5
"""Largest distance between scattering points of fixed structures, and of vessels and drifting bodies."""

TILE_M = 40.0
"""Size of the squares by which fixed points are looked up."""


class RadarWorld:
    """Everything around a vessel that the radar can see."""

    def __init__(self, profile: RunProfile, spec: MarineRadarSpec, scenery: Scenery, plant: PlantView) -> None:
        self._spec, self._scenery, self._plant = spec, scenery, plant
        environment = profile.environment
        state = spec.sea_state
        if state is None:
            state = sea_state(environment.waves, environment.wind.mean_mps)
        waves = environment.waves
        # Ground that stays under water is left out
        self._lowest_m = 0.0 if environment.water.tide is None else 20.0
        self._weather = RadarSurroundings(
            sea_state=state,
            wind_from_rad=math.radians(environment.wind.direction_deg),
            waves_from_rad=math.radians(waves.direction_deg) + math.pi,
            wave_height_m=0.0 if waves.spectrum == "none" else waves.significant_height_m,
            rain_mmph=environment.rain_mmph,
        )
        self._shapes: dict[tuple[int, bool], tuple[Mesh, ScatterPoints]] = {}

    def now(self) -> RadarSurroundings:
        """Return the surroundings at the latest step."""
        plant = self._plant
        water_down_m = self._scenery.water_down_m - plant.tide_m()
        bodies, debris = plant.bodies(), plant.state.debris.bodies
        poses = zip(bodies.meshes, bodies.pos_ned_m, bodies.rot_ned_body, strict=True)
        moving = [
            self._shape(mesh, vessel=number >= len(debris)).moved(place, turned)
            for number, (mesh, place, turned) in enumerate(poses)
        ]
        places, sections = [], []
        for reflector in self._spec.reflectors:
            section_m2, height_m = REFLECTOR_SECTIONS_M2[reflector.kind]
            height_m = height_m if reflector.height_m is None else reflector.height_m
            places.append((*reflector.place_ne_m, water_down_m - height_m))
            sections.append(section_m2 if reflector.cross_section_m2 is None else reflector.cross_section_m2)
        for body, place in zip(debris, bodies.pos_ned_m, strict=False):
            if body.buoy is not None and body.buoy.reflector_m2:
                top_m = float(body.mesh.vertices_m[:, 2].min())
                places.append((*place[:2].tolist(), float(place[2]) + top_m))
                sections.append(body.buoy.reflector_m2)
        parts = (*self._fixed, *moving, reflector_points(np.array(places).reshape(-1, 3), np.array(sections)))
        return replace(self._weather, points=parts, water_down_m=water_down_m)

    @cached_property
    def _fixed(self) -> list[ScatterPoints]:
        lowest_down_m = self._scenery.water_down_m + self._lowest_m
        parts = [
            mesh_points(part.mesh, FIXED_SPACING_M, water_down_m=lowest_down_m) for part in self._scenery.scene.parts
        ]
        return ScatterPoints.joined(parts).above(lowest_down_m).tiles(TILE_M)

    def _shape(self, mesh: Mesh, vessel: bool) -> ScatterPoints:
        key = id(mesh), vessel
        if key not in self._shapes:
            points = vessel_points(mesh, BODY_SPACING_M) if vessel else mesh_points(mesh, BODY_SPACING_M, afloat=True)
            self._shapes[key] = mesh, points  # the mesh too, so that its id is not used again
        return self._shapes[key][1]


@dataclass(frozen=True, slots=True)
class ScannedSector:
    """Results of a sector. The last one of a turn has its plots, and its picture if there are pictures."""

    start_ns: int
    sector: RadarSector
    plots: tuple[RadarPlot, ...] = ()
    png: bytes | None = None


class RadarProcessor:
    """Scans sector after sector, and finds the plots of each turn."""

    def __init__(self, radar: MarineRadar, rng: Generator) -> None:
        self._radar = radar
        self._rng = rng
        self._state = radar.initial()
        picture_px = radar.spec.picture_px
        self._picture = None if picture_px is None else RadarPicture(radar, picture_px)
        self._turn: list[ScannedSector] = []

    def scan(self, track: BodyTrack, start_ns: int, around: RadarSurroundings) -> ScannedSector:
        """Return the sector that began at start_ns."""
        first_s = (start_ns - int(track.stamps_ns[0])) * 1e-9
        self._state, sector = self._radar.scan(self._state, track, first_s, around, self._rng)
        scanned = ScannedSector(start_ns, sector)
        self._turn.append(scanned)
        if sector.number < SECTORS - 1:
            return scanned
        turn, self._turn = self._turn, []
        png = None
        if self._picture is not None:
            png = self._picture.png(np.concatenate([part.sector.intensity for part in turn]))
        return ScannedSector(start_ns, sector, tuple(self._plots(turn)), png)

    def _plots(self, turn: list[ScannedSector]) -> Iterator[RadarPlot]:
        radar = self._radar
        for plot in find_plots(radar, np.concatenate([part.sector.power for part in turn])):
            own = turn[plot.spoke // radar.sector_spokes]
            yield RadarPlot(
                own.sector.turn,
                own.start_ns + round(plot.spoke % radar.sector_spokes * radar.spoke_s * 1e9),
                plot.range_m,
                plot.bearing_rad,
                (own.sector.heading_rad + plot.bearing_rad) % math.tau,
                plot.strength_db,
                plot.length_m,
                plot.width_rad,
                plot.samples,
            )


class RadarInstrument:
    """The radar of a vessel. The first spoke is at the first physics step.

    A thread processes a sector while the physics continues. Its results are recorded at the end of the next sector, in
    every run alike. A run therefore does not record its last sector.
    """

    def __init__(self, spec: MarineRadarSpec, world: RadarWorld, rng: Generator) -> None:
        self._radar = MarineRadar(spec)
        self._processor = RadarProcessor(self._radar, rng)
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._world = world
        self._recorder: PerceptionRecorder | None = None
        self._motions: list[tuple[int, Kinematics]] = []
        self._begin_ns: int | None = None
        self._number = 0
        self._pending: Future[ScannedSector] | None = None
        self._turns = self._plots = 0

    @property
    def address(self) -> str | None:
        """None: the radar has no line for clients."""
        return None

    def begin(self, recorder: PerceptionRecorder) -> None:
        """Start the run; the recorder stores sectors and plots."""
        self._recorder = recorder

    def update(self, step: RunStep) -> list[Message]:
        """Begin to scan a sector that has ended. The companion gets no messages from the radar."""
        if self._begin_ns is None:
            self._begin_ns = step.now_ns
        self._motions.append((step.now_ns, step.motion))
        if len(self._motions) > 1 and step.now_ns >= self._start_ns(self._number + 1):
            self._keep()
            track = BodyTrack(
                np.array([stamp_ns for stamp_ns, _ in self._motions]),
                np.array([motion.pos_ned_m[0] for _, motion in self._motions]),
                np.array([motion.rot_ned_frd[0] for _, motion in self._motions]),
            )
            start_ns, around = self._start_ns(self._number), self._world.now()
            self._pending = self._thread.submit(self._processor.scan, track, start_ns, around)
            self._number += 1
            self._motions = self._motions[-2:]
        return []

    def report(self) -> dict[str, Any]:
        """Return `turns`: complete turns; `plots`: plots found in them."""
        return {"turns": self._turns, "plots": self._plots}

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)

    def _start_ns(self, sector: int) -> int:
        assert self._begin_ns is not None
        return self._begin_ns + round(sector * self._radar.sector_s * 1e9)

    def _keep(self) -> None:
        """Record the results of the sector before."""
        if self._pending is None:
            return
        scanned = self._pending.result()
        recorder, end_ns = self._recorder, self._start_ns(self._number)
        self._turns += scanned.sector.number == SECTORS - 1
        self._plots += len(scanned.plots)
        if recorder is None:
            return
        recorder.radar_sector(scanned.start_ns, self._radar, scanned.sector)
        if scanned.png is not None:
            recorder.radar_picture(end_ns, scanned.png)
        for plot in scanned.plots:
            recorder.radar_plot(end_ns, plot)


def make_radar(profile: RunProfile, seeds: Seeds, scenery: Scenery, plant: PlantView) -> RadarInstrument:
    """Return the radar of the profile. The profile must have one."""
    assert profile.sensors is not None
    assert profile.sensors.radar is not None
    spec = profile.sensors.radar
    return RadarInstrument(spec, RadarWorld(profile, spec, scenery, plant), default_rng(seeds.sequence("radar")))
