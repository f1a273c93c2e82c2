"""Conversion of the recorder's payloads to ROS messages in CDR. The table in `outputs` lists them.

recorded topic ── its vessel ──> VesselConversion ── handler of the topic ──> RosMessages
frames of MAVLink ── kind ──> a message of the sensor (`instruments`)
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.mavlink.modes import mode_name
from agent.wire import codec, dialect
from agent.wire.framing import MAGIC
from sim_core.frames import ned_to_enu
from sim_core.geodesy import LocalFrame
from sim_core.sensors.spec import LidarSpec
from xitl_cli.plugins.ros import instruments, msg
from xitl_cli.plugins.ros.camera_messages import (
    camera_frame,
    camera_messages,
    camera_of_topic,
    camera_topics,
    cameras_of,
)
from xitl_cli.plugins.ros.definitions import deserialize, ros2_types, serialize
from xitl_cli.plugins.ros.diagnostics import Diagnostics
from xitl_cli.plugins.ros.frames import (
    FRAMES,
    LIDAR_FRAME,
    RADAR_FRAME,
    SONAR_FRAME,
    FixedFrame,
    GimbalFrames,
    TurnedFrame,
    frame_name,
    named_frame,
    sensor_frames,
)
from xitl_cli.plugins.ros.outputs import (
    ANSWERS_LINK,
    DIAGNOSED,
    ESTIMATE,
    LINK_NAME,
    OUTPUTS,
    SENSORS_LINK,
    TICKS,
    TRUE_FIX,
    TRUE_STATE,
    TRUTH,
    RosTopic,
    UserTopic,
    named_topics,
    user_topics,
)
from xitl_cli.plugins.ros.robot_description import (
    ThrusterLink,
    ThrusterState,
    make_robot_description,
    state_of,
    thrusters_of,
)
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.foxglove_types import foxglove_type
from xitl_cli.record.topics import MAP_FRAME, ODOM_FRAME, TOPICS, UNKNOWN_VARIANCE, VESSEL_FRAME

STATE_NS = 100_000_000
KEPT_GYRO = 512
"""Number of kept samples that propagate a late estimate."""
STALE_ESTIMATE_NS = 1_000_000_000
VELOCITY_DEVIATION_MPS, POSITION_DEVIATION_M = 0.1, 1.0
"""Deviations of the estimate if the autopilot does not report them."""
RATE_DEVIATION_RADPS = 0.01
_STAMP = struct.Struct("<iI")
_HEADER_BYTES = 4
_LEAST_FRAME = 12
Array = NDArray[np.float64]


class RosMessage(NamedTuple):
    """A message with its time stamp."""

    topic: RosTopic
    """Topic of the message."""
    vessel: str
    """Name of the vessel, "" for a single one."""
    cdr: bytes
    """CDR with its encapsulation."""
    stamp_ns: int


class RosConversion:
    """Conversion for all vessels of a run. profiles: one per vessel, as in the run or its recording.

    It has state: call `convert` in the order of the run.
    """

    def __init__(self, profiles: Sequence[RunProfile]) -> None:
        self._named = named_topics(profiles[0].ros)
        self._left_out = {name for name, asked in profiles[0].ros.topics.items() if not asked.publish}
        self._vessels = [VesselConversion(profile, self._named, number == 0) for number, profile in enumerate(profiles)]
        self._handlers: dict[str, Callable[[bytes, int], Iterable[RosMessage]] | None] = {}

    def topics(self) -> Iterator[tuple[RosTopic, str]]:
        """Yield all topics, each with its vessel ("" for all), except topics that depend on the capabilities of an
        autopilot.
        """
        yield self._named["/tf_static"], ""
        for vessel in self._vessels:
            for topic in vessel.topics():
                if topic.name not in self._left_out:
                    yield topic, "" if topic.of_all else vessel.name

    def wants(self, topic: str) -> bool:
        """Return True if a recorded topic has an output."""
        return self._handler(topic) is not None

    def static(self) -> Iterator[RosMessage]:
        """Yield the messages sent once, at the start: fixed frames of all vessels, descriptions, missions."""
        frames = [_transform(frame, 0) for vessel in self._vessels for frame in vessel.fixed_frames]
        transforms = serialize(msg.TFMessage(transforms=frames))
        messages = [RosMessage(self._named["/tf_static"], "", transforms, 0)]
        messages += [message for vessel in self._vessels for message in vessel.static()]
        return (message for message in messages if message.topic.name not in self._left_out)

    def odom_in_map(self, vessel: str) -> tuple[float, float]:
        """Return east and north of the origin of the vessel's `odom` in `map`, in metres."""
        origin_m = next((known.odometry.origin_map_m for known in self._vessels if known.name == vessel), np.zeros(3))
        east_m, north_m, _ = origin_m.tolist()
        return east_m, north_m

    def convert(self, topic: str, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        """Convert one payload of a recorded topic, with its name as in the file: `/alpha/truth/odometry`."""
        handler = self._handler(topic)
        if handler is None:
            return ()
        messages = handler(payload, stamp_ns)
        if not self._left_out:
            return messages
        return (message for message in messages if message.topic.name not in self._left_out)

    def _handler(self, topic: str) -> Callable[[bytes, int], Iterable[RosMessage]] | None:
        if topic not in self._handlers:
            handler = None
            for vessel in self._vessels:
                prefix = f"/{vessel.name}" if vessel.name else ""
                if topic.startswith(f"{prefix}/"):
                    handler = handler or vessel.handler(topic.removeprefix(prefix))
            if topic in DIAGNOSED:  # of the host, in a run of several vessels
                handler = handler or self._vessels[0].handlers[topic]
            self._handlers[topic] = handler
        return self._handlers[topic]


class VesselConversion:
    """Conversion for one vessel.

    named: topics by their names in OUTPUTS. first: True if it produces the messages common to all vessels, except
    transforms.
    """

    def __init__(self, profile: RunProfile, named: Mapping[str, RosTopic], first: bool) -> None:
        self._named = named
        self.name = profile.vessel
        self._thrusters = thrusters_of(profile.vehicle)
        self._turning = [thruster for thruster in self._thrusters if thruster.limit_rad]
        self._profile = profile
        self._first = first
        self._estimated = profile.autopilot.kind != "none"
        moved_by = {"auto": "estimate" if self._estimated else "truth"}
        self._moved_by = moved_by.get(profile.ros.tf, profile.ros.tf)
        self.odometry = ContinuousOdometry()
        frames = [*sensor_frames(profile), *(link.frame for link in self._thrusters if not link.limit_rad)]
        if self._moved_by == "truth":  # the truth is continuous in the map
            frames.insert(0, FixedFrame(MAP_FRAME, ODOM_FRAME, (0.0, 0.0, 0.0)))
        self.fixed_frames = tuple(named_frame(frame, self.name) for frame in frames)
        self._frame = LocalFrame(profile.site.latitude_deg, profile.site.longitude_deg, profile.site.altitude_m)
        self._gimbals = GimbalFrames(cameras_of(profile))
        self._attitude = AttitudeCarry()
        self._diagnostics = Diagnostics()
        self._estimate_ns = -1
        self._state_ns = 0
        self._mode: str | None = None
        self._armed: bool | None = None
        self._mission: UploadedMission = UploadedMission()
        handlers: dict[str, Callable[[bytes, int], Iterable[RosMessage]]] = {
            TRUTH: self._truth,
            TRUE_FIX: self._true_fix,
            ESTIMATE: self._estimate,
            "/environment": self._environment,
            "/ais": self._ais,
            ANSWERS_LINK: self._answer,
            TICKS: self._tick,
            TRUE_STATE: self._state,
            **{topic: partial(self._diagnose, topic) for topic in DIAGNOSED},
        }
        if self._gimbals.wanted:
            handlers[FRAMES] = self._camera_frame
        sensors, self._instruments = profile.sensors, None
        if sensors is not None:
            frame_of = {frame.name: instruments.CloudFrame(frame) for frame in sensor_frames(profile)}
            self._instruments = instruments.Instruments(sensors, self._framed)
            handlers[SENSORS_LINK] = partial(self._sensor_frame, self._instruments)
            if sensors.lidar is not None:
                handlers["/lidar/points"] = partial(self._lidar_cloud, sensors.lidar, frame_of[LIDAR_FRAME])
            if sensors.sonar is not None:
                handlers["/sonar/points"] = partial(self._sonar_cloud, frame_of[SONAR_FRAME])
                handlers["/sonar/ping"] = partial(self._ping, math.radians(sensors.sonar.heading_deg))
            if sensors.radar is not None:
                handlers["/marine_radar/sector"] = self._radar_sector
        self._users: dict[str, list[UserTopic]] = {}
        for user in user_topics(profile.ros):
            self._users.setdefault(user.of, []).append(user)
        for topic, users in self._users.items():
            handlers[topic] = partial(self._with_users, handlers.get(topic), users)
        self.handlers = handlers
        """By recorded topic without the vessel's name, except those of cameras."""

    def handler(self, topic: str) -> Callable[[bytes, int], Iterable[RosMessage]] | None:
        """Return the handler of a recorded topic without the vessel's name, None for a topic without an output."""
        if camera := camera_of_topic(topic):
            return partial(self._camera, topic, camera)
        return self.handlers.get(topic)

    def topics(self) -> Iterator[RosTopic]:
        """Yield its topics."""
        names = ["mission", "robot_description", "ground_truth/odom", "ground_truth/fix"]
        names += ["wind", "current", "diagnostics"]
        if self._first:
            names += ["/clock", "/tf"]
        if self._estimated:
            names += ["odometry", "mode", "armed"]
            if self.name:
                names += ["ais/nmea"]
        if self._turning:
            names += ["joint_states"]
        if self._instruments is not None:
            names += self._instruments.topics
        sensors = self._profile.sensors
        if sensors is not None and sensors.lidar is not None:
            names += ["points", "scan"]
        if sensors is not None and sensors.sonar is not None:
            names += ["sonar/points", "sonar/echo"]
        if sensors is not None and sensors.radar is not None:
            names += ["marine_radar/spokes"]
        yield from (self._named[name] for name in names)
        for camera in cameras_of(self._profile):
            yield from (self._named[name].of(camera.name) for name in camera_topics(camera))
        yield from (self._named["thrusters/{thruster}/state"].of(thruster.name) for thruster in self._thrusters)
        if self._instruments is not None:
            yield from (self._named[instruments.RANGE].of(part) for part in self._instruments.rangefinders)
        yield from (user.topic for users in self._users.values() for user in users)

    def _with_users(
        self,
        ours: Callable[[bytes, int], Iterable[RosMessage]] | None,
        users: Sequence[UserTopic],
        payload: bytes,
        stamp_ns: int,
    ) -> Iterable[RosMessage]:
        """Yield xitl's messages, then the user's."""
        if ours is not None:
            yield from ours(payload, stamp_ns)
        for user in users:
            cdr = payload if user.read is None else _field_cdr(user, payload)
            if cdr is not None:
                yield RosMessage(user.topic, "" if user.topic.of_all else self.name, cdr, stamp_ns)

    def static(self) -> Iterator[RosMessage]:
        """Yield description and mission of the vessel."""
        start = self._profile.mission.start
        places = [(start.north_m, start.east_m), *self._profile.mission.course_ned_m]
        yield self._message("mission", self._path(0, places), 0)
        yield self._message("robot_description", msg.String(data=make_robot_description(self._profile)), 0)

    # Recorded topics of xitl

    def _tick(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        if self._first:
            yield self._message("/clock", msg.Clock(clock=msg.Time(*divmod(stamp_ns, 1_000_000_000))), stamp_ns)
        array = self._diagnostics.due(stamp_ns, msg.header(stamp_ns, ""))
        if array is not None:
            yield self._message("diagnostics", array, stamp_ns)

    def _diagnose(self, topic: str, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        self._diagnostics.note(topic, deserialize(payload, TOPICS[topic].schema))
        return ()

    def _state(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        """Yield the state of thrusters, gears and rudders."""
        if stamp_ns < self._state_ns:
            return
        self._state_ns = (stamp_ns // STATE_NS + 1) * STATE_NS
        rotor = deserialize(payload, TOPICS[TRUE_STATE].schema).rotor.tolist()
        density = self._profile.environment.water.density_kgpm3
        states = {thruster.name: state_of(thruster, rotor, density) for thruster in self._thrusters}
        for thruster in self._thrusters:
            message = self._joint_state(stamp_ns, [thruster], states)
            topic = self._named["thrusters/{thruster}/state"].of(thruster.name)
            yield RosMessage(topic, self.name, serialize(message), stamp_ns)
        if self._turning:
            yield self._message("joint_states", self._joint_state(stamp_ns, self._turning, states), stamp_ns)
            frames = [thruster.turned(states[thruster.name].angle_rad) for thruster in self._turning]
            transforms = [_transform(named_frame(frame, self.name), stamp_ns) for frame in frames]
            yield self._message("/tf", msg.TFMessage(transforms=transforms), stamp_ns)

    def _joint_state(self, stamp_ns: int, links: Sequence[ThrusterLink], states: Mapping[str, ThrusterState]) -> Any:
        shown = [states[link.name] for link in links]
        return msg.JointState(
            header=msg.header(stamp_ns, ""),
            name=[self._framed(link.joint) for link in links],
            position=np.array([state.angle_rad for state in shown]),
            velocity=np.array([state.speed_radps for state in shown]),
            effort=np.array([state.thrust_n for state in shown]),
        )

    def _truth(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        yield RosMessage(self._named["ground_truth/odom"], self.name, payload, stamp_ns)
        if self._moved_by != "truth" and not self._gimbals.wanted:
            return
        pose = deserialize(payload, OUTPUTS["odometry"].type).pose.pose
        if self._moved_by == "truth":
            yield self._moved(stamp_ns, pose)
        turn = pose.orientation
        yield from self._turned(self._gimbals.attitude(stamp_ns, np.array([turn.w, turn.x, turn.y, turn.z])))

    def _turned(self, frames: Iterable[TurnedFrame]) -> Iterable[RosMessage]:
        """Yield the transforms of cameras on gimbals."""
        for stamp_ns, frame in frames:
            transform = _transform(named_frame(frame, self.name), stamp_ns)
            yield self._message("/tf", msg.TFMessage(transforms=[transform]), stamp_ns)

    def _camera_frame(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        return self._turned(self._gimbals.image(payload))

    def _true_fix(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        place = foxglove_type("LocationFix").FromString(payload)
        fix = msg.NavSatFix(
            header=msg.header(stamp_ns, self._framed(VESSEL_FRAME)),
            status=msg.NavSatStatus(status=msg.NavSatStatus.STATUS_FIX, service=msg.NavSatStatus.SERVICE_GPS),  # type: ignore[arg-type]  # as in Dashing
            latitude=place.latitude,
            longitude=place.longitude,
            altitude=place.altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=msg.NavSatFix.COVARIANCE_TYPE_KNOWN,
        )
        yield self._message("ground_truth/fix", fix, stamp_ns)

    def _estimate(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        """Convert the recorder's estimate, which is in the map, with the variances that the autopilot reports."""
        if stamp_ns <= self._estimate_ns:
            return
        self._estimate_ns = stamp_ns
        odometry = deserialize(payload, OUTPUTS["odometry"].type)
        odometry.header.frame_id = self._framed(ODOM_FRAME)
        odometry.child_frame_id = self._framed(VESSEL_FRAME)
        place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        pose, twist = odometry.pose.covariance.reshape(6, 6).copy(), np.zeros((6, 6))
        for axis in range(3):
            if not 0.0 < pose[axis, axis] < UNKNOWN_VARIANCE:  # older recordings have 0 for "unknown"
                pose[axis, axis] = POSITION_DEVIATION_M**2
            pose[axis + 3, axis + 3] = instruments.ATTITUDE_DEVIATION_RAD[axis] ** 2
            twist[axis, axis], twist[axis + 3, axis + 3] = VELOCITY_DEVIATION_MPS**2, RATE_DEVIATION_RADPS**2
        odometry.pose.covariance, odometry.twist.covariance = pose.reshape(36), twist.reshape(36)
        if math.isfinite(place.x) and math.isfinite(turn.w):
            self._attitude.estimated(stamp_ns, (turn.w, turn.x, turn.y, turn.z))
            # Convert the position from `map` to `odom`
            linear = odometry.twist.twist.linear
            velocity_map_mps = rotated((turn.w, turn.x, turn.y, turn.z), np.array([linear.x, linear.y, linear.z]))
            place_map_m = np.array([place.x, place.y, place.z])
            place.x, place.y, place.z = self.odometry.update(stamp_ns, place_map_m, velocity_map_mps).tolist()
        yield self._message("odometry", odometry, stamp_ns)
        if self._moved_by == "estimate":
            yield self._moved(stamp_ns, odometry.pose.pose, self.odometry.origin_map_m)

    def _environment(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        message = deserialize(payload, TOPICS["/environment"].schema)
        for topic, velocity_ned_mps in (("wind", message.wind_ned_mps), ("current", message.current_ned_mps)):
            vector = msg.Vector3(*ned_to_enu(velocity_ned_mps).tolist())
            yield self._message(
                topic, msg.Vector3Stamped(header=msg.header(stamp_ns, MAP_FRAME), vector=vector), stamp_ns
            )

    def _ais(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        for sentence in deserialize(payload, TOPICS["/ais"].schema).sentences.splitlines():
            yield self._message("ais/nmea", msg.String(data=sentence), stamp_ns)

    def _lidar_cloud(
        self, lidar: LidarSpec, frame: instruments.CloudFrame, payload: bytes, stamp_ns: int
    ) -> Iterable[RosMessage]:
        base_m, packed = instruments.recorded_points(cloud_data(payload), timed=True)
        header = msg.header(stamp_ns, self._framed(LIDAR_FRAME))
        cloud = instruments.point_cloud(header, frame.points(base_m), packed["intensity"], packed["t"])
        yield self._message("points", cloud, stamp_ns)
        header = msg.header(stamp_ns, self._framed(VESSEL_FRAME))
        scan = instruments.scan_of_cloud(
            header,
            instruments.leveled(base_m, self._attitude.at_sample()),
            self._profile.environment.water.level_m,  # because the body's origin floats at the map's zero
            (lidar.min_range_m, lidar.max_range_m),
            1.0 / lidar.rate_hz,
        )
        yield self._message("scan", scan, stamp_ns)

    def _sonar_cloud(self, frame: instruments.CloudFrame, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        base_m, packed = instruments.recorded_points(cloud_data(payload), timed=False)
        header = msg.header(stamp_ns, self._framed(SONAR_FRAME))
        cloud = instruments.point_cloud(header, frame.points(base_m), packed["intensity"])
        yield self._message("sonar/points", cloud, stamp_ns)

    def _ping(self, heading_rad: float, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        ping = deserialize(payload, TOPICS["/sonar/ping"].schema)
        intensity = np.asarray(ping.intensity, dtype=np.uint8)
        sample_m = 0.5 * ping.sound_speed_mps * ping.sample_period_s
        angle_rad = ping.angle_grad * math.tau / 400.0 - heading_rad
        points_m = instruments.echo_points(angle_rad, (np.arange(len(intensity)) + 0.5) * sample_m)
        header = msg.header(stamp_ns, self._framed(SONAR_FRAME))
        yield self._message("sonar/echo", instruments.point_cloud(header, points_m, intensity), stamp_ns)

    def _camera(self, topic: str, camera: str, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        for name, message in camera_messages(topic, payload, self._framed(camera_frame(camera))):
            yield RosMessage(self._named[name].of(camera), self.name, serialize(message), stamp_ns)

    def _radar_sector(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        sector = deserialize(payload, TOPICS["/marine_radar/sector"].schema)
        types, topic = ros2_types().types, OUTPUTS["marine_radar/spokes"]
        duration, echo = types["builtin_interfaces/msg/Duration"], types["marine_sensor_msgs/msg/RadarEcho"]
        spokes = np.asarray(sector.intensity, np.uint8).reshape(sector.spokes, sector.bins).astype(np.float32)
        message = types[topic.type](
            header=msg.header(stamp_ns, self._framed(RADAR_FRAME)),
            angle_start=-sector.angle_start_rad,
            angle_increment=-sector.angle_increment_rad,
            time_increment=duration(*divmod(round(sector.time_increment_s * 1e9), 1_000_000_000)),
            scan_time=duration(*divmod(round(sector.scan_time_s * 1e9), 1_000_000_000)),
            range_min=sector.range_min_m,
            range_max=sector.range_max_m,
            intensities=[echo(echoes=spoke) for spoke in spokes],
        )
        yield self._message("marine_radar/spokes", message, stamp_ns)

    # Frames of MAVLink

    def _sensor_frame(self, sensors: instruments.Instruments, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        message = read_frame(payload, sensors.kinds | UploadedMission.kinds)
        if message is None:
            return
        kind = message.get_msgId()
        if kind in UploadedMission.kinds:
            places = self._mission.handle(message)
            if places is not None:
                latitude, longitude = np.array(places, dtype=np.float64).reshape(-1, 2).T
                ned_m = self._frame.ned(latitude, longitude, np.full(len(latitude), self._profile.site.altitude_m))
                yield self._message("mission", self._path(stamp_ns, ned_m[:, :2].tolist()), stamp_ns)
            return
        if kind == dialect.MAVLINK_MSG_ID_XITL_IMU:
            self._attitude.turned(message.time_usec * 1000, message.gyro)
        for name, part, measured, measured_ns in sensors.messages(message, self._attitude):
            topic = self._named[name].of(part) if part else self._named[name]
            yield RosMessage(topic, self.name, serialize(measured), measured_ns)

    def _answer(self, payload: bytes, stamp_ns: int) -> Iterable[RosMessage]:
        message = read_frame(payload, _ANSWERS)
        if message is None:
            return
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            if message.autopilot == dialect.MAV_AUTOPILOT_INVALID:
                return
            armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
            mode = mode_name(message.custom_mode, message.autopilot == dialect.MAV_AUTOPILOT_PX4)
            if mode != self._mode:
                self._mode = mode
                yield self._message("mode", msg.String(data=mode), stamp_ns)
            if armed is not self._armed:
                self._armed = armed
                yield self._message("armed", msg.Bool(data=armed), stamp_ns)
        elif (battery := instruments.battery(message, msg.header(stamp_ns, ""))) is not None:
            yield self._message("battery", battery, stamp_ns)

    # Pieces

    def _framed(self, frame: str) -> str:
        return frame_name(frame, self.name)

    def _message(self, topic: str, message: Any, stamp_ns: int) -> RosMessage:
        named = self._named[topic]
        return RosMessage(named, "" if named.of_all else self.name, serialize(message), stamp_ns)

    def _moved(self, stamp_ns: int, pose: Any, origin_map_m: Array | None = None) -> RosMessage:
        """Return `odom` → `base_link`, and `map` → `odom` if it moves.

        origin_map_m: position of `odom` in `map` (3,).
        """
        place = pose.position
        transform = msg.TransformStamped(
            header=msg.header(stamp_ns, self._framed(ODOM_FRAME)),
            child_frame_id=self._framed(VESSEL_FRAME),
            transform=msg.Transform(translation=msg.Vector3(place.x, place.y, place.z), rotation=pose.orientation),
        )
        transforms = [transform]
        if origin_map_m is not None:
            odom = FixedFrame(MAP_FRAME, ODOM_FRAME, (origin_map_m[0], origin_map_m[1], origin_map_m[2]))
            transforms.append(_transform(named_frame(odom, self.name), stamp_ns))
        return self._message("/tf", msg.TFMessage(transforms=transforms), stamp_ns)

    def _path(self, stamp_ns: int, places_ne_m: Iterable[tuple[float, float]]) -> Any:
        """Return a nav_msgs/Path: each place with the heading of the path toward it."""
        header, poses = msg.header(stamp_ns, MAP_FRAME), []
        before: tuple[float, float] | None = None
        for north_m, east_m in places_ne_m:
            yaw_rad = 0.0 if before is None else math.atan2(north_m - before[0], east_m - before[1])
            turn = msg.Quaternion(0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad))
            poses.append(msg.PoseStamped(header=header, pose=msg.Pose(msg.Point(east_m, north_m, 0.0), turn)))
            before = north_m, east_m
        if len(poses) > 1:
            poses[0].pose.orientation = poses[1].pose.orientation
        return msg.Path(header=header, poses=poses)


class AttitudeCarry:
    """The attitude at the instant of an IMU sample: the newest estimate, propagated by the gyroscope since.

    An estimate arrives after its instant, so the samples since are kept. The computation uses plain floats: numpy takes
    twenty times as long for four numbers, several hundred times a second.
    """

    def __init__(self) -> None:
        self._turn: tuple[float, float, float, float] | None = None  # w x y z, FLU to ENU
        self._at_ns = 0
        self._estimated_ns = 0
        self._gyro: deque[tuple[int, Sequence[float]]] = deque(maxlen=KEPT_GYRO)

    def estimated(self, stamp_ns: int, turn_wxyz: tuple[float, float, float, float]) -> None:
        """Add an estimate. Its instant is not in the future and is later than that of the previous one."""
        self._turn, self._at_ns, self._estimated_ns = turn_wxyz, stamp_ns, stamp_ns
        while self._gyro and self._gyro[0][0] <= stamp_ns:
            self._gyro.popleft()
        for sample_ns, gyro_frd_radps in self._gyro:
            self._carry(sample_ns, gyro_frd_radps)

    def turned(self, stamp_ns: int, gyro_frd_radps: Sequence[float]) -> None:
        """Add a sample (3,) of the gyroscope, for the time up to its instant."""
        self._gyro.append((stamp_ns, gyro_frd_radps))
        self._carry(stamp_ns, gyro_frd_radps)

    def at_sample(self) -> tuple[float, float, float, float] | None:
        """Return w x y z at the newest sample, from FLU to ENU; None without a recent estimate."""
        return None if self._at_ns - self._estimated_ns > STALE_ESTIMATE_NS else self._turn

    def _carry(self, stamp_ns: int, gyro_frd_radps: Sequence[float]) -> None:
        if self._turn is None or stamp_ns <= self._at_ns:
            return
        half_s = 0.5e-9 * (stamp_ns - self._at_ns)
        forward, right, down = gyro_frd_radps
        w, x, y, z = self._turn
        angle = half_s * math.hypot(forward, right, down)
        cosine, sine = math.cos(angle), half_s * (math.sin(angle) / angle if angle else 1.0)
        roll, pitch, yaw = sine * forward, -sine * right, -sine * down
        self._turn, self._at_ns = (
            (
                w * cosine - x * roll - y * pitch - z * yaw,
                w * roll + x * cosine + y * yaw - z * pitch,
                w * pitch - x * yaw + y * cosine + z * roll,
                w * yaw + x * pitch - y * roll + z * cosine,
            ),
            stamp_ns,
        )


class UploadedMission:
    """The places of a mission, from the frames that send it to the autopilot."""

    kinds = frozenset((dialect.MAVLINK_MSG_ID_MISSION_COUNT, dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT))

    def __init__(self) -> None:
        self._expected = 0
        self._places: dict[int, tuple[float, float] | None] = {}

    def handle(self, message: Any) -> list[tuple[float, float]] | None:
        """Return latitudes and longitudes after the last item: home first, then all items with a place."""
        if message.mission_type != dialect.MAV_MISSION_TYPE_MISSION:
            return None
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_COUNT:
            self._expected, self._places = message.count, {}
            return None
        place = (message.x * 1e-7, message.y * 1e-7)
        self._places[message.seq] = place if any(place) else None
        if len(self._places) < self._expected or message.seq + 1 != self._expected:
            return None
        return [place for _, place in sorted(self._places.items()) if place is not None]


_ANSWERS = frozenset((dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_SYS_STATUS))


def _field_cdr(user: UserTopic, payload: bytes) -> bytes | None:
    """Return None for a frame of another message, and if the recorded message lacks the element."""
    assert user.read is not None
    if user.message is not None:
        message = read_frame(payload, frozenset((user.message,)))
    else:
        schema = TOPICS[LINK_NAME.sub(r"/link/{link}/\1", user.of)].schema
        message = deserialize(payload, schema)
    if message is None:
        return None
    try:
        value = user.read(message)
    except (AttributeError, IndexError, TypeError, ValueError):
        return None
    if user.topic.type == msg.Float64MultiArray.__msgtype__:
        layout = msg.MultiArrayLayout(dim=[], data_offset=0)
        return serialize(msg.Float64MultiArray(layout=layout, data=np.array(value, dtype=np.float64)))
    return serialize(ros2_types().types[user.topic.type](data=value))


def read_frame(payload: bytes, kinds: frozenset[int]) -> Any:
    """Return the MAVLink message in a recorded frame, None if its kind is not in `kinds`."""
    (size,) = struct.unpack_from("<I", payload, _HEADER_BYTES + _STAMP.size)
    start = _HEADER_BYTES + _STAMP.size + 4
    frame = payload[start : start + size]
    if len(frame) < _LEAST_FRAME or frame[0] != MAGIC or int.from_bytes(frame[7:10], "little") not in kinds:
        return None
    return codec.decode(frame)


def cloud_data(payload: bytes) -> bytes:
    """Return the packed points of a foxglove.PointCloud."""
    data: bytes = foxglove_type("PointCloud").FromString(payload).data
    return data


def _transform(frame: FixedFrame, stamp_ns: int) -> Any:
    return msg.TransformStamped(
        header=msg.header(stamp_ns, frame.parent),
        child_frame_id=frame.name,
        transform=msg.Transform(translation=msg.Vector3(*frame.position_m), rotation=msg.Quaternion(*frame.turn)),
    )


class ContinuousOdometry:
    """Integrates the velocity of an estimate with jumps of its corrected position.

    The position drifts from that of the estimate without bound, and never jumps. The axes of `odom` are those of `map`.
    """

    def __init__(self) -> None:
        self.origin_map_m: Array = np.zeros(3)
        """Position of `odom` in `map` (3,), ENU; zero at first."""
        self._place_odom_m: Array | None = None
        self._velocity_mps: Array = np.zeros(3)
        self._stamp_ns = 0

    def update(self, stamp_ns: int, place_map_m: Array, velocity_map_mps: Array) -> Array:
        """Return the position in `odom` (3,) at an instant later than the last, from estimates in `map`, both ENU (3,).

        An estimate that is not finite changes nothing.
        """
        last = place_map_m if self._place_odom_m is None else self._place_odom_m
        if not (np.isfinite(place_map_m).all() and np.isfinite(velocity_map_mps).all()):
            return last
        if self._place_odom_m is None:
            place_odom_m = place_map_m
        else:
            dt_s = (stamp_ns - self._stamp_ns) * 1e-9
            place_odom_m = last + 0.5 * dt_s * (self._velocity_mps + velocity_map_mps)
        self._stamp_ns, self._place_odom_m, self._velocity_mps = stamp_ns, place_odom_m, velocity_map_mps
        self.origin_map_m = place_map_m - place_odom_m
        return place_odom_m


def rotated(wxyz: tuple[float, float, float, float], vector: Array) -> Array:
    """Rotate a vector (3,) by a unit quaternion."""
    axis = np.array(wxyz[1:])
    across = 2.0 * np.cross(axis, vector)
    return vector + wxyz[0] * across + np.cross(axis, across)
