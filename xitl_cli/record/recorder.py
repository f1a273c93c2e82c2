"""The recorder: what a run tells it, turned into topics. docs/recording.md is the table of topics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from foxglove import messages
from numpy.typing import NDArray

from sim_core import frames
from sim_core.kinematics import Kinematics
from xitl_cli.record import schemas
from xitl_cli.record.cdr import Field, Layout
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.perception import PerceptionRecorder
from xitl_cli.record.records import (
    ActuatorAge,
    Clock,
    Estimate,
    LinkState,
    Miss,
    MotorCommand,
    NodeState,
    Takeover,
    Task,
)

MAP_FRAME = "map"
VESSEL_FRAME = "base_link"
ESTIMATE_FRAME = "base_link_estimate"
_ZEROS = (0.0,) * 36
_BINS = 16
_NO_BINS = (0,) * _BINS

_Log = messages.LogLevel
_LEVELS = (_Log.Fatal, _Log.Fatal, _Log.Fatal, _Log.Error, _Log.Warning, _Log.Info, _Log.Info, _Log.Debug)


class Recorder:
    """Records into one MCAP file; `links` name the links whose raw frames are kept.

    What is not known is NaN among the numbers and -1 among counts and instants.
    """

    def __init__(self, path: Path, compression: str, motors: int, links: Sequence[str] = ("agent",)) -> None:
        self._file = file = McapFile(path, compression)
        self._state_layout = Layout(("f64", 3), ("f64", 3), ("f64", 3), ("f64", 4), ("f64", 3), ("f64[]", motors))
        self._odometry_layout, self._estimate_layout = (
            Layout(("string", MAP_FRAME), ("string", child), ("f64", 7), ("f64", 36), ("f64", 6), ("f64", 36))
            for child in (VESSEL_FRAME, ESTIMATE_FRAME)
        )
        self._environment_layout = Layout(("f64", 3), ("f64", 3), "f64")
        self._actuators_layout = Layout(("f64[]", motors), "u8", "u8", "f64")
        self._frame_head = Layout("u32")
        self._state = file.ros_channel("/truth/state", "xitl_msgs/msg/VesselState", schemas.VESSEL_STATE)
        self._odometry = file.ros_channel("/truth/odometry", "nav_msgs/msg/Odometry", schemas.ODOMETRY)
        self._estimate = file.ros_channel("/estimate/odometry", "nav_msgs/msg/Odometry", schemas.ODOMETRY)
        self._environment = file.ros_channel("/environment", "xitl_msgs/msg/Environment", schemas.ENVIRONMENT)
        self._actuators = file.ros_channel("/actuators", "xitl_msgs/msg/Actuators", schemas.ACTUATORS)
        self._actuator_ages = file.ros_channel("/actuators/age", "xitl_msgs/msg/ActuatorAge", schemas.ACTUATOR_AGE)
        self._tasks = file.ros_channel("/tasks", "xitl_msgs/msg/Task", schemas.TASK)
        self._misses = file.ros_channel("/misses", "xitl_msgs/msg/Miss", schemas.MISS)
        self._clocks = file.ros_channel("/clocks", "xitl_msgs/msg/Clock", schemas.CLOCK)
        self._links = file.ros_channel("/links", "xitl_msgs/msg/Link", schemas.LINK)
        self._nodes = file.ros_channel("/nodes", "xitl_msgs/msg/Node", schemas.NODE)
        self._bridges = file.ros_channel("/bridge", "xitl_msgs/msg/Bridge", schemas.BRIDGE)
        self._takeovers = file.ros_channel("/takeovers", "xitl_msgs/msg/Takeover", schemas.TAKEOVER)
        self._faults = file.ros_channel("/faults", "xitl_msgs/msg/Fault", schemas.FAULT)
        self._sent, self._received = (
            {
                link: file.ros_channel(f"/link/{link}/{way}", "xitl_msgs/msg/MavlinkFrame", schemas.MAVLINK_FRAME)
                for link in links
            }
            for way in ("tx", "rx")
        )
        self._tf = file.foxglove_channel("/tf", messages.FrameTransforms)
        self._pose = file.foxglove_channel("/truth/pose", messages.PoseInFrame)
        self._fix = file.foxglove_channel("/truth/fix", messages.LocationFix)
        self._scene = file.foxglove_channel("/scene", messages.SceneUpdate)
        self._log = file.foxglove_channel("/log", messages.Log)

    @cached_property
    def perception(self) -> PerceptionRecorder:
        """For what a companion computer sees and says, bodies adrift and contacts."""
        return PerceptionRecorder(self._file, self._transform)

    def truth(self, stamp_ns: int, motion: Kinematics, rotor: NDArray[np.float64]) -> None:
        """The true state of the first vessel: state, odometry, pose and transform."""
        gyro_frd = motion.gyro_frd_radps[0]
        self._state(
            self._state_layout.pack(
                stamp_ns,
                *motion.pos_ned_m[0].tolist(),
                *motion.vel_ned_mps[0].tolist(),
                *motion.acc_ned_mps2[0].tolist(),
                *motion.quat_ned_frd[0].tolist(),
                *gyro_frd.tolist(),
                *rotor[0].tolist(),
            ),
            stamp_ns,
        )
        position, attitude = motion.pos_ned_m[0], motion.quat_ned_frd[0]
        payload, (x, y, z), (qw, qx, qy, qz) = self._odometry_payload(
            self._odometry_layout,
            stamp_ns,
            position,
            motion.vel_ned_mps[0] @ motion.rot_ned_frd[0],
            attitude,
            gyro_frd,
        )
        self._odometry(payload, stamp_ns)
        stamp = _timestamp(stamp_ns)
        translation = messages.Vector3(x=x, y=y, z=z)
        rotation = messages.Quaternion(x=qx, y=qy, z=qz, w=qw)
        self._pose(
            messages.PoseInFrame(
                timestamp=stamp, frame_id=MAP_FRAME, pose=messages.Pose(position=translation, orientation=rotation)
            ),
            stamp_ns,
        )
        self._transform(stamp_ns, VESSEL_FRAME, translation, rotation)

    def fix(self, stamp_ns: int, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        """The true place on the map."""
        fix = messages.LocationFix(
            timestamp=_timestamp(stamp_ns), frame_id=VESSEL_FRAME, latitude=lat_deg, longitude=lon_deg, altitude=alt_m
        )
        self._fix(fix, stamp_ns)

    def environment(
        self, stamp_ns: int, current_ned_mps: NDArray[np.float64], wind_ned_mps: NDArray[np.float64], surface_m: float
    ) -> None:
        """What surrounds the first vessel."""
        payload = self._environment_layout.pack(stamp_ns, *current_ned_mps.tolist(), *wind_ned_mps.tolist(), surface_m)
        self._environment(payload, stamp_ns)

    def estimate(self, stamp_ns: int, estimate: Estimate) -> None:
        """What the autopilot believes, at the instant its belief arrived."""
        payload, (x, y, z), (qw, qx, qy, qz) = self._odometry_payload(
            self._estimate_layout,
            stamp_ns,
            estimate.pos_ned_m,
            estimate.vel_ned_mps @ frames.quat_to_matrix(estimate.quat_ned_frd),
            estimate.quat_ned_frd,
            estimate.gyro_frd_radps,
        )
        self._estimate(payload, stamp_ns)
        self._transform(
            stamp_ns, ESTIMATE_FRAME, messages.Vector3(x=x, y=y, z=z), messages.Quaternion(x=qx, y=qy, z=qz, w=qw)
        )

    def actuators(self, stamp_ns: int, command: MotorCommand) -> None:
        """The motor commands in force."""
        age_s = math.nan if command.age_s is None else command.age_s
        payload = self._actuators_layout.pack(stamp_ns, *command.motors, command.armed, command.failsafe, age_s)
        self._actuators(payload, stamp_ns)

    def actuator_age(self, stamp_ns: int, age: ActuatorAge) -> None:
        """How old the motor commands in use were so far."""
        payload = _layout("u32", "u32", "u32", ("f64", 3)).pack(
            stamp_ns,
            age.exchanges,
            age.stale,
            age.longest_stale,
            *_numbers(age.age_p50_s, age.age_p99_s, age.age_max_s),
        )
        self._actuator_ages(payload, stamp_ns)

    def frame_sent(self, stamp_ns: int, frame: bytes, link: str = "agent") -> None:
        """A raw MAVLink frame from host to agent."""
        self._sent[link](self._frame_head.pack(stamp_ns, len(frame)) + frame, stamp_ns)

    def frame_received(self, stamp_ns: int, frame: bytes, sent_ns: int | None = None, link: str = "agent") -> None:
        """A raw MAVLink frame from agent to host; `sent_ns` is when the agent says it sent it, in simulation time."""
        self._received[link](self._frame_head.pack(stamp_ns, len(frame)) + frame, stamp_ns, sent_ns)

    def task(self, stamp_ns: int, task: Task) -> None:
        """How a periodic task kept its deadlines so far."""
        layout = _layout(
            ("string", task.node),
            ("string", task.task),
            *("f64", "u32", "u32", "f64", "f64", "f64"),
            *("u32", "f64", "i64", "i64", ("u32", _BINS), ("u32", _BINS)),
        )
        payload = layout.pack(
            stamp_ns,
            task.rate_hz,
            task.cycles,
            task.missed,
            task.start_jitter_max_s,
            task.run_mean_s,
            task.run_max_s,
            task.skipped,
            task.start_jitter_mean_s,
            *_counts(task.worst_run_ns, task.worst_start_ns),
            *(task.start_histogram or _NO_BINS),
            *(task.run_histogram or _NO_BINS),
        )
        self._tasks(payload, stamp_ns)

    def miss(self, stamp_ns: int, miss: Miss) -> None:
        """One deadline that was missed."""
        layout = _layout(("string", miss.node), ("string", miss.task), "u32", ("i64", 3), "u32")
        payload = layout.pack(stamp_ns, miss.cycle, miss.due_ns, miss.start_ns, miss.end_ns, miss.skipped)
        self._misses(payload, stamp_ns)

    def clock(self, stamp_ns: int, clock: Clock) -> None:
        """One exchange of time stamps with a node."""
        layout = _layout(("string", clock.node), "u32", "i64", "i64", ("f64", 6), "u32")
        payload = layout.pack(
            stamp_ns,
            clock.sample,
            clock.host_ns,
            clock.node_ns,
            clock.round_trip_s,
            clock.offset_s,
            clock.drift_ppm,
            *_numbers(clock.residual_s, clock.path_delay_s, clock.asymmetry_bound_s),
            clock.steps,
        )
        self._clocks(payload, stamp_ns)

    def link(self, stamp_ns: int, state: LinkState) -> None:
        """One direction of a link so far."""
        payload = _layout(("string", state.name), ("i64", 10), ("f64", 3)).pack(
            stamp_ns,
            *_counts(state.sent, state.received, state.lost, state.gaps, state.late, state.repeated),
            *_counts(state.dropped, state.unsent, state.refused, state.impaired),
            *_numbers(state.latency_p50_s, state.latency_p99_s, state.latency_max_s),
        )
        self._links(payload, stamp_ns)

    def node(self, stamp_ns: int, state: NodeState) -> None:
        """How a machine in the loop is."""
        texts = (state.node, state.nodes, state.kind, state.machine, state.kernel, state.version)
        layout = _layout(*(("string", text) for text in texts), ("f64", 4), "u8", ("string", state.flags))
        numbers = _numbers(state.memory_mib, state.cpu_percent, state.load, state.temperature_c)
        self._nodes(layout.pack(stamp_ns, *numbers, state.running), stamp_ns)

    def bridge(self, stamp_ns: int, counts: Mapping[str, int]) -> None:
        """What a bridge to another autopilot has done, by the names of `schemas.BRIDGE_COUNTS`."""
        values = [counts[name] for name in schemas.BRIDGE_COUNTS]
        self._bridges(_layout(("i64", len(values))).pack(stamp_ns, *values), stamp_ns)

    def takeover(self, stamp_ns: int, takeover: Takeover) -> None:
        """One agent stepped in for another."""
        layout = _layout(("string", takeover.from_node), ("string", takeover.to_node), "f64", "f64")
        self._takeovers(layout.pack(stamp_ns, takeover.silent_s, takeover.step), stamp_ns)

    def fault(self, stamp_ns: int, fault: str, active: bool) -> None:
        """A fault on purpose comes into force or ends."""
        self._faults(_layout(("string", fault), "u8").pack(stamp_ns, active), stamp_ns)

    def say(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        """A sentence from a node; `severity` is MAV_SEVERITY."""
        level = _LEVELS[min(max(severity, 0), 7)]
        entry = messages.Log(timestamp=_timestamp(stamp_ns), level=level, name=source, message=text)
        self._log(entry, stamp_ns)

    def scene(self, update: messages.SceneUpdate, stamp_ns: int = 0) -> None:
        """Surroundings to draw, once, from an instant on."""
        self._scene(update, stamp_ns)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Keep a file inside the recording."""
        self._file.attach(name, media_type, data)

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Keep named texts inside the recording."""
        self._file.metadata(name, values)

    def flush_if_due(self) -> None:
        """Hand what was recorded to the operating system about once a second."""
        self._file.flush_if_due()

    def close(self) -> None:
        """Write the index and close."""
        self._file.close()

    def _transform(
        self, stamp_ns: int, child: str, translation: messages.Vector3, rotation: messages.Quaternion
    ) -> None:
        transform = messages.FrameTransform(
            timestamp=_timestamp(stamp_ns),
            parent_frame_id=MAP_FRAME,
            child_frame_id=child,
            translation=translation,
            rotation=rotation,
        )
        self._tf(messages.FrameTransforms(transforms=[transform]), stamp_ns)

    @staticmethod
    def _odometry_payload(
        layout: Layout,
        stamp_ns: int,
        pos_ned_m: NDArray[np.float64],
        vel_frd_mps: NDArray[np.float64],
        quat_ned_frd: NDArray[np.float64],
        gyro_frd_radps: NDArray[np.float64],
    ) -> tuple[bytes, list[float], list[float]]:
        """nav_msgs/Odometry in ENU with a FLU body, as REP 103 asks; twist in the body frame."""
        position = frames.ned_to_enu(pos_ned_m).tolist()
        w, x, y, z = attitude = frames.quat_ned_frd_to_enu_flu(quat_ned_frd).tolist()
        linear = frames.frd_to_flu(vel_frd_mps).tolist()
        angular = frames.frd_to_flu(gyro_frd_radps).tolist()
        payload = layout.pack(stamp_ns, *position, x, y, z, w, *_ZEROS, *linear, *angular, *_ZEROS)
        return payload, position, attitude


def _timestamp(stamp_ns: int) -> messages.Timestamp:
    return messages.Timestamp(*divmod(stamp_ns, 1_000_000_000))


@lru_cache(maxsize=256)
def _layout(*fields: Field) -> Layout:
    return Layout(*fields)


def _numbers(*values: float | None) -> list[float]:
    return [math.nan if value is None else value for value in values]


def _counts(*values: int | None) -> list[int]:
    return [-1 if value is None else value for value in values]
