"""Values that a profile inherited from another vessel or another site.

A profile that extends a complete one inherits missing keys. That is intended when it changes a value, but hardly when
it sets another hull or another place. Drag, windage, gains, structures and waypoints would then belong to the former
vessel or site.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

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
    # ArduPilot without its parameter files, which a vessel for the embedded autopilot removed.
    autopilot, mission = profile.autopilot, profile.mission
    group = entry.child("autopilot")
    files = None if group is None else group.child("parameter_files")
    if files is not None and not files.value and autopilot is not None and autopilot.kind == "ardupilot":
        before = _replaced(files)
        if before is not None and isinstance(before.value, tuple) and before.value:
            names = ", ".join(str(file.value) for file in before.value)
            yield (
                f"{files.origin}: autopilot.parameter_files = [] removes {names} from ArduPilot; "
                "name its files for connection, propulsion and vessel (docs/ardupilot.md)"
            )
    yield from _of_site(entry)
    # Items that the embedded autopilot skips, and a fence that is not active.
    if mission is None or autopilot is None or autopilot.kind != "embedded":
        return
    skipped = [
        f"{number} ({COMMANDS[item.command].name})"
        for number, item in enumerate(mission.items)
        if item.command in COMMANDS and item.command not in PERFORMED
    ]
    if skipped:
        yield f"mission.items: the embedded autopilot skips {', '.join(skipped)}, like ArduRover"
    if mission.fence and not autopilot.parameters.get("FENCE_ENABLE") and not autopilot.parameter_files:
        yield "mission.fence is uploaded but not active; set autopilot.parameters.FENCE_ENABLE to 1"


def _of_vessel(entry: Entry, gains_are_named: bool) -> Iterator[str]:
    changed = _changed_vessel(entry)
    if changed is None:
        return
    now, before = changed
    source = before.origin.source
    inherited = [
        path
        for path, leaf in _leaves(entry.child("vehicle"), ("vehicle",))
        if leaf.origin.source == source and path[-1] not in (*_OF_ANY_HULL, "name") and leaf.value
    ]
    inherited += [
        path
        for path, leaf in _leaves(entry.child("autopilot"), ("autopilot",))
        if leaf.origin.source == source
        and (
            (path[1] == "parameter_files" and leaf.value and not gains_are_named)
            or (path[1] == "parameters" and str(path[-1]).startswith(_GAINS))
        )
    ]
    if inherited:
        yield (
            f"{now.origin}: this is another vessel than in {source}, but {_listed(inherited)} still inherited from "
            "there; set the values of this vessel, or start from base-sitl, which has none (`xitl init`)"
        )


def _changed_vessel(entry: Entry) -> tuple[Entry, Entry] | None:
    """Return the value that makes another hull, and the value that it replaced; None without one."""
    vehicle = entry.child("vehicle")
    if vehicle is None:
        return None
    changed: dict[tuple[str, ...], tuple[Entry, Entry]] = {}
    for path in (("hull",), *(("hull", key) for key in _HULL), ("hulls",), ("name",), ("mass_kg",)):
        leaf, depth = vehicle.nearest(path)
        before = _replaced(leaf)
        if depth == len(path) and not isinstance(leaf.value, dict) and before is not None:
            if path[0] in ("hull", "hulls"):
                return leaf, before
            changed[path] = leaf, before
    # Another name and another mass mean another boat. One of them means a version of the same boat.
    return changed[("mass_kg",)] if ("name",) in changed and ("mass_kg",) in changed else None


def _gains_of_vessel(profile: Profile) -> Iterator[str]:
    """Yield sentences on gains for another vessel. The name of a shipped file ends with that of its vessel."""
    if profile.vehicle is None or profile.autopilot is None or profile.autopilot.kind == "none":
        return
    fix = "use the gains of this vessel"
    if profile.autopilot.kind == "embedded":
        fix += ", or `parameter_files: []` for gains computed from its data"
    for number, file in enumerate(profile.autopilot.parameter_files):
        if file.startswith("embedded-") and profile.autopilot.kind == "ardupilot":
            yield (
                f"autopilot.parameter_files.{number} = {file} is for the embedded autopilot, but autopilot.kind = "
                f"{profile.autopilot.kind}; use that autopilot's file for this vessel (docs/ardupilot.md)"
            )
            continue
        # The shipped vessel whose name ends that of the file.
        vehicles = (path for name, path in each_shipped_profile() if name.startswith("vehicles/"))
        path = next((path for path in vehicles if file.endswith(f"-{path.stem}")), None)
        group = None if path is None else compose(path).child("vehicle")
        if path is None or group is None:
            continue
        try:
            tuned = read_group(group, VesselSpec, "vehicle")
        except UserError:
            continue
        if difference := _difference(profile.vehicle, tuned):
            yield (
                f"autopilot.parameter_files.{number} = {file} has the gains of {path.stem}, but "
                f"{profile.vehicle.name} has {difference}; {fix}"
            )


def _difference(vessel: VesselSpec, tuned: VesselSpec) -> str:
    """Return the difference that makes it another vessel; empty without one."""
    for quantity, unit, share, own, other in (
        ("a hull of", "m", SAME_HULL_SHARE, vessel.length_m, tuned.length_m),
        ("a width of", "m", SAME_HULL_SHARE, vessel.width_m, tuned.width_m),
        ("a mass of", "kg", SAME_SHARE, vessel.mass_kg, tuned.mass_kg),
        ("a thrust of", "N", SAME_SHARE, _thrust_n(vessel), _thrust_n(tuned)),
    ):
        if abs(own - other) > share * other:
            return f"{quantity} {own:g} {unit}, not {other:g}"
    return ""


def _thrust_n(vessel: VesselSpec) -> float:
    return sum(propeller.static_thrust_n(Water().density_kgpm3)[0] for propeller in vessel.propellers)


def _of_site(entry: Entry) -> Iterator[str]:
    # The coordinate that moves the site, and the distance.
    site = entry.child("site")
    latitude, longitude = (None if site is None else site.child(key) for key in ("latitude_deg", "longitude_deg"))
    if latitude is None or longitude is None:
        return
    replaced = [(leaf, _replaced(leaf)) for leaf in (latitude, longitude)]
    changed = [(leaf, before) for leaf, before in replaced if before is not None]
    if not changed:
        return
    north_m, east_m = (
        0.0 if before is None else (_number(leaf) - _number(before)) * _EARTH_M_PER_DEG for leaf, before in replaced
    )
    distance_m = math.hypot(north_m, east_m * math.cos(math.radians(_number(latitude))))
    if distance_m <= ELSEWHERE_M:
        return
    now, before = changed[0]
    source = before.origin.source
    inherited: list[KeyPath] = []
    for group in _SITE:
        for path, leaf in _leaves(entry.child(group), (group,)):
            if leaf.origin.source == source and leaf.value not in (None, False, ()) and _of_place(path):
                inherited.append(path)
    if inherited:
        yield (
            f"{now.origin}: the site is {distance_m / 1000:.0f} km from the site of {source}, but {_listed(inherited)} "
            "still inherited from there; set your values, set absent things to null, or start from base-sitl, which "
            "has none (`xitl init`)"
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
