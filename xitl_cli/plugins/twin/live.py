"""Boat and ghost in the live outputs of a run, such as the 3D view.

The view draws the vessel of a plant. Here, the plant's vessel follows the boat, and the ghost is part of the recorded
scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.simulation import SimulationState
from xitl_cli.plugins.twin.boat import BoatInterval, BoatTelemetry
from xitl_cli.plugins.twin.session import Observer
from xitl_cli.profile.load import LoadedProfile, load_with_origins
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.live_output import LiveRun, LiveVessel
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep, SimulationClock
from xitl_cli.run.core.pace import Realtime
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.display import RunStatus
from xitl_cli.run.nodes.plugin_nodes import live_outputs
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.scene import make_scene
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

_OPEN_WATER = (
    "site.name=boat",
    "site.latitude_deg=0",
    "site.longitude_deg=0",
    "site.altitude_m=0",
    "mission.speed_mps=1",
    "mission.start={north_m: 0, east_m: 0, heading_deg: 0}",
    "mission.waypoints_ned_m=[[1, 0]]",
    "clock.mode=realtime",
    "view.show=true",
)


class BoatControl(ControlNode):
    """The boat as the node that moves the vessel."""

    def __init__(self, commands: int) -> None:
        self.command = MotorCommand((0.0,) * commands)
        self.progress = Progress("", waypoints=())


class LiveBoat:
    """Passes each interval to the nodes of the live outputs."""

    def __init__(self, profile: RunProfile, plant: Plant, control: BoatControl, nodes: Sequence[RunNode]) -> None:
        self._profile = profile
        self._plant = plant
        self._control = control
        self._nodes = nodes
        self._number = 0
        self.speed_mps = self.heading_deg = 0.0

    def show(self, interval: BoatInterval, telemetry: BoatTelemetry) -> None:
        """Move the drawn vessel to the boat."""
        state = self._plant.state
        assert isinstance(state, SimulationState)
        motion = state.vessel.motion
        north_mps, east_mps, _, _, north_m, east_m = interval.motion
        half = 0.5 * interval.length_s
        place = motion.pos_ned_m.copy()
        place[0, :2] = north_m + half * north_mps, east_m + half * east_mps
        quat = euler_to_quat(interval.attitude_rad[None])
        moved = replace(
            motion,
            pos_ned_m=place,
            vel_ned_mps=np.array([[north_mps, east_mps, 0.0]]),
            quat_ned_frd=quat,
            rot_ned_frd=quat_to_matrix(quat),
        )
        vessel = replace(state.vessel, motion=moved, packed=None)
        self._plant.state = replace(state, vessel=vessel, time_ns=interval.end_ns)
        self._control.command = MotorCommand(tuple(interval.commands[-1].tolist()), interval.armed)
        self._control.progress = Progress("", armed=interval.armed, waypoints=())
        self.speed_mps = math.hypot(north_mps, east_mps)
        self.heading_deg = math.degrees(interval.attitude_rad[2]) % 360.0
        self._number += 1
        step = RunStep(self._number, interval.end_ns, self._plant.vessels[0], moved)
        for node in self._nodes:
            node.exchange(step)

    def status(self) -> RunStatus:
        """Return the status for the readouts."""
        now_s = self._plant.state.time_ns * 1e-9
        return RunStatus(
            sim_s=now_s,
            duration_s=math.inf,
            mode="",
            armed=self._control.command.armed,
            waypoints_reached=0,
            waypoints_total=0,
            speed_mps=self.speed_mps,
            heading_deg=self.heading_deg,
            cross_track_m=None,
            position_error_m=None,
            current_mps=math.nan,
            wind_mps=math.nan,
            motors=self._control.command.motors,
        )


@contextmanager
def live_observer(
    loaded: LoadedProfile, vehicle: str, recorder: Recorder, tell: Callable[[str], None]
) -> Iterator[Observer]:
    """Open the 3D view of a boat and its ghost.

    Raises UserError if the view cannot be opened.
    """
    profile = _runnable(loaded, vehicle)
    scenery = Scenery(profile)
    plant = build_plant([profile], Seeds(0), scenery)
    control = BoatControl(profile.vehicle.commands)
    nodes: list[RunNode] = []
    boat = LiveBoat(profile, plant, control, nodes)
    mission: Any = SimpleNamespace(others=None)
    scene = partial(make_scene, [profile], scenery)
    for output in live_outputs([profile]):
        watch = output.vessel_node(LiveVessel(profile, plant.vessels[0], control, mission, boat.status))
        run = LiveRun(plant, lambda: scene().encode(), tell, lambda: False)
        nodes += [*([] if watch is None else [watch]), *output.world_nodes(run)]
    pace = Realtime(plant.simulation.dt_s)
    context = RunContext(recorder, pace, SimulationClock(pace))
    try:
        for node in nodes:
            node.prepare()
        recorder.scene(scene())
        for node in nodes:
            node.begin(context)
        yield boat
        for node in nodes:
            node.end()
    finally:
        for node in nodes:
            node.close()


def _runnable(loaded: LoadedProfile, vehicle: str) -> RunProfile:
    """Return the profile, or open water with its vehicle."""
    if not loaded.profile.missing_for_run():
        return load_with_origins(vehicle, ("view.show=true", "clock.mode=realtime")).runnable()
    return load_with_origins("bases/base-sitl", _OPEN_WATER, parts=(vehicle,)).runnable()
