"""`world.debris`: encounters that can be drawn, and an address where launches can be heard."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile

_PATH: KeyPath = ("world", "debris")


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """What cannot be launched, or heard."""
    if profile.world is None:
        return
    debris = profile.world.debris
    encounters = debris.encounters
    if encounters.count and not encounters.kinds:
        yield (
            (*_PATH, "encounters", "kinds"),
            "world.debris.encounters.kinds is empty; name one of trunk, branch, plants, animal, or set count: 0",
        )
    if encounters.ahead_m[0] > encounters.ahead_m[1]:
        yield (
            (*_PATH, "encounters", "ahead_m"),
            f"world.debris.encounters.ahead_m = {list(encounters.ahead_m)} is from far to near; write the nearer first",
        )
    for number, launch in enumerate(debris.launches):
        if launch.length_m is not None and not 0.1 <= launch.length_m <= 50.0:
            yield (
                (*_PATH, "launches", number, "length_m"),
                f"world.debris.launches.{number}.length_m = {launch.length_m:g} is no body's; use 0.1 to 50 m",
            )
    if debris.control is not None:
        problem = problem_of_url(debris.control)
        if problem is None and not debris.control.startswith("udp://"):
            problem = "is heard by UDP alone; write it like udp://127.0.0.1:14670"
        if problem is not None:
            yield (*_PATH, "control"), f"world.debris.control = {shown(debris.control)} {problem}"
