"""The recorder of a run: converts to the usual axes of tools and writes to the topics of `topics`.

Odometry is in ENU with a FLU body (REP 103). Clouds are x forward, y left, z up: of the body in `base_link`, and in
`odom`, which is the body's pose when the companion's odometry began. All input is NED and FRD.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from foxglove import messages
from numpy.typing import NDArray

from sim_core import frames
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.record.mcap_file import McapFile, PayloadWriter, RecordedFile
from xitl_cli.record.topics import (
    ESTIMATE_FRAME,
    LIDAR_POINT,
    MAP_FRAME,
    MAP_POINT,
    MAP_SOURCES,
    ODOM_FRAME,
    SONAR_POINT,
    TOPICS,
    UNKNOWN_VARIANCE,
    VESSEL_FRAME,
    MapSource,
    MotionEstimate,
    MotorCommand,
    RadarPlot,
    Topic,
    body_frame,
    message_type,
    topic_name,
    vessel_name,
)
from xitl_cli.record.truth import ODOMETRY, POSE, STATE, TRANSFORM, TruthTable, timestamp, transform_message

if TYPE_CHECKING:
    from agent.companion.sonar import SonarPing
    from sim_core.sensors.radar import MarineRadar, RadarSector

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Intensity = NDArray[np.uint8]
Channel = tuple[Callable[..., bytes], PayloadWriter]
"""Encodes a stamp and one value for each field; writes the payload."""

SCENE, WAVES = "/scene", "/environment/waves"
"""Topics whose newest values a viewer needs."""
_UNKNOWN = tuple(np.diag([UNKNOWN_VARIANCE] * 6).ravel().tolist())
_NO_ROTATION = (0.0, 0.0, 0.0)
_FLU = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_FRD_FLU = np.diag([1.0, -1.0, -1.0, 1.0])
_Level = messages.LogLevel
_LEVELS = (
    *(_Level.Fatal, _Level.Fatal, _Level.Fatal, _Level.Error),
    *(_Level.Warning, _Level.Info, _Level.Info, _Level.Debug),
)
_Element = messages.PackedElementFieldNumericType
_ELEMENTS = {np.dtype("<f4"): _Element.Float32, np.dtype("u1"): _Element.Uint8}
_COMPANION_FIELDS = attrgetter(
    *(field.name.removesuffix("_s") for field in TOPICS["/companion/status"].message_type().fields)
)


def _values_of(record: type) -> Callable[[Any], tuple[Any, ...]]:
    """The values of a record's columns, in order."""
    names = [field.name for field in message_type(record).fields]
    read = attrgetter(*names)
    return read if len(names) > 1 else lambda one: (read(one),)


_RECORDS: dict[type, tuple[str, Callable[[Any], tuple[Any, ...]]]] = {
    topic.fields: (topic.name, _values_of(topic.fields))
    for topic in TOPICS.values()
    if topic.fields is not None and is_dataclass(topic.fields)
}
"""Topic and values of each record that is written unchanged."""


class TopicWriter:
    """Writes messages to the topics of one vessel in `file`. `links`: names of the links whose raw frames are recorded.

    vessel: prefix of topics and frames in a fleet; empty for a single vessel. from_start: open the topics that a file
    has from the start of a run.
    """

    def __init__(self, file: McapFile, links: Sequence[str] = (), vessel: str = "", from_start: bool = True) -> None:
        self._file = file
        self._links = tuple(links)
        self._vessel = vessel
        self._channels: dict[str, Channel] = {}
        self._watched: dict[str, tuple[Callable[..., object], ...]] = {}
        self._added: dict[str, Topic] = {}
        for topic in TOPICS.values() if from_start else ():
            if topic.from_start:
                for link in self._links if topic.per_link else ("",):
                    self._open(topic, link)

    def write(self, topic: str, stamp_ns: int, *values: Any) -> None:
        """Write a ROS 2 message, one value for each field, or a foxglove message."""
        encode, write = self._channels.get(topic) or self._open(self._added.get(topic) or TOPICS[topic])
        write(encode(stamp_ns, *values), stamp_ns)

    def repeat(self, topic: str, key: tuple[str, ...], stamp_ns: int, payload: bytes | None) -> None:
        """Begin each next file of a split recording with this written message, see `McapFile.repeat`."""
        self._file.repeat(topic_name(TOPICS[topic], self._vessel), key, payload, stamp_ns)

    def add(self, topic: Topic) -> None:
        """One more topic. Raises UserError for a topic that cannot be added."""
        check_added_topic(topic, self._added.values())
        self._added[topic.name] = topic
        if topic.from_start:
            self._open(topic)

    def watch(self, topic: str, seen: Callable[..., object]) -> None:
        """Call `seen` with the stamp and the values of each message on a topic from now on."""
        self._watched[topic] = (*self._watched.get(topic, ()), seen)
        if topic in self._channels:
            self._channels[topic] = _watched(self._channels[topic], seen)

    def link_channels(self, direction: str) -> dict[str, Channel]:
        """Return encoder and writer of raw frames by link. `direction`: `tx` from host to agent, `rx` back."""
        return {link: self._channels[f"/link/{link}/{direction}"] for link in self._links}

    def frame(self, frame: str) -> str:
        """Return the name in the file of a frame of the vessel."""
        return vessel_name(frame, self._vessel)

    def source(self, source: str) -> str:
        """Return the name in the file of a source of the vessel's log messages."""
        return vessel_name(source, self._vessel)

    def transform(self, stamp_ns: int, child: str, position: Sequence[float], quat_wxyz: Sequence[float]) -> None:
        """Write the position and attitude of the frame `child` in the map: ENU, FLU to ENU."""
        w, x, y, z = quat_wxyz
        self.write(TRANSFORM, stamp_ns, transform_message(stamp_ns, child, [*position, x, y, z, w]))

    def watches(self, *topics: str) -> bool:
        """Whether somebody watches one of these topics."""
        return not self._watched.keys().isdisjoint(topics)

    def payload_writer(self, topic: str) -> PayloadWriter:
        """Return the writer of encoded messages of a topic that nobody watches."""
        _, write = self._channels.get(topic) or self._open(TOPICS[topic])
        return write

    def _open(self, topic: Topic, link: str = "") -> Channel:
        name = topic_name(topic, self._vessel, link)
        encode: Callable[..., bytes]
        if topic.fields is None:
            encode = _encode_foxglove
            message_type = getattr(messages, topic.schema.removeprefix("foxglove."))
            writer = self._file.foxglove_channel(name, message_type, topic_name(topic, link=link))
        else:
            kind = topic.message_type()
            encode = kind.encode
            writer = self._file.ros_channel(name, topic.schema, kind.definition, topic_name(topic, link=link))
        channel = encode, writer
        for seen in self._watched.get(topic.name, ()):
            channel = _watched(channel, seen)
        return self._channels.setdefault(topic.name.format(link=link), channel)


_TOPIC_NAME = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")
_LINK_TOPIC = re.compile(r"/link/[^/]+/[tr]x")


def check_added_topic(topic: Topic, added: Iterable[Topic] = ()) -> None:
    """Raises UserError for a topic that clashes with the recorder's own topics or with `added`, or has no encoder."""
    if not _TOPIC_NAME.fullmatch(topic.name):
        raise UserError(f"{topic.name}: is not the name of a topic; write for example /radar/targets")
    if topic.name in TOPICS or _LINK_TOPIC.fullmatch(topic.name):
        raise UserError(f"{topic.name}: xitl records a topic with this name; choose another name")
    for other in added:
        if topic.name == other.name:
            raise UserError(f"{topic.name}: another plug-in records a topic with this name; rename one of them")
        if topic.fields is not None and topic.fields is other.fields:
            raise UserError(f"{topic.name}: has the record of {other.name}; give each topic its own dataclass")
    if topic.fields is None:
        if not topic.schema.startswith("foxglove.") or not hasattr(messages, topic.schema.removeprefix("foxglove.")):
            raise UserError(f"{topic.name}: {topic.schema} is no message of foxglove; give the fields of the message")
    elif not is_dataclass(topic.fields):
        raise UserError(f"{topic.name}: its fields are not a dataclass; make {topic.fields.__name__} one")
    else:
        try:
            encoded = [field.name for field in topic.message_type().fields]
        except (TypeError, NameError, AssertionError):
            encoded = []
        for field in fields(topic.fields):
            if field.name not in encoded:
                raise UserError(
                    f"{topic.name}: {topic.fields.__name__}.{field.name} has no type of ROS 2; annotate it with a type "
                    "of xitl_cli.record.cdr, such as Float64"
                )


def _watched(channel: Channel, seen: Callable[..., object]) -> Channel:
    encode, write = channel

    def encode_seen(stamp_ns: int, *values: Any) -> bytes:
        seen(stamp_ns, *values)
        return encode(stamp_ns, *values)

    return encode_seen, write


class Recorder:
    """Records a run into an MCAP file. Unknown numbers are NaN; unknown counts and instants are -1.

    path: of the file, or the open file for several vessels. Each vessel then has a recorder with its name. The run has
    one without a name, for shared topics and the host's reports. links, vessel, from_start: see TopicWriter.
    """

    def __init__(
        self,
        path: Path | McapFile,
        compression: str = "",
        links: Sequence[str] = ("agent",),
        vessel: str = "",
        from_start: bool = True,
    ) -> None:
        self._file = path if isinstance(path, McapFile) else McapFile(path, compression)
        self._topics = TopicWriter(self._file, links if from_start else (), vessel, from_start)
        self._records = _RECORDS
        self._log_readers: list[Callable[[int, int, str, str], object]] = []
        self._sent, self._received = self._topics.link_channels("tx"), self._topics.link_channels("rx")

    @cached_property
    def perception(self) -> PerceptionRecorder:
        """Records sensors and results of a companion, drifting bodies and contacts."""
        return PerceptionRecorder(self._topics)

    def of_vessel(self, name: str) -> Recorder:
        """Return a recorder of one more vessel into the same file. Its topics are created at their first message."""
        return Recorder(self._file, vessel=name, from_start=False)

    def watch(self, topic: str, seen: Callable[..., object]) -> None:
        """Call `seen` with the stamp and the values of each message on a topic from now on."""
        self._topics.watch(topic, seen)

    def read_in_run(self, *topics: str) -> bool:
        """Whether something reads one of these topics during the run, not only in the recording."""
        return self._file.mirrored or self._topics.watches(*topics)

    def write(self, stamp_ns: int, record: Any) -> None:
        """Write a record of `topics`: TaskTiming, TaskMissEvent, ClockExchange, LinkReport, FaultEvent, ...

        Records of an added topic are written in the same way.
        """
        try:
            topic, values = self._records[type(record)]
        except KeyError:
            name = type(record).__name__
            raise TypeError(f"no topic has the record {name}; add its topic to `topics` of the NodeKind") from None
        self._topics.write(topic, stamp_ns, *values(record))
        if topic == WAVES:
            payload = TOPICS[WAVES].message_type().encode(stamp_ns, *values(record))
            self._topics.repeat(WAVES, (WAVES,), stamp_ns, payload)

    def add_topic(self, topic: Topic) -> None:
        """Record one more topic, of a plug-in. Its records are written by `write` or, of foxglove's, by `message`.

        Raises UserError for the name of a topic that xitl or another plug-in records, and for fields without encoder.
        """
        self._topics.add(topic)
        if topic.fields is not None:
            self._records = {**self._records, topic.fields: (topic.name, _values_of(topic.fields))}

    def message(self, topic: str, stamp_ns: int, message: Any) -> None:
        """A message of `foxglove.messages` on an added topic, by the topic's name without that of the vessel."""
        self._topics.write(topic, stamp_ns, message)

    def truth(self, stamp_ns: int, motion: Kinematics, rotor: Array) -> None:
        """Write the true state of the first vessel: state, odometry, pose and transform."""
        TruthWriter([self]).write(stamp_ns, [TruthTable(motion, rotor)])

    def fix(self, stamp_ns: int, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """Write the true geodetic position."""
        fix = messages.LocationFix(
            timestamp=timestamp(stamp_ns),
            frame_id=self._topics.frame(VESSEL_FRAME),
            latitude=lat_deg,
            longitude=lon_deg,
            altitude=alt_m,
        )
        self._topics.write("/truth/fix", stamp_ns, fix)

    def environment(self, stamp_ns: int, current_ned_mps: Array, wind_ned_mps: Array, surface_m: float) -> None:
        """Write current (3,), wind (3,) and surface elevation at the first vessel."""
        self._topics.write("/environment", stamp_ns, current_ned_mps.tolist(), wind_ned_mps.tolist(), surface_m)

    def estimate(self, stamp_ns: int, estimate: MotionEstimate) -> None:
        """Write the autopilot's estimate of the instant `stamp_ns`."""
        position, attitude = self._odometry(
            "/estimate/odometry",
            ESTIMATE_FRAME,
            stamp_ns,
            estimate.pos_ned_m,
            estimate.vel_ned_mps @ frames.quat_to_matrix(estimate.quat_ned_frd),
            estimate.quat_ned_frd,
            estimate.gyro_frd_radps,
            _pose_covariance(estimate.pos_deviation_ned_m, estimate.yaw_deviation_rad),
            _UNKNOWN,
        )
        self._topics.transform(stamp_ns, self._topics.frame(ESTIMATE_FRAME), position, attitude)

    def actuators(self, stamp_ns: int, command: MotorCommand, names: str) -> None:
        """Write the active motor commands, with the names of the actuators."""
        self._topics.write(
            "/actuators", stamp_ns, command.motors, command.armed, command.failsafe, command.age_s, names
        )

    def frame_sent(self, stamp_ns: int, frame: bytes, link: str = "agent") -> None:
        """Write a raw MAVLink frame from host to agent."""
        encode, write = self._sent[link]
        write(encode(stamp_ns, frame), stamp_ns)

    def frame_received(self, stamp_ns: int, frame: bytes, sent_ns: int | None = None, link: str = "agent") -> None:
        """Write a raw MAVLink frame from agent to host.

        `sent_ns`: simulation time at which the agent sent it, by its own clock.
        """
        encode, write = self._received[link]
        write(encode(stamp_ns, frame), stamp_ns, sent_ns)

    def log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        """Write a log message of a node. `severity`: MAV_SEVERITY."""
        level = _LEVELS[min(max(severity, 0), 7)]
        name = self._topics.source(source)
        for read in self._log_readers:
            read(stamp_ns, severity, name, text)
        entry = messages.Log(timestamp=timestamp(stamp_ns), level=level, name=name, message=text)
        self._topics.write("/log", stamp_ns, entry)

    def on_log(self, read: Callable[[int, int, str, str], object]) -> None:
        """Call `read` with the stamp, severity (MAV_SEVERITY), source and text of each log message from now on."""
        self._log_readers.append(read)

    def scene(self, update: messages.SceneUpdate, stamp_ns: int = 0) -> None:
        """Write surroundings to draw from an instant on; an entity replaces an earlier one with its frame and id."""
        self._topics.write(SCENE, stamp_ns, update)
        if self._file.is_split:
            from xitl_cli.record.scene_changes import scene_changes

            for change in scene_changes(update.encode()):
                self._topics.repeat(SCENE, change.key, stamp_ns, change.update)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a file inside the recording."""
        self._file.attach(name, media_type, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Store named texts inside the recording."""
        self._file.metadata(name, values)

    def flush_if_due(self) -> None:
        """Pass the recorded data to the operating system about once a second."""
        self._file.flush_if_due()

    @property
    def files(self) -> tuple[RecordedFile, ...]:
        """The closed files of a split recording, in order."""
        return self._file.files

    def close(self) -> None:
        """Write the index and close."""
        self._file.close()

    def _odometry(
        self,
        topic: str,
        frame: str,
        stamp_ns: int,
        pos_ned_m: Array,
        vel_frd_mps: Array,
        quat_ned_frd: Array,
        gyro_frd_radps: Array,
        pose_covariance: tuple[float, ...],
        twist_covariance: tuple[float, ...],
    ) -> tuple[list[float], list[float]]:
        """Write nav_msgs/Odometry; return position (ENU) and attitude (FLU to ENU, w x y z)."""
        position = frames.ned_to_enu(pos_ned_m).tolist()
        w, x, y, z = attitude = frames.quat_ned_frd_to_enu_flu(quat_ned_frd).tolist()
        twist = frames.frd_to_flu(vel_frd_mps).tolist() + frames.frd_to_flu(gyro_frd_radps).tolist()
        child = self._topics.frame(frame)
        self._topics.write(
            topic, stamp_ns, MAP_FRAME, child, position, (x, y, z, w), pose_covariance, twist, twist_covariance
        )
        return position, attitude


class TruthWriter:
    """Writes the true motion of vessels: state, odometry, pose and transform.

    recorders: one for each vessel, in the order of the messages. rows: for each vessel, its table and its row there; by
    default all are rows of one table.
    """

    def __init__(self, recorders: Sequence[Recorder], rows: Sequence[tuple[int, int]] = ()) -> None:
        self._rows = tuple(rows) or tuple((0, row) for row in range(len(recorders)))
        self._join = recorders[0]._file.joined_writer
        self._topics = [recorder._topics for recorder in recorders]
        named = zip(self._rows, [topics.frame(VESSEL_FRAME) for topics in self._topics], strict=True)
        self._frames: dict[int, list[str]] = {}
        for (table, _), frame in sorted(named):
            self._frames.setdefault(table, []).append(frame)
        self._write: Callable[[Sequence[bytes], int], None] | None = None

    def write(self, stamp_ns: int, tables: Sequence[TruthTable]) -> None:
        """Write the rows of the tables."""
        if any(topics.watches(*_TRUTH) for topics in self._topics):  # the watchers get values, not payloads
            for topics, (table, row) in zip(self._topics, self._rows, strict=True):
                frame = self._frames[table][row]
                topics.write(STATE, stamp_ns, *tables[table].state(row))
                topics.write(ODOMETRY, stamp_ns, *tables[table].odometry(row, frame))
                topics.write(POSE, stamp_ns, tables[table].pose(stamp_ns, row))
                topics.write(TRANSFORM, stamp_ns, tables[table].transform(stamp_ns, row, frame))
            return
        if self._write is None:
            self._write = self._join([topics.payload_writer(topic) for topic in _TRUTH for topics in self._topics])
        framed = [(table, self._frames[number]) for number, table in enumerate(tables)]
        encoded = (
            [table.state_payloads(stamp_ns) for table in tables],
            [table.odometry_payloads(stamp_ns, frames) for table, frames in framed],
            [table.pose_payloads(stamp_ns) for table in tables],
            [table.transform_payloads(stamp_ns, frames) for table, frames in framed],
        )
        self._write([of_topic[table][row] for of_topic in encoded for table, row in self._rows], stamp_ns)


_TRUTH = (STATE, ODOMETRY, POSE, TRANSFORM)


def _pose_covariance(pos_deviation_ned_m: Array | None, yaw_deviation_rad: float | None) -> tuple[float, ...]:
    """Return the covariance (36,) of a pose in ENU, row by row. No autopilot reports the variance of its tilt."""
    if pos_deviation_ned_m is None:
        return _UNKNOWN
    north, east, down = pos_deviation_ned_m.tolist()
    covariance = list(_UNKNOWN)
    covariance[0], covariance[7], covariance[14] = east * east, north * north, down * down
    if yaw_deviation_rad is not None:
        covariance[35] = yaw_deviation_rad * yaw_deviation_rad
    return tuple(covariance)


class PerceptionRecorder:
    """Sensors and results of a companion, drifting bodies and contacts. A topic is created at its first message."""

    def __init__(self, topics: TopicWriter) -> None:
        self._topics = topics

    def lidar_points(self, stamp_ns: int, points_frd_m: Points, offset_s: Points, intensity: Intensity) -> None:
        """Write a frame of the lidar that began at `stamp_ns`: (n, 3) in body FRD, each at its own instant."""
        packed = _packed(LIDAR_POINT, points_frd_m, intensity)
        packed["t"] = offset_s
        self._topics.write("/lidar/points", stamp_ns, _cloud(stamp_ns, self._topics.frame(VESSEL_FRAME), packed))

    def ping(self, stamp_ns: int, ping: SonarPing) -> None:
        """Write a ping of the sonar that was sent at `stamp_ns`."""
        self._topics.write(
            "/sonar/ping",
            stamp_ns,
            ping.number,
            ping.angle_grad,
            [float(value) for value in ping.position_frd_m],
            ping.sample_period_s,
            ping.sound_speed_mps,
            np.asarray(ping.intensity, dtype=np.uint8).tobytes(),
        )

    def sonar_points(self, stamp_ns: int, points_frd_m: Points, intensity: Intensity) -> None:
        """Write the points detected in the pings: (n, 3) in body FRD."""
        packed = _packed(SONAR_POINT, points_frd_m, intensity)
        self._topics.write("/sonar/points", stamp_ns, _cloud(stamp_ns, self._topics.frame(VESSEL_FRAME), packed))

    def radar_sector(self, stamp_ns: int, radar: MarineRadar, sector: RadarSector) -> None:
        """Write a sector of the radar that began at `stamp_ns`."""
        self._topics.write(
            "/marine_radar/sector",
            stamp_ns,
            sector.turn,
            sector.number,
            *sector.intensity.shape,
            radar.angle_rad(sector.number),
            radar.step_rad,
            radar.spoke_s,
            radar.spoke_s * radar.spec.spokes,
            0.5 * radar.bin_m,
            radar.spec.range_m - 0.5 * radar.bin_m,
            sector.heading_rad,
            sector.intensity.tobytes(),
        )

    def radar_plot(self, stamp_ns: int, plot: RadarPlot) -> None:
        """Write a plot of the turn that ended at `stamp_ns`."""
        topic, values = _RECORDS[RadarPlot]
        self._topics.write(topic, stamp_ns, *values(plot))

    def radar_picture(self, stamp_ns: int, png: bytes) -> None:
        """Write the picture of the turn that ended at `stamp_ns`."""
        frame = self._topics.frame(VESSEL_FRAME)
        image = messages.CompressedImage(timestamp=timestamp(stamp_ns), frame_id=frame, data=png, format="png")
        self._topics.write("/marine_radar/picture", stamp_ns, image)

    def odom_frame(self, stamp_ns: int, pos_ned_m: Array, quat_ned_frd: Array) -> None:
        """Write the true pose of the body when the odometry began: (3,), (4,). Tools then draw the map in its place."""
        position = frames.ned_to_enu(np.asarray(pos_ned_m, dtype=np.float64)).tolist()
        attitude = frames.quat_ned_frd_to_enu_flu(np.asarray(quat_ned_frd, dtype=np.float64)).tolist()
        frame = self._topics.frame(ODOM_FRAME)
        self._topics.transform(stamp_ns, frame, position, attitude)
        w, x, y, z = attitude
        placed = transform_message(stamp_ns, frame, [*position, x, y, z, w])
        self._topics.repeat(TRANSFORM, (frame,), stamp_ns, placed.encode())

    def odometry(self, stamp_ns: int, pose_odom: Array, vel_frd_mps: Array) -> None:
        """Write a pose (4, 4) of the odometry, body FRD to FRD at its start, and the velocity (3,) in the body."""
        pose = _FRD_FLU @ np.asarray(pose_odom, dtype=np.float64) @ _FRD_FLU
        w, x, y, z = frames.matrix_to_quat(pose[:3, :3]).tolist()
        linear = frames.frd_to_flu(np.asarray(vel_frd_mps, dtype=np.float64)).tolist()
        self._topics.write(
            "/companion/odometry",
            stamp_ns,
            self._topics.frame(ODOM_FRAME),
            self._topics.frame(VESSEL_FRAME),
            pose[:3, 3].tolist(),
            (x, y, z, w),
            _UNKNOWN,
            (*linear, *_NO_ROTATION),
            _UNKNOWN,
        )

    def map_points(self, stamp_ns: int, points_odom_m: Points, intensity: Intensity, source: MapSource) -> None:
        """Write new points (n, 3) of the companion's map, in its odometry's frame (FRD at its start)."""
        packed = _packed(MAP_POINT, points_odom_m, intensity)
        packed["source"] = MAP_SOURCES.index(source)
        self._topics.write("/companion/map", stamp_ns, _cloud(stamp_ns, self._topics.frame(ODOM_FRAME), packed))

    def obstacle(self, stamp_ns: int, message: Any) -> None:
        """Write XITL_OBSTACLE as received."""
        self._topics.write(
            "/companion/obstacles",
            stamp_ns,
            message.id,
            message.points,
            message.hits,
            message.time_usec * 1000,
            message.pos_ned,
            message.vel_ned,
            message.size,
            message.heading,
            message.range,
            message.closing_speed,
            message.bearing,
            message.label,
            message.label_share,
        )

    def companion(self, stamp_ns: int, message: Any) -> None:
        """Write XITL_COMPANION_STATUS as received."""
        self._topics.write("/companion/status", stamp_ns, *_COMPANION_FIELDS(message))

    def bodies(
        self,
        stamp_ns: int,
        kinds: Sequence[str],
        lengths_m: Array,
        pos_ned_m: Array,
        quat_ned_frd: Array,
        vel_ned_mps: Array,
    ) -> None:
        """Write the drifting bodies: (B,), (B,), (B, 3), (B, 4), (B, 3). The index of a body is its number.

        Each body has a separate frame, `body_frame`, in which it is drawn.
        """
        numbers = (np.asarray(values).tolist() for values in (lengths_m, pos_ned_m, quat_ned_frd, vel_ned_mps))
        rows = zip(kinds, *numbers, strict=True)
        for number, (kind, length_m, place, quat, velocity) in enumerate(rows):
            self._topics.write("/truth/bodies", stamp_ns, kind, number, length_m, place, quat, velocity)
            position = frames.ned_to_enu(np.array(place)).tolist()
            attitude = frames.quat_ned_frd_to_enu_flu(np.array(quat)).tolist()
            self._topics.transform(stamp_ns, body_frame(number), position, attitude)

    def contact(
        self, stamp_ns: int, body: str, pos_ned_m: Array, force_n: float, speed_mps: float, began: bool
    ) -> None:
        """Write a contact of the hull with `body` at a place (3,). `began`: the contact is new."""
        place = np.asarray(pos_ned_m, dtype=np.float64).tolist()
        self._topics.write("/contacts", stamp_ns, body, place, float(force_n), float(speed_mps), bool(began))


def _encode_foxglove(stamp_ns: int, message: Any) -> bytes:
    payload: bytes = message.encode()
    return payload


def _packed(kind: np.dtype[Any], points_m: Points, intensity: Intensity) -> NDArray[Any]:
    """Return the points (n,) with a point's dtype, in axes forward, left, up."""
    packed = np.zeros(len(points_m), dtype=kind)
    points_flu_m = np.asarray(points_m, dtype=np.float32).reshape(-1, 3) * _FLU
    for axis, name in enumerate("xyz"):
        packed[name] = points_flu_m[:, axis]
    packed["intensity"] = intensity
    return packed


def _cloud(stamp_ns: int, frame: str, packed: NDArray[Any]) -> messages.PointCloud:
    kinds = packed.dtype.fields
    assert kinds is not None
    return messages.PointCloud(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=messages.Pose(
            position=messages.Vector3(x=0.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        ),
        point_stride=packed.dtype.itemsize,
        fields=[
            messages.PackedElementField(name=name, offset=kind[1], type=_ELEMENTS[kind[0]])
            for name, kind in kinds.items()
        ],
        data=packed.tobytes(),
    )
