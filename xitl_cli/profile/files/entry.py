"""A tree of profile values with their origins, and problems with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import TypeAlias

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError

Scalar: TypeAlias = str | int | float | bool | None
Key: TypeAlias = str | int
KeyPath: TypeAlias = tuple[Key, ...]


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of a value: a file with a 1-based line, or an override (no line)."""

    source: str
    line: int | None = None
    note: str = field(default="", compare=False)
    """Sentence for a warning about its key: see renamed_keys.py."""

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"


@dataclass(frozen=True, slots=True)
class Entry:
    """One value of a profile: a scalar, a mapping or a list, with its origin."""

    value: Scalar | dict[str, Entry] | tuple[Entry, ...]
    origin: Origin
    replaced: Entry | None = field(default=None, compare=False, repr=False)
    """The value that this one replaced."""

    def child(self, key: Key) -> Entry | None:
        """Return the entry under `key`, or None."""
        if isinstance(self.value, dict):
            return self.value.get(key) if isinstance(key, str) else None
        if isinstance(self.value, tuple) and isinstance(key, int) and 0 <= key < len(self.value):
            return self.value[key]
        return None

    def plain(self) -> object:
        """Return the values without origins: dicts, tuples (for lists) and scalars."""
        if isinstance(self.value, dict):
            return {key: entry.plain() for key, entry in self.value.items()}
        if isinstance(self.value, tuple):
            return tuple(entry.plain() for entry in self.value)
        return self.value

    def nearest(self, path: KeyPath) -> tuple[Entry, int]:
        """Return the deepest existing entry on the way to `path`, and the number of keys that lead there."""
        entry, depth = self, 0
        for key in path:
            below = entry.child(key)
            if below is None:
                break
            entry, depth = below, depth + 1
        return entry, depth


def merge(base: Entry, over: Entry) -> Entry:
    """Lay `over` on `base`: mappings merge key by key, other values are replaced. Values keep their origins."""
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return Entry(over.value, over.origin, base)
    merged = dict(base.value)
    for key, entry in over.value.items():
        merged[key] = merge(merged[key], entry) if key in merged else entry
    return Entry(merged, over.origin)


def dotted(path: KeyPath) -> str:
    """Return `("vehicle", "propellers", 0)` as `vehicle.propellers.0`.

    Unusual keys are quoted, to keep the text on one line.
    """
    return ".".join(
        str(key) if isinstance(key, int) or (key and key.isprintable() and not set(key) & set(" .:=")) else repr(key)
        for key in path
    )


def finding(key: str, text: str) -> tuple[KeyPath, str]:
    """Return a finding of a check: the path of a dotted key, and a sentence that begins with the key."""
    return tuple(key.split(".")), f"{key} {text}"


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem of a profile."""

    origin: Origin
    sentence: str

    def __str__(self) -> str:
        return f"{self.origin}: {self.sentence}"


class ProfileError(UserError):
    """An unusable profile. `str()` is the first problem and a count; `problems` has all of them.

    `profile`: the user's name of the profile, for the command that shows the other problems.
    """

    def __init__(self, problems: Sequence[Problem], profile: str) -> None:
        if not problems:
            raise ValueError("a ProfileError needs at least one problem")
        self.problems = tuple(problems)
        self.profile = profile
        more = len(self.problems) - 1
        rest = f" (and {more} more: run `xitl profiles check {profile}`)" if more else ""
        super().__init__(f"{self.problems[0]}{rest}")


def shown(value: object) -> str:
    """Return a value as an error quotes it: short, on one line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a group of keys" if value else "an empty group"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}" if value else "an empty list"
    if isinstance(value, int) and value.bit_length() > 64:
        return "an integer of more than 64 bits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def profile_error(origin: Origin, sentence: str) -> ProfileError:
    """Return an error with one problem."""
    return ProfileError([Problem(origin, sentence)], origin.source)
