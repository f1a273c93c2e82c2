"""`clock` and `recording`: how time passes in a run and what is kept of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Group, Positive, RateHz


class Clock(Group):
    """Lockstep runs as fast as it goes and repeats bit for bit; realtime follows the wall clock."""

    mode: Literal["lockstep", "realtime"] = "lockstep"
    physics_rate_hz: RateHz = 400.0
    exchange_rate_hz: RateHz = 50.0
    duration_s: Positive = 600.0
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1


class Recording(Group):
    """What goes into run.mcap, and whether the autopilot's own log is kept beside it."""

    compression: Literal["lz4", "zstd", "none"] = "lz4"
    truth_rate_hz: RateHz = 50.0
    scene: bool = True
    dataflash: bool = True
