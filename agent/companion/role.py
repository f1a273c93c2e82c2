"""Companion role with the functions HS, HC and HA: perception, map and obstacle avoidance on a companion computer.

Without numpy, it reports that, keeps time and sends its status only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Callable

from agent.companion.settings import CompanionParameters
from agent.mavlink.commands import StatusTextSender
from agent.roles.role import Role, Traffic
from agent.timing.clock import Clock
from agent.timing.tasks import Executor
from agent.wire import dialect
from agent.wire.codec import Message

if TYPE_CHECKING:
    from agent.companion.perception import Perception

WATCH_HZ = 10.0
PERCEIVE_HZ = 25.0
PLAN_HZ = 5.0
TELL_HZ = 2.0
HEARTBEAT_NS = 1_000_000_000
SILENCE_S = 1.0
_WARNING, _NOTICE = dialect.MAV_SEVERITY_WARNING, dialect.MAV_SEVERITY_NOTICE
_SENSORS = (
    dialect.MAVLink_xitl_cloud_message,
    dialect.MAVLink_xitl_ping_message,
    dialect.MAVLink_xitl_detection_message,
)
_COMMANDS = (
    dialect.MAVLink_command_long_message,
    dialect.MAVLink_set_position_target_local_ned_message,
    dialect.MAVLink_set_position_target_global_int_message,
)


class CompanionRole(Role):
    """Sends heartbeats of an onboard controller, events when the host falls silent or returns, and its perceptions.

    Perception begins with the first cloud, ping or detection, with the settings of that instant.
    """

    title = "companion"
    nodes = "HS,HC,HA"
    telemetry_hz = WATCH_HZ

    def __init__(self) -> None:
        self._texts = StatusTextSender()
        self._settings = CompanionParameters(lambda problem: self.add_event(_WARNING, problem))

    def reset(self, clock: Clock, lockstep: bool) -> None:
        self._clock = clock
        self._lockstep = lockstep
        self._beat_ns: int | None = None
        self._silent = False
        self._waiting: list[Message] = []
        self._perception: Perception | None = None
        self._unavailable = False
        self._commands_sent = 0

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        self._silent_s = silent_s
        executor.add("watch", WATCH_HZ, self._watch)
        executor.add("perceive", PERCEIVE_HZ, self._perceive)
        executor.add("plan", PLAN_HZ, self._plan)
        executor.add("tell", TELL_HZ, self._tell)

    def handle(self, message: Message, now_ns: int) -> Sequence[Message]:
        answers = self._settings.handle(message)
        perception = self._perception
        if perception is None:
            kind = type(message)
            if self._unavailable or kind not in _SENSORS:
                return answers
            perception = self._perception = self._start_perception()
            if perception is None:
                return answers
        if not perception.handle(message, now_ns):
            answers += perception.avoidance.handle(message, now_ns)
        return answers

    def _start_perception(self) -> Perception | None:
        try:
            from agent.companion.obstacle_avoidance import ObstacleAvoidance
            from agent.companion.perception import Perception
        except ImportError as error:
            self._unavailable = True
            self.add_event(_WARNING, f"No perception: {error}; pip install 'numpy>=1.21' kiss-icp")
            return None
        settings = self._settings
        avoidance = ObstacleAvoidance(
            margin_m=settings["AVD_MARGIN"],
            horizon_s=settings["AVD_HORIZON"],
            speed_mps=settings["WP_SPEED"],
            length_m=settings["HULL_LENGTH"],
            width_m=settings["HULL_WIDTH"],
            waterline_m=settings["HULL_WATER"],
            range_m=settings["AVD_RANGE"],
            avoids=bool(settings["AVD_ENABLE"]),
            vessels=bool(settings["AVD_VESSELS"]),
            view_yaw_rad=math.radians(settings["LIDAR_YAW"]),
        )
        return Perception(settings, avoidance, self._lockstep, lambda text: self.add_event(_WARNING, text))

    def _watch(self, now_ns: int) -> None:
        silent = self._silent_s() > SILENCE_S
        if silent != self._silent:
            self._silent = silent
            self.add_event(_NOTICE, "Host is silent" if silent else "Host is back")

    def _perceive(self, now_ns: int) -> None:
        if self._perception is not None:
            self._waiting += self._perception.process(self._clock.now_ns)

    def _plan(self, now_ns: int) -> None:
        if self._perception is not None:
            avoidance = self._perception.avoidance
            messages = avoidance.plan(now_ns)
            self._commands_sent += sum(type(message) in _COMMANDS for message in messages)
            self._waiting += messages
            self._waiting += avoidance.proximity_messages(now_ns)

    def _tell(self, now_ns: int) -> None:
        if self._perception is not None:
            self._waiting += self._perception.avoidance.obstacle_messages(now_ns)
            self._waiting.append(self._perception.status(now_ns))

    @property
    def traffic(self) -> Traffic:
        """Traffic. Estimates: clouds passed from sensing to control. Efforts: commands sent to the autopilot."""
        if self._perception is None:
            return Traffic()
        return Traffic(estimates=self._perception.clouds, efforts=self._commands_sent)

    def add_event(self, severity: int, text: str) -> None:
        self._waiting.extend(self._texts.messages(severity, text))

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        due, self._waiting = self._waiting, []
        if self._beat_ns is None or now_ns - self._beat_ns >= HEARTBEAT_NS:
            self._beat_ns = now_ns
            due.append(
                dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                    dialect.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    dialect.MAV_STATE_ACTIVE,
                    3,
                )
            )
        return due

    def end_tick(self, tick: int, now_ns: int) -> Sequence[Message]:
        return (dialect.MAVLink_xitl_tick_message(now_ns // 1000, tick),)

    def end_run(self, now_ns: int) -> Sequence[Message]:
        return () if self._perception is None else (self._perception.status(now_ns),)
