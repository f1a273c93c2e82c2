"""Camera of each browser: behind a vessel, in orbit around it, from above, or free.

The mouse changes distance and direction. The camera keeps this change and still follows the vessel.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import field
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.plugins.view.model import Array, ViewInstant, ViewScene

if TYPE_CHECKING:
    import viser

FOLLOW, ORBIT, ABOVE, FREE = "follow", "orbit", "from above", "free"
MODES = (FOLLOW, ORBIT, ABOVE, FREE)
DISTANCE_LENGTHS = 3.6
"""Distance of the camera from the vessel, in vessel lengths. The minimum is `LEAST_M`."""
LEAST_M = 5.5
TURN_RADPS = 0.12
"""Angular rate of the camera in orbit."""
HEADING_S = 2.5
"""Time constant with which the camera follows the vessel's heading."""
PLACE_S = 0.25
"""Time constant with which the camera follows the vessel's position, so that waves and gusts do not shake it."""
HANDS_OFF_S = 0.4
"""Time after a mouse move until the camera follows the vessel again."""
SENT_KEPT = 1000
"""Number of sent camera positions to remember. A slow browser reports them late."""
SAME = 1e-4
"""Tolerance for a reported and a sent position to be equal, as a fraction of the camera distance."""
NEAR_M, FAR_M, FIELD_OF_VIEW_RAD = 0.15, 2600.0, 0.9


@dataclass(slots=True)
class CameraPose:
    """Position of a camera relative to its subject."""

    distance_m: float
    azimuth_rad: float
    """Direction from the subject to the camera, relative to a reference direction."""
    elevation_rad: float
    """Angle above the horizon."""

    @classmethod
    def of(cls, offset_m: Array, reference_rad: float) -> CameraPose:
        """Return the pose of a camera at this offset (3,) from its subject."""
        east, north, up = offset_m.tolist()
        level = math.hypot(east, north)
        turn = math.remainder(math.atan2(north, east) - reference_rad, math.tau)
        return cls(max(math.hypot(level, up), 0.2), turn, math.atan2(up, level))

    def offset_m(self, reference_rad: float) -> Array:
        """Return the offset (3,) of the camera from its subject."""
        level, turn = self.distance_m * math.cos(self.elevation_rad), reference_rad + self.azimuth_rad
        up = self.distance_m * math.sin(self.elevation_rad)
        return np.array([level * math.cos(turn), level * math.sin(turn), up])


def usual_pose(mode: str, length_m: float) -> CameraPose:
    """Return the initial pose of a mode for a vessel of this length."""
    distance_m = max(DISTANCE_LENGTHS * length_m, LEAST_M)
    if mode == ABOVE:
        return CameraPose(5.0 * distance_m, -0.5 * math.pi, 1.55)
    return CameraPose(distance_m * (1.5 if mode == ORBIT else 1.0), math.pi - 0.45, 0.24)


@dataclass(slots=True)
class _BrowserCamera:
    """The camera of one browser."""

    mode: str
    subject: str
    pose: CameraPose
    place_m: Array | None = None
    heading_rad: float = 0.0
    turned_rad: float = 0.0
    sent: Array = field(default_factory=lambda: np.full((SENT_KEPT, 6), np.inf))
    """The latest camera positions and look-at points that the server sent to the browser, in any order."""
    sent_count: int = 0
    heard: bool = False
    """True after the browser reported a sent position. Later reports are not older than that position."""
    stamp: float = 0.0
    """Time stamp of the last evaluated report."""
    touched_s: float = field(default=-math.inf)

    def start_again(self, mode: str, subject: str, length_m: float) -> None:
        """Restart with another mode or vessel."""
        self.mode, self.subject, self.pose = mode, subject, usual_pose(mode, length_m)
        self.place_m, self.turned_rad = None, 0.0
        self.sent[:] = np.inf
        self.heard = False

    def note_sent(self, place: tuple[float, ...]) -> None:
        """Remember a camera position and look-at point that the server sent."""
        self.sent[self.sent_count % SENT_KEPT] = place
        self.sent_count += 1

    def moved_by_hand(self, place: tuple[float, ...]) -> bool:
        """Return whether the user moved the camera to a reported position.

        A position that the server sent, or that the browser reported before it received one, returns False.
        """
        if not np.isfinite(place).all():
            return False
        off = self.sent - place
        if (np.einsum("ij,ij->i", off, off) < (SAME * self.pose.distance_m) ** 2).any():
            self.heard = True
            return False
        return self.heard


class Cameras:
    """Moves the camera of every connected browser. Call `update` with each drawn instant."""

    def __init__(
        self, server: viser.ViserServer, scene: ViewScene, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._server = server
        self._scene = scene
        self._now_s = now_s
        self._names = list(scene.vessels) or [""]
        self._cameras: dict[int, _BrowserCamera] = {}
        self._last_s: float | None = None
        # Aim the initial camera along the first leg of the mission
        camera = server.initial_camera
        camera.near, camera.far, camera.fov = NEAR_M, FAR_M, FIELD_OF_VIEW_RAD
        name = self._names[0]
        vessel = scene.vessels.get(name)
        places = vessel.mission_enu_m if vessel is not None else np.empty((0, 3))
        start = places[0] if len(places) else np.array([*scene.water.centre_en_m, scene.water.level_m])
        ahead = places[1] - places[0] if len(places) > 1 else np.array([1.0, 0.0, 0.0])
        offset = usual_pose(FOLLOW, self._length_m(name)).offset_m(math.atan2(ahead[1], ahead[0]))
        camera.position, camera.look_at = tuple(start + offset), tuple(start)
        server.on_client_connect(self._join)
        server.on_client_disconnect(lambda client: self._cameras.pop(client.client_id, None))

    def _length_m(self, name: str) -> float:
        vessel = self._scene.vessels.get(name)
        return 2.0 if vessel is None else vessel.length_m

    def _join(self, client: Any) -> None:
        follower = _BrowserCamera(FOLLOW, self._names[0], usual_pose(FOLLOW, self._length_m(self._names[0])))
        self._cameras[client.client_id] = follower
        modes = client.gui.add_dropdown("Camera", MODES, initial_value=FOLLOW, order=1.0)
        subjects = None
        if len(self._names) > 1:
            subjects = client.gui.add_dropdown("of", tuple(self._names), initial_value=self._names[0], order=1.1)

        def choose(event: object) -> None:
            subject = self._names[0] if subjects is None else subjects.value
            follower.start_again(modes.value, subject, self._length_m(subject))

        modes.on_update(choose)
        if subjects is not None:
            subjects.on_update(choose)

    def update(self, instant: ViewInstant) -> None:
        """Move every camera to the vessels' current positions."""
        now_s = self._now_s()
        elapsed_s = min(now_s - self._last_s, 1.0) if self._last_s is not None else 0.0
        self._last_s = now_s
        clients = self._server.get_clients()
        for number, follower in list(self._cameras.items()):
            vessel = instant.vessels.get(follower.subject)
            if number not in clients or vessel is None or follower.mode == FREE:
                continue
            if np.isfinite(vessel.position_enu_m).all() and np.isfinite(vessel.attitude_wxyz).all():
                place = np.array([*vessel.position_enu_m[:2], self._scene.water.level_at_m(instant.time_s) + 0.1])
                w, x, y, z = np.asarray(vessel.attitude_wxyz).tolist()
                heading_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))  # east towards north
                self._move(clients[number], follower, place, heading_rad, now_s, elapsed_s)

    def _move(
        self, client: Any, follower: _BrowserCamera, place_m: Array, heading_rad: float, now_s: float, elapsed_s: float
    ) -> None:
        camera = client.camera
        if follower.place_m is None:
            follower.place_m, follower.heading_rad = place_m, heading_rad
        else:
            share = 1.0 - math.exp(-elapsed_s / PLACE_S)
            if math.dist(place_m, follower.place_m) > 100.0:
                share = 1.0
            follower.place_m = follower.place_m + share * (place_m - follower.place_m)
            turn = math.remainder(heading_rad - follower.heading_rad, math.tau)
            follower.heading_rad += (1.0 - math.exp(-elapsed_s / HEADING_S)) * turn
        reference = {FOLLOW: follower.heading_rad, ORBIT: follower.turned_rad, ABOVE: 0.0}[follower.mode]
        stamp, seen = camera.update_timestamp, _place(camera)
        if stamp != follower.stamp and stamp == camera.update_timestamp:  # no other report arrived in between
            follower.stamp = stamp
            if follower.moved_by_hand(seen):
                follower.pose = CameraPose.of(np.array(seen[:3]) - np.array(seen[3:]), reference)
                follower.touched_s = now_s
        if now_s - follower.touched_s < HANDS_OFF_S:
            return
        if follower.mode == ORBIT:
            follower.turned_rad += TURN_RADPS * elapsed_s
            reference = follower.turned_rad
        position = follower.place_m + follower.pose.offset_m(reference)
        with client.atomic():
            for name, place in (("position", position), ("look_at", follower.place_m)):
                with suppress(ValueError):  # viser raises it after a report of non-finite values
                    setattr(camera, name, place)
        follower.note_sent(_place(camera))
        follower.stamp = camera.update_timestamp


def _place(camera: Any) -> tuple[float, ...]:
    """Return the position and the look-at point, six numbers."""
    return (*camera.position.tolist(), *camera.look_at.tolist())
