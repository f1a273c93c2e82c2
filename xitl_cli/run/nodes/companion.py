"""The companion computer of a run, or ROS nodes in its place: exchanges, and messages to and from the autopilot."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import field
from functools import partial
from typing import Any

from agent import __version__
from agent.wire import dialect
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from agent.wire.link import Link
from agent.wire.signing import Signing
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from sim_core.vessel.floating import floating_pose
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import CompanionSpec
from xitl_cli.record.topics import DETECTIONS, CameraDetection
from xitl_cli.run.core.node import ExchangePart, RunContext, RunNode, RunStep
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.links.connection import (
    AgentConnection,
    StoppedWaitingError,
    companion_terms,
    connections_report,
)
from xitl_cli.run.links.inbox import AgentInbox, MessageRoute
from xitl_cli.run.links.link_accounts import agent_traffic
from xitl_cli.run.links.peer import AgentOptions, open_peer
from xitl_cli.run.world.world import local_frame
from xitl_cli.signing import read_key_file


def _ids(*names: str) -> frozenset[int]:
    return frozenset(getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names)


TO_COMPANION = _ids(
    *("HEARTBEAT", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"),
    *("GPS_GLOBAL_ORIGIN", "HOME_POSITION", "COMMAND_ACK", "POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT"),
    *("MISSION_CURRENT", "MISSION_ITEM_REACHED", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"),
)
TO_AUTOPILOT = _ids(
    *("COMMAND_LONG", "COMMAND_INT", "SET_MODE", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"),
    *("MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_REQUEST", "OBSTACLE_DISTANCE", "DISTANCE_SENSOR"),
)
KEPT_ELSEWHERE = _ids("XITL_CLOUD", "XITL_PING", "XITL_DETECTION")
"""Not recorded as frames: they are /lidar/points, /sonar/ping, /cameras/detections and /companion/map."""


def companion_parameters(profile: RunProfile) -> dict[str, float]:
    """Return the values that follow from vessel, lidar and mission, overridden by the profile's values."""
    assert profile.companion is not None
    vessel = profile.vehicle
    water = profile.environment.water
    values = {
        "HULL_LENGTH": vessel.length_m,
        "HULL_WIDTH": vessel.width_m,
        "HULL_WATER": -floating_pose(vessel, water).depth_m,
        "WP_SPEED": profile.mission.speed_mps,
        "AVD_VESSELS": float(bool(profile.vessel)),
    }
    if profile.sensors is not None and profile.sensors.lidar is not None:
        values["LIDAR_YAW"] = profile.sensors.lidar.yaw_deg
    return values | dict(profile.companion.parameters)


COMPANION_LINK = "companion"
MOST_WARNINGS = 8
_TICK = dialect.MAVLINK_MSG_ID_XITL_TICK


@dataclass(slots=True)
class _Batch:
    """Frames and messages up to the answer to a tick."""

    tick: int = -1
    frames: list[bytes] = field(default_factory=list)
    messages: list[Any] = field(default_factory=list)


class CompanionInbox(AgentInbox):
    """The messages of a companion, as AgentInbox. Any message is a sign of life, and a tick is answered with the tick.

    While `holds` is True, messages wait until `release` of the answer that follows them. Their arrival on the wall
    clock then makes no difference. answered_tick: the latest answer that has arrived. warnings: the first few
    sentences, each once, in which the companion or the run reported a problem with it.
    """

    def __init__(
        self, frame: LocalFrame, lockstep: bool, on_message: Callable[[Any], object] = lambda message: None
    ) -> None:
        # A companion has no estimate of the autopilot's kind.
        super().__init__(COMPANION_LINK, frame, 0, lockstep, lambda stamp_ns, estimate: None, on_message)
        self.holds = False
        self.warnings: list[str] = []
        self._handlers[_TICK] = lambda message: None
        self._frames: deque[_Batch] = deque([_Batch()])
        self._messages: deque[_Batch] = deque([_Batch()])

    def handle(self, messages: list[Any]) -> None:
        if messages:
            self.command_ns = time.monotonic_ns()
            self.fresh = True
        if not self.holds:
            super().handle(messages)
            return
        for message in messages:
            self._messages[-1].messages.append(message)
            if message.get_msgId() == _TICK:
                self._messages[-1].tick = message.tick
                self._messages.append(_Batch())
                self.answered_tick = max(self.answered_tick, message.tick)

    def say(self, severity: int, source: str, text: str) -> None:
        if severity <= WARNING and text not in self.warnings and len(self.warnings) < MOST_WARNINGS:
            self.warnings.append(text)
        super().say(severity, source, text)

    def tap(self, direction: str, frame: bytes) -> None:
        if direction == "tx" or not self.holds:
            self._keep(direction, frame)
            return
        self._frames[-1].frames.append(frame)
        if _id_of(frame) == _TICK:
            self._frames.append(_Batch())

    def release(self, tick: int) -> None:
        """Handle all messages up to the answer to `tick`."""
        while self._messages[0].tick >= 0 and self._messages[0].tick <= tick:
            self._handle_batch(self._frames.popleft(), self._messages.popleft())

    def release_all(self) -> None:
        """Stop holding messages, and handle the remaining ones."""
        self.holds = False
        for frames, messages in zip(self._frames, self._messages, strict=True):
            self._handle_batch(frames, messages)
        self._frames, self._messages = deque([_Batch()]), deque([_Batch()])

    def _handle_batch(self, frames: _Batch, messages: _Batch) -> None:
        for frame in frames.frames:
            self._keep("rx", frame)
        super().handle(messages.messages)

    def _keep(self, direction: str, frame: bytes) -> None:
        number = _id_of(frame)
        if number in KEPT_ELSEWHERE:
            counts = self.traffic[direction]
            counts[number] = counts.get(number, 0) + 1
        else:
            super().tap(direction, frame)


def _id_of(frame: bytes) -> int:
    return frame[7] | frame[8] << 8 | frame[9] << 16


REPEAT_S = 0.5
SYNC_EVERY_S = 0.1


class CompanionNode(RunNode):
    """One companion. The run continues without it when it has ended; `gone` then has the reason.

    In lockstep its messages up to its answer to tick n take effect at exchange n + lag, wherever it runs. A run
    therefore repeats, and the companion processes a cloud while the host continues. In real time they take effect when
    they arrive.

    `to_autopilot`: sends to the autopilot. `interrupted`: returns True when the user asked to stop; called during
    waits. heard: route to subscribe to the messages when they take effect. gone_s: simulation time at which the run
    gave the companion up, None while it is present. intake: its part of an exchange ahead of the autopilot.
    """

    def __init__(
        self,
        profile: RunProfile,
        to_autopilot: Callable[[Any], None],
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        companion = profile.companion
        assert companion is not None
        self._profile = profile
        self._companion = companion
        self._to_autopilot = to_autopilot
        self._lockstep = profile.clock.mode == "lockstep"
        cameras = () if profile.sensors is None else profile.sensors.cameras
        self._cameras = {camera.name: camera.position_frd_m for camera in cameras}
        self.inbox = CompanionInbox(local_frame(profile.site), self._lockstep, self._heard)
        key = companion.link_key_file
        signing = None if key is None else Signing(read_key_file(key, "companion.link_key_file"))
        self.agent = AgentConnection(COMPANION_LINK, profile, self.inbox, signing, companion_terms(profile))
        self.heard = MessageRoute()
        self.intake = ExchangePart(self._take_effect)
        self._interrupted = interrupted
        self.gone_s: float | None = None
        self._forwards: list[Any] = []
        self._exchanges = 0
        self._now_ns: Callable[[], int] = lambda: 0
        self._sent: tuple[int, int] | None = None
        self._synced_s = 0.0
        self._stuck = False
        self._ended = False

    @property
    def gone(self) -> UserError | None:
        """The reason why the companion does not continue."""
        return self.agent.gone

    def links(self) -> Sequence[Link]:
        return [] if self.gone is not None else [self.agent.link]

    # Before the run

    def prepare(self) -> None:
        companion = self._companion
        options = AgentOptions(self._profile.autopilot.system_id, companion=True, link_key_file=companion.link_key_file)
        self.agent.reach(open_peer(companion.runs, companion.link, options))

    def begin(self, context: RunContext) -> None:
        self._now_ns = context.clock.now_ns
        self.agent.begin(context, companion_parameters(self._profile), {})
        context.recorder.watch(DETECTIONS, self._send_detection)
        self.inbox.holds = self._lockstep
        if self._lockstep:
            self.agent.link.wait_for_room = self._wait_for_room

    # In the run

    def send(self, messages: Sequence[Any]) -> None:
        """Send the data of the companion's sensors."""
        if self.gone is None:
            self.agent.send_sensors(list(messages))

    def _send_detection(self, stamp_ns: int, *values: Any) -> None:
        """Send an object that the detector of a camera found, when its image is available."""
        found = CameraDetection(*values)
        label = found.label.encode("ascii", "replace")[:16]
        angles = found.bearing_rad, found.width_rad, found.bottom_rad, found.top_rad
        place = self._cameras[found.camera]
        self.send([dialect.MAVLink_xitl_detection_message(stamp_ns // 1000, place, *angles, found.confidence, label)])

    def forward(self, message: Any) -> None:
        """Pass on a message of the autopilot with the next exchange if it is for the companion."""
        if message.get_msgId() in TO_COMPANION and self.gone is None:
            self._forwards.append(message)

    def _take_effect(self, step: RunStep) -> None:
        """Let the companion's messages take effect, ahead of the autopilot's part of an exchange."""
        self._exchanges += 1
        if self.gone is not None:
            return
        if not self._lockstep:
            self._watch()
            return
        due = self._exchanges - self._companion.lag
        if due > 0:
            self._wait_for(due)
        self.inbox.release(due)

    def exchange(self, step: RunStep) -> None:
        """Pass on the autopilot's messages and, in lockstep, the tick."""
        if self.gone is not None:
            return
        if self._forwards:
            self.agent.link.pass_on(*self._forwards)
            self._forwards = []
        if self._lockstep:
            self._sent = (step.now_ns, self._exchanges)
            self.agent.send_tick(*self._sent)
        self.agent.receive(0.0)

    def receive(self, timeout_s: float) -> None:
        if self.gone is None:
            self.agent.receive(timeout_s)

    def _watch(self) -> None:
        now_s = time.monotonic()
        if now_s - self._synced_s >= SYNC_EVERY_S:
            self._synced_s = now_s
            self.agent.request_time()
        self.agent.receive(0.0)
        self.agent.watch()
        self.inbox.fresh = False
        if self.gone is not None:
            self._give_up(self.gone)

    def _wait_for_room(self) -> None:
        """Wait until the transport has space. A busy companion reads late, and a lost message would make runs differ.

        Do not wait for a companion that hangs or has ended, or when the user ends the run: `_wait_for` detects that.
        """
        transport = self.agent.link.transport
        started_s = time.monotonic()
        while not transport.wait_for_room(0.0 if self._stuck else REPEAT_S):
            waited_s = time.monotonic() - started_s
            if self._stuck or self._interrupted() or waited_s > self._companion.silent_s:
                self._stuck = True
                return
        self._stuck = False

    def _wait_for(self, tick: int) -> None:
        """Wait for an answer, and give up a companion that stays silent.

        Raises StoppedWaitingError when the user ends the run.
        """
        started_s = sent_s = looked_s = time.monotonic()
        while self.inbox.answered_tick < tick:
            self.agent.receive(REPEAT_S)
            now_s = time.monotonic()
            if self.inbox.answered_tick >= tick or now_s - looked_s < REPEAT_S:
                continue
            looked_s = now_s
            if self._interrupted():
                raise StoppedWaitingError
            try:
                self.agent.peer.check()
            except UserError as error:
                self._give_up(error)
                return
            if now_s - started_s > self._companion.silent_s:
                self._give_up(self.agent.silent(now_s - started_s))
                return
            if self._sent is not None and now_s - sent_s >= self.agent.again_s(REPEAT_S, self._companion.silent_s):
                self.agent.send_tick(*self._sent)
                sent_s = now_s

    def _give_up(self, why: UserError) -> None:
        self.agent.gone = why
        self.gone_s = self._now_ns() * 1e-9
        self.inbox.say(WARNING, "run", f"the run continues without its companion: {why}")

    def _heard(self, message: Any) -> None:
        self.heard.publish(message)
        if message.get_msgId() in TO_AUTOPILOT and not self._ended:
            self._to_autopilot(message)

    # After the run

    def end(self) -> None:
        """Stop the companion. Its messages during the request for the final counts still count."""
        self._ended = True
        if self._lockstep and self.gone is None and self._sent is not None:
            self._wait_for(self._sent[1])
        self.inbox.release_all()
        self.agent.stop()

    def close(self) -> None:
        self.agent.close()

    def report(self) -> dict[str, Any]:
        return {
            **connections_report([self.agent]),
            "companion": {"gone_s": self.gone_s, "warnings": list(self.inbox.warnings)},
        }


LINK, ASKED = "ros", "ros"
NODES = "HS,HC,HA"
_STANDS_FOR = {
    "/lidar/points": dialect.MAVLINK_MSG_ID_XITL_CLOUD,
    "/sonar/ping": dialect.MAVLINK_MSG_ID_XITL_PING,
    "/estimate/odometry": dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
}
"""Message that xitl's companion would get instead of each topic, in the terms of graph/graph.py."""


class RosCompanionNode(RunNode):
    """The nodes count as present when they have given an order. Their sensor data then count as used.

    asked_by: number of executed orders to the vessel, by client.
    """

    def __init__(self, companion: CompanionSpec, asked_by: Counter[str]) -> None:
        self._on_board = companion.runs == "board"
        self._asked_by = asked_by
        self._sent: Counter[int] = Counter()

    def begin(self, context: RunContext) -> None:
        def count(number: int, *message: Any) -> None:
            self._sent[number] += 1

        for topic, number in _STANDS_FOR.items():
            context.recorder.watch(topic, partial(count, number))

    def report(self) -> dict[str, Any]:
        orders = self._asked_by[ASKED]
        if not orders:
            return {}
        seen = sum(self._sent[number] for topic, number in _STANDS_FOR.items() if topic != "/estimate/odometry")
        sent = dict(self._sent) | {dialect.MAVLINK_MSG_ID_MISSION_CURRENT: 1}  # /mission is latched
        received = {dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: orders}
        node = NodeReport(
            NODES,
            "companion board" if self._on_board else "this machine",
            __version__,
            memory_mib=None,
            refused=0,
            link=LINK,
            kind="real" if self._on_board else "virtual",
            estimates=seen,
            efforts=orders,
        )
        return {"nodes": [node], "agents": [agent_traffic(node, [], {"tx": sent, "rx": received})]}


WATCHED_S = 3.0
ENOUGH_SHARE = 0.8
ASKS = 6
_ESTIMATE = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION


class EstimateRate(RunNode):
    """Requests position and attitude at `rate_hz`, and again while estimates arrive more slowly.

    A bridge requests its own rate from its autopilot at the start, so an acknowledgement proves little. An autopilot
    that keeps another rate gets no more than ASKS requests.
    """

    def __init__(self, commands: AutopilotCommands, rate_hz: float) -> None:
        self._commands = commands
        self._rate_hz = rate_hz
        self._asks = 0
        self._estimates = 0
        self._next_ns = 0

    def begin(self, context: RunContext) -> None:
        def count(stamp_ns: int, *odometry: Any) -> None:
            self._estimates += 1

        context.recorder.watch("/estimate/odometry", count)

    def exchange(self, step: RunStep) -> None:
        if self._asks == ASKS or step.now_ns < self._next_ns or not self._commands.view.heard:
            return
        self._next_ns = step.now_ns + round(WATCHED_S * 1e9)
        arrived, self._estimates = self._estimates, 0
        if arrived >= ENOUGH_SHARE * self._rate_hz * WATCHED_S:
            self._asks = ASKS
        elif arrived or not self._asks:
            self._asks += 1
            for message in _ESTIMATE:
                self._commands.stream(message, self._rate_hz)
