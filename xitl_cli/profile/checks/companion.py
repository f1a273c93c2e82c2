"""A companion that can be reached, with settings that it has, beside an autopilot that it can serve."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import urlsplit

from agent.companion.settings import checked_parameter
from agent.fcu.parameters import ParameterError
from xitl_cli.profile.checks.link import misplaced, problem_of_url
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.companion import Companion

FAST = ("udp", "tcp")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A link that is missing, is none, is too slow or another's; settings that do not exist; nobody to serve."""
    companion = profile.companion
    if companion is None:
        return
    if profile.autopilot is not None and profile.autopilot.kind == "none":
        yield (
            ("companion",),
            "companion: there is no autopilot for it to hear and to give orders to; "
            "use autopilot.kind = embedded, or leave it out",
        )
    yield from _link(profile, companion)
    for name, value in companion.parameters.items():
        try:
            checked_parameter(name, value)
        except ParameterError as error:
            yield ("companion", "parameters", name), f"companion.parameters: {error}"


def _link(profile: Profile, companion: Companion) -> Iterator[tuple[KeyPath, str]]:
    path, link, runs = ("companion", "link"), companion.link, companion.runs
    if link is None:
        if runs != "in-process":
            example = "udp://192.168.55.1:14661" if runs == "board" else "udp://127.0.0.1:14661"
            yield path, f"companion.link is missing with companion.runs = {runs}; add one such as {example}"
        return
    problem = problem_of_url(link) or misplaced(urlsplit(link), "companion.runs", runs)
    scheme = urlsplit(link).scheme if problem is None else ""
    sensors = profile.sensors
    if scheme and scheme not in FAST and sensors is not None and sensors.lidar is not None and runs != "in-process":
        most = sensors.lidar.points_hz * 10.3 / 1e6
        problem = f"is too slow for the clouds of sensors.lidar, up to {most:.1f} MB/s; use udp:// or tcp://"
    if problem is None and runs != "in-process" and profile.autopilot is not None and profile.autopilot.link == link:
        problem = "is the autopilot's too; give each a port of its own"
    if problem is not None:
        yield path, f"companion.link = {shown(link)} {problem}"
