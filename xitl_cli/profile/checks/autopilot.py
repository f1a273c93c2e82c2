"""The autopilot's link, parameter files and parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator

from agent.fcu.parameters import ParameterError, Parameters, checked
from xitl_cli.errors import UserError
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.parameter_files import find_parameter_file
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.operation import Autopilot

_LINK = re.compile(r"udp://(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]]+):([0-9]{1,5})")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A link that is missing or is none, files that are not there, parameters that the autopilot does not have."""
    if profile.autopilot is None:
        return
    yield from _link(profile.autopilot)
    for number, name in enumerate(profile.autopilot.parameter_files):
        path = ("autopilot", "parameter_files", number)
        try:
            file = find_parameter_file(name)
            if profile.autopilot.kind == "embedded":
                Parameters().load(file.read_text(encoding="utf-8"), str(file))
        except (UserError, ValueError, OSError) as error:
            yield path, f"autopilot.parameter_files.{number}: {error}"
    if profile.autopilot.kind == "embedded":
        for name, value in profile.autopilot.parameters.items():
            try:
                checked(name, value)
            except ParameterError as error:
                yield ("autopilot", "parameters", name), f"autopilot.parameters: {error}"


def _link(autopilot: Autopilot) -> Iterator[tuple[KeyPath, str]]:
    path = ("autopilot", "link")
    if autopilot.link is not None:
        match = _LINK.fullmatch(autopilot.link)
        if match is None:
            yield path, f"autopilot.link = {shown(autopilot.link)} is not a link; write udp://address:port"
        elif not 0 < int(match[2]) < 65536:
            yield path, f"autopilot.link = {shown(autopilot.link)} has no such port; use a port from 1 to 65535"
    elif autopilot.kind != "none" and autopilot.runs != "in-process":
        example = "udp://192.168.7.2:14660" if autopilot.runs == "board" else "udp://127.0.0.1:14660"
        yield path, f"autopilot.link is missing with autopilot.runs = {autopilot.runs}; add one such as {example}"
