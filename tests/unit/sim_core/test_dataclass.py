"""`sim_core.dataclass` next to the standard library's `dataclasses.dataclass`: the same classes, made by both."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
import re
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any

import pytest

from sim_core.dataclass import dataclass

ROOT = Path(__file__).parents[3]


@dataclass(frozen=True, slots=True)
class Base:
    """A frozen class with slots, as most are."""

    name: str
    speed_mps: float = 1.5
    tags: list[str] = field(default_factory=list)
    note: str = field(default="", compare=False, repr=False)
    doubled: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "doubled", 2.0 * self.speed_mps)


@dataclass(frozen=True, slots=True, kw_only=True)
class Derived(Base):
    """Fields by keyword after inherited ones."""

    depth_m: float
    limits: tuple[float, float] = (0.0, 1.0)


@dataclass
class Mutable:
    """With defaults, and `_set` as a field."""

    _set: int
    values: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Single:
    """With one field."""

    value: float


def by_the_standard_library(frozen: bool, slots: bool, kw_only: bool, eq: bool) -> tuple[type[Any], type[Any]]:
    """Return one class made by both decorators."""

    def declared() -> type[Any]:
        class Sample:
            """Any."""

            a: int
            b: float = 2.0
            c: list[int] = field(default_factory=list)
            d: str = field(default="d", compare=False)
            e: str = field(default="e", repr=False, kw_only=True)

        return Sample

    options = {"frozen": frozen, "slots": slots, "kw_only": kw_only, "eq": eq}
    return dataclass(**options)(declared()), dataclasses.dataclass(**options)(declared())


@pytest.mark.parametrize("frozen", [True, False])
@pytest.mark.parametrize("slots", [True, False])
@pytest.mark.parametrize("kw_only", [True, False])
@pytest.mark.parametrize("eq", [True, False])
def test_a_class_behaves_as_that_of_the_standard_library(frozen: bool, slots: bool, kw_only: bool, eq: bool) -> None:
    ours, theirs = by_the_standard_library(frozen, slots, kw_only, eq)
    assert str(inspect.signature(ours)) == str(inspect.signature(theirs))
    assert [(f.name, f.type, f.kw_only, f.compare) for f in fields(ours)] == [
        (f.name, f.type, f.kw_only, f.compare) for f in fields(theirs)
    ]
    for made in (ours, theirs):
        one, same, other = made(a=1, c=[3]), made(a=1, c=[3], d="differs"), made(a=2)
        assert repr(one).endswith("Sample(a=1, b=2.0, c=[3], d='d')")
        assert (one == same) is eq
        assert one != other
        assert one != (1, 2.0, [3])
        assert replace(one, b=4.0).b == 4.0
        assert dataclasses.asdict(one) == {"a": 1, "b": 2.0, "c": [3], "d": "d", "e": "e"}
        assert made(a=1).c is not made(a=1).c
        assert hasattr(one, "__dict__") is not slots
        with pytest.raises(TypeError, match="missing 1 required"):
            made()
        with pytest.raises(TypeError, match="unexpected keyword argument 'z'"):
            made(a=1, z=3)
        if frozen:
            with pytest.raises(dataclasses.FrozenInstanceError, match="cannot assign to field 'a'"):
                one.a = 5
            with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'a'"):
                del one.a
        else:
            one.a = 5
            assert one.a == 5
        if eq and not frozen:
            with pytest.raises(TypeError, match="unhashable"):
                hash(one)
        elif not eq:
            assert hash(one) == object.__hash__(one)
        else:
            hashed = made(a=1, c=(3,))
            assert hash(hashed) == hash((1, 2.0, (3,), "e"))


def test_init_is_compiled_at_the_first_call() -> None:
    @dataclass(frozen=True, slots=True)
    class Fresh:
        """Not constructed yet."""

        a: int

    assert not inspect.isfunction(vars(Fresh)["__init__"])
    assert Fresh(1).a == 1
    assert inspect.isfunction(vars(Fresh)["__init__"])


def test_a_derived_class_has_the_fields_of_its_base() -> None:
    derived = Derived("boat", 2.0, depth_m=3.0)
    assert (derived.name, derived.speed_mps, derived.doubled, derived.depth_m) == ("boat", 2.0, 4.0, 3.0)
    assert list(inspect.signature(Derived).parameters) == ["name", "speed_mps", "tags", "note", "depth_m", "limits"]
    assert Base("boat", 2.0) != derived


def test_a_class_of_the_standard_library_may_derive_from_one() -> None:
    @dataclasses.dataclass(frozen=True, slots=True)
    class Theirs(Base):
        """As a plug-in may declare it."""

        colour: str = "red"

    assert Theirs("boat", colour="blue").colour == "blue"
    assert Theirs("boat").doubled == 3.0


@pytest.mark.parametrize("value", [Base("boat", 2.0, ["a"]), Derived("boat", depth_m=1.0), Mutable(1, {"b": 2})])
def test_pickles_and_copies_are_equal(value: object) -> None:
    assert pickle.loads(pickle.dumps(value)) == value
    assert copy.deepcopy(value) == value
    assert copy.copy(value) == value


def test_a_nan_equals_itself() -> None:
    nan = float("nan")
    assert Mutable(0, {"a": nan}) == Mutable(0, {"a": nan})
    assert Single(nan) == Single(nan)


def test_a_class_without_a_docstring_has_its_signature() -> None:
    @dataclass(frozen=True, slots=True)
    class Plain:
        a: int
        b: float = 2.0

    assert str(inspect.signature(Plain)) == "(a: 'int', b: 'float' = 2.0) -> None"
    assert Plain(1) == Plain(1, 2.0)


def test_own_methods_are_kept() -> None:
    @dataclass(frozen=True)
    class Own:
        """With its own methods."""

        a: int

        def __init__(self) -> None:
            object.__setattr__(self, "a", 7)

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Own)

        def __hash__(self) -> int:
            return 42

    assert Own().a == 7
    assert hash(Own()) == 42
    assert Own() == Own()


def test_an_own_comparison_has_the_hash_of_the_fields() -> None:
    """As in the standard library."""

    @dataclass(frozen=True)
    class Own:
        """With its own comparison."""

        a: int

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Own)

    assert hash(Own(3)) == hash((3,))


def test_modules_of_runs_use_it() -> None:
    """All product code but the agent and the logs, which import nothing of sim_core, and what `xitl --help` loads."""
    files = [path for package in ("sim_core", "xitl_cli", "xitl") for path in (ROOT / package).rglob("*.py")]
    names = ("sim_core/dataclass.py", "xitl_cli/logs", "xitl_cli/plugin.py", "xitl_cli/registry.py")
    apart = [ROOT / name for name in names]
    standard = re.compile(r"^from dataclasses import .*\bdataclass\b", re.M)
    found = [
        str(path.relative_to(ROOT))
        for path in files
        if not any(path.is_relative_to(other) for other in apart) and standard.search(path.read_text())
    ]
    assert len(files) > 300
    assert found == []
