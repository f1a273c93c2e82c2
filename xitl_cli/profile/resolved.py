"""A checked profile back to YAML that loads to an equal one."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import yaml

from xitl_cli.profile.files.entry import Entry, KeyPath, dotted
from xitl_cli.profile.files.yaml_file import parse_yaml, plain_scalar
from xitl_cli.profile.schema import Profile

if TYPE_CHECKING:
    from xitl_cli.profile.load import LoadedProfile


class _Dumper(yaml.SafeDumper):
    """Short lists of numbers on one line, no aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _sequence(dumper: yaml.SafeDumper, items: tuple[object, ...] | list[object]) -> yaml.Node:
    flow = all(isinstance(item, (int, float, str)) for item in items)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", items, flow_style=flow)


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.Node:
    quotes = None if isinstance(plain_scalar(text), str) else "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=quotes)


_Dumper.add_representer(str, _text)
_Dumper.add_representer(list, _sequence)
_Dumper.add_representer(tuple, _sequence)


def resolved_yaml(profile: Profile) -> str:
    """`profile` with everything it extends, every override and every default written out."""
    present = _present(asdict(profile))
    if profile.faults is not None:
        present["faults"] = {name: _present(asdict(fault)) for name, fault in profile.faults.items()}
    return yaml.dump(present, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def _present(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def values_with_origins(loaded: LoadedProfile) -> Iterator[tuple[str, str, str]]:
    """Every value of a profile as (dotted key, value, where it was written or `default`)."""
    resolved = parse_yaml(resolved_yaml(loaded.profile), "resolved")
    if resolved is None:
        return
    for path, leaf in _rows(resolved, ()):
        found, depth = loaded.entry.nearest(path)
        text = leaf.value if isinstance(leaf.value, str) else json.dumps(leaf.plain(), ensure_ascii=False)
        yield dotted(path), text, str(found.origin) if depth == len(path) else "default"


def _rows(entry: Entry, path: KeyPath) -> Iterator[tuple[KeyPath, Entry]]:
    """Scalars, and lists as wholes."""
    if isinstance(entry.value, dict) and entry.value:
        for key, below in entry.value.items():
            yield from _rows(below, (*path, key))
    else:
        yield path, entry
