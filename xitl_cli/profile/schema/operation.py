"""`mission`, `driver` and `autopilot`: what the vessel is to do and who steers it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive


class Start(Group):
    """Where the vessel lies at the start, at rest."""

    north_m: float = 0.0
    east_m: float = 0.0
    heading_deg: Direction = 0.0


class Mission(Group):
    """Waypoints (north, east) from the local origin."""

    speed_mps: Annotated[float, Field(gt=0, le=30)] = 3.0
    acceptance_radius_m: Positive = 3.0
    start: Start = Start()
    waypoints_ned_m: tuple[tuple[float, float], ...] = ()


class ScriptStep(Group):
    """From `at_s` on, these motor commands in [-1, 1], one per propeller."""

    at_s: NonNegative
    motors: Annotated[tuple[Annotated[float, Field(ge=-1, le=1)], ...], Field(min_length=1)]


class Driver(Group):
    """Who gives the orders: a mission, a timed script of motor commands, or nobody."""

    kind: Literal["mission", "script", "none"] = "none"
    script: tuple[ScriptStep, ...] = ()


class Autopilot(Group):
    """The autopilot, where it runs, and the link to it."""

    kind: Literal["none", "embedded"] = "none"
    runs: Literal["in-process", "process", "board"] = "in-process"
    link: str | None = None
    parameter_files: tuple[str, ...] = ()
    parameters: dict[str, float] = {}  # noqa: RUF012 - pydantic copies it
    connect_timeout_s: Annotated[float, Field(gt=0, le=600)] = 6.0
