"""Checks across groups of a profile that are valid by themselves. Each finding is a key path and a sentence."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.checks import agents, faults, fleet, graph, link, operation, sensors, view, world
from xitl_cli.profile.files.entry import KeyPath
from xitl_cli.profile.schema import Profile


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield everything in `profile`, of one vessel, that does not fit together."""
    yield from check_vessel(profile)
    yield from fleet.check_alone(profile)
    yield from operation.check_technique(profile, [profile])
    yield from view.check(profile, [profile])


def check_vessel(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield the findings on one vessel, without keys that several vessels may distribute among themselves."""
    for part in (sensors, world, operation, agents, link, faults, graph):
        yield from part.check(profile)


def check_fleet(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield the findings on all vessels together, each of which is valid by itself."""
    yield from operation.check_technique(profile, list(profile.sailed.values()))
    yield from fleet.check(profile)
    yield from view.check(profile, list(profile.sailed.values()))
