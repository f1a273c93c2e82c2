"""Live 3D view of a run. It starts the view process and sends an instant each time that the process requests one.

A VesselWatch keeps the recorded data of a vessel that the view draws. The LiveViewNode combines the data of all vessels
into instants. Without a browser, it only reads the clock at each exchange.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core import frames
from sim_core.dataclass import dataclass
from sim_core.fleet import Fleet
from sim_core.world.debris import DebrisState
from sim_core.world.traffic import ScriptedVessel, scripted_motion
from xitl_cli.errors import UserError
from xitl_cli.logs.charts.chart import Chart
from xitl_cli.logs.model.errors import LogError
from xitl_cli.plugins.view.camera_images import live_image
from xitl_cli.plugins.view.messages import ViewEnd, ViewRefusal, ViewStart, ViewUpdate
from xitl_cli.plugins.view.model import (
    Array,
    BodyInstant,
    Points,
    VesselInstant,
    ViewEvent,
    ViewInstant,
    obstacle_class,
)
from xitl_cli.plugins.view.scene import NO_WAVES, scene_waves
from xitl_cli.plugins.view.server import ViewAddress, check_view_extra, has_desktop, listen, open_browser
from xitl_cli.profile.checks.view import mission_chart
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.foxglove_types import foxglove_type
from xitl_cli.record.topics import SONAR_POINT, camera_topic
from xitl_cli.run.core.live_output import LiveOutput, LiveRun, LiveVessel
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep
from xitl_cli.run.core.pace import OperatedLockstep
from xitl_cli.run.core.side_process import SideProcess
from xitl_cli.run.nodes.display import RunStatus
from xitl_cli.run.nodes.mission import MissionNode
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.world.plant import Plant, PlantView
from xitl_cli.run.world.scene import make_debris_scene, make_scripted_scene

SOURCE = "view"
FIRST_BROWSER_S = 20.0
"""Maximum time that a run in lockstep waits for the browser that it has opened."""
ALONE_S = 5.0
"""Time after the last browser has gone until the view restores the pace. A user may reload the page meanwhile."""
END_S = 3.0
MOST_WAITING_BYTES = 8 << 20
MOST_EVENTS = 200
OBSTACLE_S = 3.0
"""Time for which an obstacle is drawn after its last report."""
SONAR_PINGS = 400
PROCESS_ENVIRONMENT = {"MALLOC_ARENA_MAX": "1"}
"""glibc gives each thread a heap of its own, and buffers of viser that go from thread to thread fragment them."""
_FLU = np.array([1.0, -1.0, -1.0])


@dataclass(slots=True)
class _Seen:
    """A cloud, and the vessel's pose at the time when the cloud was complete."""

    message: Any
    position_enu_m: Array
    rotation: Array


class VesselWatch(RunNode):
    """Data of one vessel for the view. Estimate, clouds, obstacles, clocks and messages come from its recorded topics.

    Clock offsets are relative to the first offset, because the start time of a machine has no meaning for the user.
    """

    def __init__(
        self,
        profile: RunProfile,
        plant: PlantView,
        control: ControlNode,
        mission: MissionNode,
        status: Callable[[], RunStatus],
    ) -> None:
        self.name = profile.vessel
        self._profile = profile
        self._plant = plant
        self._control = control
        self._mission = mission
        self._status = status
        sensors = profile.sensors
        self._cameras = {camera.name: camera for camera in (() if sensors is None else sensors.cameras)}
        self._estimate: tuple[Sequence[float], Sequence[float]] | None = None
        self._lidar: _Seen | None = None
        self._sonar: deque[_Seen] = deque(maxlen=SONAR_PINGS)
        self._drawn: dict[int, tuple[_Seen, Points]] = {}
        self._obstacles: dict[int, tuple[int, Any, Any, str]] = {}
        self._battery: dict[str, float] = {}
        self._clocks: dict[str, tuple[float, float, float]] = {}
        self._events: deque[ViewEvent] = deque(maxlen=MOST_EVENTS)
        self._passing: dict[str, bytes] = {}
        self._images: dict[str, tuple[int, Any]] = {}
        """The image of each camera since the latest instant."""

    def begin(self, context: RunContext) -> None:
        recorder = context.recorder
        recorder.watch("/estimate/odometry", self._on_estimate)
        recorder.watch("/lidar/points", self._on_lidar)
        recorder.watch("/sonar/points", self._on_sonar)
        recorder.watch("/companion/obstacles", self._on_obstacle)
        recorder.watch("/clocks", self._on_clock)
        recorder.watch("/battery", self._on_battery)
        recorder.watch("/scene", self._on_scene)
        recorder.on_log(self._on_log)
        for camera in self._cameras:
            recorder.watch(camera_topic(camera, "image"), partial(self._on_image, camera))

    def _on_image(self, camera: str, stamp_ns: int, message: Any) -> None:
        self._images[camera] = stamp_ns, message

    def _on_scene(self, stamp_ns: int, update: Any) -> None:
        encoded = update.encode()
        entities = foxglove_type("SceneUpdate").FromString(encoded).entities
        names = [entity.id for entity in entities if entity.lifetime.seconds or entity.lifetime.nanos]
        if names:
            self._passing["/".join(names)] = encoded

    def passing_drawings(self) -> list[bytes]:
        """Return the scene updates with temporary entities since the last call, only the latest of each name."""
        drawings, self._passing = list(self._passing.values()), {}
        return drawings

    def _on_estimate(
        self, stamp_ns: int, frame: str, child: str, place: Sequence[float], turn: Sequence[float], *rest: object
    ) -> None:
        self._estimate = place, turn

    def _on_lidar(self, stamp_ns: int, cloud: Any) -> None:
        self._lidar = self._seen(cloud)

    def _on_sonar(self, stamp_ns: int, cloud: Any) -> None:
        self._sonar.append(self._seen(cloud))

    def _seen(self, cloud: Any) -> _Seen:
        position, attitude = _enu(self._plant.motion(), 0)
        return _Seen(cloud, position, frames.quat_to_matrix(attitude))

    def _on_obstacle(self, stamp_ns: int, number: int, *values: Any) -> None:
        self._obstacles[number] = stamp_ns, values[3], values[5], obstacle_class(*values[-2:])

    def _on_clock(self, stamp_ns: int, node: str, *values: Any) -> None:
        if node != "PS1":
            first_s = self._clocks[node][0] if node in self._clocks else values[4]
            self._clocks[node] = first_s, values[4] - first_s, values[5]

    def _on_battery(self, stamp_ns: int, voltage_v: float, current_a: float, used_ah: float) -> None:
        self._battery = {"battery V": voltage_v, "battery used Ah": used_ah}

    def instant(self, now_ns: int, late: int) -> VesselInstant:
        """Return the vessel's current state. late: number of deadlines that the host missed."""
        control, status = self._control, self._status()
        progress = control.progress
        position, attitude = _enu(self._plant.motion(), 0)
        estimate_place = estimate_turn = None
        if self._estimate is not None:
            (x, y, z, w) = self._estimate[1]
            estimate_place, estimate_turn = np.array(self._estimate[0]), np.array([w, x, y, z])
        for number in [key for key, value in self._obstacles.items() if now_ns - value[0] > OBSTACLE_S * 1e9]:
            del self._obstacles[number]
        obstacles = self._obstacles.values()
        places = [frames.ned_to_enu(np.asarray(place, dtype=np.float64)) for _, place, _, _ in obstacles]
        radius = [0.5 * max(float(size[0]), float(size[1])) for _, _, size, _ in obstacles]
        waypoints = progress.waypoints if progress.waypoints is not None else self._profile.mission.course_ned_m
        others = self._mission.others
        target = None
        if progress.target is not None and 0 <= progress.target < len(waypoints):
            north_m, east_m = waypoints[progress.target]
            target = np.array([east_m, north_m, 0.0])
        guided = None
        if progress.guided_ne_m is not None:
            north_m, east_m = progress.guided_ne_m
            target, guided = None, np.array([east_m, north_m, 0.0])
        images, self._images = self._images, {}
        return VesselInstant(
            position,
            attitude,
            estimate_place,
            estimate_turn,
            tuple(control.command.motors),
            progress.mode if not progress.waits_for else f"waits for {progress.waits_for}",
            progress.armed,
            progress.reached,
            status.waypoints_total,
            None if others is None else np.array([(east_m, north_m, 0.0) for north_m, east_m in others]),
            target,
            self._clouds(),
            np.array(places).reshape(-1, 3),
            np.array(radius),
            self._numbers(status, late),
            guided,
            {name: live_image(*image, self._cameras[name].kind == "depth") for name, image in images.items()},
            tuple(text for _, _, _, text in obstacles),
        )

    def _clouds(self) -> dict[str, Points]:
        clouds: dict[str, Points] = {}
        if self._lidar is not None:
            clouds["lidar"] = self._placed(self._lidar)
        pings = [points for seen in self._sonar if len(points := self._placed(seen))]
        if pings:
            clouds["sonar"] = np.concatenate(pings)
        current = {id(seen) for seen in (self._lidar, *self._sonar)}
        self._drawn = {key: value for key, value in self._drawn.items() if key in current}
        return clouds

    def _placed(self, seen: _Seen) -> Points:
        """Return the points of a cloud in the map. They are computed once, and only for drawn clouds."""
        known = self._drawn.get(id(seen))
        if known is not None:
            return known[1]
        points = cloud_points(seen.message) @ seen.rotation.T + seen.position_enu_m
        self._drawn[id(seen)] = seen, points.astype(np.float32)
        return self._drawn[id(seen)][1]

    def _numbers(self, status: RunStatus, late: int) -> dict[str, float]:
        motion, current_ned_mps = self._plant.motion(), self._plant.state.current_ned_mps
        through_water_mps = (motion.vel_ned_mps - current_ned_mps)[0, :2]
        desired_deg = self._control.progress.desired_heading_deg
        numbers = {
            "speed m/s": status.speed_mps,
            "speed through water m/s": math.hypot(*through_water_mps.tolist()),
            "heading °": status.heading_deg,
            "desired heading °": math.nan if desired_deg is None else desired_deg,
            "cross-track m": math.nan if status.cross_track_m is None else status.cross_track_m,
            "estimate off m": math.nan if status.position_error_m is None else status.position_error_m,
            "wind m/s": status.wind_mps,
            "current m/s": status.current_mps,
            "links lost": status.lost,
            "deadline misses": status.missed + late,
            **self._battery,
        }
        for node, (_, since_s, drift_ppm) in self._clocks.items():
            several = f" {node}" if len(self._clocks) > 1 else ""
            numbers[f"clock offset{several} ms"] = 1e3 * since_s
            numbers[f"clock drift{several} ppm"] = drift_ppm
        return numbers

    def events(self) -> list[ViewEvent]:
        """Return the messages since the last call."""
        events = list(self._events)
        self._events.clear()
        return events

    def _on_log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        self._events.append(ViewEvent(stamp_ns * 1e-9, severity, f"{source}: {text}"))


def cloud_points(message: Any) -> Points:
    """Return the points (n, 3) of a recorded foxglove.PointCloud. Its points begin with x, y, z as float32."""
    read = foxglove_type("PointCloud").FromString(message.encode())
    kind = np.dtype({"names": ["xyz"], "formats": [("<f4", 3)], "offsets": [0], "itemsize": read.point_stride})
    assert SONAR_POINT.names is not None
    assert SONAR_POINT.names[:3] == ("x", "y", "z")
    return np.frombuffer(read.data, dtype=kind)["xyz"]


def _enu(motion: Any, row: int) -> tuple[Array, Array]:
    """Return the position in ENU, and the attitude (w, x, y, z) from FLU to ENU."""
    return frames.ned_to_enu(motion.pos_ned_m[row]), frames.quat_ned_frd_to_enu_flu(motion.quat_ned_frd[row])


class LiveViewNode(RunNode):
    """The 3D view of a run. The run continues if the view process ends or hangs, or if no browser is connected.

    profiles: profiles of all vessels. drawn: returns the recorded scene, encoded. watches: one watch per vessel.
    tell: prints a message, such as the address, to the user. interrupted: returns True when the user asked to stop.
    """

    def __init__(
        self,
        profiles: Sequence[RunProfile],
        plant: Plant,
        watches: Sequence[VesselWatch],
        drawn: Callable[[], bytes],
        tell: Callable[[str], None],
        interrupted: Callable[[], bool],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._operator: OperatorNode | None = None
        self._profiles = tuple(profiles)
        self._spec = profiles[0].view
        self._plant = plant
        self._watches = watches
        self._drawn = drawn
        self._tell = tell
        self._interrupted = interrupted
        self._now_s = now_s
        self._traffic: tuple[ScriptedVessel, ...] = ()
        if isinstance(plant.simulation, Fleet):
            self._traffic = tuple(plant.simulation.traffic)
        self._sent_bodies = 0
        self._sent_waves = plant.simulation.environment.waves
        self._next_s = 0.0
        self._requested = False
        self._browsers = self._joined = self._shown = self._skipped = self._actions = self._refused = 0
        self._alone_since_s: float | None = None
        self._watched = self._unpaced = False
        self._rate: deque[tuple[float, int]] = deque(maxlen=20)
        self._address: ViewAddress | None = None
        self._page = SideProcess("xitl_cli.plugins.view.process", self._on_loss, END_S, PROCESS_ENVIRONMENT)
        self._chart: Chart | None = None
        self._opened = False
        self._ended = ""
        self._recorder: Any = None
        self._pace: Any = None

    def attach_operator(self, operator: OperatorNode) -> None:
        """Set the operator that carries out the actions from the page. It also polls the view, even in a paused run."""
        self._operator = operator
        operator.listen(self.poll)

    def prepare(self) -> None:
        """Start the view process, print its address and, if the profile asks for it, open a browser."""
        check_view_extra()
        if (file := self._profiles[0].view.map) is not None:
            try:
                self._chart = mission_chart(file, self._profiles)
            except LogError as error:  # it has changed since the check of the profile
                raise UserError(f"view.map = {error}") from error
        listener, self._address = listen(self._spec.host, self._spec.port)
        with listener:
            self._page.start([listener])
        if self._address.moved is not None:
            self._tell(f"port {self._address.moved} is taken, so the view is at {self._address.port}")
        self._tell(f"view: {self._address.url}")
        wanted = self._spec.open
        if wanted or (wanted is None and has_desktop()):
            self._opened = open_browser(self._address.url)

    def begin(self, context: RunContext) -> None:
        self._recorder, self._pace = context.recorder, context.pace
        lead = self._profiles[0]
        updates = [self._drawn()]
        if self._traffic:
            updates.append(make_scripted_scene(self._traffic).encode())
        lockstep = lead.clock.mode == "lockstep"
        assert self._address is not None
        operator = self._operator
        operated = operator is not None
        faults = () if operator is None else tuple(operator.faults.items())
        own = lead.name, self._address, self._spec.dark, tuple(updates), self._profiles
        pace = self._spec.pace if operator is None or operator.factor is None else operator.factor
        self._page.send(ViewStart(*own, operated, lockstep, faults, pace, self._chart))
        if self._opened and lockstep:
            until_s = self._now_s() + FIRST_BROWSER_S
            while not self._page.gone and not self._browsers and self._now_s() < until_s and not self._interrupted():
                self.poll()
                time.sleep(0.02)

    def exchange(self, step: RunStep) -> None:
        self.poll()

    def poll(self) -> None:
        """Handle the requests of the view process at its rate, and send an instant if it asked for one."""
        now_s = self._now_s()
        if now_s < self._next_s or self._page.gone:
            return
        self._next_s = now_s + 1.0 / self._spec.rate_hz
        for message in self._page.receive():
            self._handle(message)
        self._set_pace(now_s)
        if not self._browsers:
            return
        if not self._requested or self._page.waiting_bytes > MOST_WAITING_BYTES:
            self._skipped += 1
            return
        self._requested = False
        self._shown += 1
        # Waiting launches are included, so that a paused run shows launches immediately
        debris = self._plant.debris_with(() if self._operator is None else self._operator.waiting_launches)
        if len(debris.bodies) > self._sent_bodies:
            self._page.send(ViewUpdate(make_debris_scene(debris.bodies, self._sent_bodies).encode()))
            self._sent_bodies = len(debris.bodies)
        for watch in self._watches:
            for update in watch.passing_drawings():
                self._page.send(ViewUpdate(update))
        self._page.send(self._instant(now_s, debris))

    def _handle(self, message: Mapping[str, Any]) -> None:
        if "browsers" in message:
            self._browsers, self._joined = int(message["browsers"]), int(message["joined"])
            if not self._browsers:
                self._requested = False
        elif "ask" in message:
            self._requested = True
        elif isinstance(action := message.get("action"), dict):
            self._actions += 1
            refusal = self._ask(action)
            if refusal is not None:
                self._refused += 1
                self._page.send(ViewRefusal(refusal))

    def _ask(self, action: Mapping[str, Any]) -> str | None:
        return "this run accepts no actions" if self._operator is None else self._operator.ask(action, SOURCE)

    def _set_pace(self, now_s: float) -> None:
        """Request the profile's pace at the first browser, unless one is set. Restore it after the last browser."""
        if self._browsers:
            self._alone_since_s = None
            if not self._watched:
                self._watched = True
                if self._paceable and self._spec.pace is not None and self._pace.factor is None:
                    self._ask({"action": "pace", "factor": self._spec.pace})
                    self._unpaced = True
        elif self._watched:
            self._alone_since_s = self._alone_since_s or now_s
            if now_s - self._alone_since_s >= ALONE_S:
                self._alone_since_s = None
                self._leave_alone()

    def _leave_alone(self) -> None:
        """Remove the pace that the view set. A paused run stays paused, and a message explains how to resume it."""
        if self._unpaced:
            self._ask({"action": "pace", "factor": None})
        self._watched = self._unpaced = False
        if self._operator is not None and self._operator.paused and self._address is not None:
            self._tell(
                f"the last browser has closed and the run stays paused: open {self._address.url} and resume it, "
                "or end it with Ctrl-C"
            )

    @property
    def _paceable(self) -> bool:
        return isinstance(self._pace, OperatedLockstep)

    def _instant(self, now_s: float, debris: DebrisState) -> ViewInstant:
        plant, state = self._plant, self._plant.state
        now_ns = state.time_ns
        late = self._pace.task(self._profiles[0].clock.physics_rate_hz).missed
        vessels = {watch.name: watch.instant(now_ns, late) for watch in self._watches}
        if self._traffic:
            motion = scripted_motion(self._traffic, now_ns * 1e-9, plant.vessels[0].tide_m())
            for row, vessel in enumerate(self._traffic):
                place, attitude = _enu(motion, row)
                speed = math.hypot(*motion.vel_ned_mps[row, :2].tolist())
                vessels[vessel.name] = VesselInstant(place, attitude, mode="scripted", numbers={"speed m/s": speed})
        first = plant.vessels[0].state
        wind, current = (frames.ned_to_enu(stream[0]) for stream in (first.wind_ned_mps, first.current_ned_mps))
        events = sorted((event for watch in self._watches for event in watch.events()), key=attrgetter("time_s"))
        waves = None
        if (field := plant.simulation.environment.waves) is not self._sent_waves:  # an operator changed them
            self._sent_waves, waves = field, scene_waves(field) or NO_WAVES
        self._rate.append((now_s, now_ns))
        (since_s, since_ns) = self._rate[0]
        pace = (now_ns - since_ns) * 1e-9 / (now_s - since_s) if now_s > since_s else math.nan
        return ViewInstant(
            now_ns * 1e-9,
            vessels,
            (float(wind[0]), float(wind[1])),
            (float(current[0]), float(current[1])),
            self._bodies(debris),
            tuple(events),
            self._paceable and self._pace.paused,
            pace,
            waves,
        )

    def _bodies(self, debris: DebrisState) -> dict[int, BodyInstant]:
        if not debris.bodies:
            return {}
        late_s = (self._plant.state.time_ns - debris.time_ns) * 1e-9
        euler = np.zeros((len(debris.bodies), 3))
        euler[:, 2] = debris.yaw_rad + late_s * debris.yaw_rate_radps
        places = frames.ned_to_enu(debris.pos_ned_m + late_s * debris.vel_ned_mps)
        attitudes = frames.quat_ned_frd_to_enu_flu(frames.euler_to_quat(euler))
        return {number: BodyInstant(places[number], attitudes[number]) for number in range(len(debris.bodies))}

    def _on_loss(self, why: str) -> None:
        self._browsers = 0
        self._ended = f"the 3D view has ended; the run continues without it{why}"
        if self._operator is not None and self._operator.paused_by == SOURCE:
            self._ask({"action": "resume"})  # the page that could do so is gone
            self._ended += "; its pause has ended"
        self._leave_alone()
        self._tell(f"warning: {self._ended}")
        if self._recorder is not None:
            self._recorder.log(self._plant.state.time_ns, WARNING, SOURCE, self._ended)

    def end(self) -> None:
        self._page.send(ViewEnd(f"after {self._plant.state.time_ns * 1e-9:.1f} s of simulation time"))

    def close(self) -> None:
        self._page.close()

    def report(self) -> dict[str, Any]:
        """Return `view`: address, counts of shown and skipped instants, browsers, and requested and refused actions.

        The address has no token, because users share summaries.
        """
        address = "" if self._address is None else f"http://{self._address.host}:{self._address.port}/"
        return {
            "view": {
                "address": address,
                "shown": self._shown,
                "skipped": self._skipped,
                "browsers": self._joined,
                "actions": self._actions,
                "refused": self._refused,
            },
            "warnings": [self._ended] if self._ended else [],
        }


class ViewOutput(LiveOutput):
    """The 3D view as a live output of a run."""

    def __init__(self, profiles: Sequence[RunProfile]) -> None:
        self._profiles = profiles
        self._watches: list[VesselWatch] = []

    def vessel_node(self, vessel: LiveVessel) -> VesselWatch:
        watch = VesselWatch(vessel.profile, vessel.plant, vessel.control, vessel.mission, vessel.status)
        self._watches.append(watch)
        return watch

    def world_nodes(self, run: LiveRun) -> Sequence[RunNode]:
        return [LiveViewNode(self._profiles, run.plant, self._watches, run.scene, run.tell, run.interrupted)]
