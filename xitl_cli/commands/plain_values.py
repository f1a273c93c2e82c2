"""A command that converts the usual values of its options itself.

typer converts values with pydantic, whose import takes longer than everything else that typer does. Values that this
module does not convert, and all wrong values, are left to typer, so that its errors stay the same.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from typer.core import TyperCommand

_INTEGER = re.compile(r"[-+]?[0-9]{1,15}", re.ASCII)
_NUMBER = re.compile(r"[-+]?[0-9]{1,15}(\.[0-9]{1,15})?(e[-+]?[0-9]{1,2})?", re.ASCII)


class PlainCommand(TyperCommand):
    """A command that imports pydantic only for unusual values."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return all parameters."""
        return converting_plainly(super().get_params(ctx))


def converting_plainly(params: list[Any]) -> list[Any]:
    """Let parameters of typer convert usual values without pydantic. Return them."""
    for param in params:
        if hasattr(param, "type_descriptor"):  # older versions of typer convert without pydantic
            param.process_value = partial(_processed, param, type(param).process_value)
    return params


def _processed(param: Any, by_typer: Callable[[Any, Any, Any], Any], ctx: Any, value: Any) -> Any:
    """Return the value of a parameter, converted here or by typer."""
    several = param.multiple or param.nargs == -1
    if value is None and not param.required:
        absent = () if several else None
        return absent if param.callback is None else param.callback(ctx, param, absent)
    kind, info = param.type_descriptor.annotation, param.type_descriptor.parameter_info
    special = param.callback is not None or value is None or info.parser is not None
    if special or info.min is not None or info.max is not None:
        return by_typer(param, ctx, value)
    if kind == list[str] and several and value and all(isinstance(word, str) for word in value):
        return list(value)
    if several or not isinstance(value, str):
        return by_typer(param, ctx, value)
    if kind is str:
        return value
    if kind is int and _INTEGER.fullmatch(value):
        return int(value)
    if kind is float and _NUMBER.fullmatch(value):
        return float(value)
    if kind is Path and _is_usual_path(info) and (os.access(value, os.R_OK) or not os.path.lexists(value)):
        return Path(value)
    return by_typer(param, ctx, value)


def _is_usual_path(info: Any) -> bool:
    """Whether a path may be a file or a directory, or missing."""
    return (
        info.file_okay
        and info.dir_okay
        and not (info.exists or info.writable or info.resolve_path or info.allow_dash)
        and info.path_type is None
    )
