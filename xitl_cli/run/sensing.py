"""The simulated sensors of one vessel, their samples as custom MAVLink messages, and their latency."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from typing import Any

from numpy.random import Generator, default_rng

from agent.wire import dialect
from sim_core.geodesy import LocalFrame, normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.sensors.barometer import Barometer, BarometerSample
from sim_core.sensors.gnss import Gnss, GnssSample
from sim_core.sensors.imu import Imu, ImuSample
from sim_core.sensors.magnetometer import Magnetometer, MagnetometerSample, local_field_ned_gauss
from xitl_cli.profile.schema.faults import Fault
from xitl_cli.profile.schema.place import Site
from xitl_cli.profile.schema.sensors import Sensors
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensor_faults import SensorFaults

Message = Any  # the generated codec is untyped


class _Channel:
    """One sensor, its state and random generator, its faults, and how its sample becomes a message."""

    def __init__(
        self, sensor: Any, rng: Generator, every: int, encode: Callable[[int, Any], Message], faults: SensorFaults
    ) -> None:
        self.every = every
        self.latency_ns = round(sensor.latency_s * 1e9)
        self._sensor = sensor
        self._rng = rng
        self._state = sensor.initial(1, rng)
        self._encode = encode
        self.faults = faults
        self._faulty = bool(faults)

    def message(self, stamp_ns: int, motion: Kinematics) -> Message | None:
        self._state, sample = self._sensor.measure(self._state, motion, self._rng)
        if self._faulty:
            sample = self.faults.applied(stamp_ns, sample)
            if sample is None:
                return None
        return self._encode(stamp_ns // 1000, sample)


class Sensing:
    """All sensors of the profile and their faults. `due` is called after each physics step, with steps counted from 1.

    A sensor measures on behind its faults, so that what comes after one is what would have come without it.
    """

    def __init__(
        self,
        sensors: Sensors,
        site: Site,
        physics_rate_hz: float,
        seeds: Seeds,
        faults: Mapping[str, Fault] | None = None,
    ) -> None:
        frame = local_frame(site)
        models: list[tuple[str, Any, Callable[[int, Any], Message]]] = [
            (
                "imu",
                Imu(gravity_mps2=normal_gravity_mps2(site.latitude_deg, site.altitude_m), **sensors.imu.model_dump()),
                _imu,
            ),
            ("gnss", Gnss(frame=frame, **sensors.gnss.model_dump()), _gnss),
            (
                "magnetometer",
                Magnetometer(field_ned_gauss=magnetic_field_ned_gauss(site), **sensors.magnetometer.model_dump()),
                _magnetometer,
            ),
            ("barometer", Barometer(origin_altitude_m=site.altitude_m, **sensors.barometer.model_dump()), _barometer),
        ]
        self._channels = [
            _Channel(
                model,
                default_rng(seeds.of(name)),
                round(physics_rate_hz / model.rate_hz),
                encode,
                SensorFaults(name, faults or {}, seeds, frame),
            )
            for name, model, encode in models
        ]
        self._waiting: list[tuple[int, int, Message]] = []
        self._order = 0

    def due(self, step: int, stamp_ns: int, motion: Kinematics) -> list[Message]:
        """Measure what is due at this step; return what has waited out its latency, oldest first."""
        ready: list[Message] = []
        for channel in self._channels:
            if step % channel.every == 0:
                message = channel.message(stamp_ns, motion)
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
        for channel in self._channels:
            for name, of_channel in channel.faults.counts.items():
                counts.setdefault(name, {}).update(of_channel)
        return counts


def local_frame(site: Site) -> LocalFrame:
    """NED at the site. Mean sea level is taken for the ellipsoid: their difference is constant over the site."""
    return LocalFrame(site.latitude_deg, site.longitude_deg, site.altitude_m)


def magnetic_field_ned_gauss(site: Site) -> tuple[float, float, float]:
    """The field the profile gives, else that of the world magnetic model."""
    if site.magnetic_field_ned_gauss is not None:
        return site.magnetic_field_ned_gauss
    return local_field_ned_gauss(site.latitude_deg, site.longitude_deg, site.altitude_m, site.year).ned_gauss


def _imu(stamp_us: int, sample: ImuSample) -> Message:
    gyro, accel = sample.gyro_frd_radps[0].tolist(), sample.accel_frd_mps2[0].tolist()
    return dialect.MAVLink_xitl_imu_message(stamp_us, gyro, accel, float(sample.temperature_degc[0]))


def _gnss(stamp_us: int, sample: GnssSample) -> Message:
    return dialect.MAVLink_xitl_gnss_message(
        stamp_us,
        round(float(sample.lat_deg[0]) * 1e7),
        round(float(sample.lon_deg[0]) * 1e7),
        round(float(sample.alt_m[0]) * 1e3),
        sample.vel_ned_mps[0].tolist(),
        float(sample.horizontal_accuracy_m[0]),
        float(sample.vertical_accuracy_m[0]),
        float(sample.speed_accuracy_mps[0]),
        int(sample.fix_type[0]),
        int(sample.satellites[0]),
    )


def _magnetometer(stamp_us: int, sample: MagnetometerSample) -> Message:
    return dialect.MAVLink_xitl_magnetometer_message(stamp_us, sample.field_frd_gauss[0].tolist())


def _barometer(stamp_us: int, sample: BarometerSample) -> Message:
    return dialect.MAVLink_xitl_barometer_message(
        stamp_us, float(sample.pressure_pa[0]), float(sample.temperature_degc[0])
    )
