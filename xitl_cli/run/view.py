"""What a person sees while a run goes on: a live panel in a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.run.core.node import ControlNode, ExchangePart, RunContext, RunNode, RunStep
from xitl_cli.run.links.connection import AgentConnection, report_of
from xitl_cli.run.nodes.mission_score import MissionScore
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.scenery import Scenery

LIVE_INTERVAL_S = 0.2
PLAIN_INTERVAL_S = 5.0


@dataclass(frozen=True, slots=True)
class Glance:
    """The state of a run at a glance."""

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
    def show(self, glance: Glance) -> None: ...
    def warn(self, text: str) -> None: ...
    def close(self) -> None: ...


class NoView:
    """Shows nothing."""

    def due(self) -> bool:
        return False

    def show(self, glance: Glance) -> None:
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

    def show(self, glance: Glance) -> None:
        self._next_s = self._now_s() + PLAIN_INTERVAL_S
        if glance.waits_for:
            self._console.print(
                f"t {glance.sim_s:6.1f} s  waits for {glance.waits_for}", highlight=False, markup=False, soft_wrap=True
            )
            return
        error = "" if glance.position_error_m is None else f"  estimate off {glance.position_error_m:.2f} m"
        self._console.print(
            f"t {glance.sim_s:6.1f} s  {_state(glance):<14} "
            f"waypoint {glance.waypoints_reached}/{glance.waypoints_total}  {glance.speed_mps:4.1f} m/s  "
            f"heading {glance.heading_deg:3.0f}°  cross-track {_metres(glance.cross_track_m)}{error}  "
            f"lost {glance.lost}  missed {glance.missed}"
            + (f"  fault {', '.join(glance.faults)}" if glance.faults else ""),
            highlight=False,
            markup=False,
            soft_wrap=True,
        )

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
        self._last: tuple[float, Glance] | None = None
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._live.start()

    def due(self) -> bool:
        return self._now_s() >= self._next_s

    def show(self, glance: Glance) -> None:
        now_s = self._now_s()
        self._next_s = now_s + LIVE_INTERVAL_S
        self._live.update(self._panel(glance, now_s), refresh=True)
        self._last = (now_s, glance)

    def warn(self, text: str) -> None:
        _warn(self._live.console, text)

    def close(self) -> None:
        self._live.stop()

    def _panel(self, glance: Glance, now_s: float) -> RenderableType:
        factor = sent_rate = received_rate = 0.0
        if self._last is not None and now_s > self._last[0]:
            before_s, before = self._last
            wall_s = now_s - before_s
            factor = (glance.sim_s - before.sim_s) / wall_s
            sim_s = max(glance.sim_s - before.sim_s, 1e-9)
            sent_rate = (glance.sent - before.sent) / sim_s
            received_rate = (glance.received - before.received) / sim_s
        progress = Table.grid(padding=(0, 1), expand=True)
        progress.add_column(ratio=1)
        progress.add_column(justify="right")
        share = glance.waypoints_reached / max(glance.waypoints_total, 1)
        progress.add_row(
            ProgressBar(total=1.0, completed=share),
            f"{glance.waypoints_reached}/{glance.waypoints_total}  {glance.sim_s:.1f} s  {factor:.1f}× real time",
        )
        state = Table.grid(padding=(0, 2))
        for _ in range(4):
            state.add_column()
        state.add_row("mode", Text(_state(glance), style="bold"), "speed", f"{glance.speed_mps:.2f} m/s")
        state.add_row("heading", f"{glance.heading_deg:.0f}°", "cross-track", _metres(glance.cross_track_m))
        state.add_row("current", f"{glance.current_mps:.2f} m/s", "wind", f"{glance.wind_mps:.1f} m/s")
        state.add_row(
            "motors",
            "  ".join(f"{motor:+.2f}" for motor in glance.motors),
            "estimate off",
            _metres(glance.position_error_m),
        )
        state.add_row("to agent", f"{sent_rate:.0f} msg/s", "from agent", f"{received_rate:.0f} msg/s")
        trouble = Text(
            f"{glance.lost} lost, {glance.missed} missed", style="red" if glance.lost or glance.missed else "green"
        )
        fault = Text(", ".join(glance.faults), style="bold magenta")
        state.add_row("link", trouble, "fault" if glance.faults else "", fault)
        waiting = [Text(f"waits for {glance.waits_for}", style="bold yellow")] if glance.waits_for else []
        lines = [Text(line, style="dim", overflow="ellipsis", no_wrap=True) for line in glance.messages[-3:]]
        content = Group(*waiting, progress, state, *lines)
        return Panel(content, title=self._title, title_align="left", border_style="cyan")


def make_view(console: Console, title: str, quiet: bool) -> View:
    """The view that suits where the output goes."""
    if quiet:
        return NoView()
    return LiveView(console, title) if console.is_terminal else PlainView(console)


def _warn(console: Console, text: str) -> None:
    console.print(f"warning: {text}", highlight=False, markup=False, soft_wrap=True)


def _state(glance: Glance) -> str:
    return f"{glance.mode} {'armed' if glance.armed else 'disarmed'}"


def _metres(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f} m"


class DisplayNode(RunNode):
    """Shows in a view, whenever that is due, how the vessel that `control` moves is doing; warnings at the start.

    agents: whose counts are shown. faults: names of those in force. showing: its part of an exchange, the last of all.
    """

    def __init__(
        self,
        make_view: Callable[[], View],
        scenery: Scenery,
        clock: ClockSpec,
        plant: Plant,
        control: ControlNode,
        score: MissionScore,
        agents: Sequence[AgentConnection],
        faults: Callable[[], tuple[str, ...]],
    ) -> None:
        self.showing = ExchangePart(self._show)
        self._make_view = make_view
        self._scenery = scenery
        self._view: View | None = None
        self._clock = clock
        self._plant = plant
        self._control = control
        self._score = score
        self._agents = agents
        self._faults = faults

    def begin(self, context: RunContext) -> None:
        self._pace = context.pace
        self._view = self._make_view()
        for text in self._scenery.warnings:
            self._view.warn(text)

    def close(self) -> None:
        if self._view is not None:
            self._view.close()

    def _show(self, step: RunStep) -> None:
        if self._view is not None and self._view.due():
            self._view.show(self._glance(step))

    def _glance(self, step: RunStep) -> Glance:
        control, score, state = self._control, self._score, self._plant.state
        progress, motion = control.progress, step.motion
        north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
        rotation = motion.rot_ned_frd[0]
        report = report_of(self._agents)
        links, tasks = report["links"], [self._pace.task(self._clock.physics_rate_hz), *report["tasks"]]
        return Glance(
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
