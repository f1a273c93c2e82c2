"""The base profile of every run of a campaign, and the overrides of a point."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.axes import EXTENDS, FAULTS, Axis, AxisValue, RunPoint
from xitl_cli.profile.files.catalogue import find_profile, is_shipped, profile_name, shipped_profiles, shown_path
from xitl_cli.profile.files.compose import compose, lay_on, place
from xitl_cli.profile.files.entry import Entry, Key, Origin, Problem, ProfileError
from xitl_cli.profile.files.yaml_file import plain_scalar
from xitl_cli.profile.load import LoadedProfile, loaded_profile, prepared, with_absolute_paths

_MOST_TRIED = 12
"""Number of values of an axis that are tried on the base before the campaign runs."""


@dataclass(frozen=True, slots=True)
class RunOverrides:
    """Overrides that turn the base into a run: parts merged into it, then keys set (as on the command line), then the
    seed.
    """

    parts: tuple[str, ...]
    values: tuple[tuple[str, Any], ...]
    seed: int

    @property
    def arguments(self) -> list[str]:
        """Return arguments of `xitl sim`, without the profile and its parts."""
        sets = [word for key, value in self.values for word in ("--set", f"{key}={_text(value)}")]
        return [*sets, "--seed", str(self.seed)]


def _text(value: Any) -> str:
    """Return a value as YAML that the command line reads as the same value."""
    if isinstance(value, str):
        plain = plain_scalar(value) == value and value[:1] not in "-?:,[]{}#&*!|>'\"%@`" and value == value.strip()
        return value if plain and value and ": " not in value and " #" not in value else json.dumps(value)
    return json.dumps(value)


@dataclass(frozen=True)
class BaseProfile:
    """The base profile of a campaign."""

    name: str
    """Name for the command line."""
    path: Path
    folder: Path
    """Folder to which the plan's paths are relative."""
    fixed: tuple[tuple[str, Entry], ...]
    loaded: LoadedProfile
    _composed: dict[tuple[str, ...], Entry] = field(default_factory=dict, compare=False, repr=False)
    _texts: dict[tuple[str, ...], str] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def load(cls, name: str, written: Entry | None, fixed: Entry | None, folder: Path) -> BaseProfile:
        """Load the profile with the plan's values. Raises ProfileError, and UserError for an unusable profile."""
        origin = written.origin if written is not None else Origin(name)
        try:
            path = find_profile(name, beside=folder)
        except UserError as error:
            raise ProfileError([Problem(origin, f"base: {error}")], name) from None
        pairs = tuple(_leaves(fixed)) if fixed is not None and fixed.value is not None else ()
        entry = prepared(_placed(compose(path), pairs))
        loaded = loaded_profile(entry, path, name)
        loaded.profile.run_profiles()
        shipped = profile_name(path)
        called = shipped if is_shipped(shipped) else shown_path(path)
        return cls(called, path, folder, pairs, loaded)

    @property
    def vessels(self) -> tuple[str, ...]:
        """Names of a fleet's vessels; empty for one vessel without a name."""
        return tuple(getattr(self.loaded.profile, "vessels", None) or ())

    @property
    def digest(self) -> str:
        """Digest of the composed profile without axes. A change of the profile makes other runs."""
        return hashlib.sha256(self.text(()).encode()).hexdigest()[:16]

    def own_seeds(self) -> tuple[int, ...]:
        """Return the seed of the profile."""
        return (self.loaded.profile.run_profiles()[0].clock.seed,)

    def value(self, key: str) -> Any:
        """Return its value at a dotted key; None for a missing key, and for parts."""
        if key.split(".")[0] == EXTENDS:
            return None
        if _fault(key):
            return self._has_fault(key)
        value: Any = self.loaded.profile
        for part in key.split("."):
            if isinstance(value, Mapping):
                value = value.get(part)
            elif isinstance(value, tuple):
                value = value[int(part)] if part.isdigit() and int(part) < len(value) else None
            else:
                value = getattr(value, part, None)
        return value if isinstance(value, (str, int, float, bool, tuple)) else None

    def text(self, parts: tuple[str, ...]) -> str:
        """Return the profile with these parts, as JSON (which is YAML). A remote worker needs nothing else."""
        if parts not in self._texts:
            self._texts[parts] = json.dumps(self._with_parts(parts).plain(), ensure_ascii=False)
        return self._texts[parts]

    def overrides(self, point: RunPoint, origins: Mapping[str, Origin] | None = None) -> RunOverrides:
        """Return the overrides of a point. Paths are relative to the plan. Raises ProfileError for an unknown part."""
        parts: list[str] = []
        values: list[tuple[str, Any]] = []
        for key, value in point.values.items():
            origin = (origins or {}).get(key) or Origin(shown_path(self.folder / "plan.yaml"), 1)
            if key.split(".")[0] == EXTENDS:
                parts += self._part_names(key, value, origin)
            elif _fault(key):
                if value and not self._has_fault(key):
                    parts.append(self._fault_part(key, origin))
                elif not value and self._has_fault(key):
                    values.append((key, None))
            else:
                values.append((key, self._absolute(key, value, origin)))
        return RunOverrides(tuple(parts), tuple(values), point.seed)

    def command(self, point: RunPoint) -> str:
        """Return the command that repeats a run."""
        made = self.overrides(point)
        fixed = [word for key, entry in self.fixed for word in ("--set", f"{key}={_text(entry.plain())}")]
        parts = [word for part in made.parts for word in ("--with", part)]
        return shlex.join(["xitl", "sim", self.name, *fixed, *parts, *made.arguments])

    def check_axes(self, axes: Sequence[Axis]) -> None:
        """Try the written values on the base, one at a time, at most a dozen per axis. Raises ProfileError with all
        problems.
        """
        problems: list[Problem] = []
        for axis in axes:
            values = axis.values
            if len(values) > _MOST_TRIED:  # both ends, and evenly spaced values between
                last = len(values) - 1
                values = tuple(values[round(number * last / (_MOST_TRIED - 1))] for number in range(_MOST_TRIED))
            for value in values or (axis.example(),):
                try:
                    self.check(RunPoint(0, {axis.key: value}, 1), {axis.key: axis.origin})
                except ProfileError as error:
                    problems += error.problems[:1]
                    break
        if problems:
            raise ProfileError(problems, self.name)

    def check(self, point: RunPoint, origins: Mapping[str, Origin]) -> LoadedProfile:
        """Return the profile of a point. Raises ProfileError."""
        made = self.overrides(point, origins)
        some = next(iter(origins.values()), Origin(self.name))
        pairs = [(key, _entry(value, origins.get(key, some))) for key, value in made.values]
        loaded = loaded_profile(prepared(_placed(self._with_parts(made.parts), pairs)), self.path, self.name)
        loaded.profile.run_profiles()
        return loaded

    def _with_parts(self, parts: tuple[str, ...]) -> Entry:
        if parts not in self._composed:
            entry = compose(self.path)
            for part in parts:
                entry = lay_on(entry, find_profile(part))
            self._composed[parts] = prepared(_placed(entry, self.fixed))
        return self._composed[parts]

    def _part_names(self, key: str, value: AxisValue, origin: Origin) -> list[str]:
        names = value if isinstance(value, tuple) else () if value is None else (value,)
        parts = []
        for name in names:
            try:
                path = find_profile(str(name), beside=self.folder)
            except UserError as error:
                raise ProfileError([Problem(origin, f"{key}: {error}")], self.name) from None
            shipped = profile_name(path)
            parts.append(shipped if is_shipped(shipped) else shown_path(path))
        return parts

    def _has_fault(self, key: str) -> bool:
        return key.split(".")[1] in (self.loaded.profile.faults or {})

    def _fault_part(self, key: str, origin: Origin) -> str:
        part, shipped = f"{FAULTS}/{key.split('.')[1]}", shipped_profiles()
        if part not in shipped:
            import difflib

            known = [name for name in shipped if name.startswith(f"{FAULTS}/")]
            close = difflib.get_close_matches(part, known, n=1)
            fix = f"did you mean {close[0].replace('/', '.')}?" if close else f"shipped faults: {', '.join(known)}"
            problem = f"{key} is neither a fault of {self.name} nor a shipped fault; {fix}"
            raise ProfileError([Problem(origin, problem)], self.name)
        return part

    def _absolute(self, key: str, value: AxisValue, origin: Origin) -> Any:
        """Return the absolute path of a file that is relative to the plan; return other values unchanged."""
        if not isinstance(value, (str, tuple)):
            return value
        keys = key.split(".")
        entry = _entry(value, Origin(str(self.folder / "plan.yaml"), origin.line or 1))
        for part in reversed(keys):
            entry = Entry({part: entry}, entry.origin)
        path: list[Key] = [int(part) if part.isdigit() else part for part in keys]
        absolute, depth = with_absolute_paths(entry).nearest(tuple(path))
        if depth < len(keys):
            absolute = with_absolute_paths(entry).nearest(tuple(keys))[0]
        return absolute.plain()


def _fault(key: str) -> bool:
    """Return True if a key refers to a whole fault."""
    return key.startswith(f"{FAULTS}.") and key.count(".") == 1


def _leaves(entry: Entry, above: str = "") -> list[tuple[str, Entry]]:
    """Return the values that a plan sets, by dotted key. Keys may be nested."""
    if not isinstance(entry.value, dict):
        problem = "set is not a group; write `key of the profile: value` under it"
        raise ProfileError([Problem(entry.origin, problem)], entry.origin.source)
    leaves: list[tuple[str, Entry]] = []
    for key, below in entry.value.items():
        path = f"{above}.{key}" if above else key
        leaves += _leaves(below, path) if isinstance(below.value, dict) and below.value else [(path, below)]
    return leaves


def _placed(entry: Entry, pairs: Sequence[tuple[str, Entry]]) -> Entry:
    for key, value in pairs:
        entry = place(entry, key, value)
    return entry


def _entry(value: Any, origin: Origin) -> Entry:
    """Return plain values as entries with one origin."""
    if isinstance(value, Mapping):
        return Entry({key: _entry(below, origin) for key, below in value.items()}, origin)
    if isinstance(value, (tuple, list)):
        return Entry(tuple(_entry(below, origin) for below in value), origin)
    return Entry(value, origin)
