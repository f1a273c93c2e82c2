"""Writes the tables of docs/profiles.md from the schema, below the part that is written by hand.

python tools/generate_profile_reference.py [--check]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from sim_core.keys import (
    Bounds,
    Items,
    Required,
    alternatives,
    key_annotations,
    meaning_of,
    optional,
    unit_of,
    unpacked,
)
from sim_core.world.spec import TrafficSpec
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.fleet import SAILED, SeveralSpec

VESSEL = "vessels.NAME"
PAGE = Path(__file__).parents[1] / "docs/profiles.md"
MARK = "<!-- Below is generated from the schema: make pages -->"
_NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false", Any: "group"}


def page(text: str) -> str:
    """The page with its tables as the schema has them."""
    by_hand, found, _ = text.partition(MARK)
    if not found:
        raise ValueError(f"{PAGE} has no line {MARK}; add it where the tables begin")
    return "\n".join([f"{by_hand}{MARK}\n", *_sections()])


def _sections() -> Iterator[str]:
    paths: dict[Any, list[str]] = {}
    several = ((SeveralSpec, VESSEL), *_groups(TrafficSpec, f"{VESSEL}.traffic"))
    for group, path in (*_groups(Profile, ""), *several):
        paths.setdefault(group, []).append(path)
    for group, places in paths.items():
        yield f"## {', '.join(f'`{place}`' for place in places if place) or 'Top'}\n"
        yield " ".join((group.__doc__ or "").split()) + "\n"
        yield "| key | type | unit | default | range | meaning |\n|---|---|---|---|---|---|"
        if group is SeveralSpec:
            yield f"| {', '.join(f'`{key}`' for key in SAILED)} | | | | | as at the top, which gives the missing keys |"
            yield f"| `traffic` | group, or null | | null | | {_first_sentence(TrafficSpec)} |"
        for field in _keys(group):
            yield _row(field, key_annotations(group)[field.name])
        yield ""


def _keys(group: Any) -> tuple[Field[Any], ...]:
    """Those of a profile without what it has as one of several vessels."""
    return tuple(field for field in fields(group) if (group, field.name) != (Profile, "traffic"))


def _groups(group: Any, path: str) -> Iterator[tuple[Any, str]]:
    yield group, path
    for name, annotation in ((field.name, key_annotations(group)[field.name]) for field in _keys(group)):
        if (group, name) == (Profile, "vessels"):
            continue
        below = f"{path}.{name}" if path else name
        for found, suffix in _groups_in(annotation):
            yield from _groups(found, below + suffix)


def _groups_in(annotation: Any) -> Iterator[tuple[Any, str]]:
    """The groups that a key holds, with what follows it in their path."""
    for kind, _ in alternatives(annotation):
        if is_dataclass(kind):
            yield kind, ""
        elif get_origin(kind) is dict:
            yield from ((found, f".NAME{suffix}") for found, suffix in _groups_in(get_args(kind)[1]))
        elif get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis:
            yield from ((found, f".N{suffix}") for found, suffix in _groups_in(get_args(kind)[0]))


def _row(field: Field[Any], annotation: Any) -> str:
    meaning = (meaning_of(annotation) or _first_sentence(annotation)).replace("|", "\\|")
    default, unit = _default(field, annotation), unit_of(field.name)
    cells = (f"`{field.name}`", _type(annotation), unit, default, _range(annotation), meaning)
    return "|" + "".join(f" {cell} |" if cell else " |" for cell in cells)


def _first_sentence(annotation: Any) -> str:
    """Of the docstring of the group that a key holds; the rest stands with its own table."""
    groups = [group for group, _ in _groups_in(annotation)]
    return " ".join((groups[0].__doc__ or "").split()).partition(". ")[0].rstrip(".") if groups else ""


def _type(annotation: Any) -> str:
    said = " or ".join(_kind_name(kind) for kind, _ in alternatives(annotation))
    return f"{said}, or null" if optional(annotation) else said


def _kind_name(kind: Any) -> str:
    if is_dataclass(kind):
        return "group"
    if get_origin(kind) is Literal:
        return ", ".join(f"`{word}`" for word in get_args(kind))
    if get_origin(kind) is dict:
        inner = _type(get_args(kind)[1])
        return "groups by name" if inner == "group" else f"{inner} by name"
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        if inner[-1] is Ellipsis:
            return f"list of {_type(inner[0])}"
        entry = alternatives(inner[0])[0][0]
        return (
            f"{len(inner)} rows of {_kind_name(entry)}"
            if get_origin(entry) is tuple
            else f"{len(inner)} {_NAMES[entry]}s"
        )
    return _NAMES[kind]


def _default(field: Field[Any], annotation: Any) -> str:
    if Required in unpacked(annotation)[1] or (field.default is MISSING and field.default_factory is MISSING):
        return "required"
    value = field.default_factory() if field.default is MISSING else field.default  # type: ignore[misc]
    return _shown(value)


def _shown(value: Any) -> str:
    if value is None:
        return "null"
    if is_dataclass(value):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    if isinstance(value, dict):
        return "{}"
    return f"{value:g}" if isinstance(value, float) else str(value) or '""'


def _range(annotation: Any) -> str:
    """Bounds of a number, of each number of a list, and how many entries a list has."""
    found = []
    for kind, markers in alternatives(annotation):
        entries = get_args(kind) if get_origin(kind) is tuple else ()
        inner = [marker for one in entries for _, own in alternatives(one) for marker in own]
        for marker in dict.fromkeys([*markers, *inner]):
            if isinstance(marker, Bounds):
                found.append(_bounds(marker))
            elif isinstance(marker, Items):
                most = f" to {marker.at_most}" if marker.at_most else " or more"
                found.append(f"{marker.at_least}{most} entries")
    return ", ".join(found)


def _bounds(bounds: Bounds) -> str:
    low = [f"{bounds.at_least:g}"] if bounds.at_least is not None else []
    low += [f"above {bounds.above:g}"] if bounds.above is not None else []
    high = [f"{bounds.at_most:.10g}"] if bounds.at_most is not None else []
    high += [f"below {bounds.below:g}"] if bounds.below is not None else []
    if low and high:
        return f"{low[0]} to {high[0]}"
    return f"{low[0]} or more" if bounds.at_least is not None else (low + high)[0]


if __name__ == "__main__":
    before = PAGE.read_text(encoding="utf-8")
    after = page(before)
    if "--check" in sys.argv:
        sys.exit(f"{PAGE} is not what the schema says; run make pages" if after != before else 0)
    PAGE.write_text(after, encoding="utf-8")
