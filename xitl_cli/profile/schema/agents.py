"""`mission`, `driver`, `autopilot` and `companion`: the task of the vessel, and the parts that steer it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace
from functools import partial
from typing import Annotated, Literal, get_args

from sim_core.dataclass import dataclass
from sim_core.keys import (
    AmongVessels,
    Bounds,
    Direction,
    Items,
    MoreChoices,
    NonNegative,
    Place,
    Positive,
    Specification,
    SpecificationError,
)
from xitl_cli.registry import BRIDGES, DRIVERS, names

Runs = Literal["in-process", "process", "board"]
Channels = Annotated[tuple[Annotated[int, Bounds(at_least=1, at_most=32)], ...], Items(1)]
NeutralPulse = Annotated[float, Bounds(at_least=800, at_most=2200)]
PulseSpan = Annotated[float, Bounds(above=0, at_most=1000)]
RcChannel = Annotated[int, Bounds(at_least=1, at_most=18)]
OwnDriver = Literal["mission", "ground-station", "script", "replay", "follow", "ros", "none"]
OWN_DRIVERS: tuple[str, ...] = get_args(OwnDriver)
OwnBridge = Literal["vectornav", "microstrain7", "hil", "px4"]
RcPulse = Annotated[int, Bounds(at_least=0, at_most=2200)]
Timeout = Annotated[float, Bounds(above=0, at_most=600)]
Silence = Annotated[float, Bounds(at_least=1, at_most=600)]
LOOPBACK = "127.0.0.1"
MOST_VESSELS = 250  # ground stations have the system ids above


EXTERNAL, FIND = "external", "find"  # of autopilot.firmware
PX4_SIMULATOR_PORT, PX4_MAVLINK_PORT, MOST_PX4_INSTANCES = 4560, 14580, 200
"""Ports of a PX4 in software, plus the number of its instance: TCP to its simulator, UDP for companions."""


@dataclass(frozen=True, slots=True)
class StartSpec(Specification):
    """Position and heading of the vessel at the start, at rest."""

    north_m: float = 0.0
    east_m: float = 0.0
    heading_deg: Direction = 0.0


STAGES_OF_COURSE = (16, 17, 18, 19, 20, 31, 82)
"""MAV_CMD of items that are sailed to: WAYPOINT, LOITER_UNLIM, _TURNS, _TIME, RETURN_TO_LAUNCH, _TO_ALT, SPLINE."""
_RETURN = 20
_JUMPS = (177, 601)  # MAV_CMD_DO_JUMP, MAV_CMD_DO_JUMP_TAG


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionItemSpec(Specification):
    """One item of a MAVLink plan."""

    command: Annotated[Annotated[int, Bounds(at_least=0, at_most=65535)], "MAV_CMD, such as 16 for NAV_WAYPOINT"]
    parameters: Annotated[
        tuple[float | None, float | None, float | None, float | None],
        "the first four parameters; null: the autopilot's own values",
    ] = (0.0, 0.0, 0.0, 0.0)
    place_ned_m: Annotated[Place | None, "position, north and east; null: the command has no position"] = None
    altitude_m: float = 0.0
    frame: Annotated[Annotated[int, Bounds(at_least=0, at_most=255)], "MAV_FRAME of the altitude"] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSpec(Specification):
    """Waypoints from the local origin, or a course from a file."""

    speed_mps: Annotated[
        float, Bounds(above=0, at_most=30), "speed over ground; default: `vehicle.cruise_speed_mps`, if it is given"
    ] = 3.0
    acceptance_radius_m: Positive = 3.0
    start: StartSpec = StartSpec()
    waypoints_ned_m: Annotated[
        tuple[Place, ...],
        Items(0, 65534, "as MAVLink numbers 65535 items and the first is home"),
        "a list of [north, east]",
    ] = ()
    file: Annotated[
        str | None,
        "instead of `waypoints_ned_m`: a course from QGroundControl (`.plan`), Mission Planner (`.waypoints`) or "
        "a map (`.geojson`, `.kml`, `.gpx`). When the profile is read, the keys from the file replace this key",
    ] = None
    items: Annotated[
        tuple[MissionItemSpec, ...],
        Items(0, 65534, "as MAVLink numbers 65535 items and the first is home"),
        "instead of `waypoints_ned_m`: a MAVLink mission after home, for a file with other commands",
    ] = ()
    fence: Annotated[
        tuple[MissionItemSpec, ...], "items of a fence, uploaded before the mission; `FENCE_ENABLE` activates it"
    ] = ()
    rally: Annotated[tuple[MissionItemSpec, ...], "rally points, for an ArduPilot or a PX4"] = ()

    def check(self) -> None:
        if self.items and self.waypoints_ned_m:
            raise SpecificationError(("items",), "and waypoints_ned_m exclude each other; remove one of them")

    @property
    def course(self) -> dict[int, Place]:
        """Return the places to sail to (north, east), by the number of their item; home is item 0."""
        if not self.items:
            return dict(enumerate(self.waypoints_ned_m, start=1))
        home = self.start.north_m, self.start.east_m
        course = {}
        for number, item in enumerate(self.items, 1):
            place = home if item.command == _RETURN else item.place_ned_m
            if place is not None and item.command in STAGES_OF_COURSE:
                course[number] = place
        return course

    @property
    def course_ned_m(self) -> tuple[Place, ...]:
        """Return the places to sail to, in the order of their items."""
        return tuple(self.course.values())

    @property
    def jumps(self) -> bool:
        """Return True if items are sailed more than once."""
        return any(item.command in _JUMPS for item in self.items)

    def moved(self, move: Callable[[Place], Place]) -> MissionSpec:
        """Return the same mission with every place of the course moved."""
        items = tuple(
            item if item.place_ned_m is None else replace(item, place_ned_m=move(item.place_ned_m))
            for item in self.items
        )
        return replace(self, waypoints_ned_m=tuple(map(move, self.waypoints_ned_m)), items=items)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptStep(Specification):
    """Commands at an instant: motor commands without an autopilot, MAVLink orders with an autopilot."""

    at_s: Annotated[NonNegative, "simulation time; the steps must be in order"]
    motors: Annotated[
        Annotated[tuple[Annotated[float, Bounds(at_least=-1, at_most=1)], ...], Items(1)] | None,
        "without an autopilot: one command for each propeller, then gear, then rudder; valid until the next step",
    ] = None
    arm: bool | None = None
    mode: Annotated[
        Literal[
            "MANUAL", "ACRO", "STEERING", "HOLD", "LOITER", "SIMPLE", "CIRCLE", "AUTO", "RTL", "SMART_RTL", "GUIDED"
        ]
        | None,
        "name of a mode",
    ] = None
    rc_us: Annotated[
        Annotated[tuple[RcPulse | None, ...], Items(1, 18)] | None,
        "pulse widths of RC channels 1 to 18; null does not change a channel, 0 releases it",
    ] = None
    goto_ned_m: Annotated[Place | None, "a GUIDED target, north and east"] = None
    end: Annotated[bool, "ends the run"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySpec(Specification):
    """Conversion of a recording's outputs to commands: (pulse - trim) / span, limited to [-1, 1]."""

    outputs: Annotated[
        Channels | None,
        "recorded channels, in the order of propellers, gears and rudders, or of steering and throttle; null: the "
        "functions in a DataFlash log (SERVOn_FUNCTION). Without these: channels 1 and 3 for two commands, "
        "otherwise channels from 1 on",
    ] = None
    outputs_are: Annotated[Literal["motors", "steering-throttle"] | None, "null: as the log states"] = None
    trim_us: Annotated[NeutralPulse, "neutral pulse width"] = 1500.0
    span_us: Annotated[PulseSpan, "difference from neutral to full"] = 400.0
    start_s: Annotated[float | None, "on the recording's clock; null: at the first armed output"] = None
    end_s: Annotated[float | None, "on the recording's clock; null: to the end"] = None
    rc_channels: Annotated[tuple[RcChannel, RcChannel], "with an autopilot: channels of steering and throttle"] = (1, 3)
    thrust: Annotated[Literal["newton", "share"], "unit of `thrusters/*/cmd` in a bag, as in `ros.thrust`"] = "newton"


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowSpec(Specification):
    """A position relative to another vessel, kept by GUIDED targets from the data that its autopilot reports."""

    vessel: Annotated[str, "name of the vessel to follow"]
    offset_frd_m: Annotated[
        Place, "offset forward and to starboard of it, along its track; [-10, 0] is 10 m back on the track"
    ] = (
        -10.0,
        0.0,
    )
    lost_s: Annotated[
        float,
        Bounds(at_least=0.5, at_most=600),
        "a leader without messages for this time is lost; the follower keeps its position",
    ] = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverSpec(Specification):
    """Source of the commands to the vessel or its autopilot."""

    kind: Annotated[
        OwnDriver,
        "ground-station: the vessel's state is frozen until a ground station arms it; follow: follows another "
        "vessel; ros: only ROS nodes, see [ros.md](ros.md); another name: the driver of a package, see "
        "[plugins.md](plugins.md)",
        MoreChoices(partial(names, DRIVERS)),
    ] = "none"
    stay: Annotated[bool, "with a ground station: continue after its mission has ended"] = False
    script: Annotated[tuple[ScriptStep, ...], "steps in order of time"] = ()
    file: Annotated[
        str | None,
        "file of a replay: a log with servo outputs (.bin, .tlog, .mcap), a table of pulse widths (.csv), or a "
        "ROS bag with `mavros/rc/out` or `thrusters/*/cmd`",
    ] = None
    replay: ReplaySpec = ReplaySpec()
    follow: Annotated[FollowSpec | None, AmongVessels()] = None
    arms: Annotated[bool, "for ros: set GUIDED and arm as soon as the autopilot is ready; false: nodes do this"] = True
    departs_with: Annotated[
        Literal["followers", "fleet", "nobody"],
        AmongVessels(),
        "for a mission or a replay: the vessel stays moored until its followers have armed, until all others of "
        "the fleet can arm, or until it can arm itself",
    ] = "followers"


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbySpec(Specification):
    """A second agent with the same sensors, parameters, mission and orders as the first, in real time."""

    runs: Runs = "process"
    link: Annotated[str | None, "URL of the agent"] = None
    takeover_s: Annotated[
        float, Bounds(at_least=0.06, at_most=60), "takes over after this time without a motor command"
    ] = 0.3
    max_step: Annotated[
        float,
        Bounds(above=0, at_most=2),
        "largest change of a motor command from one exchange to the next, until it reaches the new agent's value",
    ] = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeSpec(Specification):
    """Connections to another autopilot.

    Every URL is from the point of view of the agent's machine; port 0 selects a free port.
    """

    mavlink: Annotated[str, "URL of its MAVLink"] = "tcp://127.0.0.1:5760"
    world: Annotated[str | None, "where its JSON simulator interface is served, in lockstep"] = None
    sensors: Annotated[
        OwnBridge | None,
        "format in which it gets our sensors; null: it simulates its own from the true motion; another name: the "
        "bridge of a package, see [plugins.md](plugins.md)",
        MoreChoices(partial(names, BRIDGES)),
    ] = None
    sensor_link: Annotated[str | None, "URL of a separate line for the sensors"] = None
    outputs: Annotated[Channels, "its channels in the order of propellers, gears and rudders"] = (1, 3)
    trim_us: Annotated[NeutralPulse, "neutral pulse width"] = 1500.0
    span_us: Annotated[PulseSpan, "difference from neutral to full"] = 400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotSpec(Specification):
    """The autopilot, its location, its link, and other clients that may connect to it.

    For an autopilot other than the embedded one, the agent is a bridge.
    """

    kind: Annotated[
        Literal["none", "embedded", "ardupilot", "px4", "other"],
        "other: an autopilot that is started elsewhere and gets its sensors by the bridge of a package, see "
        "[plugins.md](plugins.md); it obeys ArduPilot's modes and commands over MAVLink",
    ] = "none"
    runs: Annotated[Runs, "location of the agent"] = "in-process"
    link: Annotated[str | None, "URL of the agent"] = None
    system_id: Annotated[
        int,
        Bounds(at_least=1, at_most=MOST_VESSELS),
        AmongVessels(),
        "MAVLink system id; with several vessels, the default is the lowest free number",
    ] = 1
    ais_link: Annotated[
        str | None,
        AmongVessels(),
        "address at which an ArduPilot that is started elsewhere reads AIS sentences (SERIALn_PROTOCOL 40, "
        "AIS_TYPE 1), such as `serial:///dev/ttyUSB1?baud=38400` or `udp://192.168.7.2:10110`. An ArduPilot "
        "started here has its own port",
    ] = None
    ground_stations: Annotated[
        tuple[str, ...] | None,
        "`udp://host:port` is a destination, `tcp://host:port` listens there or at the next free port; null: UDP "
        "14550 and TCP 5760 of this machine in real time, none in lockstep",
    ] = None
    ground_station_interface: Annotated[
        str,
        "network interface of that TCP port: 127.0.0.1 is this machine only, 0.0.0.0 every network, or the "
        "address or name (`eth0`) of one interface",
    ] = LOOPBACK
    controller: Annotated[
        str | None, "`module:Class` or `path/to/file.py:Class`, instead of the built-in controller"
    ] = None
    signing_key_file: Annotated[str | None, "key that signs messages to ground stations"] = None
    link_key_file: Annotated[str | None, "key that signs the link to the agent in both directions"] = None
    parameter_files: Annotated[
        tuple[str, ...],
        "initial parameters: names of shipped files, or .parm and .params files. An ArduPilot that is started "
        "elsewhere gets them by `xitl params push`, a PX4 at the start of a run",
    ] = ()
    parameters: Annotated[
        dict[str, float], "parameters by name; they override the files and are also set on a running autopilot"
    ] = field(default_factory=dict)
    connect_timeout_s: Timeout = 6.0
    silent_s: Annotated[Silence, "an agent without messages for this time ends the run"] = 10.0
    standby: StandbySpec | None = None
    bridge: BridgeSpec = BridgeSpec()
    firmware: Annotated[
        str,
        "external: started elsewhere. find: started here, from XITL_ARDUROVER or XITL_PX4, the PATH, or `xitl firmware "
        "get`, in this order. Or the path of its program",
    ] = EXTERNAL
    firmware_build: Literal["sitl", "linux"] = "sitl"
    firmware_arguments: Annotated[tuple[str, ...], "arguments after xitl's own"] = ()
    arm_timeout_s: Annotated[
        float,
        Bounds(above=0, at_most=3600),
        "the run ends if the autopilot is not armed, or is still starting, after this time; this includes the "
        "embedded autopilot",
    ] = 60.0
    moored_until_armed: Annotated[
        bool, "the vessel's state is frozen until the autopilot is armed, and this time does not count for the duration"
    ] = False

    @property
    def started_here(self) -> bool:
        """Return True if the run starts another autopilot. For `find`, it starts a PX4 only with a free port."""
        if self.kind == "px4" and self.firmware == FIND:
            return (self.bridge.sensor_link or "").endswith(":0")
        return self.firmware != EXTERNAL


@dataclass(frozen=True, slots=True, kw_only=True)
class CompanionSpec(Specification):
    """A companion computer that perceives, maps and avoids obstacles."""

    kind: Annotated[
        Literal["xitl", "ros"],
        "xitl: the xitl companion; ros: your ROS nodes instead, which read the sensors on topics and give their "
        "orders by `cmd_vel` and `goal_pose`: [ros.md](ros.md)",
    ] = "xitl"
    runs: Annotated[Runs, "for ros: `board` states that the nodes run on a board"] = "in-process"
    link: Annotated[str | None, "URL of the companion"] = None
    link_key_file: Annotated[str | None, "key that signs the link to it in both directions"] = None
    parameters: Annotated[dict[str, float], "settings by name: [perception.md](perception.md)"] = field(
        default_factory=dict
    )
    lag: Annotated[
        int,
        Bounds(at_least=1, at_most=100),
        "in lockstep: exchanges between an input and the effect of its answer, while the host continues",
    ] = 5
    connect_timeout_s: Timeout = 6.0
    silent_s: Annotated[
        Silence, "a companion without messages for this time is given up; the run continues without it"
    ] = 10.0

    @property
    def is_ours(self) -> bool:
        """Return True if the run has it at the end of a link."""
        return self.kind == "xitl"
