"""What a person sees while a run goes on: a live panel in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.run.core.node import ControlNode, ExchangePart, RunContext, RunNode, RunStep
from xitl_cli.run.links.connection import WARNING, AgentConnection, connections_report
from xitl_cli.run.nodes.mission_score import MissionScore
from xitl_cli.run.world.plant import Plant

LIVE_INTERVAL_S = 0.2
PLAIN_INTERVAL_S = 5.0
BESIDE_WIDTH = 64  # two facts beside each other need so many columns


@dataclass(frozen=True, slots=True)
class RunStatus:
    """How a run is doing now."""

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


class View(Protocol):
    """Shown now and then; `due` is asked on every exchange and must be cheap. What is warned of stays to be read."""

    def due(self) -> bool: ...
    def show(self, status: RunStatus) -> None: ...
    def warn(self, text: str) -> None: ...
    def close(self) -> None: ...


class NoView:
    """Shows nothing."""

    def due(self) -> bool:
        return False

    def show(self, status: RunStatus) -> None:
        pass

    def warn(self, text: str) -> None:
        pass

    def close(self) -> None:
        pass


class PlainView:
    """One line now and then, for logs and pipes."""

    def __init__(self, console: Console, now_s: Callable[[], float] = time.monotonic) -> None:
        self._console = console
        self._now_s = now_s
        self._next_s = 0.0

    def due(self) -> bool:
        return self._now_s() >= self._next_s

    def show(self, status: RunStatus) -> None:
        self._next_s = self._now_s() + PLAIN_INTERVAL_S
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


class LiveView:
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

    def show(self, status: RunStatus) -> None:
        now_s = self._now_s()
        self._next_s = now_s + LIVE_INTERVAL_S
        self._live.update(self._panel(status, now_s), refresh=True)
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
        share = status.waypoints_reached / max(status.waypoints_total, 1)
        counted = f"{status.waypoints_reached}/{status.waypoints_total}"
        progress = Table.grid(padding=(0, 1), expand=True)
        progress.add_column(ratio=1)
        progress.add_column(justify="right")
        progress.add_row(
            ProgressBar(total=1.0, completed=share), Text(f"{counted}  {status.sim_s:.1f} s  {factor:.1f}× real time")
        )
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


def make_view(console: Console, title: str, quiet: bool) -> View:
    """The view that suits where the output goes."""
    if quiet:
        return NoView()
    return LiveView(console, title) if console.is_terminal else PlainView(console)


def _warn(console: Console, text: str) -> None:
    console.print(Text(f"warning: {text}"), soft_wrap=True)


def _mode(status: RunStatus) -> str:
    return f"{status.mode} {'armed' if status.armed else 'disarmed'}"


def _metres(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} m"


class DisplayNode(RunNode):
    """Shows in a view, whenever that is due, how the vessel that `control` moves is doing; warnings at the start.

    agents: whose counts are shown. faults: names of those in force. showing: its part of an exchange, the last of all.
    """

    def __init__(
        self,
        make_view: Callable[[], View],
        warnings: Sequence[str],
        clock: ClockSpec,
        plant: Plant,
        control: ControlNode,
        score: MissionScore,
        agents: Sequence[AgentConnection],
        faults: Callable[[], tuple[str, ...]],
    ) -> None:
        self.showing = ExchangePart(self._show)
        self._make_view = make_view
        self._warnings = warnings
        self._view: View | None = None
        self._clock = clock
        self._plant = plant
        self._control = control
        self._score = score
        self._agents = agents
        self._faults = faults

    def begin(self, context: RunContext) -> None:
        self._pace = context.pace
        view = self._view = self._make_view()
        for text in self._warnings:
            self._on_view(partial(view.warn, text))
            context.recorder.log(0, WARNING, "run", text)

    def close(self) -> None:
        if self._view is not None:
            self._on_view(self._view.close)

    def _show(self, step: RunStep) -> None:
        view = self._view
        if view is not None and view.due():
            status = self._status(step)
            self._on_view(lambda: view.show(status))

    def _on_view(self, act: Callable[[], object]) -> None:
        """A terminal that hung up, or a reader that left, ends what is shown and not the run."""
        try:
            act()
        except OSError:
            self._view = None

    def _status(self, step: RunStep) -> RunStatus:
        control, score, state = self._control, self._score, self._plant.vessels[0].state
        progress, motion = control.progress, step.motion
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        report = connections_report(self._agents)
        links, tasks = report["links"], [self._pace.task(self._clock.physics_rate_hz), *report["tasks"]]
        return RunStatus(
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
