"""A host for a node in this process: sends what a host sends, and turns the machine's clock by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from agent.faults import AgentFaults
from agent.fcu.dataflash.flight_log import FlightLog
from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.autopilot import Autopilot
from agent.machine import Machine
from agent.node import AgentNode
from agent.reports import Identity
from agent.roles.autopilot import AutopilotRole
from agent.roles.role import Role
from agent.timing.tasks import TaskMiss
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair

MS = 1_000_000
LOCKSTEP, REALTIME = mav.XITL_CLOCK_MODE_LOCKSTEP, mav.XITL_CLOCK_MODE_REALTIME
START, STOP, HELLO = mav.XITL_RUN_COMMAND_START, mav.XITL_RUN_COMMAND_STOP, mav.XITL_RUN_COMMAND_HELLO
BOARD = Machine("real", "Board of a test", "Linux 6.1 armv7l PREEMPT_RT", True, 1, 480)


class HandClock:
    """Stands still unless it is turned; `work_ns` passes at each look, as if something took so long."""

    def __init__(self) -> None:
        self.time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns


class LogDouble:
    """In place of a FlightLog: counts the calls by name and keeps the missed deadlines."""

    dropped = 0

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self.misses: list[TaskMiss] = []

    def __getattr__(self, name: str) -> Callable[..., None]:
        assert hasattr(FlightLog, name), f"a flight log has no {name}"
        return lambda *_: self.calls.update([name])

    def log_missed_deadlines(self, now_ns: int, misses: Sequence[TaskMiss]) -> None:
        self.misses += misses


class Host:
    """The node is `node`, in `role` or with an autopilot; `frames` is every byte that came from it."""

    def __init__(self, role: Role | None = None, log: LogDouble | None = None, silence_s: float = 60.0) -> None:
        here, there = memory_pair()
        self.frames: list[bytes] = []
        self.link = Link(here, 255, 190, tap=lambda way, frame: self.frames.append(frame) if way == "rx" else None)
        self.clock = HandClock()
        faults = AgentFaults(self.clock)
        own = Link(faults.wrap(there), 1, 1)
        if role is None:
            role = AutopilotRole(
                lambda: MavlinkChannel(Autopilot(Parameters())),
                own.send,
                make_log=None if log is None else lambda now_ns: log,
            )
        self.role = role
        self.node = AgentNode(own, role, Identity(role.nodes, BOARD), faults, silence_s, self.clock)
        self.tick = 0

    @property
    def autopilot(self) -> Autopilot:
        assert isinstance(self.role, AutopilotRole)
        return self.role.channel.autopilot

    def send(self, *messages: Any) -> list[Any]:
        """Send, let the node work once, and return what it says."""
        self.link.send(*messages)
        self.node.poll()
        return self.link.receive()

    def run(self, command: int, mode: int = REALTIME) -> list[Any]:
        return self.send(mav.MAVLink_xitl_run_message(0, b"test", command, mode, 2))

    def imu(self, stamp_ns: int) -> Any:
        """Of a vessel at rest."""
        return mav.MAVLink_xitl_imu_message(stamp_ns // 1000, (0.0, 0.0, 0.0), (0.0, 0.0, -9.78), 20.0)

    def step(self) -> list[Any]:
        """20 ms in lockstep, with four samples of the IMU."""
        self.tick += 1
        samples = [self.imu(self.tick * 20 * MS + index * 5 * MS) for index in range(4)]
        return self.send(*samples, mav.MAVLink_xitl_tick_message(self.tick * 20_000, self.tick))

    def live(self, seconds: float, step_ns: int = 20 * MS, imu: bool = True) -> list[Any]:
        """So long in real time, the node looking every `step_ns`."""
        said: list[Any] = []
        for _ in range(round(seconds * 1e9 / step_ns)):
            self.clock.time_ns += step_ns
            said += self.send(self.imu(self.clock.time_ns)) if imu else self.send()
        return said

    def faults(self, **fields: float) -> list[Any]:
        """XITL_FAULTS, all zero but for these."""
        values = dict.fromkeys(mav.MAVLink_xitl_faults_message.fieldnames, 0)
        return self.send(mav.MAVLink_xitl_faults_message(**{**values, **fields}))


def of(kind: str, messages: list[Any]) -> list[Any]:
    """Those of one kind."""
    return [message for message in messages if message.get_type() == kind]


def texts(messages: list[Any]) -> list[str]:
    """Sentences; only those that fit one chunk."""
    return [message.text for message in of("STATUSTEXT", messages)]
