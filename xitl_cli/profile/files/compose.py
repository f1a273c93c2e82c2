"""Composition: `extends:` (later ones override, and the file itself overrides all) and `--set` overrides.

Groups merge key by key, but a complete vessel replaces the former one. The profiles that an entry of `vessels` extends
are laid under that entry.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from sim_core.keys import required_keys
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.files.catalogue import find_profile, profile_name, shown_path
from xitl_cli.profile.files.entry import Entry, Origin, dotted, merge, profile_error, shown
from xitl_cli.profile.files.renamed_keys import override_with_new_names, with_new_names
from xitl_cli.profile.files.yaml_file import parse_yaml, read_yaml

OWN_KEYS = ("name", "description")  # describe one profile; not inherited
_DEGREES = ("lat", "lon", "latitude_deg", "longitude_deg")
_RIVALS: dict[tuple[str, ...], dict[str, tuple[str, ...]]] = {
    ("mission",): {
        "waypoints_ned_m": ("file", "items"),
        "items": ("file", "waypoints_ned_m"),
        "file": ("waypoints_ned_m", "items", "fence", "rally"),
    },
    ("environment", "water", "tide"): {
        "constituents": ("table", "file"),
        "table": ("constituents", "file"),
        "file": ("constituents", "table"),
    },
    ("environment", "current", "tide"): {"constituents": ("peak_mps", "lag_min"), "peak_mps": ("constituents",)},
    ("mission", "start"): {
        **dict.fromkeys(("north_m", "east_m"), _DEGREES),
        **dict.fromkeys(_DEGREES[:2], ("north_m", "east_m", *_DEGREES[2:])),
        **dict.fromkeys(_DEGREES[2:], ("north_m", "east_m", *_DEGREES[:2])),
    },
}
"""By group: keys with the same meaning as others, and the inherited keys that they replace."""


def compose(path: Path) -> Entry:
    """Return the profile in the file at `path` with all extended profiles merged.

    It has no `extends`, and it has a `name`.
    """
    name = profile_name(path)
    merged = _composed(path, ())
    assert isinstance(merged.value, dict)
    return Entry({"name": Entry(name, merged.origin), **merged.value}, merged.origin)


def override(profile: Entry, overrides: Iterable[str]) -> Entry:
    """Return `profile` with each `KEY.PATH=VALUE` applied. VALUE is YAML; a number in the path is a list index."""
    for text in overrides:
        key, equals, value_text = text.partition("=")
        origin = Origin(f"--set {key.strip()}")
        keys = [part.strip() for part in key.split(".")]
        if not equals or not all(keys):
            raise UserError(
                f"--set {shown(text)} is not KEY=VALUE; write for example --set environment.wind.mean_mps=8"
            )
        if keys[0] == "extends":
            raise profile_error(
                origin, "extends cannot be set from the command line; write a profile file that extends both"
            )
        value = parse_yaml(value_text, str(origin), first_line=None) or Entry(None, origin)
        keys, value = override_with_new_names(keys, value)
        profile = _placed(profile, keys, 0, value)
    return profile


def lay_on(profile: Entry, part: Path) -> Entry:
    """Return `profile` with the part in the file at `part` laid on it, as if a file extended both."""
    laid = _composed(part, ())
    assert isinstance(laid.value, dict)
    return laid_on(
        profile, Entry({key: value for key, value in laid.value.items() if key not in OWN_KEYS}, laid.origin)
    )


def place(profile: Entry, key: str, value: Entry) -> Entry:
    """Return `profile` with a value merged in at a dotted key; a number in it is a list index."""
    keys = [part.strip() for part in key.split(".")]
    if not all(keys):
        raise profile_error(value.origin, f"{shown(key)} is not a key; write for example environment.wind.mean_mps")
    if keys[0] == "extends":
        raise profile_error(
            value.origin, "extends cannot be set; merge a part into the profile, or extend both in a file"
        )
    keys, value = override_with_new_names(keys, value)
    return _placed(profile, keys, 0, value)


def _composed(path: Path, chain: tuple[Path, ...]) -> Entry:
    entry = with_new_names(read_yaml(path, shown_path(path)))
    inherits = (*chain, path.resolve())
    assert isinstance(entry.value, dict)
    vessels = entry.value.get("vessels")
    if vessels is not None and isinstance(vessels.value, dict):
        composed = {name: _extended(vessel, path, inherits) for name, vessel in vessels.value.items()}
        entry = Entry({**entry.value, "vessels": Entry(composed, vessels.origin)}, entry.origin)
    return _extended(entry, path, inherits)


def _extended(entry: Entry, path: Path, chain: tuple[Path, ...]) -> Entry:
    """Return `entry` of the file at `path`, laid on the profiles that it extends.

    `chain`: files that led to this one.
    """
    if not isinstance(entry.value, dict) or "extends" not in entry.value:
        return entry
    below: Entry | None = None
    extends = entry.value["extends"]
    names = extends.value if isinstance(extends.value, tuple) else (extends,)
    for name in names:
        if not isinstance(name.value, str):
            sentence = f"extends = {shown(name.plain())} is not a profile; write a name or a list of names"
            raise profile_error(name.origin, sentence)
    for name in names:
        try:
            base_path = find_profile(str(name.value), beside=path.parent)
        except (UserError, ValueError, OSError) as error:
            raise profile_error(name.origin, f"extends = {shown(name.value)}: {error}") from None
        if base_path.resolve() in chain:
            turns = [*chain, base_path.resolve()]
            loop = " -> ".join(shown_path(turn) for turn in turns[turns.index(base_path.resolve()) :])
            sentence = f"extends = {shown(name.value)} is a circular reference: {loop}; remove one of them"
            raise profile_error(name.origin, sentence)
        base = _composed(base_path, chain)
        below = base if below is None else laid_on(below, base)
    own = Entry({key: value for key, value in entry.value.items() if key != "extends"}, entry.origin)
    if below is None:
        return own
    assert isinstance(below.value, dict)
    inherited = {key: value for key, value in below.value.items() if key not in OWN_KEYS}
    return laid_on(Entry(inherited, below.origin), own)


def laid_on(below: Entry, above: Entry) -> Entry:
    """Merge two profiles, or two entries of `vessels`; `above` overrides."""
    for path, rivals in _RIVALS.items():
        group, depth = above.nearest(path)
        if depth == len(path) and isinstance(group.value, dict):
            below = _without_keys(below, path, _rivals_of(group, rivals))
    merged = merge(below, above)
    whole: dict[str, Entry] = {}
    vehicle = above.child("vehicle")
    # A vessel without a hull or a required key is a version of another vessel.
    if (
        vehicle is not None
        and any((hull := vehicle.child(key)) is not None and hull.value for key in ("hull", "hulls"))
        and all(vehicle.child(key) is not None for key in required_keys(VesselSpec))
    ):
        assert isinstance(merged.value, dict)
        whole["vehicle"] = _only_keys_of(vehicle, merged.value["vehicle"])
    fleet, others = below.child("vessels"), above.child("vessels")
    if fleet is not None and others is not None and isinstance(fleet.value, dict) and isinstance(others.value, dict):
        vessels = {
            name: laid_on(fleet.value[name], other) for name, other in others.value.items() if name in fleet.value
        }
        whole["vessels"] = Entry({**fleet.value, **others.value, **vessels}, others.origin)
    if not whole:
        return merged
    assert isinstance(merged.value, dict)
    return Entry({**merged.value, **whole}, merged.origin)


def _rivals_of(group: Entry, rivals: dict[str, tuple[str, ...]]) -> set[str]:
    """Return the keys that the given keys of a group replace."""
    assert isinstance(group.value, dict)
    replacing = [
        key
        for key, below in group.value.items()
        if below.value is not None and not (key == "items" and not below.value)
    ]
    return {rival for key in replacing for rival in rivals.get(key, ())}


def _without_keys(entry: Entry, path: tuple[str, ...], keys: set[str]) -> Entry:
    """Return `entry` without these keys of the group at `path`."""
    if not keys or not isinstance(entry.value, dict):
        return entry
    if not path:
        left = {key: below for key, below in entry.value.items() if key not in keys}
        return entry if len(left) == len(entry.value) else Entry(left, entry.origin, entry.replaced)
    below = entry.value.get(path[0])
    if below is None:
        return entry
    changed = _without_keys(below, path[1:], keys)
    return entry if changed is below else Entry({**entry.value, path[0]: changed}, entry.origin, entry.replaced)


def at_speed_of_vessel(entry: Entry) -> Entry:
    """Set a missing speed of the mission to the vessel's, whichever was composed first."""
    vessel, mission = entry.child("vehicle"), entry.child("mission")
    speed = None if vessel is None else vessel.child("cruise_speed_mps")
    if speed is None or speed.value is None or mission is None or not isinstance(mission.value, dict):
        return entry
    assert isinstance(entry.value, dict)
    faster = Entry({"speed_mps": speed, **mission.value}, mission.origin, mission.replaced)
    return Entry({**entry.value, "mission": faster}, entry.origin)


def _only_keys_of(above: Entry, merged: Entry) -> Entry:
    if not (isinstance(above.value, dict) and isinstance(merged.value, dict)):
        return merged
    own = {key: _only_keys_of(entry, merged.value[key]) for key, entry in above.value.items()}
    return Entry(own, merged.origin, merged.replaced)


def _placed(entry: Entry, keys: list[str], depth: int, value: Entry) -> Entry:
    """Return `entry` with `value` merged in at `keys[depth:]`."""
    if depth == 0:  # remove the keys that an override of one key replaces
        for path_of_group, rivals in _RIVALS.items():
            own = value
            for own_key in reversed(keys[len(path_of_group) :]):
                own = Entry({own_key: own}, value.origin)
            if tuple(keys[: len(path_of_group)]) == path_of_group and isinstance(own.value, dict):
                entry = _without_keys(entry, path_of_group, _rivals_of(own, rivals))
    if depth == len(keys):
        return merge(entry, value)
    key, path = keys[depth], dotted(tuple(keys[:depth]))
    if isinstance(entry.value, tuple):
        count = len(entry.value)
        if not key.isascii() or not key.isdigit() or int(key[:9]) >= count:
            fix = {0: "set the whole list", 1: "use 0"}.get(count, f"use 0 to {count - 1}")
            raise profile_error(value.origin, f"{path} is a list of {count} without an entry {key!r}; {fix}")
        index = int(key)
        item = _placed(entry.value[index], keys, depth + 1, value)
        return Entry((*entry.value[:index], item, *entry.value[index + 1 :]), entry.origin)
    if entry.value is None:
        entry = Entry({}, value.origin)
    if not isinstance(entry.value, dict):
        fix = f"set {path} itself" if path else "name a key"
        raise profile_error(value.origin, f"{path} = {shown(entry.plain())} is a value, not a group; {fix}")
    below = entry.value.get(key, Entry({} if depth + 1 < len(keys) else None, value.origin))
    return Entry({**entry.value, key: _placed(below, keys, depth + 1, value)}, entry.origin)
