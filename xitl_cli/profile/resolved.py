"""Converts a checked profile back to YAML that loads to an equal profile."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import yaml

from sim_core.keys import AmongVessels, IfGiven, key_annotations, marks
from xitl_cli.profile.files.entry import Entry, KeyPath, dotted
from xitl_cli.profile.files.yaml_file import parse_yaml, plain_scalar
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.fleet import SAILED

if TYPE_CHECKING:
    from xitl_cli.profile.load import LoadedProfile


def _sequence(dumper: yaml.SafeDumper, items: tuple[object, ...] | list[object]) -> yaml.Node:
    flow = all(isinstance(item, (int, float, str)) for item in items)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=flow)


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    quotes = None if isinstance(plain_scalar(text), str) else "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=quotes)


def _dumper(base: Any) -> Any:
    """Return a dumper that writes short lists of numbers on one line, without aliases."""
    dumper: Any = type("Dumper", (base,), {"ignore_aliases": lambda self, data: True})
    dumper.add_representer(str, _text)
    dumper.add_representer(list, _sequence)
    dumper.add_representer(tuple, _sequence)
    return dumper


_DUMPER = _dumper(yaml.SafeDumper)
_QUICK_DUMPER = _dumper(yaml.CSafeDumper) if yaml.__with_libyaml__ else None
_LONGEST_LINE = 120


def _dumped(groups: dict[str, Any]) -> str:
    """Return the text of groups. The quick dumper differs only in escaped characters and in long keys."""
    style: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "width": 100}
    if _QUICK_DUMPER is not None:
        text = str(yaml.dump(groups, Dumper=_QUICK_DUMPER, **style))
        if "\\" not in text and max(map(len, text.splitlines())) <= _LONGEST_LINE:
            return text
    return str(yaml.dump(groups, Dumper=_DUMPER, **style))


def resolved_yaml(profile: Profile) -> str:
    """Return `profile` with all inherited values, overrides and defaults written out.

    Each vessel of a fleet has only the values that differ from the shared groups.
    """
    groups = _groups(profile)
    if profile.vessels is not None:
        groups["vessels"] = {name: _own(vessel, groups) for name, vessel in profile.vessels.items()}
    return _dumped(groups)


def _groups(profile: Profile) -> dict[str, Any]:
    groups = {key: value for key, value in _plain(replace(profile, vessels=None)).items() if value is not None}
    for fault in groups.get("faults", {}):
        groups["faults"][fault] = {key: value for key, value in groups["faults"][fault].items() if value is not None}
    return groups


def _plain(value: Any) -> Any:
    """Convert to mappings, tuples and scalars.

    Keys for a vessel among several, and keys marked `IfGiven`, are left out when they have their defaults.
    """
    if is_dataclass(value) and not isinstance(value, type):
        marked, spec = key_annotations(type(value)), fields(value)
        return {
            key.name: _plain(own)
            for key in spec
            if (own := getattr(value, key.name)) != key.default or not _LEFT_OUT & set(marks(marked.get(key.name)))
        }
    if isinstance(value, dict):
        return {key: _plain(below) for key, below in value.items()}
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


_LEFT_OUT = {AmongVessels, IfGiven}


def _own(vessel: Profile, shared: dict[str, Any]) -> dict[str, Any]:
    """Return the entry of `vessels` that gives this vessel."""
    groups = _groups(vessel)
    if vessel.traffic is not None:
        return {"traffic": groups["traffic"]}
    own: dict[str, Any] = {}
    for group in SAILED:
        value, common = groups.get(group), shared.get(group)
        if value == common:
            continue
        # A complete vessel replaces another one.
        own[group] = value if group == "vehicle" or common is None or value is None else _difference(value, common)
    if vessel.mission is not None:
        own.setdefault("mission", {})["start"] = groups["mission"]["start"]
    if vessel.autopilot is not None:
        own.setdefault("autopilot", {})["system_id"] = vessel.autopilot.system_id
    return own


def _difference(value: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    difference: dict[str, Any] = {key: None for key in common if key not in value}
    for key, own in value.items():
        if key not in common or own != common[key]:
            both_groups = isinstance(own, dict) and isinstance(common.get(key), dict)
            difference[key] = _difference(own, common[key]) if both_groups else own
    return difference


def values_with_origins(loaded: LoadedProfile) -> Iterator[tuple[str, str, str]]:
    """Yield every value of a profile as (dotted key, value, origin or `default`)."""
    resolved = parse_yaml(resolved_yaml(loaded.profile), "resolved")
    if resolved is None:
        return
    for path, leaf in _rows(resolved, ()):
        nearest, depth = loaded.entry.nearest(path)
        text = leaf.value if isinstance(leaf.value, str) else json.dumps(leaf.plain(), ensure_ascii=False)
        yield dotted(path), text, str(nearest.origin) if depth == len(path) else "default"


def _rows(entry: Entry, path: KeyPath) -> Iterator[tuple[KeyPath, Entry]]:
    """Yield scalars and whole lists with their paths."""
    if isinstance(entry.value, dict) and entry.value:
        for key, below in entry.value.items():
            yield from _rows(below, (*path, key))
    else:
        yield path, entry
