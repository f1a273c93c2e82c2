"""The autopilot's link, ground stations, files and parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator

from agent.fcu.parameters import ParameterError, Parameters, checked
from xitl_cli.errors import UserError
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.ground_stations import problems_of_urls
from xitl_cli.profile.parameter_files import find_parameter_file
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.operation import Autopilot
from xitl_cli.signing import read_key_file

_LINK = re.compile(r"udp://(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]]+):([0-9]{1,5})")

_CLASS = re.compile(r"([A-Za-z_]\w*(\.[A-Za-z_]\w*)*|.+\.py):[A-Za-z_]\w*")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A link that is missing or is none, files that are not there, parameters that the autopilot does not have."""
    if profile.autopilot is None:
        return
    yield from _link(profile.autopilot)
    yield from _ground_stations(profile.autopilot)
    yield from _extras(profile.autopilot)
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


def _ground_stations(autopilot: Autopilot) -> Iterator[tuple[KeyPath, str]]:
    if autopilot.ground_stations and autopilot.kind != "none" and autopilot.runs == "board":
        yield (
            ("autopilot", "ground_stations"),
            "autopilot.ground_stations cannot be given to a board from here; "
            "start the agent there with --gcs, once for each address",
        )
        return
    for number, sentence in problems_of_urls(autopilot.ground_stations or ()):
        yield ("autopilot", "ground_stations", number), sentence


def _extras(autopilot: Autopilot) -> Iterator[tuple[KeyPath, str]]:
    options = {"controller": "--controller", "signing_key_file": "--signing-key"}
    for key, option in options.items():
        if getattr(autopilot, key) is not None and autopilot.kind != "none" and autopilot.runs == "board":
            yield (
                ("autopilot", key),
                f"autopilot.{key} cannot be given to a board from here; start the agent there with {option}",
            )
    if autopilot.controller is not None and not _CLASS.fullmatch(autopilot.controller):
        yield (
            ("autopilot", "controller"),
            f"autopilot.controller = {shown(autopilot.controller)} is not a class; "
            "write package.module:Class or path/to/file.py:Class",
        )
    if autopilot.signing_key_file is not None:
        try:
            read_key_file(autopilot.signing_key_file)
        except UserError as error:
            yield ("autopilot", "signing_key_file"), f"autopilot.signing_key_file: {error}"
