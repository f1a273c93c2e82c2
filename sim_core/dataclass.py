"""`dataclass` of the standard library, for modules that each run imports.

The standard library compiles up to six methods when a class is made, which takes 0.5 to 1.3 ms. A run imports some 370
such classes, constructs half of them, and hardly ever compares or prints one. Here `__init__` is compiled at its first
call and the other methods are shared. A class takes 0.03 to 0.15 ms, and a frozen object with slots is made faster.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from operator import attrgetter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls=None, /, *, frozen=False, slots=False, eq=True, kw_only=False):
        """Make a class a dataclass, with these options of `dataclasses.dataclass`. InitVar is not supported.

        A class without a docstring gets its name as one, and not its signature, which would compile `__init__` at once.
        """

        def process(cls):
            own = vars(cls)
            cls.__doc__ = cls.__doc__ or cls.__name__
            methods = {"__init__": _DeferredInit(frozen), "__repr__": _repr}
            if eq:
                methods["__eq__"] = _eq
                if own.get("__hash__") is None:  # Python sets None for a class with its own __eq__
                    cls.__hash__ = _hash if frozen else None
            # The standard library accepts a frozen base below a frozen class only, and then makes these methods.
            frozen_base = any(dataclasses.is_dataclass(base) for base in cls.__mro__[1:]) and frozen
            if frozen and not frozen_base:
                methods |= {"__setattr__": _refuse_assignment, "__delattr__": _refuse_deletion}
                if slots:
                    methods |= {"__getstate__": _state, "__setstate__": _restore}
            for name, method in methods.items():
                if name not in own:
                    setattr(cls, name, method)
            made = dataclasses.dataclass(
                init=False, repr=False, eq=False, frozen=frozen_base, slots=slots, kw_only=kw_only
            )(cls)
            made.__dataclass_params__.frozen = frozen
            return made

        return process if cls is None else process(cls)


class _Missing:
    """Default of a parameter whose field has a factory; `inspect.signature` shows it as the standard library's."""

    def __repr__(self) -> str:
        return "<factory>"


_MISSING = _Missing()


class _DeferredInit:
    """Becomes the `__init__` of the class that holds it when somebody asks for it."""

    __slots__ = ("_frozen",)

    def __init__(self, frozen: bool) -> None:
        self._frozen = frozen

    def __get__(self, instance: object, owner: type) -> Any:
        # Python 3.13's inspect passes the class as the instance
        of_class = instance if isinstance(instance, type) else owner
        holder = next(cls for cls in of_class.__mro__ if vars(cls).get("__init__") is self)
        init = _compiled_init(holder, self._frozen)
        holder.__init__ = init  # type: ignore[misc] # that of a class, on purpose
        return init.__get__(instance, owner)


def _compiled_init(cls: type, frozen: bool) -> Any:
    """Return the function that the standard library would make for the fields of `cls`."""
    names: dict[str, Any] = {"_set": object.__setattr__, "_missing": _MISSING}
    positional, keyword, body = ["self"], list[str](), list[str]()
    fields: tuple[dataclasses.Field[Any], ...] = dataclasses.fields(cls)
    for field in fields:
        name, value, parameter = field.name, field.name, field.name
        if field.default_factory is not dataclasses.MISSING:
            names[f"_make_{name}"] = field.default_factory
            parameter += "=_missing"
            value = f"_make_{name}() if {name} is _missing else {name}" if field.init else f"_make_{name}()"
        elif field.default is not dataclasses.MISSING:
            names[f"_default_{name}"] = field.default
            parameter += f"=_default_{name}"
            value = name if field.init else f"_default_{name}"
        elif not field.init:
            continue
        if field.init:
            (keyword if field.kw_only else positional).append(parameter)
        # A slot's own setter passes by the class's refusal to assign, as does that of `object`.
        slot_setter = getattr(getattr(cls, name, None), "__set__", None)
        if not frozen:
            body.append(f"self.{name} = {value}")
        elif slot_setter is not None:
            names[f"_set_{name}"] = slot_setter
            body.append(f"_set_{name}(self, {value})")
        else:
            body.append(f"_set(self, {name!r}, {value})")
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    parameters = ", ".join([*positional, *(["*", *keyword] if keyword else [])])
    # Compiled in a function whose parameters are the names, so that no field can hide one
    source = f"def make({', '.join(names)}):\n def __init__({parameters}):\n  " + "\n  ".join(body or ["pass"])
    made: dict[str, Any] = {}
    exec(f"{source}\n return __init__", {"__name__": cls.__module__}, made)
    init = made["make"](**names)
    init.__qualname__ = f"{cls.__qualname__}.__init__"
    init.__annotations__ = {field.name: field.type for field in fields if field.init} | {"return": None}
    return init


def _repr(self: Any) -> str:
    shown = ", ".join(f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr)
    return f"{type(self).__qualname__}({shown})"


def _eq(self: Any, other: object) -> Any:
    if other.__class__ is not self.__class__:
        return NotImplemented
    return _compared_values(self) == _compared_values(other)


def _hash(self: Any) -> int:
    return hash(_compared_values(self))


def _compared_values(value: Any) -> tuple[Any, ...]:
    values: tuple[Any, ...] = _reader(value.__class__)(value)
    return values


@cache
def _reader(cls: type) -> Any:
    """Return the function that reads the fields of an object which are compared."""
    names = [field.name for field in dataclasses.fields(cls) if field.compare]
    if len(names) < 2:
        return lambda self: tuple(getattr(self, name) for name in names)
    return attrgetter(*names)


def _refuse_assignment(self: object, name: str, value: object) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deletion(self: object, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


def _state(self: Any) -> list[Any]:
    return [getattr(self, field.name) for field in dataclasses.fields(self)]


def _restore(self: Any, state: list[Any]) -> None:
    for field, value in zip(dataclasses.fields(self), state, strict=True):
        object.__setattr__(self, field.name, value)
