"""Checks across the keys of a profile whose single values are right. Each finding is a key path and a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from xitl_cli.profile.checks import (
    autopilot,
    bridge,
    companion,
    debris,
    environment,
    faults,
    graph,
    link,
    operation,
    place,
    rates,
    sensors,
    sonar,
    vehicle,
)
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.schema import Profile

Finding: TypeAlias = tuple[KeyPath, str]


def check(profile: Profile) -> Iterator[Finding]:
    """Everything in `profile` that does not go together."""
    yield from rates.check(profile)
    yield from sensors.check(profile)
    yield from sonar.check(profile)
    yield from vehicle.check(profile)
    yield from environment.check(profile)
    yield from operation.check(profile)
    yield from place.check(profile)
    yield from autopilot.check(profile)
    yield from bridge.check(profile)
    yield from link.check(profile)
    yield from companion.check(profile)
    yield from debris.check(profile)
    yield from faults.check(profile)
    yield from graph.check(profile)
