"""Another autopilot than the embedded one: how the bridge reaches it, and how its sensors and outputs go."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import urlsplit

from xitl_cli.errors import UserError
from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.ground_stations import ground_stations_of
from xitl_cli.profile.parameter_files import read_parameter_file
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.operation import Autopilot, Bridge

Finding = tuple[KeyPath, str]

EXTERNAL = "external"
OWN_LINK = ("vectornav", "microstrain7")
OWN_SIMULATION = ("gnss", "magnetometer", "barometer")
LOCAL_HOSTS = ("127.0.0.1", "localhost")
MOST_GROUND_STATIONS = 2
_EMBEDDED_ONLY = {
    "controller": "steers by itself",
    "signing_key_file": "signs by its own settings",
    "standby": "has no second one here",
}


def check(profile: Profile) -> Iterator[Finding]:
    """What does not go together in the keys of another autopilot, or is of one where there is none."""
    autopilot = profile.autopilot
    if autopilot is None:
        return
    if autopilot.kind in ("none", "embedded"):
        yield from _of_another(autopilot)
        return
    for key, why in _EMBEDDED_ONLY.items():
        if getattr(autopilot, key) is not None:
            yield ("autopilot", key), f"autopilot.{key}: {autopilot.kind} {why}; leave it out, or use kind: embedded"
    yield from _parameter_files(autopilot)
    yield from _firmware(profile, autopilot)
    yield from _ways_in(profile, autopilot, autopilot.bridge)
    yield from _px4(profile, autopilot, autopilot.bridge)
    yield from _urls(autopilot)
    yield from _outputs(profile, autopilot.bridge)
    yield from _moored(profile, autopilot)
    yield from _sensor_faults(profile, autopilot.bridge)


def _of_another(autopilot: Autopilot) -> Iterator[Finding]:
    for key in ("firmware", "firmware_build", "firmware_arguments", "moored_until_armed", "bridge"):
        if getattr(autopilot, key) != getattr(Autopilot(), key):
            yield (
                ("autopilot", key),
                f"autopilot.{key} is for another autopilot than autopilot.kind = {autopilot.kind}; "
                "leave it out, or use kind: ardupilot",
            )


def _parameter_files(autopilot: Autopilot) -> Iterator[Finding]:
    for number, name in enumerate(autopilot.parameter_files):
        try:
            read_parameter_file(name)
        except UserError as error:
            yield ("autopilot", "parameter_files", number), f"autopilot.parameter_files.{number}: {error}"


def _firmware(profile: Profile, autopilot: Autopilot) -> Iterator[Finding]:
    path: KeyPath = ("autopilot", "firmware")
    if autopilot.firmware == EXTERNAL:
        if autopilot.ground_stations and autopilot.runs != "board":
            yield (
                ("autopilot", "ground_stations"),
                "autopilot.ground_stations are given to an autopilot at its start, and this one is started elsewhere; "
                "connect the ground station there, or use autopilot.firmware: find",
            )
        if autopilot.firmware_arguments:
            yield (
                ("autopilot", "firmware_arguments"),
                "autopilot.firmware_arguments are given to an autopilot at its start, and this one is started "
                "elsewhere; give them there, or use autopilot.firmware: find",
            )
        return
    key = f"autopilot.firmware = {shown(autopilot.firmware)}"
    if autopilot.kind != "ardupilot":
        yield path, f"{key} starts ArduPilot; with autopilot.kind = {autopilot.kind} start it yourself: use external"
    if autopilot.runs == "board":
        yield path, f"{key} runs on this machine, and the bridge on a board; use external, or runs: in-process"
    if autopilot.firmware_build == "linux" and autopilot.bridge.world is not None:
        yield (
            ("autopilot", "bridge", "world"),
            "autopilot.bridge.world is for a SITL build, and firmware_build = linux runs on a real clock; "
            "leave it out and give bridge.sensors",
        )
    if autopilot.firmware_build == "linux" and autopilot.bridge.sensors == "vectornav":
        yield (
            ("autopilot", "bridge", "sensors"),
            "autopilot.bridge.sensors = 'vectornav' is not heard by ArduPilot's Linux builds, whose driver empties the "
            "line before it reads; use microstrain7",
        )
    if len(ground_stations_of(profile)) > MOST_GROUND_STATIONS:
        yield (
            ("autopilot", "ground_stations"),
            f"autopilot.ground_stations: there is room for {MOST_GROUND_STATIONS} at an autopilot started here, on its "
            "ports SERIAL1 and SERIAL2; drop the others",
        )


def _ways_in(profile: Profile, autopilot: Autopilot, bridge: Bridge) -> Iterator[Finding]:
    lockstep = profile.clock is not None and profile.clock.mode == "lockstep"
    world: KeyPath = ("autopilot", "bridge", "world")
    sensors: KeyPath = ("autopilot", "bridge", "sensors")
    link: KeyPath = ("autopilot", "bridge", "sensor_link")
    if bridge.world is not None and not lockstep:
        yield world, "autopilot.bridge.world sets the autopilot's time; use clock.mode: lockstep, or leave it out"
    if bridge.world is None and lockstep and bridge.sensors != "px4":
        yield (
            ("clock", "mode"),
            "clock.mode = lockstep needs autopilot.bridge.world, which sets the autopilot's time; add one such as "
            "udp://127.0.0.1:9002, or use clock.mode: realtime",
        )
    if bridge.world is None and bridge.sensors is None and not lockstep:
        yield (
            sensors,
            "autopilot.bridge.sensors is missing: nothing gets in without a world; use for instance vectornav",
        )
    if (bridge.sensors == "px4") != (autopilot.kind == "px4"):
        yield (
            sensors,
            f"autopilot.bridge.sensors = {shown(bridge.sensors)} does not go with autopilot.kind = {autopilot.kind}; "
            "px4 goes with px4, the others with ardupilot",
        )
    if bridge.sensors in OWN_LINK and bridge.sensor_link is None:
        yield (
            link,
            f"autopilot.bridge.sensor_link is missing: {bridge.sensors} has a line of its own; add the port of the "
            "autopilot, such as serial:///dev/ttyUSB0?baud=921600 or tcp://127.0.0.1:5763",
        )
    if bridge.sensor_link is not None and bridge.sensors not in (*OWN_LINK, "px4"):
        yield link, f"autopilot.bridge.sensor_link leads nowhere with sensors = {shown(bridge.sensors)}; leave it out"


def _px4(profile: Profile, autopilot: Autopilot, bridge: Bridge) -> Iterator[Finding]:
    if autopilot.kind != "px4":
        return
    if bridge.world is not None:
        yield (
            ("autopilot", "bridge", "world"),
            "autopilot.bridge.world is ArduPilot's JSON interface, which PX4 does not have; leave it out",
        )
    if bridge.sensor_link is None and profile.clock is not None and profile.clock.mode == "lockstep":
        yield (
            ("autopilot", "bridge", "sensor_link"),
            "autopilot.bridge.sensor_link is missing: in lockstep PX4 calls at a line of its own; add "
            "tcp://127.0.0.1:4560, or use clock.mode: realtime for a board",
        )


USUAL_PORTS = {"mavlink": "5760", "world": "9002", "sensor_link": "that of its SERIAL3, 5763 or as it was started"}


def _urls(autopilot: Autopilot) -> Iterator[Finding]:
    started = autopilot.firmware != EXTERNAL
    for key in ("mavlink", "world", "sensor_link"):
        url = getattr(autopilot.bridge, key)
        if url is None:
            continue
        path, said = ("autopilot", "bridge", key), f"autopilot.bridge.{key} = {shown(url)}"
        free = started and url.startswith(("udp://", "tcp://")) and url.endswith(":0")
        problem = None if free else problem_of_url(url)
        if not started and url.endswith(":0"):
            problem = f"has no port, and the autopilot is started elsewhere; its usual one is {USUAL_PORTS[key]}"
        if problem is None and started and urlsplit(url).scheme not in _schemes(autopilot, key):
            problem = f"is none that an autopilot started here has; use {_schemes(autopilot, key)[0]}://127.0.0.1:0"
        if problem is None and key == "world" and urlsplit(url).scheme != "udp":
            problem = "is not UDP, which the JSON interface speaks; write udp://127.0.0.1:9002"
        elsewhere = urlsplit(url).scheme != "serial" and urlsplit(url).hostname not in LOCAL_HOSTS
        if problem is None and started and elsewhere:
            problem = "is on another machine, and the autopilot is started on this one; use 127.0.0.1"
        if problem is not None:
            yield path, f"{said} {problem}"
    mavlink, sensor_link = autopilot.bridge.mavlink, autopilot.bridge.sensor_link
    if sensor_link is None or mavlink.endswith(":0"):
        return
    if mavlink.partition("?")[0] == sensor_link.partition("?")[0]:
        yield (
            ("autopilot", "bridge", "sensor_link"),
            f"autopilot.bridge.sensor_link = {shown(sensor_link)} is that of its MAVLink; give another port of the "
            "autopilot, or use sensors: hil for one line alone",
        )


def _schemes(autopilot: Autopilot, key: str) -> tuple[str, ...]:
    if key == "world":
        return ("udp",)
    if key == "mavlink":
        return ("tcp",) if autopilot.firmware_build == "sitl" else ("tcp", "udp")
    return ("tcp", "serial") if autopilot.firmware_build == "sitl" else ("tcp", "udp", "serial")


def _outputs(profile: Profile, bridge: Bridge) -> Iterator[Finding]:
    if profile.vehicle is None:
        return
    propellers = profile.vehicle.propellers
    needed = profile.vehicle.commands
    steered = needed - len(propellers)
    path: KeyPath = ("autopilot", "bridge", "outputs")
    if len(bridge.outputs) != needed:
        yield (
            path,
            f"autopilot.bridge.outputs = {shown(bridge.outputs)} does not fit a vessel with {needed} commands "
            f"({len(propellers)} throttles, {steered} steering); give one channel for each",
        )
    if len(set(bridge.outputs)) != len(bridge.outputs):
        yield path, f"autopilot.bridge.outputs = {shown(bridge.outputs)} has a channel twice; give each command its own"


def _moored(profile: Profile, autopilot: Autopilot) -> Iterator[Finding]:
    driver = profile.driver
    if not autopilot.moored_until_armed or driver is None:
        return
    if driver.kind == "none" or (driver.kind == "script" and not any(step.arm for step in driver.script)):
        yield (
            ("autopilot", "moored_until_armed"),
            f"autopilot.moored_until_armed would hold the vessel for ever, since driver.kind = {driver.kind} never "
            "arms it; use false, or a driver that arms",
        )


def _sensor_faults(profile: Profile, bridge: Bridge) -> Iterator[Finding]:
    """With a world alone ArduPilot takes the motion and our IMU, and makes the other sensors itself."""
    if bridge.world is None or bridge.sensors is not None:
        return
    for name, fault in (profile.faults or {}).items():
        for sensor in OWN_SIMULATION:
            if getattr(fault, sensor) is not None:
                yield (
                    ("faults", name, sensor),
                    f"faults.{name}.{sensor} reaches nobody: this autopilot simulates its own {sensor} from the true "
                    "motion; use autopilot.bridge.sensors, such as in sitl-ardupilot-ahrs, or drop it",
                )
