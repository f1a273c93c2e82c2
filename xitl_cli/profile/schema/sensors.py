"""`sensors`: the four that every autopilot has, and others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any

from sim_core.keys import Bounds, Items, Specification
from sim_core.sensors.spec import (
    BarometerSpec,
    GnssSpec,
    ImuSpec,
    LidarSpec,
    MagnetometerSpec,
    ObstacleScannerSpec,
    OdometrySpec,
    RangefinderSpec,
    SonarSpec,
    WindVaneSpec,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsInputSpec(GnssSpec):
    """A further satellite receiver, sent as GPS_INPUT."""

    gps_id: Annotated[int, Bounds(at_least=0, at_most=3)] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class MessagesSpec(Specification):
    """Standard messages beside our own, for an autopilot behind a bridge or a companion; null sends none."""

    gps_input: GpsInputSpec | None = None
    obstacle_distance: ObstacleScannerSpec | None = None
    odometry: OdometrySpec | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorsSpec(Specification):
    """The sensors of the vessel; lidar and sonar reach a companion."""

    imu: ImuSpec
    gnss: GnssSpec
    magnetometer: MagnetometerSpec
    barometer: BarometerSpec
    rangefinders: Annotated[tuple[RangefinderSpec, ...], Items(0, 6)] = ()
    wind_vane: WindVaneSpec | None = None
    lidar: LidarSpec | None = None
    sonar: SonarSpec | None = None
    messages: MessagesSpec = MessagesSpec()


def sampled_sensors(sensors: SensorsSpec) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Every sensor that is sampled on physics steps and sent at a rate of its own, with the path of its key."""
    for name in ("imu", "gnss", "magnetometer", "barometer"):
        yield ("sensors", name), getattr(sensors, name)
    for number, rangefinder in enumerate(sensors.rangefinders):
        yield ("sensors", "rangefinders", number), rangefinder
    if sensors.wind_vane is not None:
        yield ("sensors", "wind_vane"), sensors.wind_vane
    for field in fields(sensors.messages):
        if (message := getattr(sensors.messages, field.name)) is not None:
            yield ("sensors", "messages", field.name), message
