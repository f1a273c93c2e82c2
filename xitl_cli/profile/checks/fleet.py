"""Checks of several vessels in one water: free starts, separate agents, and keys that a single vessel does not have."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.checks.places import Places, hull_outline
from xitl_cli.profile.files.entry import KeyPath, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.formation import Offset
from xitl_cli.profile.schema.world import WorldSpec


def check_alone(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield keys that only a vessel of a fleet has."""
    if profile.traffic is not None:
        what = "traffic is one of several vessels; write it as vessels: {barge: {traffic: {...}}}"
        yield ("traffic",), what
    if profile.driver is not None and profile.driver.kind == "follow" and profile.vehicle is not None:
        yield (
            ("driver", "kind"),
            "driver.kind = follow goes after another of `vessels`, and there are none; add vessels",
        )


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fleet without a steered vessel, occupied starts, and boards that two vessels share."""
    if not profile.sailed:
        yield ("vessels",), "vessels has scripted ones alone; add one with an autopilot, such as `own: {}`"
    yield from _starts(profile)
    yield from _boards(profile)


def _boards(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield boards that two vessels share."""
    seen: dict[str, str] = {}
    for name, vessel in profile.sailed.items():
        autopilot, companion = vessel.autopilot, vessel.companion
        links: list[tuple[KeyPath, str | None]] = []
        if autopilot is not None and autopilot.kind != "none" and autopilot.runs == "board":
            links.append((("autopilot", "link"), autopilot.link))
        if autopilot is not None and autopilot.standby is not None and autopilot.standby.runs == "board":
            links.append((("autopilot", "standby", "link"), autopilot.standby.link))
        if companion is not None and companion.runs == "board":
            links.append((("companion", "link"), companion.link))
        for path, link in links:
            other = None if link is None else seen.setdefault(link, name)
            if other not in (None, name):
                key = ".".join(map(str, path))
                yield (
                    ("vessels", name, *path),
                    f"vessels.{name}.{key} = {shown(link)} is a board of vessels.{other}; give each vessel its own",
                )


def _starts(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield hulls that overlap each other, land or fixed objects, each once."""
    places = Places(profile.world or WorldSpec())
    for name, vessel in (profile.vessels or {}).items():
        hull = hull_outline(vessel)
        if hull is None:
            continue
        if (why := places.why_taken(hull)) is not None:
            path, said = _start_path(name, vessel)
            yield path, f"{said} {why}"
        places.add(name, hull)


def _start_path(name: str, vessel: Profile) -> tuple[KeyPath, str]:
    if vessel.traffic is not None:
        place = vessel.traffic.track_ned_m[0]
        return ("vessels", name, "traffic", "track_ned_m"), f"vessels.{name}: its track's first point {_place(place)}"
    assert vessel.mission is not None
    start = vessel.mission.start
    return ("vessels", name, "mission", "start"), f"vessels.{name}: its start {_place((start.north_m, start.east_m))}"


def _place(place: Offset) -> str:
    return f"[{place[0]:g}, {place[1]:g}]"
