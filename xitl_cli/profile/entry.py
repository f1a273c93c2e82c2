"""A tree of profile values, each of which knows where it was written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

Scalar: TypeAlias = str | int | float | bool | None
Key: TypeAlias = str | int
KeyPath: TypeAlias = tuple[Key, ...]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a value was written: a file with a 1-based line, or an override (no line)."""

    source: str
    line: int | None = None

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"


@dataclass(frozen=True, slots=True)
class Entry:
    """One value of a profile: a scalar, a mapping or a list, with its origin."""

    value: Scalar | dict[str, Entry] | tuple[Entry, ...]
    origin: Origin

    def child(self, key: Key) -> Entry | None:
        """The entry under `key`, or None where there is none."""
        if isinstance(self.value, dict):
            return self.value.get(key) if isinstance(key, str) else None
        if isinstance(self.value, tuple) and isinstance(key, int) and 0 <= key < len(self.value):
            return self.value[key]
        return None

    def plain(self) -> object:
        """The values alone: dicts, tuples (for lists) and scalars."""
        if isinstance(self.value, dict):
            return {key: entry.plain() for key, entry in self.value.items()}
        if isinstance(self.value, tuple):
            return tuple(entry.plain() for entry in self.value)
        return self.value

    def nearest(self, path: KeyPath) -> tuple[Entry, int]:
        """The deepest entry on the way to `path`, and how many of its keys lead there."""
        entry, depth = self, 0
        for key in path:
            below = entry.child(key)
            if below is None:
                break
            entry, depth = below, depth + 1
        return entry, depth


def merge(base: Entry, over: Entry) -> Entry:
    """`over` laid on `base`: mappings merge key by key, everything else is replaced; origins go with their values."""
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    merged = dict(base.value)
    for key, entry in over.value.items():
        merged[key] = merge(merged[key], entry) if key in merged else entry
    return Entry(merged, over.origin)


def dotted(path: KeyPath) -> str:
    """`("vehicle", "propellers", 0)` as `vehicle.propellers.0`; odd keys are quoted so that the line stays one line."""
    return ".".join(str(key) if isinstance(key, int) or _is_plain(key) else repr(key) for key in path)


def _is_plain(key: str) -> bool:
    return key != "" and key.isprintable() and not any(character in key for character in " .:=")
