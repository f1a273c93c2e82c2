"""The simulated sensors of one vessel, their samples as custom MAVLink messages, and their latency."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from numpy.random import default_rng

from sim_core.frames import Array
from sim_core.geodesy import normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.sensors.barometer import Barometer
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.imu import Imu
from sim_core.sensors.magnetometer import Magnetometer
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.faults import Fault
from xitl_cli.profile.schema.place import Site
from xitl_cli.profile.schema.sensors import Sensors
from xitl_cli.run.core.seeds import Seeds
from xitl_cli.run.sensors import sensor_messages
from xitl_cli.run.sensors.channel import Channel, SensorChannel
from xitl_cli.run.sensors.further_channels import further_channels
from xitl_cli.run.sensors.sensor_faults import SensorFaults
from xitl_cli.run.sensors.sensor_messages import Message
from xitl_cli.run.world.world import local_frame, magnetic_field_ned_gauss


class Sensing:
    """All sensors of the profile and their faults. `due` is called after each physics step, with steps counted from 1.

    `further` are sent after the usual four of the same step.
    """

    def __init__(
        self,
        sensors: Sensors,
        site: Site,
        physics_rate_hz: float,
        seeds: Seeds,
        faults: Mapping[str, Fault] | None = None,
        further: Sequence[Channel] = (),
    ) -> None:
        frame = local_frame(site)
        models: list[tuple[str, Any, Callable[[int, Any], Message]]] = [
            (
                "imu",
                Imu(gravity_mps2=normal_gravity_mps2(site.latitude_deg, site.altitude_m), **sensors.imu.model_dump()),
                sensor_messages.imu,
            ),
            ("gnss", Gnss(frame=frame, **sensors.gnss.model_dump()), sensor_messages.gnss),
            (
                "magnetometer",
                Magnetometer(field_ned_gauss=magnetic_field_ned_gauss(site), **sensors.magnetometer.model_dump()),
                sensor_messages.magnetometer,
            ),
            (
                "barometer",
                Barometer(origin_altitude_m=site.altitude_m, **sensors.barometer.model_dump()),
                sensor_messages.barometer,
            ),
        ]
        self._sensors = [
            SensorChannel(
                model,
                default_rng(seeds.of(name)),
                physics_rate_hz,
                encode,
                SensorFaults(name, faults or {}, seeds, frame),
            )
            for name, model, encode in models
        ]
        self._channels: list[Channel] = [*self._sensors, *further]
        self._waiting: list[tuple[int, int, Message]] = []
        self._order = 0

    def due(self, step: int, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> list[Message]:
        """Measure what is due at this step; return what has waited out its latency, oldest first."""
        ready: list[Message] = []
        for channel in self._channels:
            if step % channel.every == 0:
                message = channel.message(stamp_ns, motion, air_ned_mps)
                if message is None:
                    continue
                if channel.latency_ns:
                    self._order += 1
                    heapq.heappush(self._waiting, (stamp_ns + channel.latency_ns, self._order, message))
                else:
                    ready.append(message)
        while self._waiting and self._waiting[0][0] <= stamp_ns:
            ready.append(heapq.heappop(self._waiting)[2])
        return ready

    def fault_counts(self) -> dict[str, dict[str, int]]:
        """How many samples each fault has touched, by its name."""
        counts: dict[str, dict[str, int]] = {}
        for channel in self._sensors:
            for name, of_channel in channel.faults.counts.items() if channel.faults is not None else ():
                counts.setdefault(name, {}).update(of_channel)
        return counts


def sensing_of(profile: RunProfile, seeds: Seeds) -> Sensing:
    """All that the profile's agents are told of the world."""
    assert profile.sensors is not None
    further = list(further_channels(profile, seeds, local_frame(profile.site)))
    return Sensing(profile.sensors, profile.site, profile.clock.physics_rate_hz, seeds, profile.faults, further)
