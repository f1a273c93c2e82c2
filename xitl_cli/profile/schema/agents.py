"""`mission`, `driver`, `autopilot` and `companion`: what the vessel is to do, and who steers it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from sim_core.keys import (
    AmongVessels,
    Bounds,
    Direction,
    Items,
    NonNegative,
    Place,
    Positive,
    Specification,
    SpecificationError,
)

Runs = Literal["in-process", "process", "board"]
Channels = Annotated[tuple[Annotated[int, Bounds(at_least=1, at_most=32)], ...], Items(1)]
NeutralPulse = Annotated[float, Bounds(at_least=800, at_most=2200)]
PulseSpan = Annotated[float, Bounds(above=0, at_most=1000)]
RcChannel = Annotated[int, Bounds(at_least=1, at_most=18)]
RcPulse = Annotated[int, Bounds(at_least=0, at_most=2200)]
Timeout = Annotated[float, Bounds(above=0, at_most=600)]
Silence = Annotated[float, Bounds(at_least=1, at_most=600)]
LOOPBACK = "127.0.0.1"
MOST_VESSELS = 250  # by their system ids: those above are ground stations'


EXTERNAL, FIND = "external", "find"  # of autopilot.firmware
PX4_SIMULATOR_PORT, PX4_MAVLINK_PORT, MOST_PX4_INSTANCES = 4560, 14580, 200
"""Of a PX4 in software: TCP, where it calls its simulator, and UDP, its link for companions, both with the number of
its instance added."""


@dataclass(frozen=True, slots=True)
class StartSpec(Specification):
    """Where the vessel lies at the start, at rest."""

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
        tuple[float | None, float | None, float | None, float | None], "the first four; null: the autopilot's own"
    ] = (0.0, 0.0, 0.0, 0.0)
    place_ned_m: Annotated[Place | None, "north and east; null: the command has no place"] = None
    altitude_m: float = 0.0
    frame: Annotated[Annotated[int, Bounds(at_least=0, at_most=255)], "MAV_FRAME of the altitude"] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class MissionSpec(Specification):
    """Waypoints from the local origin, or a course from a file."""

    speed_mps: Annotated[
        float, Bounds(above=0, at_most=30), "over ground; without: `vehicle.cruise_speed_mps`, where that is given"
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
        "in place of `waypoints_ned_m`: a course from QGroundControl (`.plan`), Mission Planner (`.waypoints`) or a "
        "map (`.geojson`, `.kml`, `.gpx`). Reading the profile replaces it by the keys that it brings",
    ] = None
    items: Annotated[
        tuple[MissionItemSpec, ...],
        Items(0, 65534, "as MAVLink numbers 65535 items and the first is home"),
        "in place of `waypoints_ned_m`: a MAVLink mission after home, as a file with other commands brings it",
    ] = ()
    fence: Annotated[
        tuple[MissionItemSpec, ...], "items of a fence, uploaded before the mission; `FENCE_ENABLE` puts it in force"
    ] = ()
    rally: Annotated[tuple[MissionItemSpec, ...], "rally points, for an ArduPilot or a PX4"] = ()

    def check(self) -> None:
        if self.items and self.waypoints_ned_m:
            raise SpecificationError(("items",), "and waypoints_ned_m are both there; leave out one of them")

    @property
    def course(self) -> dict[int, Place]:
        """The places to sail to (north, east), by the number of their item; home is item 0."""
        if not self.items:
            return dict(enumerate(self.waypoints_ned_m, start=1))
        home = self.start.north_m, self.start.east_m
        places = {seq: home if one.command == _RETURN else one.place_ned_m for seq, one in enumerate(self.items, 1)}
        return {
            seq: place
            for seq, place in places.items()
            if place is not None and self.items[seq - 1].command in STAGES_OF_COURSE
        }

    @property
    def course_ned_m(self) -> tuple[Place, ...]:
        """The places to sail to, in the order of their items."""
        return tuple(self.course.values())

    @property
    def jumps(self) -> bool:
        """Whether items are sailed more than once."""
        return any(item.command in _JUMPS for item in self.items)

    def moved(self, move: Callable[[Place], Place]) -> MissionSpec:
        """The same mission with every place of the course moved."""
        items = tuple(
            item if item.place_ned_m is None else replace(item, place_ned_m=move(item.place_ned_m))
            for item in self.items
        )
        return replace(self, waypoints_ned_m=tuple(map(move, self.waypoints_ned_m)), items=items)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptStep(Specification):
    """What happens at an instant: motor commands without an autopilot, with one orders by MAVLink."""

    at_s: Annotated[NonNegative, "in simulation time; steps come in order"]
    motors: Annotated[
        Annotated[tuple[Annotated[float, Bounds(at_least=-1, at_most=1)], ...], Items(1)] | None,
        "without an autopilot: commands, one for each propeller, then gear, then rudder; in force until the next",
    ] = None
    arm: bool | None = None
    mode: Annotated[
        Literal[
            "MANUAL", "ACRO", "STEERING", "HOLD", "LOITER", "SIMPLE", "CIRCLE", "AUTO", "RTL", "SMART_RTL", "GUIDED"
        ]
        | None,
        "by name",
    ] = None
    rc_us: Annotated[
        Annotated[tuple[RcPulse | None, ...], Items(1, 18)] | None,
        "pulse widths of RC channels 1 to 18; null leaves a channel alone, 0 gives it back",
    ] = None
    goto_ned_m: Annotated[Place | None, "a GUIDED target, north and east"] = None
    end: Annotated[bool, "ends the run"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplaySpec(Specification):
    """How the outputs of a recording become commands: (pulse - trim) / span, limited to [-1, 1]."""

    outputs: Annotated[
        Channels | None,
        "recorded channels, in the order of propellers, gears and rudders, or steering and throttle; null: as a "
        "DataFlash log says of itself (SERVOn_FUNCTION), else 1 and 3 of two, of others as many as there are from 1",
    ] = None
    outputs_are: Annotated[Literal["motors", "steering-throttle"] | None, "null: as the log says"] = None
    trim_us: Annotated[NeutralPulse, "neutral"] = 1500.0
    span_us: Annotated[PulseSpan, "from neutral to full"] = 400.0
    start_s: Annotated[float | None, "on the recording's clock; null: at the first armed output"] = None
    end_s: Annotated[float | None, "on the recording's clock; null: to the end"] = None
    rc_channels: Annotated[tuple[RcChannel, RcChannel], "with an autopilot: of steering and throttle"] = (1, 3)
    thrust: Annotated[Literal["newton", "share"], "what `thrusters/*/cmd` of a bag are, as `ros.thrust`"] = "newton"


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowSpec(Specification):
    """A place beside another vessel, kept by GUIDED targets from what that one's autopilot says of itself."""

    vessel: Annotated[str, "whom it follows"]
    offset_frd_m: Annotated[Place, "forward and to starboard of it, along its track; [-10, 0] is 10 m back on it"] = (
        -10.0,
        0.0,
    )
    lost_s: Annotated[
        float, Bounds(at_least=0.5, at_most=600), "a leader that says nothing for so long is lost: the place is kept"
    ] = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverSpec(Specification):
    """Source of the commands to the vessel or its autopilot."""

    kind: Annotated[
        Literal["mission", "ground-station", "script", "replay", "follow", "ros", "none"],
        "ground-station: the vessel's state is frozen until a ground station arms it; follow: after another vessel; "
        "ros: nodes of ROS alone, see [ros.md](ros.md)",
    ] = "none"
    stay: Annotated[bool, "with a ground station: go on after its mission has ended"] = False
    script: Annotated[tuple[ScriptStep, ...], "in order of time"] = ()
    file: Annotated[
        str | None,
        "of a replay: a log with servo outputs (.bin, .tlog, .mcap), a table of pulse widths (.csv), or a bag of ROS "
        "with `mavros/rc/out` or `thrusters/*/cmd`",
    ] = None
    replay: ReplaySpec = ReplaySpec()
    follow: Annotated[FollowSpec | None, AmongVessels()] = None
    arms: Annotated[bool, "of ros: in GUIDED and armed as soon as the autopilot is ready; false: nodes do that"] = True
    departs_with: Annotated[
        Literal["followers", "fleet", "nobody"],
        AmongVessels(),
        "of a mission or a replay: the vessel lies moored until its followers have armed, until all others of the "
        "fleet can, or until it can itself",
    ] = "followers"


@dataclass(frozen=True, slots=True, kw_only=True)
class StandbySpec(Specification):
    """A second agent with the same sensors, parameters, mission and orders as the first, in real time."""

    runs: Runs = "process"
    link: Annotated[str | None, "its URL"] = None
    takeover_s: Annotated[
        float, Bounds(at_least=0.06, at_most=60), "it takes over when no motor command has come for so long"
    ] = 0.3
    max_step: Annotated[
        float,
        Bounds(above=0, at_most=2),
        "no motor command changes by more from one exchange to the next, until it is where the new agent wants it",
    ] = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeSpec(Specification):
    """How another autopilot is reached. Every URL is as seen from where the agent runs, port 0 is one that is free."""

    mavlink: Annotated[str, "its MAVLink"] = "tcp://127.0.0.1:5760"
    world: Annotated[str | None, "where its JSON simulator interface is served, in lockstep"] = None
    sensors: Annotated[
        Literal["vectornav", "microstrain7", "hil", "px4"] | None,
        "how ours get in; null leaves them to its own simulation of the true motion",
    ] = None
    sensor_link: Annotated[str | None, "a line of their own"] = None
    outputs: Annotated[Channels, "its channels in the order of propellers, gears and rudders"] = (1, 3)
    trim_us: Annotated[NeutralPulse, "neutral"] = 1500.0
    span_us: Annotated[PulseSpan, "from neutral to full"] = 400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotSpec(Specification):
    """The autopilot, where it runs, the link to it, and who else may talk to it.

    Of another autopilot than the embedded one the agent is a bridge.
    """

    kind: Literal["none", "embedded", "ardupilot", "px4"] = "none"
    runs: Annotated[Runs, "where the agent does"] = "in-process"
    link: Annotated[str | None, "the agent's URL"] = None
    system_id: Annotated[
        int,
        Bounds(at_least=1, at_most=MOST_VESSELS),
        AmongVessels(),
        "of MAVLink; of several vessels each has its own, the lowest that is free unless given",
    ] = 1
    ais_link: Annotated[
        str | None,
        AmongVessels(),
        "where an ArduPilot that is started elsewhere reads AIS sentences (SERIALn_PROTOCOL 40, AIS_TYPE 1), as "
        "`serial:///dev/ttyUSB1?baud=38400` or `udp://192.168.7.2:10110`; one in software started here has its own",
    ] = None
    ground_stations: Annotated[
        tuple[str, ...] | None,
        "`udp://host:port` is sent to, `tcp://host:port` is listened at, or at the next free port; null: UDP 14550 and "
        "TCP 5760 of this machine in real time, none in lockstep",
    ] = None
    ground_station_interface: Annotated[
        str,
        "where that TCP port is open: 127.0.0.1 is this machine alone, 0.0.0.0 every network, or the address or name "
        "(`eth0`) of one",
    ] = LOOPBACK
    controller: Annotated[str | None, "`module:Class` or `path/to/file.py:Class`, in place of the built-in one"] = None
    signing_key_file: Annotated[str | None, "signs what goes to ground stations"] = None
    link_key_file: Annotated[str | None, "signs the link to the agent both ways"] = None
    parameter_files: Annotated[
        tuple[str, ...],
        "what it starts with, shipped ones by name, or .parm and .params files; an ArduPilot that is started elsewhere "
        "gets them by `xitl params push`, a PX4 at the start of a run",
    ] = ()
    parameters: Annotated[dict[str, float], "by name, over those of the files; set on a live autopilot too"] = field(
        default_factory=dict
    )
    connect_timeout_s: Timeout = 6.0
    silent_s: Annotated[Silence, "an agent that is silent for so long ends the run"] = 10.0
    standby: StandbySpec | None = None
    bridge: BridgeSpec = BridgeSpec()
    firmware: Annotated[
        str,
        "external: somebody else starts it; find: it is started here, the program that XITL_ARDUROVER or XITL_PX4 "
        "names, else that on the PATH, else what `xitl firmware get` has brought; or the path of its program",
    ] = EXTERNAL
    firmware_build: Literal["sitl", "linux"] = "sitl"
    firmware_arguments: Annotated[tuple[str, ...], "after our own"] = ()
    arm_timeout_s: Annotated[
        float,
        Bounds(above=0, at_most=3600),
        "not armed by then, or still starting, ends the run, of the embedded one too",
    ] = 60.0
    moored_until_armed: Annotated[
        bool, "the vessel's state is frozen until the autopilot is armed, and the duration does not run"
    ] = False

    @property
    def started_here(self) -> bool:
        """Whether the run starts another autopilot: also not a PX4 that is looked for and whose port is named."""
        if self.kind == "px4" and self.firmware == FIND:
            return (self.bridge.sensor_link or "").endswith(":0")
        return self.firmware != EXTERNAL


@dataclass(frozen=True, slots=True, kw_only=True)
class CompanionSpec(Specification):
    """A computer beside the autopilot that perceives, maps and avoids."""

    kind: Annotated[
        Literal["xitl", "ros"],
        "xitl: ours; ros: nodes of ROS in its place, which have the sensors by topics and give their orders by "
        "`cmd_vel` and `goal_pose`: [ros.md](ros.md)",
    ] = "xitl"
    runs: Annotated[Runs, "of ros: `board` says that they run on one"] = "in-process"
    link: Annotated[str | None, "its URL"] = None
    link_key_file: Annotated[str | None, "signs the link to it both ways"] = None
    parameters: Annotated[dict[str, float], "its settings by name: [perception.md](perception.md)"] = field(
        default_factory=dict
    )
    lag: Annotated[
        int,
        Bounds(at_least=1, at_most=100),
        "in lockstep: exchanges from what it is told to what comes of it, while the host goes on",
    ] = 5
    connect_timeout_s: Timeout = 6.0
    silent_s: Annotated[Silence, "one that is silent for so long is given up; the run goes on without it"] = 10.0

    @property
    def is_ours(self) -> bool:
        """Whether the run has it at the end of a link."""
        return self.kind == "xitl"
