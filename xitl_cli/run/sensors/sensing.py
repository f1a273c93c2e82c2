"""The simulated sensors of one vessel, their samples as messages to the agents, and their latency."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from numpy.random import Generator, default_rng

from agent.bridges.kinds import bridge_kinds
from agent.wire import dialect
from sim_core.environment.wind import Air, make_wind
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame, normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.sensors.barometer import Barometer
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.imu import Imu
from sim_core.sensors.magnetometer import Magnetometer
from sim_core.simulation import Simulation, SimulationState
from sim_core.world.structures import upright_walls
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.sensors import SensorsSpec
from xitl_cli.profile.schema.world import SiteSpec
from xitl_cli.run.sensors import sensor_messages
from xitl_cli.run.sensors.sensor_faults import SensorFaults
from xitl_cli.run.sensors.sensor_messages import Message
from xitl_cli.run.world.plant import PlantView
from xitl_cli.run.world.world import local_frame, magnetic_field_ned_gauss
from xitl_cli.seeds import Seeds

if TYPE_CHECKING:
    from sim_core.sensors.rangefinder import HullsAround, TideNow
    from sim_core.sensors.wind_vane import WindVane
    from xitl_cli.profile.schema.faults import FaultSpec
    from xitl_cli.run.sensors.recorded import RecordedChannel, RecordedSamples


class SensorSuite:
    """All sensors of the profile and their faults. Call `due` after every `every` physics steps; steps count from 1.

    `further`: channels that are sent after the usual four of the same step. plant: the vessel in a fleet, whose sensors
    are measured together with those of the same model on other vessels; None for a vessel alone.
    """

    def __init__(
        self,
        sensors: SensorsSpec,
        site: SiteSpec,
        physics_rate_hz: float,
        seeds: Seeds,
        faults: Mapping[str, FaultSpec] | None = None,
        further: Sequence[Channel] = (),
        plant: PlantView | None = None,
    ) -> None:
        frame = local_frame(site)
        gravity_mps2 = normal_gravity_mps2(site.latitude_deg, site.altitude_m)
        models = (
            ("imu", Imu(sensors.imu, gravity_mps2), sensor_messages.imu),
            ("gnss", Gnss(sensors.gnss, frame), sensor_messages.gnss),
            (
                "magnetometer",
                Magnetometer(sensors.magnetometer, magnetic_field_ned_gauss(site)),
                sensor_messages.magnetometer,
            ),
            ("barometer", Barometer(sensors.barometer, site.altitude_m), sensor_messages.barometer),
        )
        self._faults = {name: SensorFaults(name, faults or {}, seeds, frame) for name, _, _ in models}
        recorded: Mapping[str, RecordedSamples] = {}
        if sensors.recorded is not None:
            from xitl_cli.run.sensors.recorded import RecordedChannel, read_samples

            recorded = read_samples(sensors.recorded, site)
        self._sensors: dict[str, SensorChannel | FleetChannel | RecordedChannel] = {}
        self._recorded: dict[str, RecordedChannel] = {}
        for name, model, encode in models:
            faults_of, rng = self._faults[name], default_rng(seeds.sequence(name))
            if name in recorded:
                self._sensors[name] = self._recorded[name] = RecordedChannel(recorded[name], encode, faults_of)
            elif plant is not None and name in _TOGETHER:
                self._sensors[name] = FleetChannel(model, rng, physics_rate_hz, _TOGETHER[name], faults_of, plant)
            else:
                self._sensors[name] = SensorChannel(model, rng, physics_rate_hz, encode, faults_of)
        self._channels: list[Channel] = [*self._sensors.values(), *further]
        dt_ns = round(1e9 / physics_rate_hz)
        delays = [-(-channel.latency_ns // dt_ns) for channel in self._channels]
        self.every = math.gcd(*(channel.every for channel in self._channels), *delays)
        self.feels_wind = any(isinstance(channel, VaneChannel) for channel in further)
        self._waiting: list[tuple[int, int, Message]] = []
        self._order = 0

    def due(self, step: int, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> list[Message]:
        """Measure the samples of this step, and return the messages with elapsed latency, oldest first.

        air_ned_mps: the wind (1, 3), for sensors that measure it.
        """
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
        """Return the number of samples that each fault has changed, by the fault's name."""
        counts: dict[str, dict[str, int]] = {}
        for faults in self._faults.values():
            for name, of_sensor in faults.counts.items():
                counts.setdefault(name, {}).update(of_sensor)
        return counts

    def recorded_report(self) -> dict[str, dict[str, dict[str, int]]]:
        """Return `recorded_sensors`: by sensor, the recorded samples that were sent, and skipped for newer ones."""
        counts = {name: {"sent": channel.sent, "skipped": channel.skipped} for name, channel in self._recorded.items()}
        return {"recorded_sensors": counts} if counts else {}

    def set_fault(self, name: str, fault: FaultSpec) -> None:
        """Activate a fault at its times. It replaces a fault of the same name."""
        for sensor, faults in self._faults.items():
            faults.set(name, fault)
            self._sensors[sensor].faults = faults or None


def make_sensing(
    profile: RunProfile,
    seeds: Seeds,
    hulls: HullsAround | None = None,
    air: Callable[[], Air] | None = None,
    tide_m: TideNow | None = None,
    plant: PlantView | None = None,
) -> SensorSuite:
    """Return all channels to the profile's agents.

    hulls: of other vessels in the world, None without any. air: air over the water now, None for the profile's.
    tide_m: height of the still water above its mean level now, None without a tide. plant: the vessel in a fleet, None
    for a vessel alone.
    """
    assert profile.sensors is not None
    further = list(_further_channels(profile, seeds, local_frame(profile.site), hulls, air, tide_m))
    physics_hz = profile.clock.physics_rate_hz
    return SensorSuite(profile.sensors, profile.site, physics_hz, seeds, profile.faults, further, plant)


def _further_channels(
    profile: RunProfile,
    seeds: Seeds,
    frame: LocalFrame,
    hulls: HullsAround | None,
    air: Callable[[], Air] | None,
    tide_m: TideNow | None,
) -> Iterator[Channel]:
    """Yield the optional sensors of a profile, and the truth for an autopilot with its own simulated sensors."""
    assert profile.sensors is not None
    sensors, water, physics_hz = profile.sensors, profile.environment.water, profile.clock.physics_rate_hz
    walls = upright_walls(profile.world.log_boom, profile.world.dam, -water.level_m)
    if sensors.rangefinders:
        from sim_core.sensors.rangefinder import Rangefinder
    for number, rangefinder in enumerate(sensors.rangefinders):
        unit = Rangefinder(rangefinder, water.depth_m - water.level_m, -water.level_m, walls, hulls, tide_m)
        rng = default_rng(seeds.sequence(f"rangefinder {number}"))
        yield SensorChannel(unit, rng, physics_hz, sensor_messages.distance_sensor(number, rangefinder))
    messages = sensors.messages
    if (fixes := messages.gps_input) is not None:
        rng = default_rng(seeds.sequence("gps input"))
        yield SensorChannel(Gnss(fixes, frame), rng, physics_hz, sensor_messages.gps_input(fixes.gps_id))
    if (scan := messages.obstacle_distance) is not None:
        from sim_core.sensors.rangefinder import ObstacleScanner

        rng = default_rng(seeds.sequence("obstacle distance"))
        yield SensorChannel(
            ObstacleScanner(scan, walls, hulls), rng, physics_hz, sensor_messages.obstacle_distance(scan)
        )
    if (pose := messages.odometry) is not None:
        from sim_core.sensors.odometry import Odometry

        encode = sensor_messages.odometry(pose.velocity_noise_mps, pose.rate_noise_radps)
        yield SensorChannel(Odometry(pose), default_rng(seeds.sequence("odometry")), physics_hz, encode)
    bridge = profile.autopilot.bridge
    bridged = profile.autopilot.kind not in ("none", "embedded")
    if bridged and any(kind.truth for kind in bridge_kinds(bridge.world, bridge.sensors)):
        vane = None
        if sensors.wind_vane is not None:
            from sim_core.sensors.wind_vane import WindVane

            steady, areas_m = make_wind(profile.environment.wind), profile.vehicle.wind.centre_height_m

            def against_areas(height_m: Array | float) -> Array:
                wind = steady if air is None else air()
                return wind.share(height_m) / wind.share(areas_m)

            mast = WindVane(sensors.wind_vane, against_areas, water.level_m, tide_m)
            vane = VaneChannel(mast, default_rng(seeds.sequence("wind vane")), physics_hz)
            yield vane
        yield TruthChannel(round(physics_hz / profile.clock.exchange_rate_hz), vane)


class Channel(Protocol):
    """One kind of message."""

    every: int
    """Physics steps between messages."""
    latency_ns: int
    """Delay of the delivery."""

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        """Return the measurement now; None without a message."""


class SensorChannel:
    """One sensor, its state and random generator, its faults, and the encoding of its sample.

    The sensor continues to measure during a fault, so that samples after the fault are the same as without it.
    """

    def __init__(
        self,
        sensor: Any,
        rng: Generator,
        physics_rate_hz: float,
        encode: Callable[[int, Any], Message],
        faults: SensorFaults | None = None,
    ) -> None:
        self.every = round(physics_rate_hz / sensor.spec.rate_hz)
        self.latency_ns = round(sensor.spec.latency_s * 1e9)
        self.faults = faults or None
        self._sensor = sensor
        self._rng = rng
        self._state = sensor.initial(1, rng)
        self._encode = encode

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        self._state, sample = self._sensor.measure(self._state, motion, self._rng)
        if self.faults is not None:
            sample = self.faults.applied(stamp_ns, sample)
            if sample is None:
                return None
        return self._encode(stamp_ns // 1000, sample)


class FleetChannel:
    """A sensor of a vessel in a fleet, otherwise as SensorChannel."""

    def __init__(
        self,
        sensor: Any,
        rng: Generator,
        physics_rate_hz: float,
        encode: Callable[[int, Any, int], Message],
        faults: SensorFaults,
        plant: PlantView,
    ) -> None:
        self.every = round(physics_rate_hz / sensor.spec.rate_hz)
        self.latency_ns = round(sensor.spec.latency_s * 1e9)
        self.faults = faults or None
        self._together, row = plant.shared(sensor, lambda: FleetSensor(sensor))
        self._row = self._together.add(row, rng)
        self._plant = plant
        self._encode = encode

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        sample, _ = self._plant.derived(self._together.measure)
        row = self._row
        if self.faults is not None:
            sample, row = self.faults.applied(stamp_ns, row_of(sample, row)), 0
            if sample is None:
                return None
        return self._encode(stamp_ns // 1000, sample, row)


_TOGETHER: Mapping[str, Callable[[int, Any, int], Message]] = {
    "imu": sensor_messages.imu,
    "magnetometer": sensor_messages.magnetometer,
    "barometer": sensor_messages.barometer,
}
"""Encoders of the sensors that a fleet measures together. A receiver of GNSS has too few samples to gain from it."""

UNKNOWN_WIND_MPS = -1.0


class TruthChannel:
    """XITL_TRUTH every `every` physics steps, for the instant of the step and without delay."""

    latency_ns = 0

    def __init__(self, every: int, vane: VaneChannel | None = None) -> None:
        self.every = every
        self._vane = vane

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message:
        wind = (UNKNOWN_WIND_MPS, 0.0) if self._vane is None else self._vane.latest(stamp_ns)
        return dialect.MAVLink_xitl_truth_message(
            stamp_ns // 1000,
            motion.pos_ned_m[0].tolist(),
            motion.vel_ned_mps[0].tolist(),
            motion.quat_ned_frd[0].tolist(),
            motion.gyro_frd_radps[0].tolist(),
            *wind,
        )


class VaneChannel:
    """The wind vane. It has no separate message: the truth message carries its newest delivered sample."""

    latency_ns = 0

    def __init__(self, vane: WindVane, rng: Generator, physics_rate_hz: float) -> None:
        self.every = round(physics_rate_hz / vane.spec.rate_hz)
        self._vane = vane
        self._rng = rng
        self._state = vane.initial(1, rng)
        self._latency_ns = round(vane.spec.latency_s * 1e9)
        self._waiting: deque[tuple[int, float, float]] = deque()
        self._latest = (UNKNOWN_WIND_MPS, 0.0)

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        self._state, sample = self._vane.measure(self._state, motion, air_ned_mps, self._rng)
        delivered_ns = stamp_ns + self._latency_ns
        self._waiting.append((delivered_ns, float(sample.speed_mps[0]), float(sample.direction_rad[0])))

    def latest(self, now_ns: int) -> tuple[float, float]:
        """Return speed in m/s, below 0 before the first sample, and direction in rad from the bow."""
        while self._waiting and self._waiting[0][0] <= now_ns:
            self._latest = self._waiting.popleft()[1:]
        return self._latest


T = TypeVar("T")

DRAWN_AHEAD = 64
"""Samples for which a generator draws at once: one call for many numbers takes a fraction of the time."""


class FleetNormals:
    """Standard normal numbers of M generators, row by row, as a sensor model of M vessels asks for them.

    Each generator gives the numbers of its own calls in the same order.
    """

    def __init__(self, generators: list[Generator]) -> None:
        self._generators = generators
        self._drawn: Array = np.empty((0, len(generators), 0))
        self._next = 0

    def standard_normal(self, shape: tuple[int, int]) -> Array:
        """Return (M, K) numbers; every call must ask for the same shape."""
        if self._next == len(self._drawn):
            drawn = [generator.standard_normal((DRAWN_AHEAD, shape[1])) for generator in self._generators]
            self._drawn, self._next = np.stack(drawn, axis=1), 0
        numbers: Array = self._drawn[self._next]
        self._next += 1
        return numbers


class FleetSensor:
    """A sensor model on M vessels of a fleet, measured together: it costs as much as on one vessel.

    Every vessel keeps its own random generator and gets the values that it would get alone. `add` all vessels before
    the first measurement.
    """

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor
        self._rows: list[int] = []
        self._generators: list[Generator] = []
        self._states: list[Any] = []
        self._state: Any = None
        self._sample: Any = None
        self._time_ns = -1

    def add(self, row: int, generator: Generator) -> int:
        """Add the vessel in this row of the state; return the row of its samples."""
        self._rows.append(row)
        self._generators.append(generator)
        self._states.append(self._sensor.initial(1, generator))
        return len(self._rows) - 1

    def measure(self, simulation: Simulation, state: SimulationState) -> Any:
        """Return the sample of all vessels (M, ...) at this state. It is taken once for an instant."""
        if state.time_ns == self._time_ns:
            return self._sample
        if self._time_ns < 0:
            self._state, self._normals = joined(self._states), FleetNormals(self._generators)
        self._time_ns = state.time_ns
        motion = state.vessel.motion
        if self._rows != list(range(len(motion.pos_ned_m))):
            rows = np.array(self._rows)
            motion = Kinematics(*(getattr(motion, field.name)[rows] for field in fields(Kinematics)))
        self._state, self._sample = self._sensor.measure(self._state, motion, self._normals)
        return self._sample


def joined(records: list[T]) -> T:
    """Join records of arrays of one row each."""
    kind: Any = type(records[0])
    names = [field.name for field in fields(kind)]
    whole: T = kind(*(np.concatenate([getattr(record, name) for record in records]) for name in names))
    return whole


def row_of(record: T, row: int) -> T:
    """Return one row of a record of arrays."""
    kind: Any = type(record)
    own: T = kind(*(getattr(record, field.name)[row : row + 1] for field in fields(kind)))
    return own
