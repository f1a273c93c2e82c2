"""What a run in real time sends over its link, and how much of a line that fills."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from agent.wire.can_transfer import CanLine
from agent.wire.serial_line import BITS_PER_BYTE
from xitl_cli.profile.schema.sensors import Sensors, sensors_of

MOST_SHARE = 0.8
"""Of a line that can be planned with: parameters, missions, texts and repetitions need the rest."""

BAUDS = (57_600, 115_200, 230_400, 460_800, 921_600, 1_000_000, 1_500_000, 2_000_000, 3_000_000, 4_000_000)
BUSES = (
    *(CanLine(bitrate) for bitrate in (125_000, 250_000, 500_000, 1_000_000)),
    *(CanLine(1_000_000, True, data_bitrate) for data_bitrate in (2_000_000, 5_000_000, 8_000_000)),
)
OVERHEAD_BYTES = 12
SIGNATURE_BYTES = 13
SYNC_RATE_HZ = 10.0
STATUS_RATE_HZ = 1.0
LOWEST_IMU_HZ = 50.0  # a sample for each control cycle
TASKS = 5  # control, log, telemetry, status, and ground stations where there are any
_OTHERS = {
    "rangefinders": "DISTANCE_SENSOR",
    "gps_input": "GPS_INPUT",
    "obstacle_distance": "OBSTACLE_DISTANCE",
    "odometry": "ODOMETRY",
}
_SENSORS = {"imu": "XITL_IMU", "gnss": "XITL_GNSS", "magnetometer": "XITL_MAGNETOMETER", "barometer": "XITL_BAROMETER"}


@dataclass(frozen=True, slots=True)
class Flow:
    """Frames of one kind in one direction."""

    what: str
    rate_hz: float
    frame_bytes: int

    @property
    def bytes_per_s(self) -> float:
        return self.rate_hz * self.frame_bytes

    def __str__(self) -> str:
        return f"{self.what} {self.rate_hz:g} Hz × {self.frame_bytes} = {self.bytes_per_s:.0f}"


@dataclass(frozen=True, slots=True)
class Load:
    """Both directions of a link."""

    to_agent: tuple[Flow, ...]
    to_host: tuple[Flow, ...]

    def times(self, agents: int) -> Load:
        """Of so many agents, each with all of it."""
        if agents == 1:
            return self
        there, back = (
            tuple(replace(flow, rate_hz=flow.rate_hz * agents) for flow in flows)
            for flows in (self.to_agent, self.to_host)
        )
        return Load(there, back)

    def serial_share(self, baud: int) -> float:
        """Of the busier direction."""
        return max(map(bytes_per_s, (self.to_agent, self.to_host))) * BITS_PER_BYTE / baud

    def can_share(self, line: CanLine) -> float:
        """Of the bus, which both directions have together; every frame as long as stuffing can make it."""
        return sum(flow.rate_hz * line.transfer_s(flow.frame_bytes) for flow in (*self.to_agent, *self.to_host))


def bytes_per_s(flows: Iterable[Flow]) -> float:
    """Of one direction."""
    return sum(flow.bytes_per_s for flow in flows)


def load_of(sensors: Sensors, signed: bool = False, imu_rate_hz: float | None = None) -> Load:
    """The traffic of these sensors and of an embedded autopilot; `imu_rate_hz` in place of the sensor's own."""
    from agent.fcu.mavlink.telemetry import RATES_HZ
    from agent.fcu.vehicle.autopilot import LOOP_HZ
    from agent.wire import dialect

    sizes = {kind.msgname: kind.unpacker.size for kind in dialect.mavlink_map.values()}
    extra = OVERHEAD_BYTES + (SIGNATURE_BYTES if signed else 0)

    def flow(what: str, message: str, rate_hz: float) -> Flow:
        return Flow(what, rate_hz, sizes[message] + extra)

    def rate_hz(sensor: str) -> float:
        own: float = getattr(sensors, sensor).rate_hz
        return imu_rate_hz if sensor == "imu" and imu_rate_hz is not None else own

    telemetry = [flow("", dialect.mavlink_map[number].msgname, rate) for number, rate in RATES_HZ.items()]
    telemetry_rate_hz = sum(one.rate_hz for one in telemetry)
    mean_bytes = round(bytes_per_s(telemetry) / telemetry_rate_hz)
    return Load(
        to_agent=(
            *(flow(sensor, message, rate_hz(sensor)) for sensor, message in _SENSORS.items()),
            *(
                flow(".".join(map(str, path[1:])), message, sensor.rate_hz)
                for path, sensor in sensors_of(sensors)
                for key, message in _OTHERS.items()
                if key in path
            ),
            flow("timesync", "XITL_TIMESYNC", SYNC_RATE_HZ),
        ),
        to_host=(
            flow("actuators", "XITL_ACTUATORS", LOOP_HZ),
            Flow("telemetry", telemetry_rate_hz, mean_bytes),
            flow("timesync", "XITL_TIMESYNC", SYNC_RATE_HZ),
            flow("task statistics", "XITL_TASK_STATS", TASKS * STATUS_RATE_HZ),
            flow("node status", "XITL_NODE_STATUS", STATUS_RATE_HZ),
        ),
    )


def highest_imu_rate_hz(
    sensors: Sensors, signed: bool, physics_hz: float, share_of: Callable[[Load], float]
) -> float | None:
    """The highest whole rate below the present one that divides the physics rate and fits, None when none does."""
    for step in range(1, int(physics_hz // LOWEST_IMU_HZ) + 1):
        rate_hz = physics_hz / step
        slower = rate_hz < sensors.imu.rate_hz and rate_hz == int(rate_hz)
        if slower and share_of(load_of(sensors, signed, rate_hz)) <= MOST_SHARE:
            return rate_hz
    return None
