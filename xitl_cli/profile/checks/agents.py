"""Checks of autopilot, bridge and companion: addresses, files, parameters, and sensors and outputs of a bridge."""

from __future__ import annotations

import re
from collections.abc import Iterator
from urllib.parse import urlsplit

from agent.bridges.kinds import NEEDED_LINK, NO_LINK, BridgeError, bridge_kind
from agent.fcu.mission import COMMANDS, MOST_ITEMS
from agent.fcu.parameters import checked
from agent.mavlink.modes import PX4_MODES
from agent.mavlink.parameter_rows import ParameterError
from xitl_cli.errors import UserError
from xitl_cli.profile.checks.link import made_for_the_run, problem_of_link, problem_of_url
from xitl_cli.profile.files.entry import KeyPath, finding, shown
from xitl_cli.profile.files.parameter_files import find_parameter_file, read_parameter_file
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.agents import (
    LOOPBACK,
    MOST_PX4_INSTANCES,
    PX4_MAVLINK_PORT,
    PX4_SIMULATOR_PORT,
    AutopilotSpec,
    BridgeSpec,
    CompanionSpec,
    MissionSpec,
)
from xitl_cli.profile.schema.profile import ground_stations_of
from xitl_cli.signing import read_key_file

_URL = re.compile(r"(udp|tcp)://(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]@?#]+):([0-9]{1,5})")
_INTERFACE = re.compile(r"[0-9A-Za-z_.-]+|\[[0-9A-Fa-f:.]+\]")
_CLASS = re.compile(r"([A-Za-z_]\w*(\.[A-Za-z_]\w*)*|.+\.py):[A-Za-z_]\w*")
LOCAL_HOSTS = ("127.0.0.1", "localhost")
MOST_GROUND_STATIONS = 2
USUAL_PORTS = {"mavlink": "5760", "world": "9002", "sensor_link": "that of its SERIAL3, 5763 or as it was started"}
PX4_PORTS = {"mavlink": PX4_MAVLINK_PORT, "sensor_link": PX4_SIMULATOR_PORT, "world": "none"}
FAST = ("udp", "tcp")
_EMBEDDED_ONLY = {
    "controller": "has its own controller",
    "signing_key_file": "has its own settings for signing",
    "standby": "cannot have a standby",
}


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield keys of autopilot, standby, bridge and companion that are missing, invalid or do not fit together."""
    yield from _autopilot(profile)
    yield from _bridge(profile)
    yield from _companion(profile)


def _autopilot(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield invalid addresses, missing files, and parameters that the autopilot does not have."""
    if profile.autopilot is None:
        return
    yield from _ground_stations(profile.autopilot)
    yield from _extras(profile.autopilot)
    yield from _standby(profile, profile.autopilot)
    for number, name in enumerate(profile.autopilot.parameter_files):
        try:
            if profile.autopilot.kind == "none":
                find_parameter_file(name)
            else:
                read_parameter_file(name, embedded=profile.autopilot.kind == "embedded")
        except UserError as error:
            yield ("autopilot", "parameter_files", number), f"autopilot.parameter_files.{number}: {error}"
    if profile.autopilot.kind == "embedded":
        yield from _embedded(profile.autopilot, profile.mission)


def _embedded(autopilot: AutopilotSpec, mission: MissionSpec | None) -> Iterator[tuple[KeyPath, str]]:
    """Yield missions and parameters that the embedded autopilot refuses."""
    if mission is not None:
        waypoints = max(len(mission.waypoints_ned_m), len(mission.items))
        if waypoints >= MOST_ITEMS:
            yield finding(
                "mission.waypoints_ned_m",
                f"= a list of {waypoints} is too long for the embedded autopilot, which stores {MOST_ITEMS} items "
                f"including home, like ArduRover on a board; use at most {MOST_ITEMS - 1}",
            )
        for number, item in enumerate(mission.items):
            if item.command not in COMMANDS:
                yield (
                    ("mission", "items", number, "command"),
                    f"mission.items.{number}: the embedded autopilot does not support command {item.command}; "
                    "remove the item",
                )
        if mission.rally:
            yield (
                ("mission", "rally"),
                "mission.rally: the embedded autopilot does not support rally points; write mission.rally: [], or use "
                "autopilot.kind: ardupilot",
            )
    for name, value in autopilot.parameters.items():
        try:
            checked(name, value)
        except ParameterError as error:
            yield ("autopilot", "parameters", name), f"autopilot.parameters: {error}"


def _ground_stations(autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    if autopilot.ground_stations and autopilot.kind != "none" and autopilot.runs == "board":
        yield finding(
            "autopilot.ground_stations",
            "cannot be given to a board from here; start the agent there with --gcs, once for each address",
        )
        return
    # Addresses: each must be valid, and none may occur twice.
    seen: dict[tuple[str, ...], int] = {}
    for number, url in enumerate(autopilot.ground_stations or ()):
        match, problem = _URL.fullmatch(url), None
        if match is None:
            problem = "is not an address; write udp://host:port to send there, or tcp://host:port to listen there"
        elif not 0 < int(match[3]) < 65536:
            problem = "has an invalid port; use a port from 1 to 65535"
        else:
            # Two listeners on one TCP port conflict, whatever their addresses.
            same = ("tcp", match[3]) if match[1] == "tcp" else (match[1], match[2].lower(), str(int(match[3])))
            first = seen.setdefault(same, number)
            if first != number:
                problem = f"is the same as number {first}; remove one of them"
        if problem is not None:
            key = f"autopilot.ground_stations.{number} = {shown(url)}"
            yield ("autopilot", "ground_stations", number), f"{key} {problem}"
    # Network interface of the default address.
    interface, problem = autopilot.ground_station_interface, None
    if interface == LOOPBACK or autopilot.kind == "none":
        return
    if not _INTERFACE.fullmatch(interface):
        problem = "is neither an address nor an interface; write 0.0.0.0 for every network, or a name such as eth0"
    elif autopilot.runs == "board":
        problem = "cannot be given to a board from here; start the agent there with --gcs tcp://0.0.0.0:5760"
    elif autopilot.ground_stations is not None:
        problem = (
            "applies to the default addresses only; write it into autopilot.ground_stations, as tcp://0.0.0.0:5760"
        )
    if problem is not None:
        yield finding("autopilot.ground_station_interface", f"= {shown(interface)} {problem}")


def _extras(autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    for key, option in (("controller", "--controller"), ("signing_key_file", "--signing-key")):
        if getattr(autopilot, key) is not None and autopilot.kind != "none" and autopilot.runs == "board":
            yield (
                ("autopilot", key),
                f"autopilot.{key} cannot be given to a board from here; start the agent there with {option}",
            )
    if autopilot.controller is not None and not _CLASS.fullmatch(autopilot.controller):
        yield finding(
            "autopilot.controller",
            f"= {shown(autopilot.controller)} is not a class; write package.module:Class or path/to/file.py:Class",
        )
    for key in ("signing_key_file", "link_key_file"):
        file = getattr(autopilot, key)
        if file is not None:
            try:
                read_key_file(file, f"autopilot.{key}")
            except UserError as error:
                yield ("autopilot", key), f"autopilot.{key}: {error}"


def _standby(profile: Profile, autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    standby = autopilot.standby
    if standby is None or autopilot.kind == "none":
        return
    path: KeyPath = ("autopilot", "standby")
    if profile.clock is not None and profile.clock.mode == "lockstep":
        yield finding(
            "autopilot.standby",
            "has no effect in lockstep, because simulation time waits for a silent agent; "
            "use clock.mode: realtime, or remove the standby",
        )
    if profile.driver is not None and profile.driver.kind == "ground-station":
        yield finding(
            "autopilot.standby",
            "would not get the mission that a ground station gives to the first agent; "
            "use driver.kind: mission, or remove the standby",
        )
    if standby.runs != "in-process":
        if standby.link is None:
            example = "udp://192.168.8.2:14660" if standby.runs == "board" else "udp://127.0.0.1:14661"
            yield path, f"autopilot.standby.link is missing with runs = {standby.runs}; add one such as {example}"
        elif standby.link == autopilot.link and not made_for_the_run(standby.link):
            yield (
                (*path, "link"),
                f"autopilot.standby.link = {shown(standby.link)} is also the link of the first agent; use two links",
            )


def _bridge(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield keys of another autopilot that do not fit together, or that exist without such an autopilot."""
    autopilot = profile.autopilot
    if autopilot is None:
        return
    if autopilot.kind in ("none", "embedded"):
        for key in ("firmware", "firmware_build", "firmware_arguments", "moored_until_armed", "bridge"):
            if getattr(autopilot, key) != getattr(AutopilotSpec(), key):
                yield finding(
                    f"autopilot.{key}",
                    f"does not apply to autopilot.kind = {autopilot.kind}; remove it, or use kind: ardupilot",
                )
        return
    for key, reason in _EMBEDDED_ONLY.items():
        if getattr(autopilot, key) is not None:
            yield ("autopilot", key), f"autopilot.{key}: {autopilot.kind} {reason}; remove it, or use kind: embedded"
    yield from _firmware(profile, autopilot)
    yield from _ways_in(profile, autopilot, autopilot.bridge)
    yield from _px4(profile, autopilot, autopilot.bridge)
    yield from _urls(autopilot)
    yield from _outputs(profile, autopilot.bridge)
    yield from _moored(profile, autopilot)


def _firmware(profile: Profile, autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    path: KeyPath = ("autopilot", "firmware")
    if not autopilot.started_here:
        if autopilot.ground_stations and autopilot.runs != "board":
            yield finding(
                "autopilot.ground_stations",
                "apply only to an autopilot that is started here; connect the ground station to the other "
                "autopilot directly, or use autopilot.firmware: find",
            )
        if autopilot.firmware_arguments:
            yield finding(
                "autopilot.firmware_arguments",
                "apply only to an autopilot that is started here; set them where you start it, or use "
                "autopilot.firmware: find",
            )
        return
    key = f"autopilot.firmware = {shown(autopilot.firmware)}"
    if autopilot.kind == "other":
        yield path, f"{key}: xitl starts ArduPilot and PX4 only; start this autopilot elsewhere and use external"
        return
    if autopilot.kind == "px4":
        yield from _started_px4(profile, autopilot, key)
    if autopilot.runs == "board":
        yield path, f"{key} runs on this machine, but the bridge runs on a board; use external, or runs: in-process"
    if autopilot.firmware_build == "linux" and autopilot.bridge.world is not None:
        yield finding(
            "autopilot.bridge.world",
            "is for a SITL build, but firmware_build = linux runs on a real clock; remove it and set bridge.sensors",
        )
    if autopilot.firmware_build == "linux" and autopilot.bridge.sensors == "vectornav":
        yield finding(
            "autopilot.bridge.sensors",
            "= 'vectornav' does not work with ArduPilot's Linux builds, because their driver discards the input "
            "before it reads; use microstrain7",
        )
    if len(ground_stations_of(profile)) > MOST_GROUND_STATIONS:
        yield (
            ("autopilot", "ground_stations"),
            f"autopilot.ground_stations: an autopilot that is started here can have {MOST_GROUND_STATIONS}, on its "
            "ports SERIAL1 and SERIAL2; remove the others",
        )


def _ways_in(profile: Profile, autopilot: AutopilotSpec, bridge: BridgeSpec) -> Iterator[tuple[KeyPath, str]]:
    lockstep = profile.clock is not None and profile.clock.mode == "lockstep"
    try:
        kind = bridge_kind(bridge.sensors) if bridge.sensors else None
    except BridgeError as error:
        yield ("autopilot", "bridge", "sensors"), f"autopilot.bridge.sensors: {error}"
        return
    sets_time = kind is not None and kind.sets_time
    if bridge.world is not None and not lockstep:
        yield finding("autopilot.bridge.world", "sets the autopilot's time; use clock.mode: lockstep, or remove it")
    if bridge.world is None and lockstep and autopilot.kind != "px4" and not sets_time:
        yield finding(
            "clock.mode",
            "= lockstep needs autopilot.bridge.world, which sets the autopilot's time; add one such as "
            "udp://127.0.0.1:9002, or use clock.mode: realtime",
        )
    if bridge.world is None and bridge.sensors is None and not lockstep:
        yield finding(
            "autopilot.bridge.sensors",
            "is missing: without a world it has no sensors; use for example vectornav",
        )
    if bridge.world is not None and sets_time and autopilot.kind != "px4":
        yield (
            ("autopilot", "bridge", "world"),
            f"autopilot.bridge.world: {bridge.sensors} sets the autopilot's time itself; remove it",
        )
    if autopilot.kind == "px4" if kind is None else autopilot.kind not in kind.autopilots:
        fix = "use px4" if kind is None else f"use it with {' or '.join(kind.autopilots)}"
        yield finding(
            "autopilot.bridge.sensors",
            f"= {shown(bridge.sensors)} does not work with autopilot.kind = {autopilot.kind}; {fix}",
        )
    if kind is not None and kind.sensor_link == NEEDED_LINK and bridge.sensor_link is None:
        yield finding(
            "autopilot.bridge.sensor_link",
            f"is missing: {bridge.sensors} needs a separate line; add the port of the "
            "autopilot, such as serial:///dev/ttyUSB0?baud=921600 or tcp://127.0.0.1:5763",
        )
    if bridge.sensor_link is not None and (kind is None or kind.sensor_link == NO_LINK):
        yield finding(
            "autopilot.bridge.sensor_link", f"has no effect with sensors = {shown(bridge.sensors)}; remove it"
        )


def _px4(profile: Profile, autopilot: AutopilotSpec, bridge: BridgeSpec) -> Iterator[tuple[KeyPath, str]]:
    if autopilot.kind != "px4":
        return
    for number, step in enumerate(() if profile.driver is None else profile.driver.script):
        if step.mode is not None and step.mode not in PX4_MODES:
            yield (
                ("driver", "script", number, "mode"),
                f"driver.script.{number}.mode = {step.mode} is not a mode of PX4; use {', '.join(PX4_MODES)}",
            )
    if bridge.world is not None:
        yield finding("autopilot.bridge.world", "is ArduPilot's JSON interface, which PX4 does not have; remove it")
    if bridge.sensor_link is None and profile.clock is not None and profile.clock.mode == "lockstep":
        yield finding(
            "autopilot.bridge.sensor_link",
            "is missing: in lockstep PX4 connects to its simulator by a separate line; add tcp://127.0.0.1:4560, or "
            "use clock.mode: realtime for a board",
        )


def _started_px4(profile: Profile, autopilot: AutopilotSpec, key: str) -> Iterator[tuple[KeyPath, str]]:
    bridge = autopilot.bridge
    path: KeyPath = ("autopilot", "firmware")
    if autopilot.firmware_build != "sitl" or bridge.sensor_link is None:
        yield path, f"{key} starts a PX4 in software, but these settings are for a PX4 on a board; use external"
    if autopilot.ground_stations:
        yield (
            ("autopilot", "ground_stations"),
            "autopilot.ground_stations: a PX4 that is started here sends to UDP 14550 of this machine; remove the key",
        )
    port = _port_of(bridge.sensor_link)
    if port and not 0 <= port - PX4_SIMULATOR_PORT < MOST_PX4_INSTANCES:
        yield finding(
            "autopilot.bridge.sensor_link",
            f"= {shown(bridge.sensor_link)}: a PX4 that is started here connects to port "
            f"{PX4_SIMULATOR_PORT} plus the number of its instance; use tcp://127.0.0.1:0 for a free port",
        )
    if _port_of(bridge.mavlink):
        yield finding(
            "autopilot.bridge.mavlink",
            f"= {shown(bridge.mavlink)}: a PX4 that is started here uses the port of its "
            "instance; use udp://127.0.0.1:0",
        )


def _port_of(url: str | None) -> int:
    """Return the port, or 0 without one. Other checks report an invalid URL."""
    try:
        return urlsplit(url or "").port or 0
    except ValueError:
        return 0


def _urls(autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    started = autopilot.started_here
    for key in ("mavlink", "world", "sensor_link"):
        url = getattr(autopilot.bridge, key)
        if url is None:
            continue
        free = started and url.startswith(("udp://", "tcp://")) and url.endswith(":0")
        problem = None if free else problem_of_url(url)
        if not started and url.endswith(":0"):
            usual = PX4_PORTS[key] if autopilot.kind == "px4" else USUAL_PORTS[key]
            problem = f"has no port, and the autopilot is started elsewhere; use its port, usually {usual}"
        if problem is None and started and urlsplit(url).scheme not in _schemes(autopilot, key):
            scheme = _schemes(autopilot, key)[0]
            problem = f"does not work with an autopilot that is started here; use {scheme}://127.0.0.1:0"
        if problem is None and key == "world" and urlsplit(url).scheme != "udp":
            problem = "is not UDP, but the JSON interface needs UDP; write udp://127.0.0.1:9002"
        elsewhere = urlsplit(url).scheme != "serial" and urlsplit(url).hostname not in LOCAL_HOSTS
        if problem is None and started and elsewhere:
            problem = "is on another machine, but the autopilot is started on this one; use 127.0.0.1"
        if problem is not None:
            yield finding(f"autopilot.bridge.{key}", f"= {shown(url)} {problem}")
    mavlink, sensor_link = autopilot.bridge.mavlink, autopilot.bridge.sensor_link
    if sensor_link is None or mavlink.endswith(":0"):
        return
    if mavlink.partition("?")[0] == sensor_link.partition("?")[0]:
        yield finding(
            "autopilot.bridge.sensor_link",
            f"= {shown(sensor_link)} is also the URL of its MAVLink; use another port of the "
            "autopilot, or use sensors: hil for a single line",
        )


def _schemes(autopilot: AutopilotSpec, key: str) -> tuple[str, ...]:
    if autopilot.kind == "px4":
        return ("udp",) if key == "mavlink" else ("tcp",)
    if key == "world":
        return ("udp",)
    if key == "mavlink":
        return ("tcp",) if autopilot.firmware_build == "sitl" else ("tcp", "udp")
    return ("tcp", "serial") if autopilot.firmware_build == "sitl" else ("tcp", "udp", "serial")


def _outputs(profile: Profile, bridge: BridgeSpec) -> Iterator[tuple[KeyPath, str]]:
    if profile.vehicle is None:
        return
    needed = profile.vehicle.commands
    if len(bridge.outputs) != needed:
        yield finding(
            "autopilot.bridge.outputs",
            f"= {shown(bridge.outputs)} does not fit a vessel with "
            f"{profile.vehicle.command_kinds}; use {needed} channels, one per command",
        )
    if len(set(bridge.outputs)) != len(bridge.outputs):
        yield finding(
            "autopilot.bridge.outputs",
            f"= {shown(bridge.outputs)} has a channel twice; use a separate channel for each command",
        )


def _moored(profile: Profile, autopilot: AutopilotSpec) -> Iterator[tuple[KeyPath, str]]:
    driver = profile.driver
    if not autopilot.moored_until_armed or driver is None:
        return
    if driver.kind == "none" or (driver.kind == "script" and not any(step.arm for step in driver.script)):
        yield finding(
            "autopilot.moored_until_armed",
            f"would hold the vessel for ever, because driver.kind = {driver.kind} never arms it; use false, or another "
            "driver",
        )


def _companion(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a missing, invalid, too slow or shared link, unknown settings, and a companion without an autopilot."""
    companion = profile.companion
    if companion is None:
        return
    if profile.autopilot is not None and profile.autopilot.kind == "none":
        yield (
            ("companion",),
            "companion: needs an autopilot to command; use autopilot.kind = embedded, or remove the companion",
        )
    sensors = profile.sensors
    if not companion.is_ours:
        if sensors is not None and sensors.lidar is None and sensors.sonar is None:
            yield finding(
                "companion.kind",
                "= ros: its nodes have neither lidar nor sonar; extend sensors/perception, or use driver.kind: ros",
            )
        return
    if profile.autopilot is not None and profile.autopilot.kind == "px4" and companion.parameters.get("AVD_ENABLE", 1):
        yield (
            ("companion", "parameters"),
            "companion: it avoids obstacles with ArduPilot's GUIDED, which PX4 does not have; set "
            "companion.parameters.AVD_ENABLE=0, and it only maps and tracks them",
        )
    yield from _companion_link(profile, companion)
    if not companion.parameters:
        return
    from agent.companion.settings import checked_parameter

    for name, value in companion.parameters.items():
        try:
            checked_parameter(name, value)
        except ParameterError as error:
            yield ("companion", "parameters", name), f"companion.parameters: {error}"


def _companion_link(profile: Profile, companion: CompanionSpec) -> Iterator[tuple[KeyPath, str]]:
    path, link, runs = ("companion", "link"), companion.link, companion.runs
    if link is None:
        if runs != "in-process":
            example = "udp://192.168.55.1:14661" if runs == "board" else "udp://127.0.0.1:14661"
            yield path, f"companion.link is missing with companion.runs = {runs}; add one such as {example}"
        return
    problem = problem_of_link(link, "companion.runs", runs)
    scheme = urlsplit(link).scheme if problem is None else ""
    sensors = profile.sensors
    if scheme and scheme not in FAST and sensors is not None and sensors.lidar is not None and runs != "in-process":
        most = sensors.lidar.points_hz * 10.3 / 1e6
        problem = f"is too slow for the clouds of sensors.lidar, up to {most:.1f} MB/s; use udp:// or tcp://"
    if (
        problem is None
        and runs != "in-process"
        and profile.autopilot is not None
        and profile.autopilot.link == link
        and not made_for_the_run(link)
    ):
        problem = "is also the link of the autopilot; use different ports"
    if problem is not None:
        yield path, f"companion.link = {shown(link)} {problem}"
