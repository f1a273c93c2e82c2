"""The lidar in a run: records the motion during a frame, casts the frame at its end, sends the cloud in chunks."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

from agent.companion.clouds import PointCloud, cloud_messages
from agent.wire import dialect
from agent.wire.codec import Message
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.lidar import BodyTrack, Lidar, PointFates
from sim_core.sensors.optics import Atmosphere, WaterSeen
from sim_core.world.rays import RayCaster
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import PerceptionRecorder
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.world.plant import PlantView
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds


class LidarInstrument:
    """The lidar of the first vessel. `every`: physics steps in a frame; the first frame begins after that many steps.

    A cloud is sent `latency_ns` after the end of its frame.
    """

    def __init__(
        self,
        lidar: Lidar,
        caster: RayCaster,
        plant: PlantView,
        every: int,
        latency_ns: int,
        rng: Generator,
    ) -> None:
        self._lidar = lidar
        self._caster = caster
        self._plant = plant
        self._every = every
        self._latency_ns = latency_ns
        self._rng = rng
        self._recorder: PerceptionRecorder | None = None
        self._stamps_ns: list[int] = []
        self._places: list[Array] = []
        self._attitudes: list[Array] = []
        self._waiting: deque[tuple[int, list[Message]]] = deque()
        self._frames = 0
        self._fates = dict.fromkeys((field.name for field in fields(PointFates)), 0)

    @property
    def address(self) -> str | None:
        """None: the lidar has no line for clients."""
        return None

    def begin(self, recorder: PerceptionRecorder) -> None:
        """Start the run; the recorder stores the clouds."""
        self._recorder = recorder

    def update(self, step: RunStep) -> list[Message]:
        """Return the chunks of the clouds that are due after a physics step."""
        number, sim_ns, motion = step.number, step.now_ns, step.motion
        ends = number % self._every == 0
        if self._stamps_ns:
            self._keep(sim_ns, motion)
            if ends:
                self._finish()
        if ends:
            self._stamps_ns, self._places, self._attitudes = [], [], []
            self._keep(sim_ns, motion)
            self._bodies = self._plant.bodies()
        if self._waiting and self._waiting[0][0] <= sim_ns:
            return self._waiting.popleft()[1]
        return []

    def report(self) -> dict[str, Any]:
        """Return the counts of frames, triangles and points by their outcome."""
        return {"frames": self._frames, "triangles": self._caster.triangles, "points": dict(self._fates)}

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _keep(self, sim_ns: int, motion: Kinematics) -> None:
        self._stamps_ns.append(sim_ns)
        self._places.append(motion.pos_ned_m[0])
        self._attitudes.append(motion.rot_ned_frd[0])

    def _finish(self) -> None:
        """Cast the completed frame, and delay its cloud by the latency."""
        track = BodyTrack(np.array(self._stamps_ns), np.array(self._places), np.array(self._attitudes))
        start_ns, end_ns = self._stamps_ns[0], self._stamps_ns[-1]
        water = WaterSeen.around(self._plant.simulation.environment, start_ns * 1e-9, track.pos_ned_m[0])
        scan = self._lidar.scan(track, self._caster, water, self._rng, self._bodies)
        for name, count in asdict(scan.fates).items():
            self._fates[name] += count
        if self._recorder is not None:
            self._recorder.lidar_points(scan.stamp_ns, scan.points_frd_m, scan.offset_s, scan.intensity)
        cloud = PointCloud(
            dialect.XITL_CLOUD_KIND_LIDAR,
            self._frames,
            scan.stamp_ns,
            scan.points_frd_m,
            scan.offset_s,
            scan.intensity,
        )
        self._waiting.append((end_ns + self._latency_ns, cloud_messages(cloud)))
        self._frames += 1


def make_lidar(
    profile: RunProfile,
    seeds: Seeds,
    scenery: Scenery,
    plant: PlantView,
) -> LidarInstrument:
    """Return the lidar of the profile. The profile must have one."""
    assert profile.sensors is not None
    assert profile.sensors.lidar is not None
    keys, environment = profile.sensors.lidar, profile.environment
    air = Atmosphere() if environment.visibility_m is None else Atmosphere(environment.visibility_m)
    return LidarInstrument(
        lidar=Lidar(keys, environment.water_reflectivity, air),
        caster=scenery.caster(),
        plant=plant,
        every=round(profile.clock.physics_rate_hz / keys.rate_hz),
        latency_ns=round(keys.latency_s * 1e9),
        rng=default_rng(seeds.sequence("lidar")),
    )
