"""The topics of a recording: names, message types, fields, rates and meanings, declared once.

A class below is a message, its annotations are the fields: ROS 2 types from `cdr`, unit and frame in the name, what is
left to say beside the type. A report is declared once: the same fields are the entry of summary.json. Counters of a
bridge are declared in agent/bridges/counts.py. Those that are dataclasses are written as they are (`Recorder.write`),
the others by a method of the recorder. `TOPICS` is the table. From it come encoders, the definitions in the file and
the tables of docs/recording.md (`make pages`).
"""

from __future__ import annotations

from dataclasses import asdict, field
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from agent.bridges.counts import BridgeCounts
from sim_core.dataclass import dataclass
from xitl_cli.record.cdr import (
    SEPARATOR,
    Bool,
    Bytes,
    Float64,
    Float64Sequence,
    Float64x3,
    Float64x4,
    Float64x6,
    Float64x36,
    Int64,
    MessageType,
    String,
    Uint8,
    Uint32,
)

MAP_FRAME = "map"
VESSEL_FRAME = "base_link"
ESTIMATE_FRAME = "base_link_estimate"
ODOM_FRAME = "odom"
"""The body's place when the companion's odometry began."""
UNKNOWN_VARIANCE = 1e6
"""In m², rad² and so on, of an element of nav_msgs/Odometry whose accuracy nobody states.

The message has no mark for "unknown". Filters take zero for an exact value, as they must for the truth.
"""

HISTOGRAM_BINS = 16
Histogram: TypeAlias = Annotated[tuple[int, ...], f"uint32[{HISTOGRAM_BINS}]"]

MapSource = Literal["lidar", "sonar"]
MAP_SOURCES: tuple[MapSource, ...] = ("lidar", "sonar")
"""By number, as the field `source` of a map has them."""

_PLACE = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
LIDAR_POINT = np.dtype([*_PLACE, ("t", "<f4"), ("intensity", "u1")])
"""t: seconds after the cloud's stamp."""
SONAR_POINT = np.dtype([*_PLACE, ("intensity", "u1")])
MAP_POINT = np.dtype([*_PLACE, ("intensity", "u1"), ("source", "u1")])


# Motion and surroundings


class VesselStateMessage:
    position_ned_m: Float64x3
    velocity_ned_mps: Float64x3
    acceleration_ned_mps2: Float64x3
    quaternion_ned_frd: Annotated[Float64x4, "w x y z"]
    angular_velocity_frd_radps: Float64x3
    rotor: Annotated[
        Float64Sequence, "speed of each propeller, then angle of each gear and rudder, share of full in [-1, 1]"
    ]


class OdometryMessage:
    """nav_msgs/Odometry in ENU with a FLU body, as REP 103 asks; twist in the body frame."""

    frame_id: String
    child_frame_id: String
    position: Float64x3
    orientation: Annotated[Float64x4, "x y z w"]
    pose_covariance: Float64x36
    twist: Annotated[Float64x6, "linear, angular"]
    twist_covariance: Float64x36

    definition = f"\n{SEPARATOR}\nMSG: ".join(
        (
            "std_msgs/Header header\nstring child_frame_id\n"
            "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
            "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
            "builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
            "geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance",
            "geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
            "geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
            "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
            "geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance",
            "geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
            "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
        )
    )


class EnvironmentMessage:
    current_ned_mps: Float64x3
    wind_ned_mps: Float64x3
    surface_elevation_m: Float64


@dataclass(frozen=True, slots=True)
class TideState:
    """The tide."""

    level_m: Annotated[Float64, "still water above the local origin, up"]
    height_m: Annotated[Float64, "still water above its mean level"]
    rise_mps: Float64
    stream_mps: Annotated[Float64, "away from banks, positive with the flood, negative with the ebb"]


@dataclass(frozen=True, slots=True)
class SeaComponents:
    """Components of the sea, all in one order: the surface rises by the sum of a cos(k_n n + k_e e - omega t + phase)
    at n, e of the map, t seconds of simulation time.
    """

    amplitude_m: Float64Sequence
    wave_number_north_radpm: Float64Sequence
    wave_number_east_radpm: Float64Sequence
    angular_frequency_radps: Annotated[Float64Sequence, "at a fixed position"]
    phase_rad: Float64Sequence


class BodyMessage:
    kind: String
    number: Annotated[Uint32, "N of its frame `body_N`"]
    length_m: Float64
    position_ned_m: Float64x3
    quaternion_ned_frd: Annotated[Float64x4, "w x y z"]
    velocity_ned_mps: Float64x3


class ContactMessage:
    what: String
    position_ned_m: Float64x3
    force_n: Float64
    speed_mps: Annotated[Float64, "closing speed"]
    began: Annotated[Bool, "1 for a new contact"]


@dataclass(frozen=True, slots=True)
class BatteryMessage:
    """The vessel's battery at its terminals."""

    voltage_v: Float64
    current_a: Float64
    used_ah: Annotated[Float64, "used since full charge"]


# Autopilot, companion and the links to them


@dataclass(frozen=True, slots=True)
class MotionEstimate:
    """The autopilot's estimate of the vessel's motion, in the same local frame as the truth: (3,), (3,), (4,), (3,)."""

    pos_ned_m: NDArray[np.float64]
    vel_ned_mps: NDArray[np.float64]
    quat_ned_frd: NDArray[np.float64]
    gyro_frd_radps: NDArray[np.float64]
    pos_deviation_ned_m: NDArray[np.float64] | None = None
    """(3,), standard deviation of the position as the autopilot estimates it, None if it does not report it."""
    yaw_deviation_rad: float | None = None
    """Standard deviation of the heading as the autopilot estimates it, None if it does not report it."""


@dataclass(frozen=True, slots=True)
class MotorCommand:
    """Commands in force in [-1, 1], in the order of the vessel's, and how old they are; None: that cannot be told."""

    motors: tuple[float, ...]
    armed: bool = False
    failsafe: bool = False
    age_s: float | None = 0.0


class ActuatorsMessage:
    command: Annotated[Float64Sequence, "of each propeller, then each gear, then each rudder; share of full in [-1, 1]"]
    armed: Bool
    failsafe: Bool
    age_s: Float64
    names: Annotated[String, "of the commands: `propeller 0, steering 0, rudder 0`"]


@dataclass(frozen=True, slots=True)
class ActuatorAge:
    """Age of the motor commands in use since the run started, from the agent's sending to the exchange that used them.

    None: not known.
    """

    exchanges: Uint32
    stale: Annotated[Uint32, "exchanges without a new command"]
    longest_stale: Annotated[Uint32, "the most of them in a row"]
    age_p50_s: Float64 | None = None
    age_p99_s: Float64 | None = None
    age_max_s: Float64 | None = None


class MavlinkFrameMessage:
    frame: Bytes


SENDER, RECEIVER = "sender", "receiver"


def counted(end: str, trouble: str = "", key: str = "") -> dict[str, str]:
    """Return the metadata of a count of frames, which is None until its end of the link reports it.

    end: `SENDER` or `RECEIVER`, the end that counts. key: name of the count there, by default the name of the field:
    the host's LinkCounters have `KEY`, XITL_NODE_STATUS has `frames_KEY`. trouble: words after the number in the report
    of a run, for a count that a sound run leaves at 0.
    """
    return {"end": end, "key": key, "trouble": trouble}


@dataclass(frozen=True, slots=True)
class LinkReport:
    """Counts of one direction of a link since the run started, and its latency.

    A row of the topic `/links` and of `links` in summary.json. Each annotated field is a column and, apart from the
    latencies, a key. Counts of the other end are None until it reports them. They are None in the end if the two ends
    could not agree.
    """

    name: Annotated[
        String, "`sensors` (to the agent) or `actuators` (from it); other links add their name: `standby actuators`"
    ]
    sent: Annotated[Int64, "frames handed to the transport"] | None
    received: Annotated[Int64, "valid frames, including repeated ones"] | None
    lost: Annotated[Int64, "sent and never received: sent = received − repeated + lost"] | None = None
    gaps: Annotated[Int64, "frames that the receiver misses"] | None = field(
        default=None, metadata=counted(RECEIVER, "gaps", key="lost")
    )
    late: Annotated[Int64, "out of order"] | None = field(default=None, metadata=counted(RECEIVER, "late"))
    repeated: Annotated[Int64, "received twice"] | None = field(default=None, metadata=counted(RECEIVER, "repeated"))
    dropped: Annotated[Int64, "damaged, unknown, or of another host"] | None = field(
        default=None, metadata=counted(RECEIVER)
    )
    unsent: Annotated[Int64, "not accepted by the sender's transport"] | None = field(
        default=None, metadata=counted(SENDER, "unsent")
    )
    refused: Annotated[Int64, "wrong signature, or not from the host or the agent of the run"] | None = field(
        default=None, metadata=counted(RECEIVER, "refused")
    )
    impaired: Annotated[Int64, "dropped by an injected fault, part of `lost`"] | None = field(
        default=None, metadata=counted(SENDER, "lost on purpose")
    )
    latency_p50_s: Float64 | None = None
    latency_p99_s: Float64 | None = None
    latency_max_s: Float64 | None = None
    host_end: dict[str, int] = field(default_factory=dict)
    """Other counters of the host's transport, by name. The receiving direction reports them. No column."""

    def section(self) -> dict[str, Any]:
        """Return a row of `links`."""
        report: type = type(self)
        names = [column.name for column in message_type(report).fields if not column.name.startswith("latency_")]
        dropped, unsent = names.index("dropped"), names.index("unsent")
        names[dropped], names[unsent] = "unsent", "dropped"  # the order of format 1 of summary.json
        latency_us: dict[str, float | None] = {}
        for key in ("p50", "p99", "max"):  # from whole nanoseconds
            latency_s = getattr(self, f"latency_{key}_s")
            latency_us[key] = None if latency_s is None else round(latency_s * 1e9) / 1e3
        return {name: getattr(self, name) for name in names} | {"host_end": self.host_end, "latency_us": latency_us}


@dataclass(frozen=True, slots=True)
class NodeState:
    """State of a machine in the loop, as its agent reports it. None: not known."""

    node: Annotated[String, "its link"]
    nodes: Annotated[String, "kinds that it runs, such as `LS,LC,LA`"]
    kind: Annotated[String, "`real` or `virtual`"]
    machine: String
    kernel: String
    version: String
    memory_mib: Float64 | None = None
    cpu_percent: Annotated[Float64, "of one core"] | None = None
    load: Float64 | None = None
    temperature_c: Float64 | None = None
    running: Bool = False
    flags: Annotated[String, "scheduling and memory settings, in words"] = ""


@dataclass(frozen=True, slots=True)
class TakeoverReport:
    """One agent replaced another: a row of the topic `/takeovers` and of `takeovers` in summary.json."""

    from_node: String
    to_node: String
    silent_s: Float64
    step: Annotated[Float64, "largest change of a motor command in the exchange that switched"]
    at_s: float = 0.0
    """Simulation time. No column, because it is the stamp of the message."""

    def section(self) -> dict[str, Any]:
        """Return a row of `takeovers`."""
        return {"at_s": self.at_s} | asdict(self)


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """An injected fault begins or ends."""

    fault: String
    active: Annotated[Bool, "1 begins, 0 ends"]


@dataclass(frozen=True, slots=True)
class AutopilotEvent:
    """The autopilot changed its mode, armed or disarmed, or one of its failsafes acted."""

    at_s: Annotated[Float64, "simulation time at which the autopilot reported it"]
    event: Annotated[
        String, "`mode`, `armed`, `disarmed`, `failsafe`, `failsafe over`, `fence limits speed` or `fence limit over`"
    ]
    mode: Annotated[String, "mode after the event"]
    mode_before: String
    reason: Annotated[
        String, "cause in the autopilot's words, or from its reports of fence and estimator; empty: none"
    ] = ""

    def section(self) -> dict[str, Any]:
        """A row of `autopilot_events` of summary.json."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class OperatorAction:
    """Action of an operator on the run."""

    action: Annotated[String, "a JSON object, see [view.md](view.md)"]
    source: Annotated[String, "origin: `view`, `foxglove`, `ros`, or the word given in a file"]


@dataclass(frozen=True, slots=True)
class EncounterState:
    """How two vessels stand to each other that came up with one another so as to involve risk of collision."""

    first: String
    second: String
    event: Annotated[String, "`begins`, `too close`, `passes`, or empty"]
    rule: Annotated[Uint8, "of the COLREGs: 13, 14 or 15 at the beginning; 0: none"]
    geometry: Annotated[String, "`overtaking`, `head-on` or `crossing`"]
    gives_way: Annotated[String, "name of the vessel that must give way"]
    stands_on: Annotated[String, "name of the vessel that keeps course and speed; empty for head-on"]
    distance_m: Annotated[Float64, "between their positions"]
    closing_mps: Float64
    predicted_m: Annotated[Float64, "closest approach of their positions, with their present velocities"]
    predicted_s: Annotated[Float64, "time until the closest approach; negative: time since"]
    hull_closest_m: Annotated[Float64, "smallest distance between the hulls so far"]


@dataclass(frozen=True, slots=True)
class AisReport:
    """A transmission that the vessel's AIS receiver heard, with the AIS names of its fields.

    Of a position report the name and the callsign are empty, of static data all numbers but the MMSI are unknown.
    """

    mmsi: Uint32
    ais_class: Annotated[String, "`class-a` or `class-b`"]
    report: Annotated[String, "`position` or `static`"]
    sentences: Annotated[String, "`!AIVDM` of NMEA 0183, one per line"]
    latitude_deg: Float64 | None = None
    longitude_deg: Float64 | None = None
    speed_mps: Annotated[Float64, "over ground"] | None = None
    course_rad: Annotated[Float64, "over ground, clockwise from true north"] | None = None
    heading_rad: Annotated[Float64, "clockwise from true north"] | None = None
    navigational_status: Int64 | None = None
    name: String = ""
    callsign: String = ""


# Timing


@dataclass(frozen=True, slots=True)
class TaskTiming:
    """Deadlines of one periodic task of a node since the run started.

    Histograms count cycles by time: bin 0 below 2 µs, bin k from 2^k to below 2^(k+1) µs, the last one all that is
    longer; empty where none was kept.
    """

    node: String
    task: String
    rate_hz: Float64
    cycles: Uint32
    missed: Annotated[Uint32, "skipped, or ended after the next was due"]
    start_jitter_max_s: Float64 = 0.0
    run_mean_s: Float64 = 0.0
    run_max_s: Float64 = 0.0
    skipped: Uint32 = 0
    start_jitter_mean_s: Float64 = 0.0
    worst_run_ns: Annotated[Int64, "simulation time at which the longest run began"] | None = None
    worst_start_ns: Annotated[Int64, "simulation time of the most delayed start"] | None = None
    start_histogram: Histogram = ()
    run_histogram: Histogram = ()


@dataclass(frozen=True, slots=True)
class TaskMissEvent:
    """One deadline that a task missed; instants in simulation time."""

    node: String
    task: String
    cycle: Uint32
    due_ns: Int64
    start_ns: Int64
    end_ns: Int64
    skipped: Annotated[Uint32, "cycles skipped before it started"] = 0


@dataclass(frozen=True, slots=True)
class PaceReport:
    """How the machine that simulates kept up with the wall clock, since the run started."""

    slips: Annotated[Uint32, "times that simulation time was held, because the host was too late to recover"] = 0
    slipped_s: Annotated[Float64, "total time of slips"] = 0.0
    stalls: Annotated[Uint32, "times without the start of a physics step for more than 40 ms"] = 0
    stalled_s: Annotated[Float64, "of all stalls"] = 0.0
    longest_stall_s: Float64 = 0.0


@dataclass(frozen=True, slots=True)
class ClockExchange:
    """One exchange of time stamps with a node, and the relation of the clocks estimated from all of them.

    None: not known.
    """

    node: String
    sample: Uint32
    host_ns: Int64
    node_ns: Int64
    round_trip_s: Float64
    offset_s: Annotated[Float64, "node minus host at `host_ns`"]
    drift_ppm: Annotated[Float64, "excess rate of the node's clock over the host's"]
    residual_s: Annotated[Float64, "difference of this exchange from the estimate"] | None = None
    path_delay_s: Annotated[Float64, "half of the shortest round trip"] | None = None
    asymmetry_bound_s: Annotated[Float64, "largest error of the offset from an asymmetric path"] | None = None
    steps: Annotated[Uint32, "of the node's clock"] = 0
    drift_error_ppm: Annotated[Float64, "standard error of the drift, from the fit"] | None = None


# Perception


class PingMessage:
    number: Uint32
    angle_grad: Annotated[Uint32, "of the beam, clockwise from the bow, 400 per turn"]
    position_frd_m: Float64x3
    sample_period_s: Float64
    sound_speed_mps: Float64
    intensity: Bytes


class RadarSectorMessage:
    """Successive spokes of a radar, with the figures of marine_sensor_msgs/RadarSector; angles are clockwise."""

    turn: Uint32
    number: Annotated[Uint32, "of the sector in the turn, 0 to 23"]
    spokes: Uint32
    bins: Annotated[Uint32, "samples of a spoke"]
    angle_start_rad: Annotated[Float64, "of the first spoke, from the bow"]
    angle_increment_rad: Float64
    time_increment_s: Annotated[Float64, "between spokes"]
    scan_time_s: Annotated[Float64, "time of one turn"]
    range_min_m: Annotated[Float64, "of the middle of the first sample"]
    range_max_m: Annotated[Float64, "of the middle of the last sample"]
    heading_rad: Annotated[Float64, "of the bow at the first spoke, from north, as measured"]
    intensity: Annotated[Bytes, "spoke by spoke"]


@dataclass(frozen=True, slots=True)
class CameraDetection:
    """An object that a detector found in an image of a camera."""

    camera: Annotated[String, "name of the camera"]
    image: Annotated[Int64, "number of the image"]
    label: Annotated[String, "class"]
    left_px: Float64
    top_px: Float64
    right_px: Float64
    bottom_px: Float64
    confidence: Annotated[Float64, "0 to 1"]
    bearing_rad: Annotated[Float64, "from the bow to its middle, clockwise, in the axes of the body"]
    width_rad: Annotated[Float64, "from its left to its right edge, in bearing"]
    bottom_rad: Annotated[Float64, "elevation of its lower edge in the axes of the body, up positive"]
    top_rad: Annotated[Float64, "elevation of its upper edge"]


@dataclass(frozen=True, slots=True)
class RadarPlot:
    """An object in the image of a radar's turn. Angles are clockwise."""

    turn: Uint32
    measured_ns: Annotated[Int64, "simulation time of the spoke at its middle"]
    range_m: Float64
    bearing_rad: Annotated[Float64, "from the bow"]
    true_bearing_rad: Annotated[Float64, "from north, by the measured heading"]
    strength_db: Annotated[Float64, "largest level above the receiver's noise"]
    length_m: Annotated[Float64, "extent along the range, including the length of the pulse"]
    width_rad: Annotated[Float64, "extent in bearing, including the width of the beam"]
    samples: Annotated[Uint32, "detected samples"]


class ObstacleMessage:
    id: Uint32
    points: Uint32
    hits: Uint32
    seen_ns: Int64
    position_ned_m: Float64x3
    velocity_ned_mps: Float64x3
    size_m: Float64x3
    heading_rad: Float64
    range_m: Float64
    closing_speed_mps: Float64
    bearing_rad: Annotated[Float64, "from the bow to its middle, clockwise"]
    label: Annotated[String, "class that the cameras saw, empty for none"]
    label_share: Annotated[Float64, "share of the cameras' evidence that is for this class"]


class CompanionMessage:
    """Fields of XITL_COMPANION_STATUS."""

    clouds: Int64
    clouds_partial: Int64
    chunks_lost: Int64
    clouds_dropped: Int64
    points: Int64
    points_refused: Int64
    pings: Int64
    poses: Int64
    poses_refused: Int64
    map_points: Int64
    obstacles: Int64
    detours: Int64
    stops: Int64
    latency_s: Float64
    manoeuvre: Uint8
    clouds_unplaced: Int64
    clouds_early: Int64
    detections: Int64
    detections_matched: Int64
    detections_dropped: Int64
    detections_early: Int64


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic."""

    name: str
    schema: str
    """A ROS 2 message with its `fields`, or a Foxglove message (protobuf)."""
    rate: str
    meaning: str
    fields: type | None = None
    per_vessel: bool = True
    """With more than one vessel, there is one topic per vessel, see `topic_name`."""
    from_start: bool = True
    """The topic is in the file from the start of a run. Otherwise, the first message adds it, so that a recording
    without perception does not change."""

    @property
    def per_link(self) -> bool:
        """There is one of each link."""
        return "{link}" in self.name

    def message_type(self) -> MessageType:
        """Return the type of a ROS 2 message. Raises ValueError for a message type of Foxglove."""
        if self.fields is None:
            raise ValueError(f"{self.name} is not a ROS 2 topic")
        return message_type(self.fields)


@cache
def message_type(fields: type) -> MessageType:
    """Return the message type of the class with the fields of a message."""
    return MessageType(fields)


_TABLE = (
    Topic("/truth/state", "xitl_msgs/msg/VesselState", "`recording.truth_rate_hz`",
          "position, velocity, acceleration (NED), attitude (FRD → NED, w x y z), angular velocity (FRD), rotor "
          "speeds in [-1, 1]", VesselStateMessage),
    Topic("/truth/odometry", "nav_msgs/msg/Odometry", "the same",
          "the same motion in ENU with a FLU body (REP 103), for ROS tools and `evo`", OdometryMessage),
    Topic("/estimate/odometry", "nav_msgs/msg/Odometry", "as the autopilot sends it",
          "the autopilot's estimate, in the frame of the truth; variance of the position if the "
          "autopilot reports it, 1e6 for unknown variances",
          OdometryMessage),
    Topic("/environment", "xitl_msgs/msg/Environment", "10 Hz",
          "current and wind (NED) at the vessel, elevation of the surface by tide and waves", EnvironmentMessage),
    Topic("/environment/tide", "xitl_msgs/msg/Tide", "1 Hz, with a tide",
          "level of the still water, its rate, and speed of the tidal stream", TideState,
          per_vessel=False, from_start=False),
    Topic("/battery", "xitl_msgs/msg/Battery", "10 Hz, with `vehicle.battery`",
          "voltage and current of the battery, used charge", BatteryMessage, from_start=False),
    Topic("/environment/waves", "xitl_msgs/msg/Waves", "at each change by an operator, 2 Hz during the change",
          "the components of the sea from this time on", SeaComponents, per_vessel=False, from_start=False),
    Topic("/actuators", "xitl_msgs/msg/Actuators", "`clock.exchange_rate_hz`",
          "motor commands in force, armed, failsafe, age", ActuatorsMessage),
    Topic("/actuators/age", "xitl_msgs/msg/ActuatorAge", "1 Hz, real time only",
          "age of the commands in use so far, and exchanges without a new one", ActuatorAge),
    Topic("/tasks", "xitl_msgs/msg/Task", "1 Hz",
          "deadlines of every periodic task of every node, with histograms of start jitter and run time", TaskTiming),
    Topic("/pace", "xitl_msgs/msg/Pace", "1 Hz, real time only",
          "stalls of the host so far, and times in which simulation time was held",
          PaceReport, from_start=False),
    Topic("/misses", "xitl_msgs/msg/Miss", "each miss, real time only",
          "one missed deadline of an agent's task: due time, start and end", TaskMissEvent),
    Topic("/clocks", "xitl_msgs/msg/Clock", "10 Hz, real time only",
          "one exchange of time stamps with a node (`sample` against `node_ns` is its time base), and "
          "the clock relation estimated from all exchanges; `autopilot` is another autopilot behind a "
          "bridge, also in lockstep at 1 Hz; for PS1: number of the step, its start, and simulation "
          "time", ClockExchange),
    Topic("/links", "xitl_msgs/msg/Link", "1 Hz",
          "counts and latencies of each direction of each link so far; the last row equals the summary", LinkReport),
    Topic("/nodes", "xitl_msgs/msg/Node", "as the agent sends it",
          "machine, kernel, processor time, load, memory and temperature of a board", NodeState),
    Topic("/bridge", "xitl_msgs/msg/Bridge", "1 Hz, another autopilot only",
          "counters of the bridge so far: received frames by kind, returned outputs, lost and repeated frames",
          BridgeCounts),
    Topic("/takeovers", "xitl_msgs/msg/Takeover", "each",
          "a standby agent takes over from a silent one", TakeoverReport),
    Topic("/autopilot/events", "xitl_msgs/msg/AutopilotEvent", "each",
          "the autopilot changes its mode, arms or disarms, or one of its failsafes acts", AutopilotEvent),
    Topic("/faults", "xitl_msgs/msg/Fault", "each",
          "an injected fault begins (`active` 1) or ends (0); [faults.md](faults.md)", FaultEvent),
    Topic("/operator/action", "xitl_msgs/msg/OperatorAction", "each",
          "an action of a person during the run; `--replay-events` repeats it", OperatorAction,
          per_vessel=False, from_start=False),
    Topic("/link/{link}/tx", "xitl_msgs/msg/MavlinkFrame", "every frame",
          "raw MAVLink 2 frames from host to agent; `{link}` is `agent`, `standby` with a second agent, `companion` "
          "with a companion (without the chunks of clouds and pings)", MavlinkFrameMessage),
    Topic("/link/{link}/rx", "xitl_msgs/msg/MavlinkFrame", "every frame",
          "raw MAVLink 2 frames from agent to host", MavlinkFrameMessage),
    Topic("/tf", "foxglove.FrameTransforms", "`recording.truth_rate_hz`",
          "`map` → `base_link` (truth) and `map` → `base_link_estimate`", per_vessel=False),
    Topic("/truth/pose", "foxglove.PoseInFrame", "the same", "pose in `map`"),
    Topic("/truth/fix", "foxglove.LocationFix", "10 Hz", "position on the Earth"),
    Topic("/scene", "foxglove.SceneUpdate", "once",
          "log boom, dam, water, mission, vessel; debris and changed missions when they appear", per_vessel=False),
    Topic(
        "/log",
        "foxglove.Log",
        "each message",
        "messages of the autopilot and of the run; the last message of a failed run is the reason",
        per_vessel=False,
    ),
    Topic("/lidar/points", "foxglove.PointCloud", "each frame",
          "a lidar's cloud in `base_link` (x forward, y left, z up): `t` in seconds after the stamp, "
          "`intensity`; each point is relative to the vessel at its own instant", from_start=False),
    Topic("/sonar/ping", "xitl_msgs/msg/Ping", "each ping", "the echo of a ping", PingMessage, from_start=False),
    Topic("/sonar/points", "foxglove.PointCloud", "each ping", "points detected in the echo", from_start=False),
    Topic("/marine_radar/sector", "xitl_msgs/msg/RadarSector", "24 per turn, with `sensors.radar`",
          "spokes of the radar's image: intensity 0 to 255 by spoke and range; "
          "[perception.md](perception.md#radar)", RadarSectorMessage, from_start=False),
    Topic("/marine_radar/plots", "xitl_msgs/msg/RadarPlot", "each plot, after its turn",
          "objects in the radar's image: range, bearing, strength, size", RadarPlot, from_start=False),
    Topic("/marine_radar/picture", "foxglove.CompressedImage", "each turn, with `sensors.radar.picture_px`",
          "the turn as a display shows it, bow up (PNG)", from_start=False),
    Topic("/companion/odometry", "nav_msgs/msg/Odometry", "each registered cloud",
          "pose of the companion's odometry in `odom`, the frame at its start; without variances: all are 1e6",
          OdometryMessage, from_start=False),
    Topic("/companion/map", "foxglove.PointCloud", "each new part",
          "new points of the map, in `odom`: `intensity`, `source` 0 lidar, 1 sonar", from_start=False),
    Topic("/companion/obstacles", "xitl_msgs/msg/Obstacle", "2 Hz each",
          "tracked obstacles, in the site's NED: position, velocity, size, range, closing speed",
          ObstacleMessage, from_start=False),
    Topic("/companion/status", "xitl_msgs/msg/Companion", "2 Hz",
          "counters of the companion so far, latency, manoeuvre", CompanionMessage, from_start=False),
    Topic("/truth/bodies", "xitl_msgs/msg/Body", "10 Hz each, with debris",
          "drifting bodies: kind, number, length, pose, velocity; drawn in the frame `body_N`",
          BodyMessage, per_vessel=False, from_start=False),
    Topic("/contacts", "xitl_msgs/msg/Contact", "at the beginning, then 10 Hz",
          "contacts of the hull: object, position, force, closing speed", ContactMessage, from_start=False),
    Topic("/ais", "xitl_msgs/msg/AisReport", "each received transmission, fleets only",
          "transmissions that the vessel's AIS receiver received; [fleets.md](fleets.md#scripted-traffic-and-ais)",
          AisReport, from_start=False),
    Topic("/encounters", "xitl_msgs/msg/Encounter", "each event, 1 Hz while it lasts, fleets only",
          "encounters of two vessels: COLREGs rule, vessel that gives way, closest approach; "
          "[fleets.md](fleets.md)", EncounterState, per_vessel=False, from_start=False),
)  # fmt: skip

TOPICS = {topic.name: topic for topic in _TABLE}
"""By name, in the order in which they stand in a file."""


def topic_name(topic: Topic, vessel: str = "", link: str = "") -> str:
    """The name in the file. With more than one vessel, `vessel` stands before what is each one's own: `/alpha/tasks`.

    link: of a topic that there is one of for each link.
    """
    name = topic.name.format(link=link)
    return f"/{vessel}{name}" if vessel and topic.per_vessel else name


DETECTIONS = "/cameras/detections"
"""Objects that the detectors of cameras found: CameraDetection."""


def camera_topic(camera: str, content: str) -> str:
    """Return the topic with the `image`, the `calibration` or the `annotations` of a camera, without the vessel."""
    return f"/cameras/{camera}/{content}"


def vessel_name(name: str, vessel: str = "") -> str:
    """A vessel's frame, or one that speaks for it, in the file: `base_link`, or `alpha/base_link` of one of several."""
    return f"{vessel}/{name}" if vessel else name


def body_frame(number: int) -> str:
    """The frame of a drifting body, about its middle."""
    return f"body_{number}"
