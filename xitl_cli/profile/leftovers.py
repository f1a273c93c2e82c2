"""Values that a profile inherited from another vessel or another site.

A profile that extends a complete one inherits missing keys. That is intended when it changes a value, but hardly when
it sets another hull or another place. Drag, windage, gains, structures and waypoints would then belong to the former
vessel or site.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from agent.fcu.mission import COMMANDS, PERFORMED
from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.files.catalogue import each_shipped_profile
from xitl_cli.profile.files.compose import compose
from xitl_cli.profile.files.entry import Entry, KeyPath, dotted
from xitl_cli.profile.reader import read_group
from xitl_cli.profile.schema import Profile

ELSEWHERE_M = 1000.0
_EARTH_M_PER_DEG = 111_000.0
_HULL = ("length_m", "width_m", "radius_m")
_OF_ANY_HULL = ("cruise_speed_mps", "strips", "surge_coefficient", "sway_coefficient", "yaw_coefficient")
_SITE = ("world", "mission", "environment", "site")
_GAINS = ("ATC_", "CRUISE_", "LOS_", "MOT", "RUD", "SERVO")
SAME_SHARE, SAME_HULL_SHARE = 0.25, 0.1
"""Largest relative differences in mass and thrust, and in hull size, for which gains still suit the vessel."""


def leftovers(profile: Profile, entry: Entry) -> Iterator[str]:
    """Yield sentences that name the inherited values, their origin, and the fix."""
    gains = list(_gains_of_vessel(profile))
    yield from _of_vessel(entry, gains_are_named=bool(gains))
    yield from gains
    yield from _without_files(profile, entry)
    yield from _of_site(entry)
    yield from _of_mission(profile)


def _of_vessel(entry: Entry, gains_are_named: bool) -> Iterator[str]:
    found = _changed_vessel(entry)
    if found is None:
        return
    now, before = found
    source = before.origin.source
    kept = [
        path
        for path, leaf in _leaves(entry.child("vehicle"), ("vehicle",))
        if leaf.origin.source == source and path[-1] not in (*_OF_ANY_HULL, "name") and leaf.value
    ]
    kept += [
        path
        for path, leaf in _leaves(entry.child("autopilot"), ("autopilot",))
        if leaf.origin.source == source
        and (
            (path[1] == "parameter_files" and leaf.value and not gains_are_named)
            or (path[1] == "parameters" and str(path[-1]).startswith(_GAINS))
        )
    ]
    if kept:
        yield (
            f"{now.origin}: the vessel is another one than that of {source}, but {_listed(kept)} still of that one; "
            "give those of this vessel, or begin from base-sitl, which has none (`xitl init`)"
        )


def _changed_vessel(entry: Entry) -> tuple[Entry, Entry] | None:
    """Return the value that makes another hull, and the value that it replaced; None without one."""
    vehicle = entry.child("vehicle")
    if vehicle is None:
        return None
    changed = {
        path: (leaf, before)
        for path in (("hull",), *(("hull", key) for key in _HULL), ("hulls",), ("name",), ("mass_kg",))
        if (leaf := _at(vehicle, path)) is not None
        and not isinstance(leaf.value, dict)
        and (before := _replaced(leaf)) is not None
    }
    for path, pair in changed.items():
        if path[0] in ("hull", "hulls"):
            return pair
    # Another name and another mass mean another boat. One of them means a version of the same boat.
    return changed[("mass_kg",)] if ("name",) in changed and ("mass_kg",) in changed else None


def _gains_of_vessel(profile: Profile) -> Iterator[str]:
    """Yield sentences on gains for another vessel. The name of a shipped file ends with that of its vessel."""
    if profile.vehicle is None or profile.autopilot is None or profile.autopilot.kind == "none":
        return
    fix = "give those of this vessel"
    if profile.autopilot.kind == "embedded":
        fix += ", or `parameter_files: []` for gains that follow from its data"
    for number, file in enumerate(profile.autopilot.parameter_files):
        if file.startswith("embedded-") and profile.autopilot.kind == "ardupilot":
            yield (
                f"autopilot.parameter_files.{number} = {file} is for the embedded autopilot, and autopilot.kind = "
                f"{profile.autopilot.kind}; name the files of that one after the vessel: see docs/ardupilot.md"
            )
            continue
        path = _vehicle_of(file)
        if path is None or (tuned := _vessel(compose(path))) is None:
            continue
        if difference := _difference(profile.vehicle, tuned):
            yield (
                f"autopilot.parameter_files.{number} = {file} has the gains of {path.stem}, and "
                f"{profile.vehicle.name} has {difference}; {fix}"
            )


def _vehicle_of(parameter_file: str) -> Path | None:
    """Return the file of the shipped vehicle whose name ends that of a parameter file."""
    vehicles = (path for name, path in each_shipped_profile() if name.startswith("vehicles/"))
    return next((path for path in vehicles if parameter_file.endswith(f"-{path.stem}")), None)


def _without_files(profile: Profile, entry: Entry) -> Iterator[str]:
    """Yield a sentence on ArduPilot without its parameter files, which a vessel for the embedded autopilot removed."""
    group = entry.child("autopilot")
    leaf = None if group is None else group.child("parameter_files")
    if leaf is None or leaf.value or profile.autopilot is None or profile.autopilot.kind != "ardupilot":
        return
    before = _replaced(leaf)
    if before is not None and isinstance(before.value, tuple) and before.value:
        names = ", ".join(str(file.value) for file in before.value)
        yield (
            f"{leaf.origin}: autopilot.parameter_files = [] leaves ArduPilot without {names}; "
            "name its files of connection, propulsion and vessel: see docs/ardupilot.md"
        )


def _of_mission(profile: Profile) -> Iterator[str]:
    """Yield sentences on items that the embedded autopilot skips, and on a fence that is not active."""
    mission, autopilot = profile.mission, profile.autopilot
    if mission is None or autopilot is None or autopilot.kind != "embedded":
        return
    passed = [
        f"{number} ({COMMANDS[item.command].name})"
        for number, item in enumerate(mission.items)
        if item.command in COMMANDS and item.command not in PERFORMED
    ]
    if passed:
        yield f"mission.items: the embedded autopilot passes over {', '.join(passed)}, as ArduRover does"
    if mission.fence and not autopilot.parameters.get("FENCE_ENABLE") and not autopilot.parameter_files:
        yield "mission.fence is uploaded and not in force; set autopilot.parameters.FENCE_ENABLE to 1"


def _vessel(entry: Entry) -> VesselSpec | None:
    group = entry.child("vehicle")
    try:
        return None if group is None else read_group(group, VesselSpec, "vehicle")
    except UserError:
        return None


def _difference(vessel: VesselSpec, tuned: VesselSpec) -> str:
    """Return the difference that makes it another vessel; empty without one."""
    for what, unit, share, own, other in (
        ("a hull of", "m", SAME_HULL_SHARE, vessel.length_m, tuned.length_m),
        ("a width of", "m", SAME_HULL_SHARE, vessel.width_m, tuned.width_m),
        ("a mass of", "kg", SAME_SHARE, vessel.mass_kg, tuned.mass_kg),
        ("a thrust of", "N", SAME_SHARE, _thrust_n(vessel), _thrust_n(tuned)),
    ):
        if abs(own - other) > share * other:
            return f"{what} {own:g} {unit}, not {other:g}"
    return ""


def _thrust_n(vessel: VesselSpec) -> float:
    return sum(propeller.static_thrust_n(Water().density_kgpm3)[0] for propeller in vessel.propellers)


def _of_site(entry: Entry) -> Iterator[str]:
    moved = _moved_site(entry)
    if moved is None:
        return
    now, before, distance_m = moved
    source = before.origin.source
    kept: list[KeyPath] = []
    for group in _SITE:
        for path, leaf in _leaves(entry.child(group), (group,)):
            if leaf.origin.source == source and leaf.value not in (None, False, ()) and _of_place(path):
                kept.append(path)
    if kept:
        yield (
            f"{now.origin}: the site is {distance_m / 1000:.0f} km from that of {source}, but {_listed(kept)} still of "
            "that one; give yours, set what is not there to null, or begin from base-sitl, which has none (`xitl init`)"
        )


def _of_place(path: KeyPath) -> bool:
    """Whether a value depends on the place of the origin."""
    group, key = path[0], str(path[-1])
    return {
        "site": key in ("altitude_m", "magnetic_field_ned_gauss"),
        "world": path[1] not in ("contact", "debris"),
        "mission": key in ("waypoints_ned_m", "items", "fence", "rally"),
        "environment": "channel" in key,
    }[str(group)]


def _moved_site(entry: Entry) -> tuple[Entry, Entry, float] | None:
    """Return the coordinate that moves the site, the coordinate that it replaced, and the distance."""
    site = entry.child("site")
    latitude, longitude = (None if site is None else site.child(key) for key in ("latitude_deg", "longitude_deg"))
    if latitude is None or longitude is None:
        return None
    changed = [(leaf, before) for leaf in (latitude, longitude) if (before := _replaced(leaf)) is not None]
    if not changed:
        return None
    north_m, east_m = (_moved_deg(leaf) * _EARTH_M_PER_DEG for leaf in (latitude, longitude))
    distance_m = math.hypot(north_m, east_m * math.cos(math.radians(_number(latitude))))
    return (*changed[0], distance_m) if distance_m > ELSEWHERE_M else None


def _moved_deg(leaf: Entry) -> float:
    before = _replaced(leaf)
    return 0.0 if before is None else _number(leaf) - _number(before)


def _number(leaf: Entry) -> float:
    assert isinstance(leaf.value, (int, float))
    return float(leaf.value)


def _replaced(leaf: Entry) -> Entry | None:
    """Return the different value that this value replaced, if any."""
    before = leaf.replaced
    while before is not None:
        if before.value is not None and before.plain() != leaf.plain():
            return before
        before = before.replaced
    return None


def _at(entry: Entry, path: tuple[str, ...]) -> Entry | None:
    found, depth = entry.nearest(path)
    return found if depth == len(path) else None


def _leaves(entry: Entry | None, path: KeyPath) -> Iterator[tuple[KeyPath, Entry]]:
    """Yield scalars and lists with their paths."""
    if entry is None:
        return
    if isinstance(entry.value, dict):
        for key, below in entry.value.items():
            yield from _leaves(below, (*path, key))
    else:
        yield path, entry


def _listed(paths: list[KeyPath]) -> str:
    """Return groups of two keys, each once, with the verb."""
    names = list(dict.fromkeys(dotted(path[:2]) for path in paths))
    text = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    return f"{text} {'is' if len(names) == 1 else 'are'}"
