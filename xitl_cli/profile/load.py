"""Loads a profile by its name and checks it."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.paths import user_path
from xitl_cli.profile.checks import check, check_fleet, check_vessel
from xitl_cli.profile.files import parameter_files
from xitl_cli.profile.files.catalogue import PROFILE, SUFFIXES, find_profile
from xitl_cli.profile.files.compose import at_speed_of_vessel, compose, lay_on, override
from xitl_cli.profile.files.entry import Entry, Key, KeyPath, Origin, Problem, ProfileError
from xitl_cli.profile.files.renamed_keys import renamed_key_warnings, with_new_names
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.fleet import is_fleet, read_fleet, unfold, unfolded_entry
from xitl_cli.profile.geographic import with_places_in_metres
from xitl_cli.profile.leftovers import leftovers
from xitl_cli.profile.named_files import with_mission_files, with_tide_file
from xitl_cli.profile.reader import read_profile
from xitl_cli.profile.schema import Profile, RunProfile
from xitl_cli.profile.schema.agents import EXTERNAL, FIND
from xitl_cli.profile.schema.derived_graph import complete_graph_group

_ANY_FILE: tuple[KeyPath, ...] = (
    ("driver", "file"),
    ("mission", "file"),
    ("sensors", "recorded", "file"),
    ("autopilot", "signing_key_file"),
    ("autopilot", "link_key_file"),
    ("environment", "water", "tide", "file"),
    ("vehicle", "hydrodynamics_file"),
    ("vehicle", "visual", "file"),
    ("view", "map"),
)

_FILES_IN_LISTS: tuple[tuple[KeyPath, KeyPath, tuple[str, ...]], ...] = (
    (("world", "meshes"), ("file",), ("",)),
    (("vehicle", "hulls"), ("mesh", "file"), ("",)),
    (("sensors", "cameras"), ("detector", "model"), ("",)),
    (("autopilot", "parameter_files"), (), parameter_files.SUFFIXES),
)
"""Lists with paths: the list, the path within an item, and the suffixes that make a text a path."""


@dataclass(frozen=True, slots=True)
class LoadedProfile:
    """A checked profile, its file, and the origin of each value."""

    profile: Profile
    path: Path
    entry: Entry

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about old names of keys, and about values of another vessel or another site."""
        renamed = renamed_key_warnings(self.entry)
        if self.profile.vessels is None:
            return (*renamed, *leftovers(self.profile, self.entry))
        vessels_of: dict[str, list[str]] = {}
        for name, vessel in self.profile.sailed.items():
            entry, _ = self.entry.nearest(("vessels", name))
            for text in leftovers(vessel, entry):
                vessels_of.setdefault(text, []).append(name)
        texts = renamed
        for text, names in vessels_of.items():
            others = f" and {len(names) - 1} more" if len(names) > 1 else ""
            of_all = len(names) == len(self.profile.sailed)
            texts.append(text if of_all else f"vessels.{names[0]}{others}: {text}")
        return tuple(texts)

    def origin(self, dotted_key: str) -> Origin:
        """Return the origin of `a.b.0.c`, or of the nearest group around it if it has its default."""
        keys: list[Key] = [int(key) if key.isdigit() else key for key in dotted_key.split(".")]
        return self.entry.nearest(tuple(keys))[0].origin

    def runnable(self) -> RunProfile:
        """Return the profile with every group that a run needs. Raises UserError with the file otherwise."""
        try:
            return self.profile.runnable()
        except UserError as error:
            raise UserError(f"{self.entry.origin.source}: {error}") from None


def load_profile(name: str, overrides: Iterable[str] = ()) -> Profile:
    """Return the checked profile `name` (a shipped name or a path) with `KEY.PATH=VALUE` overrides.

    Raises UserError for an unknown name and ProfileError, with all problems, for an invalid profile.
    """
    return load_with_origins(name, overrides).profile


def load_with_origins(name: str, overrides: Iterable[str] = (), parts: Iterable[str] = ()) -> LoadedProfile:
    """Load a profile as `load_profile` does, with the origin of every value. parts: laid on it before `overrides`."""
    overrides = tuple(overrides)
    path = find_profile(name)
    try:
        entry = compose(path)
        for part in parts:
            entry = lay_on(entry, find_profile(part))
        return loaded_profile(prepared(override(entry, overrides)), path, name)
    except ProfileError as error:
        called = " ".join([shlex.quote(name), *(f"--set {shlex.quote(text)}" for text in overrides)])
        raise ProfileError(error.problems, called) from None


def prepared(entry: Entry) -> Entry:
    """Prepare a composed profile for reading.

    Paths become absolute, files of missions and tides are read, places become metres, and null faults are removed.
    Raises ProfileError for an invalid file or place.
    """
    faults = entry.child("faults")
    if faults is not None and isinstance(faults.value, dict):
        assert isinstance(entry.value, dict)
        present = {name: fault for name, fault in faults.value.items() if fault.value is not None}
        if len(present) < len(faults.value):  # null removes an inherited fault
            without_null = Entry(present, faults.origin, faults.replaced)
            entry = Entry({**entry.value, "faults": without_null}, entry.origin)
    entry = with_tide_file(with_mission_files(with_absolute_paths(entry)))
    return with_places_in_metres(entry, entry.origin.source)


def loaded_profile(entry: Entry, path: Path, name: str) -> LoadedProfile:
    """Return the checked profile of a prepared entry. Raises ProfileError with all problems."""
    profile, entry = checked_profile(entry, name)
    return LoadedProfile(profile, path, entry)


def checked_profile(entry: Entry, name: str) -> tuple[Profile, Entry]:
    """Return the profile of a composed entry, and the entry with the profile's vessels. `name`: name for errors.

    Raises ProfileError with all problems.
    """
    if not is_fleet(entry):
        checked = at_speed_of_vessel(entry)
        profile = _with_graph(read_profile(checked, name))
        problems = [Problem(checked.nearest(path)[0].origin, sentence) for path, sentence in check(profile)]
    else:
        shared, entries = read_fleet(entry, name)
        vessels = {vessel: _with_graph(own) for vessel, own in unfold(entries, name).items()}
        profile = replace(shared, vessels=vessels)
        checked = unfolded_entry(entry, entries, vessels)
        # A problem of a shared group is reported once. The vessels of a count differ only in place and number.
        keys_of: dict[tuple[Origin, str], list[str]] = {}
        for fleet_entry in entries:
            for path, sentence in check_vessel(vessels[fleet_entry.names[0]]):
                origin = fleet_entry.entry.nearest(path)[0].origin
                keys_of.setdefault((origin, sentence), []).append(fleet_entry.key)
        problems = [
            Problem(origin, sentence if len(keys) > 1 else f"{keys[0]}: {sentence}")
            for (origin, sentence), keys in keys_of.items()
        ]
        problems += [Problem(checked.nearest(path)[0].origin, sentence) for path, sentence in check_fleet(profile)]
    if problems:
        raise ProfileError(problems, name)
    return profile, checked


def unchecked_profile(entry: Entry, name: str) -> Profile:
    """Return the profile with valid single values only.

    A run on another machine may use files that are missing here.
    """
    if not is_fleet(entry):
        return read_profile(entry, name)
    shared, entries = read_fleet(entry, name)
    return replace(shared, vessels=unfold(entries, name))


def recorded_profiles(data: bytes | None) -> tuple[RunProfile, ...]:
    """Return the profile of each vessel from a recording's profile.yaml; empty when this version cannot read it.

    The keys of plug-ins are left out, so that a recording can be read where they are not installed.
    """
    if data is None:
        return ()
    try:
        entry = parse_yaml(data.decode(errors="replace"), PROFILE)
        if entry is None:
            return ()
        return unchecked_profile(_without_plugins(with_new_names(entry, recorded=True)), PROFILE).run_profiles()
    except UserError:
        return ()


def _without_plugins(entry: Entry) -> Entry:
    if not isinstance(entry.value, dict):
        return entry
    left = {key: below for key, below in entry.value.items() if key != "plugins"}
    vessels = left.get("vessels")
    if vessels is not None and isinstance(vessels.value, dict):
        own = {name: _without_plugins(vessel) for name, vessel in vessels.value.items()}
        left["vessels"] = Entry(own, vessels.origin)
    return Entry(left, entry.origin)


def _with_graph(profile: Profile) -> Profile:
    return replace(profile, graph=complete_graph_group(profile))


def with_absolute_paths(entry: Entry) -> Entry:
    """Make relative paths absolute. They are relative to the profile's file, and the profile may be moved."""
    vessels = entry.child("vessels")
    if vessels is not None and isinstance(vessels.value, dict):
        assert isinstance(entry.value, dict)
        absolute = {name: with_absolute_paths(vessel) for name, vessel in vessels.value.items()}
        entry = Entry({**entry.value, "vessels": Entry(absolute, vessels.origin)}, entry.origin)
    entry = _rewritten(entry, ("graph", "reference"), SUFFIXES)
    for path in _ANY_FILE:
        entry = _rewritten(entry, path, ("",))
    entry = _rewritten(entry, ("autopilot", "controller"), (".py",), behind=":")
    firmware = entry.nearest(("autopilot", "firmware"))
    if firmware[1] == 2 and firmware[0].value not in (EXTERNAL, FIND):
        entry = _rewritten(entry, ("autopilot", "firmware"), ("",))
    for list_path, file_path, suffixes in _FILES_IN_LISTS:
        items, depth = entry.nearest(list_path)
        if depth == len(list_path) and isinstance(items.value, tuple):
            for number in range(len(items.value)):
                entry = _rewritten(entry, (*list_path, number, *file_path), suffixes)
    return entry


def _rewritten(entry: Entry, path: KeyPath, suffixes: tuple[str, ...], behind: str = "") -> Entry:
    """Make the path at `path` absolute if it ends in one of `suffixes`.

    `behind`: first character of the text after the path.
    """
    if not path:
        if not isinstance(entry.value, str):
            return entry
        file, mark, rest = entry.value.rpartition(behind) if behind else (entry.value, "", "")
        if not file.endswith(suffixes):
            return entry
        folder = Path() if entry.origin.line is None else Path(entry.origin.source).parent
        return Entry(f"{(folder / user_path(file)).absolute()}{mark}{rest}", entry.origin)
    below = entry.child(path[0])
    if below is None:
        return entry
    below = _rewritten(below, path[1:], suffixes, behind)
    if isinstance(entry.value, dict):
        return Entry({**entry.value, str(path[0]): below}, entry.origin)
    assert isinstance(entry.value, tuple)
    return Entry(tuple(below if key == path[0] else item for key, item in enumerate(entry.value)), entry.origin)
