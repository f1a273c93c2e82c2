"""The recorder: what a run tells it, turned into topics. docs/recording.md is the table of topics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from foxglove import messages
from numpy.typing import NDArray

from sim_core import frames
from sim_core.kinematics import Kinematics
from xitl_cli.recording import schemas
from xitl_cli.recording.cdr import Layout
from xitl_cli.recording.mcap_file import McapFile
from xitl_cli.recording.records import Clock, Estimate, MotorCommand, Task

MAP_FRAME = "map"
VESSEL_FRAME = "base_link"
ESTIMATE_FRAME = "base_link_estimate"
_ZEROS = (0.0,) * 36

_Log = messages.LogLevel
_LEVELS = (_Log.Fatal, _Log.Fatal, _Log.Fatal, _Log.Error, _Log.Warning, _Log.Info, _Log.Info, _Log.Debug)


class Recorder:
    """Records into one MCAP file; `link` names the link whose raw frames are kept."""

    def __init__(self, path: Path, compression: str, motors: int, link: str = "agent") -> None:
        self._file = file = McapFile(path, compression)
        self._state_layout = Layout(("f64", 3), ("f64", 3), ("f64", 3), ("f64", 4), ("f64", 3), ("f64[]", motors))
        self._odometry_layout, self._estimate_layout = (
            Layout(("string", MAP_FRAME), ("string", child), ("f64", 7), ("f64", 36), ("f64", 6), ("f64", 36))
            for child in (VESSEL_FRAME, ESTIMATE_FRAME)
        )
        self._environment_layout = Layout(("f64", 3), ("f64", 3), "f64")
        self._actuators_layout = Layout(("f64[]", motors), "u8", "u8", "f64")
        self._task_layouts: dict[tuple[str, str], Layout] = {}
        self._clock_layouts: dict[str, Layout] = {}
        self._frame_head = Layout("u32")
        self._state = file.ros_channel("/truth/state", "xitl_msgs/msg/VesselState", schemas.VESSEL_STATE)
        self._odometry = file.ros_channel("/truth/odometry", "nav_msgs/msg/Odometry", schemas.ODOMETRY)
        self._estimate = file.ros_channel("/estimate/odometry", "nav_msgs/msg/Odometry", schemas.ODOMETRY)
        self._environment = file.ros_channel("/environment", "xitl_msgs/msg/Environment", schemas.ENVIRONMENT)
        self._actuators = file.ros_channel("/actuators", "xitl_msgs/msg/Actuators", schemas.ACTUATORS)
        self._tasks = file.ros_channel("/tasks", "xitl_msgs/msg/Task", schemas.TASK)
        self._clocks = file.ros_channel("/clocks", "xitl_msgs/msg/Clock", schemas.CLOCK)
        self._sent = file.ros_channel(f"/link/{link}/tx", "xitl_msgs/msg/MavlinkFrame", schemas.MAVLINK_FRAME)
        self._received = file.ros_channel(f"/link/{link}/rx", "xitl_msgs/msg/MavlinkFrame", schemas.MAVLINK_FRAME)
        self._tf = file.foxglove_channel("/tf", messages.FrameTransforms)
        self._pose = file.foxglove_channel("/truth/pose", messages.PoseInFrame)
        self._fix = file.foxglove_channel("/truth/fix", messages.LocationFix)
        self._scene = file.foxglove_channel("/scene", messages.SceneUpdate)
        self._log = file.foxglove_channel("/log", messages.Log)

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
        payload = self._actuators_layout.pack(stamp_ns, *command.motors, command.armed, command.failsafe, command.age_s)
        self._actuators(payload, stamp_ns)

    def frame_sent(self, stamp_ns: int, frame: bytes) -> None:
        """A raw MAVLink frame from host to agent."""
        self._sent(self._frame_head.pack(stamp_ns, len(frame)) + frame, stamp_ns)

    def frame_received(self, stamp_ns: int, frame: bytes) -> None:
        """A raw MAVLink frame from agent to host."""
        self._received(self._frame_head.pack(stamp_ns, len(frame)) + frame, stamp_ns)

    def task(self, stamp_ns: int, task: Task) -> None:
        """How a periodic task kept its deadlines so far."""
        layout = self._task_layouts.setdefault(
            (task.node, task.task),
            Layout(("string", task.node), ("string", task.task), "f64", "u32", "u32", "f64", "f64", "f64"),
        )
        payload = layout.pack(
            stamp_ns,
            task.rate_hz,
            task.cycles,
            task.missed,
            task.start_jitter_max_s,
            task.run_mean_s,
            task.run_max_s,
        )
        self._tasks(payload, stamp_ns)

    def clock(self, stamp_ns: int, clock: Clock) -> None:
        """One exchange of time stamps with a node."""
        layout = self._clock_layouts.setdefault(
            clock.node, Layout(("string", clock.node), "u32", "i64", "i64", "f64", "f64", "f64")
        )
        payload = layout.pack(
            stamp_ns,
            clock.sample,
            clock.host_ns,
            clock.node_ns,
            clock.round_trip_s,
            clock.offset_s,
            clock.drift_ppm,
        )
        self._clocks(payload, stamp_ns)

    def say(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        """A sentence from a node; `severity` is MAV_SEVERITY."""
        level = _LEVELS[min(max(severity, 0), 7)]
        entry = messages.Log(timestamp=_timestamp(stamp_ns), level=level, name=source, message=text)
        self._log(entry, stamp_ns)

    def scene(self, update: messages.SceneUpdate) -> None:
        """The surroundings to draw, once."""
        self._scene(update, 0)

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
