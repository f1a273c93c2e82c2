"""Entries -> profile: names, types, bounds and defaults from the schema. Every problem has its line and fix.

There are no silent conversions, except that a whole number is a number. Unknown keys are refused.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import partial
from typing import Any, TypeVar, get_args, get_origin

from sim_core.keys import (
    RegisteredGroups,
    ShortForm,
    SpecificationError,
    alternatives,
    entries,
    key_annotations,
    length_problem,
    optional,
    own_rule,
    required_keys,
    unit_of,
    value_problem,
)
from xitl_cli.errors import UserError
from xitl_cli.profile.files.entry import Entry, KeyPath, Problem, ProfileError, dotted, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.profile import GroupsByName, registered_keys

T = TypeVar("T")


def read_profile(entry: Entry, name: str) -> Profile:
    """Return the profile of `entry`, with valid values and groups. `name`: the user's name of the profile.

    Raises ProfileError with all problems.
    """
    return read_group(entry, Profile, name)


def read_group(entry: Entry, group: type[T], name: str) -> T:
    """Return one group of a profile, as `read_profile` does."""
    reader = Reader()
    result = reader.read(entry, group, ())
    reader.refuse(name)
    assert result is not None
    return result


class Reader:
    """Reads groups that may share entries. A problem of a shared entry is reported once, at its first place."""

    def __init__(self) -> None:
        self._unknown: dict[tuple[int, str], Problem] = {}
        self._problems: dict[tuple[int, str], Problem] = {}
        self._count = 0
        self._read: dict[tuple[int, type], tuple[Entry, Any]] = {}

    def read(self, entry: Entry, group: type[T], path: KeyPath) -> T | None:
        """Return the group of `entry` at `path` of the profile; None when it has problems."""
        result = self._group(entry, group, path)
        assert result is None or isinstance(result, group)
        return result

    def refuse(self, name: str) -> None:
        """Raise ProfileError with all problems of the profile `name`, if there are any."""
        if self._count:
            raise ProfileError([*self._unknown.values(), *self._problems.values()], name)

    def _group(self, entry: Entry, group: Any, path: KeyPath) -> Any:
        shared = self._read.get((id(entry), group))
        if shared is not None:
            return shared[1]
        result = self._new_group(entry, group, path)
        if result is not None:
            self._read[id(entry), group] = entry, result
        return result

    def _new_group(self, entry: Entry, group: Any, path: KeyPath) -> Any:
        known = key_annotations(group)
        if not isinstance(entry.value, dict):
            return self._wrong(entry, path, f"is not a group; indent keys under it: {', '.join(known)}")
        before, meant = self._count, set()
        for key in entry.value:
            if key not in known:
                meant.add(self._unknown_key(entry.value[key], list(known), (*path, key)))
        values, required = {}, required_keys(group)
        for key, annotation in known.items():
            below = entry.value.get(key)
            if below is not None:
                values[key] = self._value(below, annotation, (*path, key))
            elif key in required and key not in meant:
                unit = unit_of(key)
                needs = f"needs {key!r}; add it{f' in {unit}' if unit else ''}"
                self._note(self._problems, entry, dotted(path) or "the profile", needs)
        if self._count > before:
            return None
        try:
            return group(**values)
        except SpecificationError as error:
            at = entry.nearest(error.path)[0]
            return self._wrong(at, (*path, *error.path), error.text, value=False)

    def _value(self, entry: Entry, annotation: Any, path: KeyPath) -> Any:
        if entry.value is None and optional(annotation):
            return None
        if (rule := own_rule(annotation)) is not None:
            problem = rule.problem(entry.plain())
            return entry.plain() if problem is None else self._wrong(entry, path, problem)
        kind, markers = alternatives(annotation)[0]
        if is_dataclass(kind):
            short = next((marker for marker in markers if isinstance(marker, ShortForm)), None)
            if short is not None and isinstance(entry.value, str):
                entry = Entry({short.key: entry}, entry.origin)
            return self._group(entry, kind, path)
        if get_origin(kind) is dict:
            if not isinstance(entry.value, dict):
                return self._wrong(entry, path, "is not a group; indent keys under it")
            if (by_name := next((marker for marker in markers if isinstance(marker, GroupsByName)), None)) is not None:
                return self._groups_by_name(entry, lambda name, _: by_name.group(name), path)
            if (
                registered := next((marker for marker in markers if isinstance(marker, RegisteredGroups)), None)
            ) is not None:
                return self._groups_by_name(entry, partial(registered_keys, registered.registry), path)
            inner = get_args(kind)[1]
            return {key: self._value(below, inner, (*path, key)) for key, below in entry.value.items()}
        if get_origin(kind) is tuple:
            if not isinstance(entry.value, tuple):
                return self._wrong(entry, path, "is not a list; write [a, b, ...]")
            if problem := length_problem(entry.value, kind, markers):
                return self._wrong(entry, path, problem)
            pairs = zip(entry.value, entries(kind, len(entry.value)), strict=True)
            return tuple(self._value(item, own, (*path, number)) for number, (item, own) in enumerate(pairs))
        name = next((key for key in reversed(path) if isinstance(key, str)), "")
        if problem := value_problem(entry.plain(), kind, markers, unit_of(name)):
            return self._wrong(entry, path, problem)
        return float(entry.value) if kind is float else entry.value  # type: ignore[arg-type]

    def _groups_by_name(self, entry: Entry, group_of: Callable[[str, str], type], path: KeyPath) -> dict[str, Any]:
        """Return the groups below `entry`; null removes an inherited group.

        group_of: the class for the name of a group and its key `kind`, which is the name if it is missing. Raises
        UserError.
        """
        assert isinstance(entry.value, dict)
        groups = {}
        for name, below in entry.value.items():
            if below.value is None:
                continue
            kind = below.value.get("kind") if isinstance(below.value, dict) else None
            try:
                group = group_of(name, str(kind.value) if kind is not None and kind.value else name)
            except UserError as error:
                problem = str(error).removeprefix(f"{name}: ")
                self._note(self._problems, below, f"{dotted((*path, name))}:", problem)
                continue
            groups[name] = self._group(below, group, (*path, name))
        return groups

    def _wrong(self, entry: Entry, path: KeyPath, problem: str, value: bool = True) -> None:
        key = f"{dotted(path)} = {shown(entry.plain())}" if value else dotted(path)
        self._note(self._problems, entry, key, problem)

    def _note(self, problems: dict[tuple[int, str], Problem], entry: Entry, key: str, problem: str) -> None:
        self._count += 1
        problems.setdefault((id(entry), problem), Problem(entry.origin, f"{key} {problem}"))

    def _unknown_key(self, entry: Entry, known: list[str], path: KeyPath) -> str | None:
        """Report the key, and return the key that was probably meant."""
        key = str(path[-1])
        # Keys of a scripted vessel do not exist at the top.
        places = (place for place in _paths(Profile, ()) if place[-1] == key and place[0] != "traffic")
        elsewhere = sorted(places, key=len)
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.8 if elsewhere else 0.6)
        if close:
            fix = f"did you mean {close[0]!r}?"
        elif elsewhere:
            fix = f"did you mean {' or '.join(repr(dotted(place)) for place in elsewhere[:2])}?"
        else:
            fix = f"known keys: {', '.join(known)}"
        self._note(self._unknown, entry, dotted(path), f"is not a known key; {fix}")
        return close[0] if close else None


def known_paths() -> frozenset[KeyPath]:
    """Return the paths of all keys and groups of a profile outside lists."""
    return frozenset(_paths(Profile, ()))


def _paths(group: Any, above: KeyPath) -> Iterator[KeyPath]:
    """Yield the paths of all known keys outside lists."""
    for name, annotation in key_annotations(group).items():
        yield (*above, name)
        for kind, _ in alternatives(annotation):
            if is_dataclass(kind):
                yield from _paths(kind, (*above, name))
