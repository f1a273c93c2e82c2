"""Keys of a specification: fields of a frozen dataclass. Annotations give the meaning and bounds of each value.

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Hull(Specification):
        length_m: Annotated[Positive, "of each hull"]
        strips: Annotated[int, Bounds(at_least=2), "of each hull"] = 6

A name carries its unit. Every constructor checks the bounds. File readers take names, types, bounds, defaults and
meanings from here too. This module does not import numpy, so that a file check does not need it.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from types import UnionType
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin, get_type_hints

from sim_core.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Allowed range of numbers."""

    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None

    def problem(self, value: float) -> str | None:
        """Return the problem of a value and its fix, as text after `key = value`; None for an allowed value."""
        if self.above is not None and not value > self.above:
            return f"is too small; use a value above {self.above:g}"
        if self.at_least is not None and not value >= self.at_least:
            return f"is too small; use a value of at least {self.at_least:g}"
        if self.below is not None and not value < self.below:
            return f"is too large; use a value below {self.below:g}"
        if self.at_most is not None and not value <= self.at_most:
            return f"is too large; use a value of at most {self.at_most:g}"
        return None


@dataclass(frozen=True, slots=True)
class Items:
    """Allowed number of entries of a list."""

    at_least: int = 0
    at_most: int | None = None
    why: str = ""
    """Reason for the limits."""

    def problem(self, value: tuple[object, ...]) -> str | None:
        """Return the problem of a list's length, like `Bounds.problem`."""
        if len(value) < self.at_least:
            return f"is too short; give at least {self.at_least}"
        if self.at_most is not None and len(value) > self.at_most:
            return f"is too long; give at most {self.at_most}" + (f", {self.why}" if self.why else "")
        return None


@dataclass(frozen=True, slots=True)
class ValueProblem:
    """A special rule that replaces the rule of the type."""

    problem: Callable[[object], str | None]
    """Returns the problem of a value, None for an allowed value."""


class Required:
    """Marks a key that a profile must give, although the class has a neutral default."""


class IfGiven:
    """Marks a key that complete profiles include only with a value other than its default."""


class AmongVessels:
    """Marks a key that matters only with several vessels. By default, files for a single vessel do not include it."""


Positive: TypeAlias = Annotated[float, Bounds(above=0)]
NonNegative: TypeAlias = Annotated[float, Bounds(at_least=0)]
Share: TypeAlias = Annotated[float, Bounds(at_least=0, at_most=1)]
Direction: TypeAlias = Annotated[float, Bounds(at_least=-360, at_most=360)]
RateHz: TypeAlias = Annotated[float, Bounds(above=0, at_most=100_000)]
Seed: TypeAlias = Annotated[int, Bounds(at_least=0)]
Place: TypeAlias = tuple[float, float]
"""North and east."""
Vector: TypeAlias = tuple[float, float, float]
"""Three numbers along the axes in the key's name (ned or frd)."""
Size: TypeAlias = tuple[Positive, Positive, Positive]
MESH_FORMATS = ("stl", "dae", "obj", "ply", "gltf", "glb")
"""Extensions of supported mesh files."""


class SpecificationError(ValueError):
    """A key that conflicts with the other keys of its group.

    path: path of the key within the group. text: the rest of the sentence, after the key.
    """

    def __init__(self, path: tuple[str | int, ...], text: str) -> None:
        super().__init__(f"{'.'.join(map(str, path))} {text}".strip())
        self.path = path
        self.text = text


class Specification:
    """A group of keys. Raises ValueError for a value out of its bounds, with class, key, value and fix.

    A subclass checks conditions between its keys in `check`, which raises SpecificationError.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        check_values(self)
        self.check()

    def check(self) -> None:
        """Raises SpecificationError when keys conflict."""


def check_values(instance: object) -> None:
    """Raises ValueError for the first field of a dataclass that its annotation does not allow."""
    group: type = type(instance)
    for name, annotation in key_annotations(group).items():
        for value, problem in problems(getattr(instance, name), annotation, unit_of(name)):
            raise ValueError(f"{group.__name__}.{name} = {value} {problem}")


@lru_cache(maxsize=256)
def key_annotations(group: type) -> dict[str, Any]:
    """Return the annotation of each key of a dataclass, in order."""
    hints = get_type_hints(group, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(group) if field.init}


@lru_cache(maxsize=256)
def required_keys(group: type) -> tuple[str, ...]:
    """Return the required keys."""
    known, absent = key_annotations(group), dataclasses.MISSING
    return tuple(
        field.name
        for field in dataclasses.fields(group)
        if field.name in known
        and (Required in unpacked(known[field.name])[1] or field.default is absent is field.default_factory)
    )


def unpacked(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the type within an annotation, and its markers and meaning."""
    if get_origin(annotation) is Annotated:
        kind, *markers = get_args(annotation)
        return kind, tuple(markers)
    return annotation, ()


def marks(annotation: Any) -> tuple[type, ...]:
    """Return the classes of the markers of a key."""
    return tuple(type(marker) for marker in unpacked(annotation)[1])


def alternatives(annotation: Any) -> list[tuple[Any, tuple[Any, ...]]]:
    """Return the types that a value may have, each with its markers, without None."""
    kind, markers = unpacked(annotation)
    if get_origin(kind) not in (Union, UnionType):
        return [] if kind is type(None) else [(kind, markers)]
    return [(inner, (*own, *markers)) for argument in get_args(kind) for inner, own in alternatives(argument)]


def optional(annotation: Any) -> bool:
    """Return True if null is allowed."""
    kind, _ = unpacked(annotation)
    return get_origin(kind) in (Union, UnionType) and type(None) in get_args(kind)


def entries(kind: Any, count: int) -> tuple[Any, ...]:
    """Return the annotations of `count` entries of a tuple type, or of all entries if their number is fixed."""
    arguments = get_args(kind)
    return arguments[:1] * count if arguments[-1] is Ellipsis else arguments


def problems(value: Any, annotation: Any, unit: str = "") -> Iterator[tuple[Any, str]]:
    """Yield the disallowed values at and below `value`, each with its problem. Groups check themselves."""
    if value is None and optional(annotation):
        return
    rule = own_rule(annotation)
    if rule is not None:
        problem = rule.problem(value)
        if problem:
            yield value, problem
        return
    for kind, markers in alternatives(annotation):
        if isinstance(value, tuple) and get_origin(kind) is tuple:
            inner = entries(kind, len(value))
            problem = length_problem(value, kind, markers)
            if problem:
                yield value, problem
            for entry, own in zip(value, inner, strict=False):
                yield from problems(entry, own, unit)
        elif kind in (float, int) or get_origin(kind) is Literal:
            problem = value_problem(value, kind, markers, unit)
            if problem:
                yield value, problem


@dataclass(frozen=True, slots=True)
class MoreChoices:
    """Marks a key that has more choices than its Literal."""

    names: Callable[[], Sequence[str]]
    """Returns the additional choices. It is called when they are needed."""


@dataclass(frozen=True, slots=True)
class ShortForm:
    """Marks a key that holds a group, for which text is a short form: the value of one key of the group."""

    key: str


@dataclass(frozen=True, slots=True)
class RegisteredGroups:
    """Marks a key that holds groups of other packages, by name. A file reader looks up the class of each group."""

    registry: str
    """Entry-point group that has the classes."""


def own_rule(annotation: Any) -> ValueProblem | None:
    """Return the special rule that replaces the rule of the type."""
    return next((marker for marker in unpacked(annotation)[1] if isinstance(marker, ValueProblem)), None)


def meaning_of(annotation: Any) -> str:
    """Return the meaning of a key, empty if its name is sufficient."""
    return next((marker for marker in unpacked(annotation)[1] if isinstance(marker, str)), "")


def length_problem(value: tuple[object, ...], kind: Any, markers: tuple[Any, ...]) -> str | None:
    """Return the problem of a list's length."""
    fixed = len(entries(kind, len(value)))
    if len(value) < fixed:
        return "is too short; give every entry, as in the shipped profiles"
    if len(value) > fixed:
        return f"is too long; give {fixed}"
    item_problems = (marker.problem(value) for marker in markers if isinstance(marker, Items))
    return next((problem for problem in item_problems if problem), None)


def value_problem(value: object, kind: Any, markers: tuple[Any, ...], unit: str = "") -> str | None:
    """Return the problem of a scalar and its fix, as text after `key = value`; None for an allowed value."""
    inside = f" in {unit}" if unit else ""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if get_origin(kind) is Literal:
        words = [str(word) for word in get_args(kind)]
        if value in words:
            return None
        more = [name for marker in markers if isinstance(marker, MoreChoices) for name in marker.names()]
        if value in more:
            return None
        added = any(isinstance(marker, MoreChoices) for marker in markers)
        words = list(dict.fromkeys([*words, *more]))
        close = difflib.get_close_matches(value, words, n=1) if isinstance(value, str) else []
        hint = f"did you mean {close[0]!r}? " if close else ""
        either = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
        return f"is not one of the choices; {hint}use {either}" + (", or install the package that has it" * added)
    if kind is str:
        return None if isinstance(value, str) else "is not text; put it in quotes"
    if kind is bool:
        return None if isinstance(value, bool) else "is neither true nor false; write true or false"
    if kind is int and not (number and isinstance(value, int)):
        return "is not a whole number; write a whole number"
    if not number or (kind is float and isinstance(value, int) and value.bit_length() > LARGEST_BITS):
        return f"is not a number; write a number{inside}"
    assert isinstance(value, (int, float))
    if isinstance(value, float) and not math.isfinite(value):
        return f"is not finite; write a finite number{inside}"
    bound_problems = (marker.problem(value) for marker in markers if isinstance(marker, Bounds))
    return next((f"{problem}{inside}" for problem in bound_problems if problem), None)


LARGEST_BITS = 64
UNITS = {
    "mps": "m/s",
    "mps2": "m/s²",
    "radps": "rad/s",
    "degps": "degrees/s",
    "degph": "degrees/h",
    "m": "m",
    "m2": "m²",
    "s": "s",
    "min": "minutes",
    "hz": "Hz",
    "mhz": "MHz",
    "khz": "kHz",
    "deg": "degrees",
    "c": "°C",
    "kg": "kg",
    "kgm2": "kg m²",
    "kgpm3": "kg/m³",
    "n": "N",
    "pa": "Pa",
    "v": "V",
    "a": "A",
    "ohm": "Ω",
    "ah": "A h",
    "gauss": "gauss",
    "ppm": "ppm",
    "us": "µs",
    "mmph": "mm/h",
    "w": "W",
    "db": "dB",
    "dbi": "dBi",
    "grad": "gradians",
    "radpsprthz": "rad/s/√Hz",
    "mps2prthz": "m/s²/√Hz",
    "gaussprthz": "gauss/√Hz",
    "mprts": "m/√s",
    "degprts": "degrees/√s",
}


def unit_of(key: str) -> str:
    """Return the unit at the end of a key's name, empty if there is none."""
    return UNITS.get(key.rsplit("_", 1)[-1], "") if "_" in key else ""
