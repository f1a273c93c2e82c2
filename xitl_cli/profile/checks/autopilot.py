"""The autopilot's ground stations, files and parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator

from agent.fcu.parameters import ParameterError, checked
from xitl_cli.errors import UserError
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.ground_stations import problems_of_urls
from xitl_cli.profile.parameter_files import find_parameter_file, read_parameter_file
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.operation import Autopilot
from xitl_cli.signing import read_key_file

_CLASS = re.compile(r"([A-Za-z_]\w*(\.[A-Za-z_]\w*)*|.+\.py):[A-Za-z_]\w*")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Addresses that are none, files that are not there, parameters that the autopilot does not have."""
    if profile.autopilot is None:
        return
    yield from _ground_stations(profile.autopilot)
    yield from _extras(profile.autopilot)
    yield from _standby(profile, profile.autopilot)
    if profile.autopilot.kind not in ("none", "embedded"):
        return
    for number, name in enumerate(profile.autopilot.parameter_files):
        path = ("autopilot", "parameter_files", number)
        try:
            if profile.autopilot.kind == "embedded":
                read_parameter_file(name, embedded=True)
            else:
                find_parameter_file(name)
        except UserError as error:
            yield path, f"autopilot.parameter_files.{number}: {error}"
    if profile.autopilot.kind == "embedded":
        for name, value in profile.autopilot.parameters.items():
            try:
                checked(name, value)
            except ParameterError as error:
                yield ("autopilot", "parameters", name), f"autopilot.parameters: {error}"


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
    for key in ("signing_key_file", "link_key_file"):
        file = getattr(autopilot, key)
        if file is not None:
            try:
                read_key_file(file)
            except UserError as error:
                yield ("autopilot", key), f"autopilot.{key}: {error}"


def _standby(profile: Profile, autopilot: Autopilot) -> Iterator[tuple[KeyPath, str]]:
    standby = autopilot.standby
    if standby is None or autopilot.kind == "none":
        return
    path: KeyPath = ("autopilot", "standby")
    if profile.clock is not None and profile.clock.mode == "lockstep":
        yield (
            path,
            "autopilot.standby has nothing to do in lockstep, where time stands still for an agent that is silent; "
            "use clock.mode: realtime, or leave the standby out",
        )
    if profile.driver is not None and profile.driver.kind == "ground-station":
        yield (
            path,
            "autopilot.standby would not get the mission that a ground station gives to the first agent; "
            "use driver.kind: mission, or leave the standby out",
        )
    if standby.runs != "in-process":
        if standby.link is None:
            example = "udp://192.168.8.2:14660" if standby.runs == "board" else "udp://127.0.0.1:14661"
            yield path, f"autopilot.standby.link is missing with runs = {standby.runs}; add one such as {example}"
        elif standby.link == autopilot.link and "/pty" not in standby.link and "://pty" not in standby.link:
            yield (
                (*path, "link"),
                f"autopilot.standby.link = {shown(standby.link)} is that of the first agent; give each its own",
            )
