"""`companion`: a computer beside the autopilot that perceives, maps and avoids."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Group


class Companion(Group):
    """The companion computer, where it runs and the link to it.

    `parameters`: its settings, by name. In lockstep what it says of an exchange takes effect `lag` exchanges later, as
    it would on a machine of its own, and the host goes on meanwhile. One that is silent for `silent_s` is given up; the
    run goes on without it.
    """

    runs: Literal["in-process", "process", "board"] = "in-process"
    link: str | None = None
    link_key_file: str | None = None
    parameters: dict[str, float] = {}  # noqa: RUF012 - pydantic copies it
    lag: Annotated[int, Field(ge=1, le=100)] = 5
    connect_timeout_s: Annotated[float, Field(gt=0, le=600)] = 6.0
    silent_s: Annotated[float, Field(ge=1, le=600)] = 10.0
