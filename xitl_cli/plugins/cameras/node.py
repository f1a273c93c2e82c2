"""The cameras of a vessel in a run: when each exposes, what it sees then, and where its images go."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, field
from datetime import UTC, timedelta
from heapq import heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np
from foxglove import messages
from numpy.random import Generator, default_rng

from sim_core import frames
from sim_core.dataclass import dataclass
from sim_core.environment.sun import sun_direction_ned
from sim_core.environment.tide_spec import instant_utc
from sim_core.frames import Array
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.lens import Lens
from xitl_cli.errors import UserError
from xitl_cli.plugin import NodeContext
from xitl_cli.plugins.cameras.daylight import Daylight, daylight, visible_extinction_per_m
from xitl_cli.plugins.cameras.detector import DetectorScore
from xitl_cli.plugins.cameras.gimbal import Gimbal
from xitl_cli.plugins.cameras.image_sensor import ImageResponse
from xitl_cli.plugins.cameras.images import (
    DETECTIONS,
    FRAMES,
    TRUTH,
    Box,
    CameraFrame,
    CameraImage,
    CameraTruth,
    ObjectClass,
    annotations_topic,
    calibration_topic,
    image_topic,
)
from xitl_cli.plugins.cameras.mavlink_camera import GimbalAngles
from xitl_cli.plugins.cameras.models import TriangleModel, body_model, hull_model, vessel_model, world_model
from xitl_cli.plugins.cameras.outputs import CameraOutputs, StreamServers
from xitl_cli.plugins.cameras.rain import Rain
from xitl_cli.plugins.cameras.remote_studio import RemoteStudio
from xitl_cli.plugins.cameras.renderer import DrawnWorld, FoamTrail, PlacedModel, Shot, Viewpoint
from xitl_cli.plugins.cameras.studio import Commission, lens_of
from xitl_cli.record.topics import CameraDetection, vessel_name
from xitl_cli.record.truth import timestamp
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.world.colours import water_reflectance

WORLD, OWN = "world", "own vessel"
UNKNOWN = math.nan, math.nan
MOST_WAITING = 3
"""Images that may be under way in real time. More are skipped and counted."""
MOST_SHOTS, MOST_BANDS = 6, 12
BLUR_PX = 1.0
"""Motion in an image that one shot may show."""
OVERLAP_S = 0.5
"""In lockstep, an image that nobody reads during the run is recorded this time after its stamp, so that the run goes on
while it is drawn."""
USUAL_SUN_DEG = (35.0, 140.0)
"""Elevation and azimuth of the sun without a time."""
WAKE_S, WAKE_STEP_S = 25.0, 0.4


@dataclass(slots=True)
class CameraCounts:
    """What became of the images of one camera."""

    images: int = 0
    lost: int = 0
    """By `drop_share`."""
    skipped: int = 0
    """In real time, because the machine could not draw them in time."""
    missing: int = 0
    """The process that draws had ended."""
    unfinished: int = 0
    """Under exposure when the run ended."""
    late: int = 0
    """Delivered later than `latency_s` in real time."""


@dataclass(slots=True)
class Mounted:
    """A camera on its vessel, and its state."""

    keys: CameraSpec
    lens: Lens
    gimbal: Gimbal
    every: int
    """Physics steps between two images."""
    window_ns: int
    """Half of exposure and readout."""
    latency_ns: int
    rng: Generator
    counts: CameraCounts = field(default_factory=CameraCounts)
    score: DetectorScore = field(default_factory=DetectorScore)
    exposing: deque[tuple[int, int]] = field(default_factory=deque)
    """Number and time stamp of the images whose exposure has not ended."""
    number: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """The vessel at an instant."""

    stamp_ns: int
    pos_ned_m: Array
    rot_ned_frd: Array
    vel_ned_mps: Array


class CameraNode(RunNode):
    """The cameras of one vessel. Images are drawn in another process and are here after their latency."""

    def __init__(self, keys: Sequence[CameraSpec], context: NodeContext) -> None:
        profile = context.profile
        self._context = context
        self._physics_hz = profile.clock.physics_rate_hz
        self._lockstep = profile.clock.mode == "lockstep"
        self._cameras = {camera.name: self._mounted(camera) for camera in keys}
        self._blurs = any(camera.window_ns for camera in self._cameras.values())
        periods = [camera.every for camera in self._cameras.values()]
        delays = [round(camera.latency_ns * 1e-9 * self._physics_hz) for camera in self._cameras.values()]
        self.sense_every = 1 if self._blurs else math.gcd(*periods, *delays)
        self._sun_start = None if profile.environment.start_utc is None else instant_utc(profile.environment.start_utc)
        self._poses: deque[Pose] = deque()
        self._wake: deque[tuple[int, Array, float, float]] = deque()
        """Time, place, heading and speed of the vessel on its way."""
        self._due: list[tuple[int, int, str]] = []
        """Heap of the images under way: when they are due, their tickets, their cameras."""
        self._mounts: dict[int, Array] = {}
        """Rotations from optical to body axes at the exposures of the images under way, by ticket."""
        self._light: tuple[int, Daylight] | None = None
        self._listeners: list[Callable[[CameraImage], None]] = []
        self._problems: list[str] = []
        self._models: dict[str, TriangleModel] = {}
        alone = not profile.vessel  # vessels of a fleet have their own processes, which fill the processors
        self._studio = RemoteStudio(keys, self._problems.append, by_turns=self._lockstep and alone)
        servers = StreamServers.of_run(context.scenery)
        self._outputs = CameraOutputs(keys, profile, servers, context.components_url, self.point, self._angles)
        if any(camera.serve is not None for camera in keys):
            self.subscribe(self._outputs.show)

    def subscribe(self, listener: Callable[[CameraImage], None]) -> None:
        """Call `listener` with each image when it is available."""
        self._listeners.append(listener)

    def point(self, camera: str, pitch_deg: float, yaw_deg: float) -> None:
        """Command the gimbal of a camera: see Gimbal.command."""
        self._cameras[camera].gimbal.command(pitch_deg, yaw_deg)

    def _angles(self, camera: str) -> GimbalAngles:
        gimbal = self._cameras[camera].gimbal
        return GimbalAngles(gimbal.pitch_deg, gimbal.yaw_deg)

    def prepare(self) -> None:
        self._refuse_hidden()
        self._outputs.prepare()
        context = self._context
        vessel = context.profile.vessel or context.profile.name
        self._models = {
            WORLD: world_model(context.scenery, context.plant.simulation.environment.tide.bounds_m[0]),
            OWN: vessel_model(
                context.profile.vehicle, context.profile.environment.water, vessel, ObjectClass.OWN_VESSEL
            ),
        }
        self._studio.start(self._models, still=(WORLD,))

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder
        for topic in (FRAMES, TRUTH, DETECTIONS):
            self._recorder.add_topic(topic)
        for camera in self._cameras.values():
            for topic in (image_topic(camera.keys.name, camera.keys.kind), calibration_topic(camera.keys.name)):
                self._recorder.add_topic(topic)
            if camera.keys.truth:
                self._recorder.add_topic(annotations_topic(camera.keys.name))

    def sense(self, step: RunStep) -> None:
        now_ns, motion = step.now_ns, step.motion
        pose = Pose(now_ns, motion.pos_ned_m[0], motion.rot_ned_frd[0], motion.vel_ned_mps[0])
        self._poses.append(pose)
        self._leave_wake(pose)
        dt_s = self.sense_every / self._physics_hz
        for camera in self._cameras.values():
            camera.gimbal.advance(dt_s)
            if step.number % camera.every == 0:
                self._expose(camera, now_ns)
            while camera.exposing and camera.exposing[0][1] + camera.window_ns <= now_ns:
                self._commission(camera, *camera.exposing.popleft())
        oldest_ns = now_ns - 2 * max(camera.window_ns for camera in self._cameras.values()) - 1
        while len(self._poses) > 1 and self._poses[1].stamp_ns < oldest_ns:
            self._poses.popleft()
        self._deliver(now_ns)

    def exchange(self, step: RunStep) -> None:
        self._outputs.poll(step.now_ns)

    def end(self) -> None:
        """Record the images that are still under way."""
        while self._due:
            self._hand_over(*heappop(self._due)[1:])
        for camera in self._cameras.values():
            camera.counts.unfinished += len(camera.exposing)
            camera.exposing.clear()

    def close(self) -> None:
        self._outputs.close()
        self._studio.close()

    def report(self) -> dict[str, Any]:
        figures = self._studio.figures
        cameras = {
            name: {
                **asdict(camera.counts),
                **({"detector": camera.score.report()} if camera.keys.detector is not None else {}),
            }
            for name, camera in self._cameras.items()
        }
        return {
            "cameras": {
                "renderer": figures.device,
                "processor_ms_per_image": figures.processor_ms_per_image,
                "by_name": cameras,
                **self._outputs.report(),
            },
            "warnings": [*self._problems, *self._slowness(figures.processor_ms_per_image)],
        }

    def _slowness(self, drawing_ms: float) -> Iterator[str]:
        """Yield a sentence for each camera whose images this machine could not draw in time."""
        for name, camera in self._cameras.items():
            if camera.counts.skipped:
                yield (
                    f"camera {name}: {camera.counts.skipped} of {camera.number} images were skipped, as one needs "
                    f"{drawing_ms:.0f} ms of processor time here; lower its rate_hz, width_px and height_px"
                )

    def _refuse_hidden(self) -> None:
        """Raise UserError for a camera inside a hull, by the box around the hull."""
        profile = self._context.profile
        for number, camera in enumerate(self._cameras.values()):
            place = np.array(camera.keys.position_frd_m)
            for hull in profile.vehicle.demi_hulls:
                middle = np.array(hull.keel_frd_m) - [0.0, 0.0, 0.5 * hull.height_m]
                size = np.array([hull.length_m, hull.width_m, hull.height_m])
                if (np.abs(place - middle) < 0.5 * size).all():
                    top_m = hull.keel_frd_m[2] - hull.height_m
                    raise UserError(
                        f"{profile.name}: sensors.cameras.{number}.position_frd_m = {place.tolist()} is inside a hull; "
                        f"use a down coordinate below {top_m:.2f}"
                    )

    # Exposure

    def _mounted(self, camera: CameraSpec) -> Mounted:
        return Mounted(
            camera,
            lens_of(camera),
            Gimbal(camera),
            round(self._physics_hz / camera.rate_hz),
            round(0.5e9 * (camera.exposure.time_s + camera.exposure.readout_s)) if camera.kind == "colour" else 0,
            round(camera.latency_s * 1e9),
            default_rng(self._context.seeds.sequence(f"camera {camera.name}")),
        )

    def _expose(self, camera: Mounted, now_ns: int) -> None:
        """Begin an image. Its time stamp is the middle of its exposure, which begins now."""
        camera.number += 1
        if camera.rng.random() < camera.keys.drop_share:
            camera.counts.lost += 1
            return
        if not self._lockstep and self._studio.waiting >= MOST_WAITING * len(self._cameras):
            camera.counts.skipped += 1
            return
        camera.exposing.append((camera.number, now_ns + camera.window_ns))

    def _commission(self, camera: Mounted, number: int, stamp_ns: int) -> None:
        grain_at = camera.rng.integers(0, 512, 2).tolist()
        seed = int(camera.rng.integers(1 << 62))
        middle, shots = self._shots(camera, stamp_ns, seed)
        exposure = camera.keys.exposure
        light = middle.world.light
        ticket = self._studio.submit(
            Commission(
                camera=camera.keys.name,
                number=number,
                stamp_ns=stamp_ns,
                shots=shots,
                middle=middle,
                response=ImageResponse(
                    exposure=light.exposure * 2.0**exposure.compensation_ev,
                    vignetting=camera.keys.lens.vignetting,
                    read_noise=exposure.read_noise,
                    shot_noise=exposure.shot_noise,
                    grain_at=(grain_at[0], grain_at[1]),
                ),
                noise_seed=seed,
            )
        )
        self._mounts[ticket] = self._pose(stamp_ns).rot_ned_frd.T @ middle.view.rot_ned_optical
        delay_ns = max(camera.latency_ns, camera.window_ns)
        if self._lockstep and not self._read_in_run(camera.keys):
            delay_ns = max(delay_ns, round(OVERLAP_S * 1e9))
        heappush(self._due, (stamp_ns + delay_ns, ticket, camera.keys.name))

    def _read_in_run(self, camera: CameraSpec) -> bool:
        """Whether anything in the run reads the images of a camera or their records."""
        topics = [FRAMES.name, TRUTH.name, image_topic(camera.name, camera.kind).name]
        topics += [calibration_topic(camera.name).name, annotations_topic(camera.name).name]
        topics += [DETECTIONS.name] if camera.detector is not None else []
        return bool(self._listeners) or self._recorder.read_in_run(*topics)

    def _shots(self, camera: Mounted, stamp_ns: int, seed: int) -> tuple[Shot, tuple[Shot, ...]]:
        """Return the shot at the time stamp, and those that together make the image: rows by time, each with blur.

        seed: of the drops of rain.
        """
        exposure, height = camera.keys.exposure, camera.lens.height_px
        mmph = self._context.profile.environment.rain_mmph if camera.keys.kind == "colour" else 0.0
        velocity = self._pose(stamp_ns).vel_ned_mps
        rain = Rain(mmph, exposure.time_s, exposure.time_s, 0.0, velocity, seed) if mmph else None
        middle = self._shot(camera, stamp_ns, rain=rain)
        if not camera.window_ns:
            return middle, (middle,)
        moved_px = self._motion_px(camera, stamp_ns)
        window_s = exposure.time_s + exposure.readout_s
        bands = int(np.clip(math.ceil(moved_px * exposure.readout_s / window_s / BLUR_PX), 1, MOST_BANDS))
        blurs = int(np.clip(math.ceil(moved_px * exposure.time_s / window_s / BLUR_PX), 1, MOST_SHOTS))
        edges = np.linspace(0, height, bands + 1).round().astype(int).tolist()
        shots = []
        for low, high in pairwise(edges):
            row_s = exposure.readout_s * (0.5 * (low + high) / height - 0.5)
            rows = (low, high) if bands > 1 else None
            for number in range(blurs):
                at_s = row_s + exposure.time_s * ((number + 0.5) / blurs - 0.5)
                rain = Rain(mmph, exposure.time_s, exposure.time_s / blurs, at_s, velocity, seed) if mmph else None
                shots.append(self._shot(camera, stamp_ns + round(at_s * 1e9), rows, 1.0 / blurs, rain))
        return middle, tuple(shots)

    def _motion_px(self, camera: Mounted, stamp_ns: int) -> float:
        """Return how far the image of a distant point moves during exposure and readout."""
        first, last = (self._pose(stamp_ns + sign * camera.window_ns).rot_ned_frd for sign in (-1, 1))
        turn = first.T @ last
        angle_rad = math.acos(float(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0)))
        return angle_rad * camera.lens.focal_px

    def _pose(self, stamp_ns: int) -> Pose:
        """Return the vessel between two recorded poses."""
        later = next((number for number, pose in enumerate(self._poses) if pose.stamp_ns >= stamp_ns), None)
        if later is None:
            return self._poses[-1]
        after = self._poses[later]
        if later == 0 or after.stamp_ns == stamp_ns:
            return after
        before = self._poses[later - 1]
        share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
        blended = before.rot_ned_frd + share * (after.rot_ned_frd - before.rot_ned_frd)
        left, _, right = np.linalg.svd(blended)  # the nearest rotation
        place = before.pos_ned_m + share * (after.pos_ned_m - before.pos_ned_m)
        return Pose(stamp_ns, place, left @ right, after.vel_ned_mps)

    def _shot(
        self,
        camera: Mounted,
        stamp_ns: int,
        rows: tuple[int, int] | None = None,
        share: float = 1.0,
        rain: Rain | None = None,
    ) -> Shot:
        pose = self._pose(stamp_ns)
        place = pose.pos_ned_m + pose.rot_ned_frd @ np.array(camera.keys.position_frd_m)
        view = Viewpoint(place, camera.gimbal.rot_ned_optical(pose.rot_ned_frd))
        return Shot(view, self._world(pose), rows, share, rain)

    def _world(self, pose: Pose) -> DrawnWorld:
        plant, environment = self._context.plant, self._context.plant.simulation.environment
        keys = self._context.profile.environment
        time_s = pose.stamp_ns * 1e-9
        wind = environment.wind.velocity_ned_mps(plant.state.environment.wind, time_s)[0, :2]
        return DrawnWorld(
            time_s=time_s,
            waves=environment.waves,
            water_down_m=self._context.scenery.water_down_m - environment.tide.height_m(time_s),
            wind_ne_mps=wind,
            light=self._light_at(pose.stamp_ns),
            extinction_per_m=visible_extinction_per_m(keys.visibility_m, keys.rain_mmph),
            water_colour=water_reflectance(keys.water_reflectivity),
            placed=self._placed(pose),
            foam=self._foam(pose),
        )

    def _light_at(self, stamp_ns: int) -> Daylight:
        """Return the light, renewed every ten seconds."""
        if self._light is None or stamp_ns >= self._light[0] + 10_000_000_000:
            profile = self._context.profile
            keys, site = profile.environment.light, profile.site
            elevation_deg, azimuth_deg = keys.sun_elevation_deg, keys.sun_azimuth_deg
            sun = np.array([0.0, 0.0, -1.0])
            if self._sun_start is not None:
                instant = self._sun_start.astimezone(UTC) + timedelta(seconds=stamp_ns * 1e-9)
                sun = sun_direction_ned(instant, site.latitude_deg, site.longitude_deg)
                by_time = math.degrees(-math.asin(sun[2])), math.degrees(math.atan2(sun[1], sun[0]))
            else:
                by_time = USUAL_SUN_DEG
            elevation = math.radians(by_time[0] if elevation_deg is None else elevation_deg)
            azimuth = math.radians(by_time[1] if azimuth_deg is None else azimuth_deg)
            across = math.cos(elevation)
            sun = np.array([across * math.cos(azimuth), across * math.sin(azimuth), -math.sin(elevation)])
            self._light = stamp_ns, daylight(sun, keys.clouds)
        return self._light[1]

    def _placed(self, pose: Pose) -> tuple[PlacedModel, ...]:
        """Return world, vessel and moving bodies at their places; a new body becomes a model first."""
        placed = [PlacedModel(WORLD, np.zeros(3), np.eye(3), 1)]
        number = 1 + len(self._models[WORLD].objects)
        placed.append(PlacedModel(OWN, pose.pos_ned_m, pose.rot_ned_frd, number))
        number += 1
        plant = self._context.plant
        bodies = plant.bodies()
        debris = plant.state.debris.bodies
        others = plant.others
        behind_s = (plant.state.time_ns - pose.stamp_ns) * 1e-9
        for index, mesh in enumerate(bodies.meshes):
            drifts = index < len(debris)
            name = f"body {index}" if drifts else others[index - len(debris)]
            if name not in self._models:
                self._models[name] = body_model(name, debris[index]) if drifts else hull_model(name, mesh)
                self._studio.add(name, self._models[name])
            place = bodies.pos_ned_m[index] - behind_s * bodies.vel_ned_mps[index]
            placed.append(PlacedModel(name, place, bodies.rot_ned_body[index], number))
            number += 1
        return tuple(placed)

    def _leave_wake(self, pose: Pose) -> None:
        if not self._wake or pose.stamp_ns >= self._wake[-1][0] + round(WAKE_STEP_S * 1e9):
            ahead, speed_mps = pose.rot_ned_frd[:2, 0], float(np.hypot(*pose.vel_ned_mps[:2]))
            self._wake.append((pose.stamp_ns, pose.pos_ned_m[:2], math.atan2(ahead[1], ahead[0]), speed_mps))
            if pose.stamp_ns - self._wake[0][0] > WAKE_S * 1e9:
                self._wake.popleft()

    def _foam(self, pose: Pose) -> tuple[FoamTrail, ...]:
        """Return the foam behind the vessel: it spreads with the root of its age and fades."""
        if len(self._wake) < 2:
            return ()
        vehicle = self._context.profile.vehicle
        stamps, places, headings, speeds = (np.array(column) for column in zip(*reversed(self._wake), strict=True))
        age_s = (pose.stamp_ns - stamps) * 1e-9
        stern = places - 0.5 * vehicle.length_m * np.column_stack([np.cos(headings), np.sin(headings)])
        half_m = 0.3 * vehicle.width_m * (1.0 + 0.5 * np.sqrt(np.maximum(age_s, 0.0)))
        side = half_m[:, None] * np.column_stack([-np.sin(headings), np.cos(headings)])
        froude = speeds / math.sqrt(9.81 * vehicle.length_m)
        share = np.clip(1.6 * froude, 0.0, 0.8) * np.exp(-age_s / 9.0)
        return (FoamTrail(stern - side, stern + side, share),)

    # Delivery

    def _deliver(self, now_ns: int) -> None:
        """Record the images whose latency is over. In real time, those that are not ready are late."""
        while self._due and self._due[0][0] <= now_ns:
            due_ns, ticket, name = self._due[0]
            if not self._lockstep and not self._studio.ready(ticket):
                return
            heappop(self._due)
            if not self._lockstep and now_ns > due_ns + 1e9 * self.sense_every / self._physics_hz:
                self._cameras[name].counts.late += 1
            self._hand_over(ticket, name)

    def _hand_over(self, ticket: int, name: str) -> None:
        camera = self._cameras[name]
        image = self._studio.collect(ticket, decode=bool(self._listeners))
        rot_frd_optical = self._mounts.pop(ticket)
        if image is None:
            camera.counts.missing += 1
            return
        camera.counts.images += 1
        if camera.keys.detector is not None and camera.keys.truth:
            camera.score.add(image.detections, image.objects)
            camera.score.horizon.add(image.found_horizon_px, image.horizon_px)
        self._record(image, rot_frd_optical)
        for listener in self._listeners:
            listener(image)

    def _record(self, image: CameraImage, rot_frd_optical: Array) -> None:
        recorder, stamp_ns, name = self._recorder, image.stamp_ns, image.camera
        frame = vessel_name(f"camera_{name}_optical", self._context.profile.vessel)
        stamp = timestamp(stamp_ns)
        picture: Any
        if image.kind == "depth":
            height, width = image.pixels.shape
            picture = messages.RawImage(
                timestamp=stamp,
                frame_id=frame,
                width=width,
                height=height,
                encoding="32FC1",
                step=4 * width,
                data=image.pixels.astype("<f4").tobytes(),
            )
        else:
            picture = messages.CompressedImage(
                timestamp=stamp, frame_id=frame, data=image.encoded, format=image.file_format
            )
        recorder.message(image_topic(name, image.kind).name, stamp_ns, picture)
        recorder.message(calibration_topic(name).name, stamp_ns, calibration(image.lens, stamp_ns, frame))
        rows = *(image.horizon_px or UNKNOWN), *(image.found_horizon_px or UNKNOWN)
        quat = frames.matrix_to_quat(image.rot_ned_optical).tolist()
        recorder.write(stamp_ns, CameraFrame(name, image.number, image.pos_ned_m.tolist(), quat, *rows))
        for seen in image.objects:
            centre, turn, size = list(seen.centre_optical_m), list(seen.quat_optical_box), list(seen.size_m)
            recorder.write(
                stamp_ns,
                CameraTruth(
                    name, image.number, seen.kind.label, seen.name, *seen.box_px, seen.pixels, centre, turn, size
                ),
            )
        for one in image.detections:
            angles = box_angles_rad(image.lens, rot_frd_optical, one.box_px)
            detection = CameraDetection(name, image.number, one.label, *one.box_px, one.confidence, *angles)
            recorder.write(stamp_ns, detection)
        if self._cameras[name].keys.truth:
            recorder.message(annotations_topic(name).name, stamp_ns, image_annotations(image))


def box_angles_rad(lens: Lens, rot_frd_optical: Array, box: Box) -> tuple[float, float, float, float]:
    """Return bearing and width in bearing of a box, and the elevations of its lower and upper edge.

    rot_frd_optical: turns the optical axes into those of the body, (3, 3).
    """
    left, top, right, bottom = box
    middle = 0.5 * (left + right), 0.5 * (top + bottom)
    edges = np.array([(left, middle[1]), (right, middle[1]), (middle[0], bottom), (middle[0], top)])
    forward, aside, down = (lens.directions(edges) @ rot_frd_optical.T).T
    bearing = np.arctan2(aside, forward)
    width = math.remainder(float(bearing[1] - bearing[0]), math.tau)
    elevation = np.arctan2(-down, np.hypot(forward, aside))
    middle_rad = math.remainder(float(bearing[0]) + 0.5 * width, math.tau)
    return middle_rad, width, float(elevation[2]), float(elevation[3])


def calibration(lens: Lens, stamp_ns: int, frame: str) -> messages.CameraCalibration:
    """Return the calibration of a lens in ROS's terms."""
    matrix = lens.matrix.ravel().tolist()
    projection = np.column_stack([lens.matrix, np.zeros(3)]).ravel().tolist()
    return messages.CameraCalibration(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        width=lens.width_px,
        height=lens.height_px,
        distortion_model="kannala_brandt" if lens.fisheye else "plumb_bob",
        D=list(lens.distortion),
        K=matrix,
        R=np.eye(3).ravel().tolist(),
        P=projection,
    )


def image_annotations(image: CameraImage) -> messages.ImageAnnotations:
    """Return the boxes and names of the objects, for Foxglove to draw over the image."""
    stamp = timestamp(image.stamp_ns)
    colour, clear = messages.Color(r=1.0, g=0.9, b=0.1, a=1.0), messages.Color(r=0.0, g=0.0, b=0.0, a=0.5)
    boxes, names = [], []
    for seen in image.objects:
        if seen.kind in (ObjectClass.GROUND, ObjectClass.OWN_VESSEL):
            continue
        left, top, right, bottom = seen.box_px
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
        boxes.append(
            messages.PointsAnnotation(
                timestamp=stamp,
                type=messages.PointsAnnotationType.LineLoop,
                points=[messages.Point2(x=x, y=y) for x, y in corners],
                outline_color=colour,
                thickness=1.0,
            )
        )
        names.append(
            messages.TextAnnotation(
                timestamp=stamp,
                position=messages.Point2(x=left, y=top),
                text=seen.name,
                font_size=10.0,
                text_color=colour,
                background_color=clear,
            )
        )
    return messages.ImageAnnotations(points=boxes, texts=names)
