"""`sensors`: the four that every autopilot has, and others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, IfGiven, Items, NonNegative, Required, Specification, SpecificationError
from sim_core.sensors.camera_spec import CameraSpec
from sim_core.sensors.spec import (
    BarometerSpec,
    GnssSpec,
    ImuSpec,
    LidarSpec,
    MagnetometerSpec,
    MarineRadarSpec,
    ObstacleScannerSpec,
    OdometrySpec,
    RangefinderSpec,
    SonarSpec,
    WindVaneSpec,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class GpsInputSpec(GnssSpec):
    """An additional satellite receiver, sent as GPS_INPUT."""

    gps_id: Annotated[int, Bounds(at_least=0, at_most=3)] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class MessagesSpec(Specification):
    """Standard messages in addition to xitl's own, for an autopilot behind a bridge or a companion; null sends none."""

    gps_input: GpsInputSpec | None = None
    obstacle_distance: ObstacleScannerSpec | None = None
    odometry: OdometrySpec | None = None


AUTO, SIMULATED = "auto", "simulated"
_SOURCE = re.compile(r"auto|simulated|/\S+")


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSensorsSpec(Specification):
    """Samples of a bag, or of an MCAP recording with ROS messages, at their time stamps, instead of simulated samples.

    For each sensor, `auto` selects the only topic of its type in the recording, and sends nothing if there is none.
    `simulated` uses the simulated vessel. Any other value is the name of a topic.
    """

    file: Annotated[str, Required] = ""
    from_s: Annotated[NonNegative, "time in the recording, as `xitl logs info` counts, at which the run begins"] = 0.0
    imu: Annotated[str, "sensor_msgs/Imu"] = AUTO
    gnss: Annotated[
        str, "sensor_msgs/NavSatFix; its velocity comes from a TwistStamped `fix_velocity` or `gps_vel`"
    ] = AUTO
    magnetometer: Annotated[str, "sensor_msgs/MagneticField"] = AUTO
    barometer: Annotated[str, "sensor_msgs/FluidPressure"] = AUTO

    def check(self) -> None:
        for name in ("imu", "gnss", "magnetometer", "barometer"):
            source = getattr(self, name)
            if not _SOURCE.fullmatch(source):
                raise SpecificationError(
                    (name,), f"= {source!r} is not a topic; use auto, simulated or a name as /imu/data"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorsSpec(Specification):
    """The sensors of the vessel; lidar and sonar are for a companion, the radar is recorded."""

    imu: ImuSpec
    gnss: GnssSpec
    magnetometer: MagnetometerSpec
    barometer: BarometerSpec
    rangefinders: Annotated[tuple[RangefinderSpec, ...], Items(0, 6)] = ()
    wind_vane: WindVaneSpec | None = None
    lidar: LidarSpec | None = None
    sonar: SonarSpec | None = None
    cameras: Annotated[tuple[CameraSpec, ...], Items(0, 16), IfGiven()] = ()
    radar: Annotated[MarineRadarSpec | None, IfGiven()] = None
    messages: MessagesSpec = MessagesSpec()
    recorded: Annotated[RecordedSensorsSpec | None, "null: all are simulated"] = None

    def check(self) -> None:
        names = [camera.name for camera in self.cameras]
        for number, name in enumerate(names):
            if name in names[:number]:
                raise SpecificationError(("cameras", number, "name"), f"= {name} is taken; give each camera its own")


def sampled_sensors(sensors: SensorsSpec) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield every sensor that is sampled at its own rate on physics steps, with the path of its key."""
    for name in ("imu", "gnss", "magnetometer", "barometer"):
        yield ("sensors", name), getattr(sensors, name)
    for number, rangefinder in enumerate(sensors.rangefinders):
        yield ("sensors", "rangefinders", number), rangefinder
    if sensors.wind_vane is not None:
        yield ("sensors", "wind_vane"), sensors.wind_vane
    for field in fields(sensors.messages):
        if (message := getattr(sensors.messages, field.name)) is not None:
            yield ("sensors", "messages", field.name), message
