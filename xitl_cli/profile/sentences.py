"""pydantic's findings as sentences: what is wrong with which value, and what to write instead."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from xitl_cli.profile.entry import Entry, KeyPath, Origin, dotted
from xitl_cli.profile.problems import Problem, shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema_walk import choices_at, group_at, paths_to

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

UNITS = {
    "mps": "m/s",
    "mps2": "m/s²",
    "radps": "rad/s",
    "m": "m",
    "m2": "m²",
    "s": "s",
    "hz": "Hz",
    "deg": "degrees",
    "kg": "kg",
    "kgm2": "kg m²",
    "kgpm3": "kg/m³",
    "n": "N",
    "pa": "Pa",
    "gauss": "gauss",
    "ppm": "ppm",
}

_NOT = {
    "int_type": "is not a whole number; write a whole number",
    "int_from_float": "is not a whole number; write a whole number",
    "bool_type": "is neither true nor false; write true or false",
    "string_type": "is not text; put it in quotes",
}


def problems_of(error: ValidationError, entry: Entry) -> list[Problem]:
    """What pydantic found in `entry`, unknown keys first; one problem per key."""
    details = error.errors(include_url=False)
    unknown = [detail for detail in details if detail["type"] == "extra_forbidden"]
    others = [detail for detail in details if detail["type"] != "extra_forbidden"]
    problems: dict[tuple[KeyPath, bool], Problem] = {}
    suspects: set[KeyPath] = set()  # keys that are missing because they were misspelt
    for detail in unknown:
        path = detail["loc"]
        problem, meant = _unknown(path, entry)
        problems[path, True] = problem
        suspects.update(meant)
    for detail in others:
        path = detail["loc"]
        if detail["type"] == "missing" and path in suspects:
            continue
        at = path[:-1] if isinstance(path[-1], int) and detail["type"] == "missing" else path
        problems.setdefault((at, False), _problem(detail, at, entry))
    return list(problems.values())


def _unknown(path: KeyPath, entry: Entry) -> tuple[Problem, list[KeyPath]]:
    group = group_at(Profile, path[:-1])
    known = list(group.model_fields) if group else []
    elsewhere = paths_to(Profile, str(path[-1]))
    close = difflib.get_close_matches(str(path[-1]), known, n=1, cutoff=0.8 if elsewhere else 0.6)
    if close:
        fix = f"did you mean {close[0]!r}?"
    elif elsewhere:
        fix = f"did you mean {' or '.join(repr(dotted(place)) for place in elsewhere[:2])}?"
    else:
        fix = f"known keys: {', '.join(known)}"
    sentence = f"{dotted(path)} is not a known key; {fix}"
    return Problem(_origin(path, entry), sentence), [(*path[:-1], match) for match in close]


def _problem(detail: ErrorDetails, path: KeyPath, entry: Entry) -> Problem:
    kind, context = detail["type"], detail.get("ctx", {})
    found, depth = entry.nearest(path)
    if kind == "missing" and depth < len(path):
        group = dotted(path[:-1]) or "the profile"
        group_entry = entry.nearest(path[:-1])[0]
        return Problem(group_entry.origin, f"{group} needs {path[-1]!r}; add it{_in_unit(path)}")
    value = found.plain()
    return Problem(found.origin, f"{dotted(path)} = {shown(value)} {_what(kind, context, path, value, detail['msg'])}")


def _what(kind: str, context: dict[str, Any], path: KeyPath, value: object, message: str) -> str:
    """What is wrong with `value`, after `key = value`."""
    if kind == "float_type":
        return f"is not a number; write a number{_in_unit(path)}"
    if kind in _NOT:
        return _NOT[kind]
    if kind == "finite_number":
        return f"is not finite; write a finite number{_in_unit(path)}"
    if kind in ("greater_than", "greater_than_equal"):
        bound = "above" if kind == "greater_than" else "of at least"
        return f"is too small; use a value {bound} {context.get('gt', context.get('ge')):g}{_in_unit(path)}"
    if kind in ("less_than", "less_than_equal"):
        bound = "below" if kind == "less_than" else "of at most"
        return f"is too large; use a value {bound} {context.get('lt', context.get('le')):g}{_in_unit(path)}"
    if kind == "literal_error":
        choices = choices_at(Profile, path)
        close = difflib.get_close_matches(value, choices, n=1) if isinstance(value, str) else []
        hint = f"did you mean {close[0]!r}? " if close else ""
        return f"is not one of the choices; {hint}use {_either(choices)}"
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        group = group_at(Profile, path)
        return f"is not a group; indent keys under it{': ' + ', '.join(group.model_fields) if group else ''}"
    if kind == "tuple_type":
        return "is not a list; write [a, b, ...]"
    if kind == "missing":
        return "is too short; give every entry, as in the shipped profiles"
    if kind == "too_short":
        return f"is too short; give at least {context['min_length']}"
    if kind == "too_long":
        return f"is too long; give {context['max_length']}"
    if kind == "sentence":
        return message
    return f"is not accepted: {' '.join(message.lower().split())}; see the shipped profiles for an example"


def _in_unit(path: KeyPath) -> str:
    for key in reversed(path):
        if isinstance(key, str):
            unit = UNITS.get(key.rsplit("_", 1)[-1]) if "_" in key else None
            return f" in {unit}" if unit else ""
    return ""


def _either(choices: list[str]) -> str:
    return choices[0] if len(choices) == 1 else f"{', '.join(choices[:-1])} or {choices[-1]}"


def _origin(path: KeyPath, entry: Entry) -> Origin:
    return entry.nearest(path)[0].origin
