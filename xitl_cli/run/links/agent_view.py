"""The host's view of an agent, from the messages that the agent sends."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.mavlink.commands import StatusTextReceiver
from agent.mavlink.exchange import HEADING_DEVIATION, text_of
from agent.mavlink.modes import mode_name, shown_mode
from agent.wire import dialect
from sim_core.frames import Array
from sim_core.geodesy import GeodeticPoint, LocalFrame, ardupilot_geodetic
from xitl_cli.record.topics import MotionEstimate, TaskMissEvent, TaskTiming

ORIGIN_SET = "origin set"  # text of ArduPilot
RECENT_TEXTS = 20
MISSION_COMPLETE = 5  # MISSION_STATE_COMPLETE of MISSION_CURRENT
SUBSYSTEMS = {
    0x1: "gyroscope",
    0x2: "accelerometer",
    0x4: "magnetometer",
    0x8: "barometer",
    0x20: "GNSS",
    0x800: "attitude",
    0x1000: "heading",
    0x2000: "height",
    0x4000: "position",
    0x200000: "estimator",
    0x2000000: "battery",
}
"""Subsystems that an autopilot needs at sea, by their bit of SYS_STATUS (MAV_SYS_STATUS_SENSOR)."""


STARTING = (dialect.MAV_STATE_BOOT, dialect.MAV_STATE_CALIBRATING)
"""MAV_STATE_UNINIT is not included: it means "state is unknown", and simple vehicles always send it."""

PREARM = ("PreArm: ", "Arm: ", "Preflight Fail: ")
"""Prefixes of reasons that prevent arming, of ArduPilot and PX4."""


class AgentView:
    """Handles every message and keeps the latest relevant values.

    It calls `on_text(severity, text)` and `on_estimate(agent_us, estimate)` for each text and estimate. `node`: name
    for its tasks. `sim_ns(agent_us)`: returns the simulation time of an instant on the agent's clock, None while
    unknown. heard: a heartbeat of the autopilot has arrived. px4: the autopilot is a PX4. starting: it boots or
    calibrates. has_origin: its estimator has an origin. unhealthy: its enabled subsystems that are not healthy.
    guided_ne_m: the latest target of GUIDED from the host, north and east, until the mode leaves GUIDED.
    desired_heading_deg: the latest heading that the autopilot steers for, until the mode changes. pair_ms:
    largest time between a position and an attitude of one estimate. sphere_metres: its local position is in ArduPilot's
    metres, about an origin on the real Earth.
    """

    def __init__(
        self,
        frame: LocalFrame,
        on_text: Callable[[int, str], None],
        on_estimate: Callable[[int, MotionEstimate], None],
        node: str = "LC",
        sim_ns: Callable[[int], int | None] = lambda agent_us: None,
    ) -> None:
        self.status: Any = None
        self.info: Any = None
        self.pair_ms = 0
        self.sphere_metres = False
        self.heard = False
        self.px4 = False
        self.starting = False
        self.has_origin = False
        self.mode = "–"
        self.armed = False
        self.ready_to_arm = False
        self.unhealthy: tuple[str, ...] = ()
        self.target_seq: int | None = None
        self.guided_ne_m: tuple[float, float] | None = None
        self.desired_heading_deg: float | None = None
        self.reached_seqs: set[int] = set()
        self.mission_complete = False
        self.acks: dict[int, int] = {}
        self.tasks: dict[str, TaskTiming] = {}
        self.texts: deque[str] = deque(maxlen=RECENT_TEXTS)
        self._frame = frame
        self._node = node
        self._sim_ns = sim_ns
        self._text = StatusTextReceiver()
        self._on_text = on_text
        self._on_estimate = on_estimate
        self._origin: GeodeticPoint | None = None
        self._origin_ned_m: Array = np.zeros((1, 3))
        self._deviation_ned_m: Array | None = None
        self._yaw_deviation_rad: float | None = None
        self._attitude: Any = None
        self._unpaired: Any = None  # a position that waits for the next attitude
        self._handlers: dict[int, Callable[[Any], object]] = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            dialect.MAVLINK_MSG_ID_STATUSTEXT: self._statustext,
            dialect.MAVLINK_MSG_ID_COMMAND_ACK: self._command_ack,
            dialect.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            dialect.MAVLINK_MSG_ID_MISSION_ITEM_REACHED: self._mission_item_reached,
            dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._global_origin,
            dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude_quaternion,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._nav_controller_output,
            dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._estimator_status,
            dialect.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: self._named_value,
            dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS: self._node_status,
            dialect.MAVLINK_MSG_ID_XITL_NODE_INFO: self._node_info,
            dialect.MAVLINK_MSG_ID_XITL_TASK_STATS: self.task,
        }

    def handle(self, message: Any) -> None:
        """Handle one message; ignore unknown kinds."""
        handler = self._handlers.get(message.get_msgId())
        if handler is not None:
            handler(message)

    def adopt(self, other: AgentView) -> None:
        """Take over the state of another agent that now steers with the same mission.

        Reached items of both are kept.
        """
        self.status, self.info = other.status, other.info
        self._change_mode(other.mode)
        self.armed, self.ready_to_arm = other.armed, other.ready_to_arm
        self.target_seq, self.mission_complete = other.target_seq, other.mission_complete
        self.reached_seqs |= other.reached_seqs
        self.acks |= other.acks

    def guide(self, lat_deg: float, lon_deg: float) -> None:
        """Keep the place that the host has sent as the target of GUIDED."""
        north_m, east_m, _ = self._frame.ned(np.array([lat_deg]), np.array([lon_deg]), np.zeros(1))[0].tolist()
        self.guided_ne_m = north_m, east_m

    def guided_target_ne_m(self) -> tuple[float, float] | None:
        """Target of the autopilot in GUIDED, north and east. None in other modes and without a target."""
        return self.guided_ne_m if self.mode == shown_mode("GUIDED", self.px4) else None

    def _heartbeat(self, message: Any) -> None:
        self.heard = True
        self.armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self.px4 = message.autopilot == dialect.MAV_AUTOPILOT_PX4
        self.starting = message.system_status in STARTING
        self._change_mode(mode_name(message.custom_mode, self.px4))

    def _change_mode(self, mode: str) -> None:
        guided = shown_mode("GUIDED", self.px4)
        if self.mode == guided and mode != guided:
            self.guided_ne_m = None
        if self.mode != mode:
            self.desired_heading_deg = None
        self.mode = mode

    def _sys_status(self, message: Any) -> None:
        self.ready_to_arm = bool(message.onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK)
        bad = message.onboard_control_sensors_enabled & ~message.onboard_control_sensors_health
        self.unhealthy = tuple(name for bit, name in SUBSYSTEMS.items() if bad & bit)

    def _statustext(self, message: Any) -> None:
        text = self._text.handle(message)
        if text is None:
            return
        self.texts.append(text)
        if text.endswith(ORIGIN_SET):
            self.has_origin = True
        self._on_text(message.severity, text)

    def why_not_armed(self) -> str:
        """Return the reasons that prevent arming, each once, as the end of a sentence.

        Without reasons, return the last text and the unhealthy subsystems; empty without either.
        """
        reasons = list(dict.fromkeys(text for text in self.texts if text.startswith(PREARM)))
        why = f"; it said: {', '.join(reasons or [self.texts[-1]])}" if self.texts else ""
        return why if reasons or not self.unhealthy else f"{why}; not healthy: {', '.join(self.unhealthy)}"

    def _command_ack(self, message: Any) -> None:
        self.acks[message.command] = message.result

    def _mission_current(self, message: Any) -> None:
        self.target_seq = message.seq
        self.mission_complete = getattr(message, "mission_state", 0) == MISSION_COMPLETE

    def _mission_item_reached(self, message: Any) -> None:
        self.reached_seqs.add(message.seq)

    def _global_origin(self, message: Any) -> None:
        self._origin = (message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
        self._origin_ned_m = self._frame.ned(*np.array([self._origin]).T)
        self.has_origin = True

    def _attitude_quaternion(self, message: Any) -> None:
        self._attitude = message
        position, self._unpaired = self._unpaired, None
        if position is not None and abs(message.time_boot_ms - position.time_boot_ms) <= self.pair_ms:
            self._estimated(position, message)

    def _local_position(self, message: Any) -> None:
        """Combine the position with the previous attitude or, if that is too old, with the next one."""
        attitude = self._attitude
        if attitude is not None and 0 <= message.time_boot_ms - attitude.time_boot_ms <= self.pair_ms:
            self._estimated(message, attitude)
        elif self.pair_ms:
            self._unpaired = message

    def _estimator_status(self, message: Any) -> None:
        """Store the standard deviations. The reported horizontal accuracy is that of both axes together."""
        axis_m = message.pos_horiz_accuracy / math.sqrt(2.0)
        self._deviation_ned_m = np.array([axis_m, axis_m, message.pos_vert_accuracy])

    def _nav_controller_output(self, message: Any) -> None:
        # Rover sends zeros in modes without a target
        steered = message.nav_bearing or message.wp_dist
        self.desired_heading_deg = message.nav_bearing % 360.0 if steered else None

    def _named_value(self, message: Any) -> None:
        """Store the standard deviation of the heading, which the embedded autopilot sends."""
        if text_of(message.name) == HEADING_DEVIATION:
            self._yaw_deviation_rad = message.value

    def _estimated(self, message: Any, attitude: Any) -> None:
        if self._origin is None:
            return
        estimate = MotionEstimate(
            pos_ned_m=self._ned(self._origin, np.array([[message.x, message.y, message.z]]))[0],
            vel_ned_mps=np.array([message.vx, message.vy, message.vz]),
            quat_ned_frd=np.array([attitude.q1, attitude.q2, attitude.q3, attitude.q4]),
            gyro_frd_radps=np.array([attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed]),
            pos_deviation_ned_m=self._deviation_ned_m,
            yaw_deviation_rad=self._yaw_deviation_rad,
        )
        self._on_estimate(message.time_boot_ms * 1000, estimate)

    def _ned(self, origin: GeodeticPoint, about_origin_m: Array) -> Array:
        if self.sphere_metres:
            return self._frame.ned(*ardupilot_geodetic(origin, about_origin_m).T)
        return self._origin_ned_m + about_origin_m

    def _node_status(self, message: Any) -> None:
        self.status = message

    def _node_info(self, message: Any) -> None:
        self.info = message

    def task(self, message: Any) -> TaskTiming:
        """Return XITL_TASK_STATS as a record, and keep it."""
        name = text_of(message.task)
        cycles = message.cycles > 0
        self.tasks[name] = task = TaskTiming(
            node=self._node,
            task=name,
            rate_hz=message.rate_hz,
            cycles=message.cycles,
            missed=message.missed,
            start_jitter_max_s=message.start_jitter_max_usec * 1e-6,
            run_mean_s=message.run_mean_usec * 1e-6,
            run_max_s=message.run_max_usec * 1e-6,
            skipped=message.skipped,
            start_jitter_mean_s=message.start_jitter_mean_usec * 1e-6,
            worst_run_ns=self._sim_ns(message.worst_run_time_usec) if cycles else None,
            worst_start_ns=self._sim_ns(message.worst_start_time_usec) if cycles else None,
            start_histogram=tuple(message.start_jitter_histogram),
            run_histogram=tuple(message.run_histogram),
        )
        return task

    def miss(self, message: Any) -> TaskMissEvent | None:
        """Return XITL_TASK_MISS as a record, or None while its instants have no simulation time."""
        due_ns, start_ns, end_ns = map(self._sim_ns, (message.due_usec, message.start_usec, message.end_usec))
        if due_ns is None or start_ns is None or end_ns is None:
            return None
        return TaskMissEvent(
            self._node, text_of(message.task), message.cycle, due_ns, start_ns, end_ns, message.skipped
        )
