"""Profile keys with another name than in an earlier version.

The old name works, with a warning that states the new one, until a stated version. From that version on, it is an error
that still states the new one. Each file is translated before profiles are merged, so that files with the old and the
new name can extend each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

from agent import __version__
from sim_core.dataclass import dataclass
from xitl_cli.profile.files.entry import Entry, Key, KeyPath, Origin, dotted, profile_error

_VESSELS = "vessels"


@dataclass(frozen=True, slots=True)
class RenamedKey:
    """A key or group with a new name. Neither path leads through a list."""

    old: tuple[str, ...]
    new: tuple[str, ...]
    since: str
    """Version that renamed it."""
    until: str
    """Version that refuses the old name, a major one."""

    @property
    def sentence(self) -> str:
        """What a user has to change."""
        return f"{dotted(self.old)} is now {dotted(self.new)}"


RENAMED_KEYS: tuple[RenamedKey, ...] = ()
"""All renamed keys. A row stays after `until`, for the error."""


def with_new_names(entry: Entry, above: tuple[Key, ...] = (), recorded: bool = False) -> Entry:
    """Return an entry with the new names of keys. above: path of the entry in the profile.

    recorded: of a recording, in which old names never expire. Raises ProfileError for an old name that has expired, or
    that is next to the new one.
    """
    for renamed in RENAMED_KEYS:
        if renamed.old[: len(above)] == above == renamed.new[: len(above)] and len(renamed.old) > len(above):
            entry = _moved(entry, renamed, len(above), recorded)
    vessels = entry.child(_VESSELS)
    if RENAMED_KEYS and not above and vessels is not None and isinstance(vessels.value, dict):
        assert isinstance(entry.value, dict)
        own = {name: with_new_names(vessel, (), recorded) for name, vessel in vessels.value.items()}
        entry = replace(entry, value={**entry.value, _VESSELS: replace(vessels, value=own)})
    return entry


def override_with_new_names(keys: list[str], value: Entry) -> tuple[list[str], Entry]:
    """Return the path and the value of an override with the new names. Raises ProfileError as `with_new_names`."""
    of_vessel = keys[:2] if keys[0] == _VESSELS and len(keys) > 2 else []
    path = tuple(keys[len(of_vessel) :])
    for renamed in RENAMED_KEYS:
        if path[: len(renamed.old)] == renamed.old:
            value = replace(value, origin=_noted(value.origin, renamed, recorded=False))
            path = (*renamed.new, *path[len(renamed.old) :])
    return [*of_vessel, *path], with_new_names(value, path)


def renamed_key_warnings(entry: Entry) -> list[str]:
    """Return a sentence for each old name in a composed profile."""
    return list(dict.fromkeys(_warnings(entry)))


def _moved(entry: Entry, renamed: RenamedKey, depth: int, recorded: bool) -> Entry:
    """Return `entry`, which is `depth` keys below the profile, with the value at the new place."""
    value, reached = entry.nearest(renamed.old[depth:])
    if reached < len(renamed.old) - depth:
        return entry
    _, there = entry.nearest(renamed.new[depth:])
    if there == len(renamed.new) - depth:
        raise profile_error(value.origin, f"{renamed.sentence}, which is also given; remove {dotted(renamed.old)}")
    moved = replace(value, origin=_noted(value.origin, renamed, recorded))
    return _with(_without(entry, renamed.old[depth:]), renamed.new[depth:], moved)


def _noted(origin: Origin, renamed: RenamedKey, recorded: bool) -> Origin:
    """Return the origin with a note for the warning. Raises ProfileError when the old name has expired."""
    if not recorded and _release(__version__) >= _release(renamed.until):
        raise profile_error(origin, f"{renamed.sentence}, since xitl {renamed.since}; write {dotted(renamed.new)}")
    return replace(origin, note=f"{renamed.sentence}; xitl {renamed.until} refuses the old name")


def _release(version: str) -> tuple[int, ...]:
    """Return the numbers of a version: (1, 2) for 1.2.0 and for 1.2."""
    numbers = [int(number) for number in re.findall(r"\d+", version)[:3]]
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def _without(entry: Entry, path: KeyPath) -> Entry:
    """Return `entry` without the key at `path`, which exists, and without groups that become empty."""
    assert isinstance(entry.value, dict)
    key, *rest = path
    left = dict(entry.value)
    below = left.pop(str(key))
    if rest:
        kept = _without(below, tuple(rest))
        if kept.value:
            left[str(key)] = kept
    return replace(entry, value=left)


def _with(entry: Entry, path: KeyPath, value: Entry) -> Entry:
    key, *rest = path
    own = entry.value if isinstance(entry.value, dict) else {}
    if not rest:
        return replace(entry, value={**own, str(key): value})
    below = own.get(str(key)) or Entry({}, value.origin)
    return replace(entry, value={**own, str(key): _with(below, tuple(rest), value)})


def _warnings(entry: Entry) -> Iterator[str]:
    if entry.origin.note:
        yield f"{entry.origin}: {entry.origin.note}"
    values = entry.value
    for below in values.values() if isinstance(values, dict) else values if isinstance(values, tuple) else ():
        yield from _warnings(below)
