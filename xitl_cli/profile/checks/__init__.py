"""Checks across the groups of a profile that are right in themselves. Each finding is a key path and a sentence."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.checks import agents, faults, graph, link, operation, sensors, world
from xitl_cli.profile.files.entry import KeyPath
from xitl_cli.profile.schema import Profile


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Everything in `profile` that does not go together."""
    for part in (sensors, world, operation, agents, link, faults, graph):
        yield from part.check(profile)
