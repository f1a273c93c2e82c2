"""Conversion of instants, durations and names to and from text; external text is made safe for a terminal."""

from __future__ import annotations

import math
from collections.abc import Collection

from xitl_cli.logs.model.errors import LogError, UnknownNameError

_LISTED = 12


def clock_text(at_s: float, decimals: int = 1) -> str:
    """Instant in clock notation: 0:43.2, 12:03.4, 1:02:03.4, -0:01.0."""
    sign = "-" if at_s < 0 else ""
    units = 10**decimals
    ticks = round(abs(at_s) * units)
    whole, part = divmod(ticks, units)
    hours, minutes, seconds = whole // 3600, whole // 60 % 60, whole % 60
    clock = f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
    return f"{sign if ticks else ''}{clock}" + (f".{part:0{decimals}}" if decimals else "")


def duration_text(length_s: float) -> str:
    """Duration of a log: 0.4 s, 43.2 s, 6:12 min, 1:02:03 h."""
    if length_s < 60.0:
        return f"{length_s:.1f} s"
    return f"{clock_text(length_s, 0)} {'h' if round(length_s) >= 3600 else 'min'}"


def length_text(length_s: float) -> str:
    """Duration within a sentence: 0.35 s, 12.4 s, 312 s."""
    return f"{length_s:.2f} s" if length_s < 1.0 else f"{length_s:.1f} s" if length_s < 100.0 else f"{length_s:.0f} s"


def parse_seconds(text: str) -> float:
    """Return seconds from 90, 90.5, 1:30.5 or 1:02:03. Raises LogError."""
    parts = text.strip().lstrip("-").split(":")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 3 or not all(math.isfinite(number) and number >= 0 for number in numbers):
        raise LogError(f"{text!r} is not a time; write seconds (90.5), minutes (1:30.5) or hours (1:02:03)")
    total = 0.0
    for number in numbers:
        total = total * 60.0 + number
    return -total if text.strip().startswith("-") else total


def parse_optional_seconds(text: str | None) -> float | None:
    """Like `parse_seconds`, but None gives None."""
    return None if text is None else parse_seconds(text)


def printable(text: str) -> str:
    """Return the text without control characters, because a log or a file name may contain terminal commands."""
    return text if text.isprintable() else "".join(letter if letter.isprintable() else " " for letter in text)


def resolve_name(wanted: str, known: Collection[str], lacks: str, advice: str) -> str:
    """Return the name in `known` that equals `wanted`, ignoring case.

    Raises UnknownNameError with `lacks`, the wanted name, the nearest name and `advice`.
    """
    if wanted in known:
        return wanted
    folded = {name.casefold(): name for name in reversed(list(known))}
    if wanted.casefold() in folded:
        return folded[wanted.casefold()]
    from difflib import get_close_matches

    near = get_close_matches(wanted.casefold(), folded, n=1)
    suggestion = f"did you mean {folded[near[0]]!r}? " if near else ""
    raise UnknownNameError(f"{lacks} {wanted!r}; {suggestion}{advice}")


def plural(count: int, noun: str, irregular: str = "") -> str:
    """Number with its noun: 1 row, 2 rows. irregular: a plural that is not formed with an s."""
    return f"{count} {noun if count == 1 else irregular or noun + 's'}"


def listed(names: Collection[str]) -> str:
    """Names as a list, such as "Roll, Pitch, Yaw". Only the first twelve are listed; the others are counted."""
    shown = [name for name in names if not name.startswith("_")][:_LISTED]
    more = len(names) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")
