"""Drivers command an autopilot in a run: a mission, a ground station, a script, a recording, ROS nodes, or none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.mavlink.modes import MISSION_MODE, shown_mode
from agent.wire import dialect
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.agents import ScriptStep
from xitl_cli.run.core import directory
from xitl_cli.run.core.node import RunNode, RunStep
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import REPEAT_S, AutopilotCommands
from xitl_cli.run_kinds import DriverContext, DriverKind

if TYPE_CHECKING:
    from xitl_cli.replay.motor_schedule import MotorSchedule


class VehicleDriver(RunNode):
    """Commands an autopilot: called at every exchange, on simulation time."""

    def exchange(self, step: RunStep) -> None:
        self.update(step.now_ns)

    def update(self, sim_ns: int) -> None:
        """Send the commands that are due. Raises UserError when the autopilot cannot be started."""

    def handle(self, message: Any) -> None:
        """Handle a message of the autopilot, after the view has handled it."""

    @property
    def ready(self) -> bool:
        """Whether the vessels that set out together can go without waiting for this one."""
        return True

    @property
    def departed(self) -> bool:
        """Whether the driver has given its first orders, so that others may give theirs."""
        return True

    def finish(self) -> None:
        """End the run, for a driver without its own end."""

    def progress(self) -> Progress:
        """Return the progress, without the values that only the view has (mode, armed, messages)."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class MissionItems:
    """The items of the profile's mission to sail."""

    seqs: tuple[int, ...] = ()
    """Numbers of the items."""
    jumps: bool = False
    """Whether a jump repeats some items."""

    def reached(self, view: AgentView) -> int:
        """Return the number of items that were reached."""
        return len(view.reached_seqs.intersection(self.seqs))

    def is_sailed(self, view: AgentView) -> bool:
        """Whether all items were reached and, if items repeat, the autopilot reports a complete mission."""
        all_reached = 0 < len(self.seqs) == self.reached(view)
        return all_reached and (view.mission_complete or not self.jumps)

    def target(self, view: AgentView) -> int:
        """Return the index of the active item: the first that was not reached, if items do not repeat."""
        if self.jumps and view.target_seq in self.seqs:
            return self.seqs.index(view.target_seq)
        left = (number for number, seq in enumerate(self.seqs) if seq not in view.reached_seqs)
        return next(left, max(len(self.seqs) - 1, 0))


class NoDriver(VehicleDriver):
    """Gives no orders; a mission that the autopilot starts by itself still counts."""

    def __init__(self, commands: AutopilotCommands, course: MissionItems) -> None:
        self._view = commands.view
        self._course = course

    def progress(self) -> Progress:
        done = self._course.is_sailed(self._view)
        return Progress("", reached=self._course.reached(self._view), finished=done, completed=done)


def nobody() -> str:
    """Return an empty text: the vessel waits for no other."""
    return ""


READY_TIMEOUT_S = 60.0
ASK_WHY_S = 5.0  # time before the timeout at which to ask for the reasons


class ArmingPhase(Enum):
    """The event that the sequence waits for."""

    READY = "the autopilot to become ready to arm"
    ARMED = "the autopilot to arm"
    STARTED = "the autopilot to change its mode"
    UNDER_WAY = "nothing"


class ArmingSequence:
    """Arms the autopilot when it is ready and sets a mode.

    `update` raises UserError when that is not done `timeout_s` after the start. The time restarts while the autopilot
    is ready and other vessels are not. waits_for: the vessels that it waits for, as of the last update.
    """

    def __init__(
        self,
        commands: AutopilotCommands,
        mode: str,
        timeout_s: float = READY_TIMEOUT_S,
        others: Callable[[], str] = nobody,
    ) -> None:
        self._commands = commands
        self._mode = mode
        self._timeout_s = timeout_s
        self._others = others
        self._from_ns = 0
        self.phase = ArmingPhase.READY
        self.waits_for = others()

    @property
    def ready(self) -> bool:
        """Whether it would arm without other vessels to wait for."""
        return self.phase is not ArmingPhase.READY or self._commands.view.ready_to_arm

    def update(self, sim_ns: int) -> bool:
        """Check the autopilot and send the command that is due. Returns True once the sequence is complete."""
        commands = self._commands
        self.waits_for = self._others() if self.phase is ArmingPhase.READY else ""
        if self.phase is ArmingPhase.READY and commands.view.ready_to_arm:
            if self.waits_for:
                self._from_ns = sim_ns
                return False
            commands.forget()
            self.phase = ArmingPhase.ARMED
        if self.phase is ArmingPhase.READY and sim_ns - self._from_ns > (self._timeout_s - ASK_WHY_S) * 1e9:
            commands.arm(sim_ns)  # the refusal gives the reasons
        if self.phase is ArmingPhase.ARMED and commands.arm(sim_ns):
            self.phase = ArmingPhase.STARTED
        if self.phase is ArmingPhase.STARTED and commands.set_mode(sim_ns, self._mode):
            self.phase = ArmingPhase.UNDER_WAY
        if self.phase is not ArmingPhase.UNDER_WAY and sim_ns - self._from_ns > self._timeout_s * 1e9:
            why = commands.view.why_not_armed()
            raise UserError(f"gave up after {self._timeout_s:g} s of waiting for {self.phase.value}{why}")
        return self.phase is ArmingPhase.UNDER_WAY


class MissionDriver(VehicleDriver):
    """Sends the commands that a person at a ground station would; done when the course is sailed."""

    def __init__(
        self,
        commands: AutopilotCommands,
        course: MissionItems,
        arm_timeout_s: float = READY_TIMEOUT_S,
        others: Callable[[], str] = nobody,
    ) -> None:
        self._view = commands.view
        self._departure = ArmingSequence(commands, "AUTO", arm_timeout_s, others)
        self._course = course
        self._under_way = False
        self._auto_heard = False

    @property
    def ready(self) -> bool:
        return self._departure.ready

    @property
    def departed(self) -> bool:
        return self._under_way

    def update(self, sim_ns: int) -> None:
        self._under_way = self._under_way or self._departure.update(sim_ns)
        self._auto_heard = self._auto_heard or (self._under_way and self._view.mode == MISSION_MODE)

    def progress(self) -> Progress:
        reached, done = self._course.reached(self._view), self._course.is_sailed(self._view)
        # The acknowledgement of AUTO arrives before the heartbeat with the mode.
        sailing = self._under_way and (self._view.mode == MISSION_MODE or not self._auto_heard)
        target = self._course.target(self._view) if sailing and not done else None
        waits_for = self._departure.waits_for
        return Progress("", target=target, reached=reached, finished=done, completed=done, waits_for=waits_for)


RC_TRIM_US, RC_SPAN_US = 1500, 400


class ReplayDriver(VehicleDriver):
    """Plays `schedule` (port, starboard) once the autopilot is armed in MANUAL. The vessel is held until then.

    Pulses are sent at every exchange. The autopilot mixes and shapes them for its motors. The recorded commands repeat
    only as well as its settings match those of the recorded vehicle.
    """

    def __init__(
        self,
        commands: AutopilotCommands,
        schedule: MotorSchedule,
        rc_channels: tuple[int, int],
        arm_timeout_s: float = READY_TIMEOUT_S,
        others: Callable[[], str] = nobody,
    ) -> None:
        self._commands = commands
        self._schedule = schedule
        self._channels = rc_channels
        self._departure = ArmingSequence(commands, "MANUAL", arm_timeout_s, others)
        self._started_ns: int | None = None
        self._played_ns = -1

    @property
    def ready(self) -> bool:
        return self._departure.ready

    def update(self, sim_ns: int) -> None:
        if self._started_ns is None:
            if not self._departure.update(sim_ns):
                return
            self._started_ns = sim_ns
        self._played_ns = sim_ns - self._started_ns
        port, starboard = self._schedule.motors_at(self._played_ns) or (0.0, 0.0)
        pulses: list[int | None] = [None] * max(self._channels)
        for channel, demand in zip(self._channels, ((port - starboard) / 2, (port + starboard) / 2), strict=True):
            pulses[channel - 1] = round(RC_TRIM_US + RC_SPAN_US * demand)
        self._commands.rc(pulses)

    def progress(self) -> Progress:
        done = self._played_ns >= self._schedule.last_ns
        departure = self._departure
        waits_for = departure.waits_for or departure.phase.value if self._started_ns is None else ""
        return Progress("", finished=done, completed=done, waypoints=(), waits_for=waits_for)


LAST_ORDER_S = 2.0  # at the end, wait this long for the orders of the last step
RC_INTERVAL_S = 0.1  # without repetition, an autopilot treats an override as a lost transmitter


class ScriptDriver(VehicleDriver):
    """Gives the orders of each step from its time on: mode, then arm, then RC and target.

    Mode and arm are repeated every second until they are accepted or the next step begins. RC pulses stay active, and
    are repeated, until a later step changes them. A script is completed when all steps were reached and all orders were
    accepted. course: the mission on board, which a script may start.
    """

    def __init__(
        self, commands: AutopilotCommands, frame: LocalFrame, steps: Sequence[ScriptStep], course: MissionItems
    ) -> None:
        self._commands = commands
        self._steps = steps
        self._targets: list[tuple[float, float, float] | None] = []
        """Latitude, longitude and altitude of each step's target."""
        for step in steps:
            target = None
            if step.goto_ned_m is not None:
                lat, lon, alt = frame.geodetic(np.array([[*step.goto_ned_m, 0.0]]))
                target = float(lat[0]), float(lon[0]), float(alt[0])
            self._targets.append(target)
        self._course = course
        self._number = -1
        self._now_ns = -1
        self._mode_set = self._armed = True
        self._refused = 0
        self._pulses: tuple[int | None, ...] | None = None
        self._pulses_ns: int | None = None
        self._target_ns: int | None = None

    def update(self, sim_ns: int) -> None:
        self._now_ns = sim_ns
        while self._number + 1 < len(self._steps) and round(self._steps[self._number + 1].at_s * 1e9) <= sim_ns:
            self._begin(self._number + 1)
        if self._number < 0:
            return
        step, target, view = self._steps[self._number], self._targets[self._number], self._commands.view
        if step.mode is not None and not self._mode_set:
            self._mode_set = self._commands.set_mode(sim_ns, step.mode)
        if step.arm is not None and self._mode_set and not self._armed:
            self._armed = self._commands.arm(sim_ns, step.arm)
        if self._mode_set and self._armed and target is not None and _is_due(self._target_ns, REPEAT_S, sim_ns):
            # A target has no answer, so it is repeated while the vehicle is in GUIDED.
            if self._target_ns is None or view.mode == shown_mode("GUIDED", view.px4):
                self._commands.go_to(sim_ns, *target)
            self._target_ns = sim_ns
        if self._pulses is not None and _is_due(self._pulses_ns, RC_INTERVAL_S, sim_ns):
            self._commands.rc(self._pulses)
            self._pulses_ns = sim_ns

    def progress(self) -> Progress:
        played = self._number + 1 == len(self._steps)
        settled = self._settled()
        given_up = self._now_ns - round(self._steps[-1].at_s * 1e9) >= LAST_ORDER_S * 1e9
        view = self._commands.view
        sailing = view.armed and view.mode == "AUTO" and bool(self._course.seqs) and not self._course.is_sailed(view)
        return Progress(
            "",
            target=self._course.target(view) if sailing else None,
            reached=self._course.reached(view),
            finished=played and self._steps[-1].end and (settled or given_up),
            completed=played and settled and not self._refused,
        )

    def _settled(self) -> bool:
        """Whether the orders of the current step were accepted."""
        mode = self._mode_set or self._commands.mode_is_set()
        return mode and (self._armed or self._commands.accepted(dialect.MAV_CMD_COMPONENT_ARM_DISARM))

    def _begin(self, number: int) -> None:
        if not self._settled():
            self._refused += 1
        step = self._steps[number]
        self._commands.forget()
        self._number = number
        self._mode_set, self._armed = step.mode is None, step.arm is None
        self._target_ns = None
        if step.rc_us is not None:
            # A channel without a new pulse keeps its former one.
            channels = zip_longest(self._pulses or (), step.rc_us)
            self._pulses = tuple(former if pulse is None else pulse for former, pulse in channels)
            self._pulses_ns = None


def _is_due(last_ns: int | None, every_s: float, now_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns >= every_s * 1e9


DOWNLOAD_S = 10.0  # a download that takes longer is given up without a message
FAREWELL_S = 2.0  # time after the last waypoint for the ground station to receive it


class GroundStationDriver(VehicleDriver):
    """Sends no commands. The vessel is held until the autopilot is armed for the first time.

    The driver downloads the mission when it starts, so that the run is judged by that mission. With `stay` the run
    continues after the mission. `addresses`: addresses of the autopilot for ground stations.
    """

    def __init__(self, commands: AutopilotCommands, frame: LocalFrame, addresses: Sequence[str], stay: bool) -> None:
        self._view = commands.view
        self._frame = frame
        self._addresses = addresses
        self._stay = stay
        self._commands = commands
        self._download = commands.download()
        self._download_ns: int | None = None
        self._seqs: tuple[int, ...] = ()
        self._places: tuple[tuple[float, float], ...] | None = None
        self._over_ns: int | None = None
        self._now_ns = 0
        self._was_armed = False
        self._was_auto = False

    def update(self, sim_ns: int) -> None:
        view = self._view
        self._now_ns = sim_ns
        if not self._is_over():
            self._over_ns = None
        elif self._over_ns is None:
            self._over_ns = sim_ns
        self._was_armed = self._was_armed or view.armed
        auto = view.armed and view.mode == "AUTO"
        if auto and not self._was_auto:
            self._download, self._download_ns = self._commands.download(), sim_ns
            if self._reached() == len(self._seqs):
                view.reached_seqs.clear()  # the item was reached in an earlier pass
        self._was_auto = auto
        if self._download_ns is not None and sim_ns - self._download_ns <= DOWNLOAD_S * 1e9:
            self._commands.send_all(self._download.poll(sim_ns))

    def handle(self, message: Any) -> None:
        was_done = self._download.done
        self._commands.send_all(self._download.handle(message, self._now_ns))
        if not self._download.done or was_done:
            return
        # Judge by the mission that was downloaded, and forget the reached items of another mission.
        items = [item for item in self._download.items if item.seq > 0 and item.command == dialect.MAV_CMD_NAV_WAYPOINT]
        alt_m = np.full(len(items), self._frame.altitude_m)
        lat = np.array([item.x * 1e-7 for item in items], dtype=float)
        lon = np.array([item.y * 1e-7 for item in items], dtype=float)
        ned = self._frame.ned(lat, lon, alt_m) if items else np.empty((0, 3))
        places = tuple((north, east) for north, east, _ in ned.tolist())
        if self._places is not None and places != self._places:
            self._view.reached_seqs.clear()
        self._seqs, self._places = tuple(item.seq for item in items), places

    def progress(self) -> Progress:
        reached, total = self._reached(), len(self._seqs)
        target = self._seqs.index(self._view.target_seq) if self._view.target_seq in self._seqs else None
        over = self._is_over()
        left = self._over_ns is not None and self._now_ns - self._over_ns >= FAREWELL_S * 1e9
        waits_for = ""
        if not self._was_armed:
            # The autopilot sends to `udp://127.0.0.1:14550` and listens at `tcp://0.0.0.0:5760`.
            addresses = ", ".join(
                address.replace("udp://", "sends to UDP ").replace("tcp://", "listens at TCP ")
                for address in self._addresses
            )
            waits_for = f"a ground station to arm the vessel ({addresses or 'at the board'})"
        return Progress(
            "",
            target=target if self._was_auto and not over else None,
            reached=reached,
            finished=over and left and not self._stay,
            completed=0 < total == reached,
            waypoints=self._places if self._places is not None else (),
            waits_for=waits_for,
        )

    def report(self) -> dict[str, Any]:
        # The station's commands reach the autopilot over a link that this machine does not see.
        return {"edges": [("D", "LC")]} if self._was_armed else {}

    def save(self, folder: Path) -> None:
        """Save the mission that the ground station started, in the format of its waypoint files."""
        if self._download.done and self._seqs:
            from xitl_cli.profile.missions.ground_station_files import waypoints_text

            directory.write_whole(folder / directory.MISSION, waypoints_text(self._download.items))

    def _is_over(self) -> bool:
        return bool(self._seqs) and self._seqs[-1] in self._view.reached_seqs

    def _reached(self) -> int:
        return sum(seq in self._view.reached_seqs for seq in self._seqs)


class RosDriver(VehicleDriver):
    """Brings the vessel into GUIDED and arms it, for ROS nodes that give an operator's orders.

    It ends only by `finish`.

    Without `arms` the nodes do that too. A mission that a node starts counts like that of a ground station.
    """

    def __init__(
        self,
        commands: AutopilotCommands,
        frame: LocalFrame,
        arms: bool,
        arm_timeout_s: float = READY_TIMEOUT_S,
        others: Callable[[], str] = nobody,
    ) -> None:
        self._departure = ArmingSequence(commands, "GUIDED", arm_timeout_s, others) if arms else None
        self._under_way = not arms
        self._ended = False
        self._mission = GroundStationDriver(commands, frame, (), stay=True)

    @property
    def ready(self) -> bool:
        return self._departure is None or self._departure.ready

    @property
    def departed(self) -> bool:
        return self._under_way

    def update(self, sim_ns: int) -> None:
        if self._departure is not None and not self._under_way:
            self._under_way = self._departure.update(sim_ns)
        self._mission.update(sim_ns)

    def handle(self, message: Any) -> None:
        self._mission.handle(message)

    def finish(self) -> None:
        self._ended = True

    def progress(self) -> Progress:
        waits_for = "" if self._departure is None else self._departure.waits_for
        completed = self._under_way
        return replace(self._mission.progress(), waits_for=waits_for, finished=self._ended, completed=completed)


def _course(context: DriverContext) -> MissionItems:
    mission = context.profile.mission
    return MissionItems(tuple(mission.course), mission.jumps)


def _replay(context: DriverContext) -> ReplayDriver:
    from xitl_cli.replay.motor_schedule import schedule_from_file

    return ReplayDriver(
        context.commands,
        schedule_from_file(context.profile),
        context.profile.driver.replay.rc_channels,
        context.profile.autopilot.arm_timeout_s,
        context.others,
    )


MISSION = DriverKind(
    lambda context: MissionDriver(
        context.commands, _course(context), context.profile.autopilot.arm_timeout_s, context.others
    )
)
GROUND_STATION = DriverKind(
    lambda context: GroundStationDriver(
        context.commands, context.frame, context.ground_stations, context.profile.driver.stay
    )
)
ROS = DriverKind(
    lambda context: RosDriver(
        context.commands,
        context.frame,
        context.profile.driver.arms,
        context.profile.autopilot.arm_timeout_s,
        context.others,
    )
)
SCRIPT = DriverKind(
    lambda context: ScriptDriver(context.commands, context.frame, context.profile.driver.script, _course(context))
)
REPLAY = DriverKind(_replay)
NONE = DriverKind(lambda context: NoDriver(context.commands, _course(context)))
