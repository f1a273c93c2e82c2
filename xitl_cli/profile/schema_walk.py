"""Finding one's way in the schema: which group or choice stands at a key path."""

from __future__ import annotations

from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from xitl_cli.profile.entry import KeyPath


def group_at(model: type[BaseModel], path: KeyPath) -> type[BaseModel] | None:
    """The group at `path` below `model`; None where something else stands there."""
    return next((found for found in _annotations(model, path) if isinstance(found, type) and _is_model(found)), None)


def choices_at(model: type[BaseModel], path: KeyPath) -> list[str]:
    """The words allowed at `path`; empty where the value is not a choice."""
    return [
        str(word) for found in _annotations(model, path) if get_origin(found) is Literal for word in get_args(found)
    ]


def paths_to(model: type[BaseModel], key: str) -> list[KeyPath]:
    """Every place below `model` (not inside lists) where `key` is a known key, the nearest first."""
    return sorted((path for path in _walk(model, ()) if path[-1] == key), key=len)


def _walk(model: type[BaseModel], above: KeyPath) -> Iterator[KeyPath]:
    for name, field in model.model_fields.items():
        yield (*above, name)
        for found in _unwrapped(field.annotation):
            if _is_model(found):
                yield from _walk(found, (*above, name))


def _annotations(annotation: Any, path: KeyPath) -> list[Any]:
    """The alternatives at `path` below `annotation`, without Annotated and None."""
    found = _unwrapped(annotation)
    for key in path:
        found = [inner for outer in found for inner in _below(outer, key)]
    return found


def _below(annotation: Any, key: str | int) -> list[Any]:
    if _is_model(annotation):
        field = annotation.model_fields.get(key)
        return [] if field is None else _unwrapped(field.annotation)
    arguments = get_args(annotation)
    if get_origin(annotation) is dict:
        return _unwrapped(arguments[1])
    if get_origin(annotation) is tuple and isinstance(key, int):
        if arguments[-1] is Ellipsis:
            return _unwrapped(arguments[0])
        return _unwrapped(arguments[key]) if key < len(arguments) else []
    return []


def _unwrapped(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Annotated:
        return _unwrapped(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [inner for alternative in get_args(annotation) for inner in _unwrapped(alternative)]
    return [] if annotation is type(None) else [annotation]


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
