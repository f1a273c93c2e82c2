"""Checks of the link to the agent: a valid URL, and a line with enough capacity for a real-time run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from urllib.parse import SplitResult, urlsplit

from agent.wire.can_bus import read_can_settings
from agent.wire.can_transfer import CanLine
from agent.wire.serial_line import BITS_PER_BYTE, device_and_baud
from agent.wire.transport import SCHEMES, BadUrlError
from agent.wire.urls import host_port
from sim_core.dataclass import dataclass
from xitl_cli.profile.files.entry import KeyPath, dotted, finding, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.agents import AutopilotSpec
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.sensors import SensorsSpec, sampled_sensors

_EXAMPLES = {
    "udp": "udp://address:port",
    "tcp": "tcp://address:port",
    "serial": "serial:///dev/ttyACM0?baud=921600",
    "can": "can://socketcan/can0?bitrate=1000000",
}


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a missing or invalid link, a link that does not fit the agent's place, and a link that is too slow."""
    autopilot = profile.autopilot
    if autopilot is None:
        return
    if autopilot.link is None and autopilot.kind != "none" and autopilot.runs != "in-process":
        example = "udp://192.168.7.2:14660" if autopilot.runs == "board" else "udp://127.0.0.1:14660"
        yield finding("autopilot.link", f"is missing with autopilot.runs = {autopilot.runs}; add one such as {example}")
    yield from _link(profile, autopilot, ("autopilot", "link"), autopilot.link, autopilot.runs)
    if autopilot.standby is not None:
        standby = autopilot.standby
        yield from _link(profile, autopilot, ("autopilot", "standby", "link"), standby.link, standby.runs)


def _link(
    profile: Profile, autopilot: AutopilotSpec, path: KeyPath, link: str | None, runs: str
) -> Iterator[tuple[KeyPath, str]]:
    if link is None:
        return
    problem = problem_of_link(link, f"{dotted(path[:-1])}.runs", runs)
    if problem is None and autopilot.kind != "none" and runs != "in-process":
        problem = _too_much(profile, autopilot, urlsplit(link))
    if problem is not None:
        yield path, f"{dotted(path)} = {shown(link)} {problem}"


def problem_of_link(link: str, key: str, runs: str) -> str | None:
    """Return the problem of a link to an agent, as `problem_of_url`.

    Port 0 means a free port on this machine. `key`: key with the agent's place.
    """
    any_port = runs != "board" and link.startswith(("udp://", "tcp://")) and link.endswith(":0")
    return problem_of_url(f"{link[:-1]}1" if any_port else link) or misplaced(urlsplit(link), key, runs)


def made_for_the_run(link: str) -> bool:
    """Return True if each agent gets its own line by this link: a pseudo terminal or a free port."""
    return "/pty" in link or link.endswith(":0")


def problem_of_url(link: str) -> str | None:
    """Return the end of a sentence that begins with key and value, or None for a usable link."""
    scheme, separator, _ = link.partition("://")
    if not separator or scheme not in SCHEMES:
        return f"is not a link; write {', '.join(_EXAMPLES.values()) if separator else _EXAMPLES['udp']}"
    try:
        url = urlsplit(link)
        if scheme in ("udp", "tcp"):
            try:
                invalid_port = url.port == 0
            except ValueError:
                invalid_port = url.netloc.rpartition(":")[2].isdigit()
            if invalid_port:
                return "has an invalid port; use a port from 1 to 65535"
            if any(letter.isspace() for letter in link):
                return f"contains a space; write {_EXAMPLES[scheme]}"
            host_port(url, listen=False)
        elif scheme == "serial":
            device_and_baud(_without_pty(url))
        else:
            read_can_settings(url, listen=False)
    except BadUrlError as error:
        return f"cannot be used: {error.what}; {error.fix}"
    except ValueError:
        return f"is not a link; write {_EXAMPLES[scheme]}"
    return None


def _without_pty(url: SplitResult) -> SplitResult:
    """Replace `serial://pty`, a device that the run creates, by a path."""
    return url._replace(netloc="", path="/pty") if url.netloc == "pty" and not url.path else url


def misplaced(url: SplitResult, key: str, runs: str) -> str | None:
    """Return the problem of a link that does not fit the agent's place. `key`: key with that place."""
    made_here = url.netloc == "pty" or (url.netloc == "slcan" and url.path == "/pty")
    if made_here and runs == "board":
        example = _EXAMPLES[url.scheme]
        return f"is a line within this machine, but the agent runs on a board; use {key} = process, or write {example}"
    if runs != "process" or made_here:
        return None
    if url.scheme == "serial":
        return f"leads to another machine; use {key} = board, or serial://pty?baud=921600 for a test here"
    if url.scheme == "can" and url.netloc == "virtual":
        return "ends within one process; write can://slcan/pty?bitrate=1000000"
    return None


def _too_much(profile: Profile, autopilot: AutopilotSpec, url: SplitResult) -> str | None:
    clock = profile.clock or ClockSpec()
    if profile.sensors is None or url.scheme not in ("serial", "can") or clock.mode != "realtime":
        return None
    signed = autopilot.link_key_file is not None
    load = load_of(profile.sensors, signed)

    def lower(share_of: Callable[[Load], float]) -> str:
        assert profile.sensors is not None
        rate_hz = highest_imu_rate_hz(profile.sensors, signed, clock.physics_rate_hz, share_of)
        return "" if rate_hz is None else f"lower sensors.imu.rate_hz to {rate_hz:g}"

    if url.scheme == "serial":
        _, baud = device_and_baud(_without_pty(url))
        return _too_much_for_baud(load, baud, lower)
    # The standby may share the bus of the first agent.
    links = [autopilot.link, None if autopilot.standby is None else autopilot.standby.link]
    urls = [urlsplit(link) for link in links if link is not None]
    agents = sum((other.scheme, other.netloc, other.path) == (url.scheme, url.netloc, url.path) for other in urls)
    return _too_much_for_bus(load, agents, read_can_settings(url, listen=False).line, lower)


def _too_much_for_baud(load: Load, baud: int, lower: Callable[[Callable[[Load], float]], str]) -> str | None:
    if load.serial_share(baud) <= MOST_SHARE:
        return None
    to_agent, to_host = bytes_per_s(load.to_agent), bytes_per_s(load.to_host)
    flows, way, needed = (load.to_agent, "to", to_agent) if to_agent >= to_host else (load.to_host, "from", to_host)
    faster = next((rate for rate in BAUDS if load.serial_share(rate) <= MOST_SHARE), None)
    remedies = [lower(lambda load: load.serial_share(baud)), "" if faster is None else f"use baud={faster} or more"]
    return (
        f"carries {baud / 10:.0f} bytes/s each way, of which {MOST_SHARE:.0%} are usable "
        f"({MOST_SHARE * baud / 10:.0f}); the data {way} the agent need {needed:.0f} bytes/s "
        f"({', '.join(map(str, flows))}); {_remedy(remedies)}"
    )


def _too_much_for_bus(
    one_agent: Load, agents: int, line: CanLine, lower: Callable[[Callable[[Load], float]], str]
) -> str | None:
    load = one_agent.times(agents)
    if load.can_share(line) <= MOST_SHARE:
        return None
    needed = bytes_per_s((*load.to_agent, *load.to_host))
    capacity = needed / load.can_share(line)
    faster = next((bus for bus in BUSES if bus.fd >= line.fd and load.can_share(bus) <= MOST_SHARE), None)
    remedies = [lower(lambda load: load.times(agents).can_share(line))]
    if faster is not None:
        fd = f"&fd=true&data_bitrate={faster.data_bitrate}" if faster.fd else ""
        remedies.append(f"use bitrate={faster.bitrate}{fd}")
    return (
        f"carries {capacity:.0f} bytes/s of such frames both ways together, of which {MOST_SHARE:.0%} are usable "
        f"({MOST_SHARE * capacity:.0f}); the data need {needed:.0f} bytes/s "
        f"{'' if agents == 1 else f'for {agents} agents '}"
        f"({', '.join(map(str, (*load.to_agent, *load.to_host)))}); {_remedy(remedies)}"
    )


def _remedy(remedies: list[str]) -> str:
    return " or ".join(filter(None, remedies)) or "lower the rates of the sensors or use UDP"


MOST_SHARE = 0.8
"""Usable share of a line. Parameters, missions, texts and repetitions need the rest."""

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
TASKS = 5  # control, log, telemetry, status, and ground stations if there are any
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

    name: str
    rate_hz: float
    frame_bytes: int

    @property
    def bytes_per_s(self) -> float:
        return self.rate_hz * self.frame_bytes

    def __str__(self) -> str:
        return f"{self.name} {self.rate_hz:g} Hz × {self.frame_bytes} = {self.bytes_per_s:.0f}"


@dataclass(frozen=True, slots=True)
class Load:
    """Both directions of a link."""

    to_agent: tuple[Flow, ...]
    to_host: tuple[Flow, ...]

    def times(self, agents: int) -> Load:
        """Return the load of several agents."""
        if agents == 1:
            return self
        there, back = (
            tuple(replace(flow, rate_hz=flow.rate_hz * agents) for flow in flows)
            for flows in (self.to_agent, self.to_host)
        )
        return Load(there, back)

    def serial_share(self, baud: int) -> float:
        """Return the share of a serial line that the busier direction uses."""
        return max(map(bytes_per_s, (self.to_agent, self.to_host))) * BITS_PER_BYTE / baud

    def can_share(self, line: CanLine) -> float:
        """Return the share of the bus that both directions use together.

        Frames have the largest length that stuffing can give.
        """
        return sum(flow.rate_hz * line.transfer_s(flow.frame_bytes) for flow in (*self.to_agent, *self.to_host))


def bytes_per_s(flows: Iterable[Flow]) -> float:
    """Return the rate of one direction."""
    return sum(flow.bytes_per_s for flow in flows)


def load_of(sensors: SensorsSpec, signed: bool = False, imu_rate_hz: float | None = None) -> Load:
    """Return the traffic of these sensors and of an embedded autopilot. `imu_rate_hz` replaces the sensor's rate."""
    from agent.fcu.mavlink.telemetry import RATES_HZ
    from agent.fcu.vehicle.autopilot import LOOP_HZ
    from agent.wire import dialect
    from agent.wire.actuators import EXTENSION_BYTES

    sizes = {kind.msgname: kind.unpacker.size for kind in dialect.mavlink_map.values()}
    sizes["XITL_ACTUATORS"] -= EXTENSION_BYTES  # zeros at the end are not sent: up to eight commands need none of it
    extra = OVERHEAD_BYTES + (SIGNATURE_BYTES if signed else 0)

    def flow(name: str, message: str, rate_hz: float) -> Flow:
        return Flow(name, rate_hz, sizes[message] + extra)

    def rate_hz(sensor: str) -> float:
        own: float = getattr(sensors, sensor).rate_hz
        return imu_rate_hz if sensor == "imu" and imu_rate_hz is not None else own

    telemetry = [flow("", dialect.mavlink_map[number].msgname, rate) for number, rate in RATES_HZ.items()]
    telemetry_rate_hz = sum(message.rate_hz for message in telemetry)
    mean_bytes = round(bytes_per_s(telemetry) / telemetry_rate_hz)
    return Load(
        to_agent=(
            *(flow(sensor, message, rate_hz(sensor)) for sensor, message in _SENSORS.items()),
            *(
                flow(".".join(map(str, path[1:])), message, sensor.rate_hz)
                for path, sensor in sampled_sensors(sensors)
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
    sensors: SensorsSpec, signed: bool, physics_hz: float, share_of: Callable[[Load], float]
) -> float | None:
    """Return the highest whole rate below the current rate that divides the physics rate and fits.

    None without such a rate.
    """
    for step in range(1, int(physics_hz // LOWEST_IMU_HZ) + 1):
        rate_hz = physics_hz / step
        slower = rate_hz < sensors.imu.rate_hz and rate_hz == int(rate_hz)
        if slower and share_of(load_of(sensors, signed, rate_hz)) <= MOST_SHARE:
            return rate_hz
    return None
