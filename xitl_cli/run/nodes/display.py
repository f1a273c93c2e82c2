"""Status of a run for the user: a live panel in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import partial
from typing import Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from sim_core.dataclass import dataclass
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.run.core.node import ControlNode, ExchangePart, RunContext, RunNode, RunStep
from xitl_cli.run.core.pace import SOURCE as PACE
from xitl_cli.run.core.scores import MissionScore
from xitl_cli.run.links.connection import WARNING, AgentConnection
from xitl_cli.run.world.plant import PlantView

LIVE_INTERVAL_S = 0.2
PLAIN_INTERVAL_S = 5.0
STALLS_S = 60.0  # from one warning about stalls to the next
BESIDE_WIDTH = 64  # columns that two facts in one row need
SOURCE = "run"


@dataclass(frozen=True, slots=True)
class RunStatus:
    """Current status of a vessel of a run."""

    sim_s: float
    duration_s: float
    mode: str
    armed: bool
    waypoints_reached: int
    waypoints_total: int
    speed_mps: float
    heading_deg: float
    cross_track_m: float | None
    position_error_m: float | None
    current_mps: float
    wind_mps: float
    motors: tuple[float, ...]
    sent: int = 0
    received: int = 0
    lost: int = 0
    missed: int = 0
    messages: tuple[str, ...] = field(default=())
    waits_for: str = ""
    faults: tuple[str, ...] = field(default=())
    vessel: str = ""
    """Name of the vessel in a fleet."""


class StatusDisplay(Protocol):
    """Shows one status for each vessel at intervals. `due` is called on every exchange and must be cheap.

    Warnings stay visible.
    """

    def due(self) -> bool: ...
    def show(self, *statuses: RunStatus) -> None: ...
    def warn(self, text: str) -> None: ...
    def close(self) -> None: ...


class NoDisplay:
    """Shows nothing."""

    def due(self) -> bool:
        return False

    def show(self, *statuses: RunStatus) -> None:
        pass

    def warn(self, text: str) -> None:
        pass

    def close(self) -> None:
        pass


class PlainDisplay:
    """One line at intervals, for logs and pipes."""

    def __init__(self, console: Console, now_s: Callable[[], float] = time.monotonic) -> None:
        self._console = console
        self._now_s = now_s
        self._next_s = 0.0

    def due(self) -> bool:
        return self._now_s() >= self._next_s

    def show(self, *statuses: RunStatus) -> None:
        self._next_s = self._now_s() + PLAIN_INTERVAL_S
        status = statuses[0]
        if len(statuses) > 1:
            self._say(f"t {status.sim_s:6.1f} s  {fleet_line(statuses)}")
            return
        if status.waits_for:
            self._say(f"t {status.sim_s:6.1f} s  waits for {status.waits_for}")
            return
        error = "" if status.position_error_m is None else f"  estimate off {status.position_error_m:.2f} m"
        self._say(
            f"t {status.sim_s:6.1f} s  {_mode(status):<14} "
            f"waypoint {status.waypoints_reached}/{status.waypoints_total}  {status.speed_mps:4.1f} m/s  "
            f"heading {status.heading_deg:3.0f}°  cross-track {_metres(status.cross_track_m)}{error}  "
            f"lost {status.lost}  missed {status.missed}"
            + (f"  fault {', '.join(status.faults)}" if status.faults else "")
        )

    def _say(self, text: str) -> None:
        self._console.print(Text(text), soft_wrap=True)

    def warn(self, text: str) -> None:
        _warn(self._console, text)

    def close(self) -> None:
        pass


class LiveDisplay:
    """A panel that redraws itself a few times a second."""

    def __init__(self, console: Console, title: str, now_s: Callable[[], float] = time.monotonic) -> None:
        self._title = title
        self._now_s = now_s
        self._next_s = 0.0
        self._last: tuple[float, RunStatus] | None = None
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._live.start()

    def due(self) -> bool:
        return self._now_s() >= self._next_s

    def show(self, *statuses: RunStatus) -> None:
        now_s, status = self._now_s(), statuses[0]
        self._next_s = now_s + LIVE_INTERVAL_S
        panel = self._panel(status, now_s) if len(statuses) == 1 else self._fleet_panel(statuses, now_s)
        self._live.update(panel, refresh=True)
        self._last = (now_s, status)

    def warn(self, text: str) -> None:
        _warn(self._live.console, text)

    def close(self) -> None:
        self._live.stop()

    def _panel(self, status: RunStatus, now_s: float) -> RenderableType:
        factor = sent_rate = received_rate = 0.0
        if self._last is not None and now_s > self._last[0]:
            before_s, before = self._last
            wall_s = now_s - before_s
            factor = (status.sim_s - before.sim_s) / wall_s
            sim_s = max(status.sim_s - before.sim_s, 1e-9)
            sent_rate = (status.sent - before.sent) / sim_s
            received_rate = (status.received - before.received) / sim_s
        progress = _progress(status.waypoints_reached, status.waypoints_total, status.sim_s, factor)
        trouble = "red" if status.lost or status.missed else "green"
        facts = [
            ("mode", Text(_mode(status), style="bold")),
            ("speed", Text(f"{status.speed_mps:.2f} m/s")),
            ("heading", Text(f"{status.heading_deg:.0f}°")),
            ("cross-track", Text(_metres(status.cross_track_m))),
            ("current", Text(f"{status.current_mps:.2f} m/s")),
            ("wind", Text(f"{status.wind_mps:.1f} m/s")),
            ("motors", Text("  ".join(f"{motor:+.2f}" for motor in status.motors))),
            ("estimate off", Text(_metres(status.position_error_m))),
            ("to agent", Text(f"{sent_rate:.0f} msg/s")),
            ("from agent", Text(f"{received_rate:.0f} msg/s")),
            ("link", Text(f"{status.lost} lost, {status.missed} missed", style=trouble)),
        ]
        if status.faults:
            facts.append(("fault", Text(", ".join(status.faults), style="bold magenta")))
        beside = 2 if self._live.console.width >= BESIDE_WIDTH else 1
        state = Table.grid(padding=(0, 2))
        for at in range(0, len(facts), beside):
            state.add_row(*(cell for fact in facts[at : at + beside] for cell in fact))
        waiting = [Text(f"waits for {status.waits_for}", style="bold yellow")] if status.waits_for else []
        lines = [Text(line, style="dim") for line in status.messages[-3:]]
        content = Group(*waiting, progress, state, *lines)
        return Panel(content, title=Text(self._title), title_align="left", border_style="cyan")

    def _fleet_panel(self, statuses: Sequence[RunStatus], now_s: float) -> RenderableType:
        """Return a table with one row for each vessel.

        When space is short, it shows the vessels that need attention.
        """
        sim_s = statuses[0].sim_s
        factor = 0.0
        if self._last is not None and now_s > self._last[0]:
            factor = (sim_s - self._last[1].sim_s) / (now_s - self._last[0])
        reached = sum(status.waypoints_reached for status in statuses)
        total = sum(status.waypoints_total for status in statuses)
        shown = worst_first(statuses, max(self._live.console.height - FLEET_FRAME, 3))
        rows = Table.grid(padding=(0, 2))
        for number in range(len(FLEET_HEADS)):
            rows.add_column(justify="right" if number > 1 else "left", no_wrap=True)
        rows.add_row(*(Text(head, style="dim") for head in FLEET_HEADS))
        for status in shown:
            rows.add_row(*(Text(cell) for cell in fleet_cells(status)))
        hidden = [Text(f"and {len(statuses) - len(shown)} more", style="dim")] if len(shown) < len(statuses) else []
        messages = [
            Text(f"{status.vessel}: {status.messages[-1]}", style="dim") for status in shown[:2] if status.messages
        ]
        content = Group(_progress(reached, total, sim_s, factor), rows, *hidden, *messages)
        return Panel(content, title=Text(self._title), title_align="left", border_style="cyan")


FLEET_FRAME = 8
"""Lines of a fleet's panel that are not rows of vessels."""
FLEET_HEADS = ("vessel", "mode", "waypoints", "cross-track", "speed", "estimate off")


def fleet_cells(status: RunStatus) -> tuple[str, ...]:
    """Return a row of a fleet's table."""
    return (
        status.vessel,
        f"waits for {status.waits_for}" if status.waits_for else _mode(status),
        f"{status.waypoints_reached}/{status.waypoints_total}",
        _metres(status.cross_track_m),
        f"{status.speed_mps:.1f} m/s",
        _metres(status.position_error_m),
    )


def fleet_line(statuses: Sequence[RunStatus]) -> str:
    """Summarize a fleet in one line: vessels per mode, waypoints, and the vessel with the largest cross-track error."""
    modes = Counter(f"waits for {vessel.waits_for}" if vessel.waits_for else _mode(vessel) for vessel in statuses)
    reached = sum(vessel.waypoints_reached for vessel in statuses)
    total = sum(vessel.waypoints_total for vessel in statuses)
    off = [vessel for vessel in statuses if vessel.cross_track_m is not None]
    words = [", ".join(f"{count} {mode}" for mode, count in modes.most_common()), f"waypoints {reached}/{total}"]
    if off:
        worst = max(off, key=lambda vessel: abs(vessel.cross_track_m or 0.0))
        words.append(f"cross-track up to {_metres(abs(worst.cross_track_m or 0.0))} ({worst.vessel})")
    words.append(f"lost {sum(vessel.lost for vessel in statuses)}  missed {sum(vessel.missed for vessel in statuses)}")
    words += [f"fault {', '.join(vessel.faults)} ({vessel.vessel})" for vessel in statuses if vessel.faults]
    return "  ".join(words)


def worst_first(statuses: Sequence[RunStatus], count: int) -> list[RunStatus]:
    """Return all in their order if they are at most `count`.

    Otherwise, return the `count` with the largest cross-track errors, the largest first.
    """
    if len(statuses) <= count:
        return list(statuses)
    return sorted(statuses, key=lambda vessel: -abs(vessel.cross_track_m or 0.0))[:count]


def _progress(reached: int, total: int, sim_s: float, factor: float) -> Table:
    progress = Table.grid(padding=(0, 1), expand=True)
    progress.add_column(ratio=1)
    progress.add_column(justify="right")
    progress.add_row(
        ProgressBar(total=1.0, completed=reached / max(total, 1)),
        Text(f"{reached}/{total}  {sim_s:.1f} s  {factor:.1f}× real time"),
    )
    return progress


def make_display(console: Console, title: str, quiet: bool) -> StatusDisplay:
    """Return the display that suits the output."""
    if quiet:
        return NoDisplay()
    return LiveDisplay(console, title) if console.is_terminal else PlainDisplay(console)


def _warn(console: Console, text: str) -> None:
    console.print(Text(f"warning: {text}"), soft_wrap=True)


def _mode(status: RunStatus) -> str:
    return f"{status.mode} {'armed' if status.armed else 'disarmed'}"


def _metres(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} m"


class StatusSource:
    """Status of the vessel that `control` moves.

    agents: connections with the counts to show. faults: returns the names of the active faults.
    """

    def __init__(
        self,
        profile: RunProfile,
        plant: PlantView,
        control: ControlNode,
        score: MissionScore,
        agents: Sequence[AgentConnection],
        faults: Callable[[], tuple[str, ...]],
    ) -> None:
        self._vessel = profile.vessel
        self._clock = profile.clock
        self._plant = plant
        self._control = control
        self._score = score
        self._agents = agents
        self._faults = faults

    def __call__(self) -> RunStatus:
        control, score, state, motion = self._control, self._score, self._plant.state, self._plant.motion()
        progress = control.progress
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        links = [link for agent in self._agents for link in agent.links()]
        tasks = [task for agent in self._agents for task in agent.inbox.view.tasks.values()]
        return RunStatus(
            vessel=self._vessel,
            sim_s=state.time_ns * 1e-9,
            duration_s=self._clock.duration_s,
            mode=progress.mode,
            armed=progress.armed,
            waypoints_reached=progress.reached,
            waypoints_total=score.total,
            speed_mps=math.hypot(north_mps, east_mps),
            heading_deg=math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) % 360.0,
            cross_track_m=score.latest_m,
            position_error_m=control.position_error_m,
            current_mps=math.hypot(*state.current_ned_mps[0].tolist()),
            wind_mps=math.hypot(*state.wind_ned_mps[0].tolist()),
            motors=control.command.motors,
            sent=sum(link.sent or 0 for link in links if link.name == "sensors"),
            received=sum(link.received or 0 for link in links if link.name == "actuators"),
            lost=sum(link.lost or 0 for link in links),
            missed=sum(task.missed for task in tasks),
            messages=progress.messages,
            waits_for=progress.waits_for,
            faults=self._faults(),
        )


class StallWarnings:
    """Warns of stalls of this machine: of the first one at once, of later ones once every `STALLS_S`.

    An overloaded machine has dozens in a minute. After `STALLS_S` without a stall, the next one is a first one.
    """

    def __init__(self, warn: Callable[[str], None], now_s: Callable[[], float] = time.monotonic) -> None:
        self._warn = warn
        self._now_s = now_s
        self._warned_s = -math.inf
        self._count = 0
        self._worst_s = 0.0

    def add(self, length_s: float, text: str) -> None:
        """Add a stall. text: its warning."""
        self.poll()
        if self._now_s() - self._warned_s >= STALLS_S:
            self._warned_s = self._now_s()
            self._warn(text)
        else:
            self._count += 1
            self._worst_s = max(self._worst_s, length_s)

    def poll(self) -> None:
        """Warn of the stalls of the last `STALLS_S` if it is time."""
        if self._count and self._now_s() - self._warned_s >= STALLS_S:
            self.flush()

    def flush(self) -> None:
        """Warn of the stalls since the last warning, if there were any."""
        if self._count:
            stalls = "stall" if self._count == 1 else "stalls"
            since_s = self._now_s() - self._warned_s
            self._warn(f"{self._count} more {stalls} in the last {since_s:.0f} s, the worst {self._worst_s:.2f} s")
            self._warned_s = self._now_s()
            self._count, self._worst_s = 0, 0.0


class DisplayNode(RunNode):
    """Shows the status of the vessels from their sources at intervals, and the run's warnings when they occur.

    Of stalls, it shows the first one and then a summary a minute; the recording has all of them.
    showing: the node's part of an exchange, the last of all.
    """

    def __init__(
        self,
        make_display: Callable[[], StatusDisplay],
        warnings: Sequence[str],
        clock: ClockSpec,
        sources: Sequence[Callable[[], RunStatus]],
    ) -> None:
        self.showing = ExchangePart(self._show)
        self._make_display = make_display
        self._warnings = warnings
        self._display: StatusDisplay | None = None
        self._clock = clock
        self._sources = sources
        self._stalls = StallWarnings(self._warn)

    def begin(self, context: RunContext) -> None:
        self._pace = context.pace
        self._display = self._make_display()
        for text in self._warnings:
            self._warn(text)
            context.recorder.log(0, WARNING, SOURCE, text)
        context.recorder.on_log(self._on_log)

    def close(self) -> None:
        self._stalls.flush()
        if self._display is not None:
            self._on_display(self._display.close)

    def _show(self, step: RunStep) -> None:
        self._stalls.poll()
        display = self._display
        if display is not None and display.due():
            first, *others = (source() for source in self._sources)
            late = self._pace.task(self._clock.physics_rate_hz).missed
            self._on_display(partial(display.show, replace(first, missed=first.missed + late), *others))

    def _on_log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        """Show a warning of the run. An error of the run is the last line of the command."""
        if source == PACE:
            self._stalls.add(self._pace.slip_s, text)
        elif severity == WARNING and source == SOURCE:
            self._warn(text)

    def _warn(self, text: str) -> None:
        if self._display is not None:
            self._on_display(partial(self._display.warn, text))

    def _on_display(self, act: Callable[[], object]) -> None:
        """Call `act`. A closed terminal or pipe ends the display, not the run."""
        try:
            act()
        except OSError:
            self._display = None
