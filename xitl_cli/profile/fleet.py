"""`vessels`: each entry is laid on the profile's groups, read as a profile, and repeated by its count.

shared groups ── laid under ──> entry ── read, checked ──> Profile ── unfolded by count ──> follower_1, follower_2 …
"""

from __future__ import annotations

import difflib
import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace

from sim_core.dataclass import dataclass
from sim_core.world.spec import LAST_MMSI, AisSpec
from xitl_cli.profile.checks.fleet import Places, hull_outline
from xitl_cli.profile.files.compose import OWN_KEYS, at_speed_of_vessel, laid_on
from xitl_cli.profile.files.entry import Entry, Problem, ProfileError, dotted, merge
from xitl_cli.profile.reader import Reader
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.agents import MOST_VESSELS, MissionSpec, StartSpec
from xitl_cli.profile.schema.fleet import (
    SAILED,
    Offset,
    SeveralSpec,
    ahead_of,
    formation_offsets,
    in_forward_starboard,
    in_north_east,
    spread_offsets,
)
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.profile.schema.world import WorldSpec

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_SEVERAL = tuple(field.name for field in fields(SeveralSpec))
_OF_A_VESSEL = (*SAILED, "traffic", *_SEVERAL)
_OF_ALL = tuple(field.name for field in fields(Profile) if field.name not in (*_OF_A_VESSEL, *OWN_KEYS, "vessels"))


@dataclass(frozen=True, slots=True)
class FleetEntry:
    """An entry of `vessels`."""

    name: str
    written: Entry
    """The entry with the parts that it extends."""
    entry: Entry
    """`written` laid on the shared groups."""
    profile: Profile
    """The profile that `entry` gives."""
    several: SeveralSpec
    """The keys for several vessels in one entry."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vessels that the entry creates."""
        if self.several.count is None:
            return (self.name,)
        return tuple(f"{self.name}_{number}" for number in range(1, self.several.count + 1))

    @property
    def key(self) -> str:
        """Path of the entry in the profile."""
        return f"vessels.{self.name}"

    def says(self, *path: str) -> bool:
        """Whether the entry, or a part that it extends, has a key."""
        return self.written.nearest(path)[1] == len(path)

    def gives(self, *path: str) -> bool:
        """Whether the entry or the shared groups have a key."""
        return self.entry.nearest(path)[1] == len(path)


def is_fleet(entry: Entry) -> bool:
    """Whether a composed profile has `vessels`."""
    vessels = entry.child("vessels")
    return vessels is not None and vessels.value is not None


def read_fleet(entry: Entry, name: str) -> tuple[Profile, list[FleetEntry]]:
    """Return the shared profile and the entries of `vessels`, each valid by itself. `name`: name of the profile.

    Raises ProfileError with all problems.
    """
    assert isinstance(entry.value, dict)
    shared = Entry({key: value for key, value in entry.value.items() if key != "vessels"}, entry.origin)
    written = _written(entry.value["vessels"], name)
    reader = Reader()
    profile = reader.read(at_speed_of_vessel(shared), Profile, ())
    entries = [_read(reader, vessel, shared, own) for vessel, own in written.items()]
    reader.refuse(name)
    assert profile is not None
    return profile, [fleet_entry for fleet_entry in entries if fleet_entry is not None]


def _written(vessels: Entry, name: str) -> dict[str, Entry]:
    """Return the written entry of each vessel, and check that it has no keys of the whole fleet."""
    if not isinstance(vessels.value, dict):
        sentence = "vessels is not a group; write vessels: {leader: {}, other: {}}, each with its own keys"
        raise ProfileError([Problem(vessels.origin, sentence)], name)
    problems: list[Problem] = []
    written: dict[str, Entry] = {}
    for vessel, own in vessels.value.items():
        path = dotted(("vessels", vessel))
        if own.value is None and own.replaced is not None:
            continue  # null removes an inherited vessel
        own = Entry({}, own.origin) if own.value is None else own
        if not _NAME.fullmatch(vessel):
            rule = "use small letters, digits and _, with a letter first, because it is the prefix of topics"
            problems.append(Problem(own.origin, f"{path} is not a valid name of a vessel; {rule}"))
        elif not isinstance(own.value, dict):
            problems.append(Problem(own.origin, f"{path} is not a group; write {{}} for the vessel of the profile"))
        else:
            problems += _foreign_keys(own, path)
            written[vessel] = own
    if not problems and not written:
        problems = [Problem(vessels.origin, "vessels is empty; add one, such as `leader: {}`, or remove the key")]
    if problems:
        raise ProfileError(problems, name)
    return written


def _foreign_keys(own: Entry, path: str) -> Iterator[Problem]:
    """Yield keys that are the same for all vessels, and keys that a scripted vessel does not have."""
    assert isinstance(own.value, dict)
    scripted = _is_scripted(own)
    of_all = {key: value for key, value in own.value.items() if key in (*_OF_ALL, *OWN_KEYS, "vessels")}
    extended = [key for key, value in of_all.items() if value.origin.line and value.origin.source != own.origin.source]
    if extended:
        fix = "extend profiles without them, such as vehicles/otter"
        sentence = f"{path} extends a profile with {_listed(extended)}, which must be the same for all vessels; {fix}"
        yield Problem(own.origin, sentence)
    for key, value in own.value.items():
        if key in extended:
            continue
        if key in of_all:
            sentence = f"{path}.{key} must be the same for all vessels; move it out of `vessels`"
            yield Problem(value.origin, sentence)
        elif key not in _OF_A_VESSEL:
            close = difflib.get_close_matches(key, _OF_A_VESSEL, n=1)
            fix = f"did you mean {close[0]!r}?" if close else f"known keys: extends, {', '.join(_OF_A_VESSEL)}"
            yield Problem(value.origin, f"{path}.{dotted((key,))} is not a known key; {fix}")
        elif scripted and key in SAILED:
            hint = "; its AIS is traffic.ais" if key == "ais" else ""
            sentence = f"{path}.{key} has no effect on scripted traffic; remove {key} or traffic{hint}"
            yield Problem(value.origin, sentence)


def _read(reader: Reader, vessel: str, shared: Entry, written: Entry) -> FleetEntry | None:
    assert isinstance(written.value, dict)
    assert isinstance(shared.value, dict)
    path = ("vessels", vessel)
    own = {key: value for key, value in written.value.items() if key not in _SEVERAL}
    several = {key: value for key, value in written.value.items() if key in _SEVERAL}
    below = shared.value
    if _is_scripted(written):
        below = {key: value for key, value in shared.value.items() if key in OWN_KEYS}
    entry = laid_on(Entry(below, written.origin), Entry(own, written.origin))
    entry = at_speed_of_vessel(entry)
    how_many = reader.read(Entry(several, written.origin), SeveralSpec, path)
    profile = reader.read(entry, Profile, path)
    if how_many is None or profile is None:
        return None
    return FleetEntry(vessel, written, entry, profile, how_many)


def _is_scripted(written: Entry) -> bool:
    traffic = written.child("traffic")
    return traffic is not None and traffic.value is not None


def unfold(entries: list[FleetEntry], name: str) -> dict[str, Profile]:
    """Return the vessels of the entries, by name and in their order, with their places and ids.

    Raises ProfileError for duplicate names, for a vessel that follows none or itself, for places without space, and for
    duplicate or too high ids.
    """
    by_name: dict[str, FleetEntry] = {}
    duplicates: dict[str, Problem] = {}
    for entry in entries:
        for vessel in entry.names:
            other = by_name.setdefault(vessel, entry)
            if other is not entry:
                single, many = (entry, other) if entry.several.count is None else (other, entry)
                sentence = (
                    f"vessels.{single.name} is also created by the count of vessels.{many.name}; rename one of them"
                )
                duplicates.setdefault(entry.name, Problem(single.written.origin, sentence))
    _refuse(iter(duplicates.values()), name)
    _refuse(_wrong_leaders(entries, by_name), name)
    placed: dict[str, Profile] = {}
    for entry in sorted(entries, key=lambda entry: entry.several.spread is not None):  # random places avoid the others
        _place(entry, by_name, placed, name)
    ordered = {vessel: placed[vessel] for vessel in by_name}
    return _numbered(entries, ordered, name)


def _refuse(problems: Iterator[Problem], name: str) -> None:
    if listed := list(problems):
        raise ProfileError(listed, name)


def _wrong_leaders(entries: list[FleetEntry], by_name: Mapping[str, FleetEntry]) -> Iterator[Problem]:
    """Yield leaders that are missing, scripted, or followers of their follower."""
    for entry in entries:
        vessel = _leader(entry)
        if vessel is None:
            continue
        origin = entry.entry.nearest(("driver", "follow", "vessel"))[0].origin
        key = f"{entry.key}.driver.follow.vessel = {vessel}"
        leader = by_name.get(vessel)
        if leader is None:
            many = next((other for other in entries if other.name == vessel), None)
            names = [other for other in by_name if by_name[other] is not entry]
            if many:
                hint = f"{vessel} is {many.names[0]} to {many.names[-1]}; use one of them"
            elif names:
                few = names if len(names) <= 6 else [*names[:5], f"{len(names) - 5} more"]
                hint = f"use {_listed(few, 'or')}"
            else:
                hint = "add a second vessel"
            yield Problem(origin, f"{key} is not one of the vessels; {hint}")
            continue
        if leader.profile.traffic is not None:
            sentence = f"{key} is scripted and reports no position; follow a vessel with an autopilot"
            yield Problem(origin, sentence)
            continue
        chain = [entry]
        while leader is not None and leader not in chain:
            chain.append(leader)
            next_leader = _leader(leader)
            leader = None if next_leader is None else by_name.get(next_leader)
        if leader is entry:
            loop = " -> ".join(follower.name for follower in (*chain, entry))
            yield Problem(origin, f"{key} is a circular reference: {loop}; give one of them a mission")


def _leader(entry: FleetEntry) -> str | None:
    driver = entry.profile.driver
    return driver.follow.vessel if driver is not None and driver.kind == "follow" and driver.follow else None


def _listed(words: list[str], between: str = "and") -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {between} {words[-1]}"


def _place(entry: FleetEntry, by_name: Mapping[str, FleetEntry], placed: dict[str, Profile], name: str) -> None:
    """Add the vessels of an entry to `placed`, after the vessels that they follow."""
    if entry.names[0] in placed:
        return
    profile, driver = entry.profile, entry.profile.driver
    vessel = _leader(entry)
    if vessel is not None and driver is not None and driver.follow is not None:
        _place(by_name[vessel], by_name, placed, name)
        mission, start = profile.mission or MissionSpec(), (placed[vessel].mission or MissionSpec()).start
        if not entry.says("mission", "start"):
            place = ahead_of((start.north_m, start.east_m), start.heading_deg, driver.follow.offset_frd_m)
            mission = replace(mission, start=StartSpec(_to_mm(place[0]), _to_mm(place[1]), start.heading_deg))
        profile = replace(profile, mission=replace(mission, waypoints_ned_m=(), items=()))
    if entry.several.count is None:
        placed[entry.name] = profile
        return
    # The heading at the start; for a scripted vessel, that of the first leg of its track.
    if profile.traffic is None:
        heading_deg = (profile.mission or MissionSpec()).start.heading_deg
    elif len(profile.traffic.track_ned_m) == 1:
        heading_deg = profile.traffic.heading_deg or 0.0
    else:
        (north_m, east_m), (to_north_m, to_east_m) = profile.traffic.track_ned_m[:2]
        heading_deg = math.degrees(math.atan2(to_east_m - east_m, to_north_m - north_m))
    group = entry.several.formation or entry.several.spread
    for vessel, offset in zip(entry.names, _offsets(entry, profile, heading_deg, placed, name), strict=True):
        placed[vessel] = _shifted(profile, offset, heading_deg, group is not None and group.waypoints == "shifted")


def _offsets(
    entry: FleetEntry, profile: Profile, heading_deg: float, placed: Mapping[str, Profile], name: str
) -> list[Offset]:
    """Return the offset of each vessel from the entry's place, north and east.

    Raises ProfileError without enough space.
    """
    count, formation, spread = entry.several.count or 1, entry.several.formation, entry.several.spread
    if formation is not None:
        ahead = formation_offsets(formation.shape, count, formation.spacing_m)
        return [in_north_east(offset, heading_deg) for offset in ahead]
    if spread is None:
        return [(0.0, 0.0)]
    seed = (profile.clock or ClockSpec()).seed
    places = Places(profile.world or WorldSpec())
    for vessel, other in placed.items():
        if (hull := hull_outline(other)) is not None:
            places.add(vessel, hull)
    middle = hull_outline(profile)

    def free(offset_m: Offset) -> bool:
        return middle is None or places.why_taken(tuple(_moved(corner, offset_m) for corner in middle)) is None

    offsets = spread_offsets(count, spread.radius_m, spread.apart_m, f"{seed}/{entry.name}/spread", free)
    if offsets is not None:
        return offsets
    lack = f"no room for {count} vessels {spread.apart_m:g} m apart within {spread.radius_m:g} m"
    sufficient_m = max(math.ceil(spread.apart_m * math.sqrt(count)), math.ceil(1.5 * spread.radius_m))
    fix = f"use radius_m: {sufficient_m}, fewer vessels or another start"
    origin = entry.written.nearest(("spread",))[0].origin
    raise ProfileError([Problem(origin, f"{entry.key}.spread has {lack}; {fix}")], name)


def _moved(place: Offset, by: Offset) -> Offset:
    return place[0] + by[0], place[1] + by[1]


def _to_mm(coordinate_m: float) -> float:
    """Round to written precision; never -0."""
    return round(coordinate_m, 3) + 0.0


def _shifted(profile: Profile, offset_ne_m: Offset, heading_deg: float, with_waypoints: bool) -> Profile:
    """Return the vessel at an offset from the entry's place.

    Its waypoints, or its place relative to the leader, move along.
    """

    def moved(place: Offset) -> Offset:
        north_m, east_m = _moved(place, offset_ne_m)
        return _to_mm(north_m), _to_mm(east_m)

    if profile.traffic is not None:
        track = tuple(map(moved, profile.traffic.track_ned_m))
        return replace(profile, traffic=replace(profile.traffic, track_ned_m=track))
    mission, driver = profile.mission or MissionSpec(), profile.driver
    start = StartSpec(*moved((mission.start.north_m, mission.start.east_m)), mission.start.heading_deg)
    mission = replace(mission, start=start)
    if with_waypoints:
        mission = mission.moved(moved)
        if driver is not None and driver.follow is not None:
            ahead = in_forward_starboard(offset_ne_m, heading_deg)
            place = driver.follow.offset_frd_m
            offset_frd_m = _to_mm(place[0] + ahead[0]), _to_mm(place[1] + ahead[1])
            follow = replace(driver.follow, offset_frd_m=offset_frd_m)
            driver = replace(driver, follow=follow)
    return replace(profile, mission=mission, driver=driver)


def _numbered(entries: list[FleetEntry], placed: Mapping[str, Profile], name: str) -> dict[str, Profile]:
    """Add system ids and MMSI. Given ids count up within an entry; the other ids are the lowest free ones."""
    written_ids: dict[str, int] = {}
    mmsi: dict[str, int] = {}
    for entry in entries:
        profile = entry.profile
        ais = profile.ais if profile.traffic is None else profile.traffic.ais
        for number, vessel in enumerate(entry.names):
            if profile.autopilot is not None and entry.gives("autopilot", "system_id"):
                written_ids[vessel] = profile.autopilot.system_id + number
            if ais is not None and ais.mmsi is not None:
                mmsi[vessel] = ais.mmsi + number
    free = (number for number in itertools.count(1) if number not in written_ids.values())
    ids = {
        vessel: written_ids.get(vessel) or next(free)
        for vessel, profile in placed.items()
        if profile.autopilot is not None
    }
    by_name = {vessel: entry for entry in entries for vessel in entry.names}
    _refuse(_wrong_ids(ids, ("autopilot", "system_id"), MOST_VESSELS, by_name), name)
    _refuse(_wrong_ids(mmsi, ("ais", "mmsi"), LAST_MMSI, by_name), name)
    numbered = {}
    for vessel, profile in placed.items():
        if profile.autopilot is not None:
            profile = replace(profile, autopilot=replace(profile.autopilot, system_id=ids[vessel]))
        if vessel in mmsi and profile.traffic is not None:
            ais = replace(profile.traffic.ais, mmsi=mmsi[vessel])
            profile = replace(profile, traffic=replace(profile.traffic, ais=ais))
        elif vessel in mmsi:
            profile = replace(profile, ais=replace(profile.ais or AisSpec(), mmsi=mmsi[vessel]))
        numbered[vessel] = profile
    return numbered


def _wrong_ids(
    ids: Mapping[str, int], path: tuple[str, str], most: int, by_name: Mapping[str, FleetEntry]
) -> Iterator[Problem]:
    """Yield ids of two vessels, and ids beyond the largest possible one."""
    seen: dict[int, str] = {}
    for vessel, number in ids.items():
        origin = by_name[vessel].entry.nearest(path)[0].origin
        key = f"vessels.{vessel}.{dotted(path)} = {number}"
        if number > most:
            yield Problem(origin, f"{key} is above the largest id, {most}; use fewer vessels or lower ids")
            return
        other = seen.setdefault(number, vessel)
        if other != vessel:
            yield Problem(origin, f"{key} is also the id of {other}; use different ids, or remove the key")


def unfolded_entry(entry: Entry, entries: list[FleetEntry], vessels: Mapping[str, Profile]) -> Entry:
    """Return `entry` with the unfolded vessels, for the origin of each value.

    A moved place has its formation's origin.
    """
    assert isinstance(entry.value, dict)
    unfolded: dict[str, Entry] = {}
    for fleet_entry in entries:
        for vessel in fleet_entry.names:
            assert isinstance(fleet_entry.entry.value, dict)
            unfolded[vessel] = fleet_entry.entry
            group = fleet_entry.written.child("formation") or fleet_entry.written.child("spread")
            mission = vessels[vessel].mission
            if group is not None and mission is not None:
                at = group.origin
                start = {key.name: Entry(getattr(mission.start, key.name), at) for key in fields(mission.start)}
                moved = Entry({"mission": Entry({"start": Entry(start, at)}, at)}, fleet_entry.entry.origin)
                unfolded[vessel] = merge(fleet_entry.entry, moved)
    return Entry({**entry.value, "vessels": Entry(unfolded, entry.value["vessels"].origin)}, entry.origin)
