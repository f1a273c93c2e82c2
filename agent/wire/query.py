"""The query of a transport's URL: known keys with their types, values as a person writes them."""

from __future__ import annotations

from typing import Union
from urllib.parse import SplitResult, parse_qsl

from agent.wire.transport import BadUrlError

Value = Union[int, float, bool, str]


def text_of(url: SplitResult) -> str:
    """The URL as it was written; geturl() drops the slashes of schemes it does not know."""
    query_text = f"?{url.query}" if url.query else ""
    return f"{url.scheme}://{url.netloc}{url.path}{query_text}" + (f"#{url.fragment}" if url.fragment else "")


def query(url: SplitResult, example: str) -> dict[str, Value]:
    """The keys and values of a URL's query. Raises BadUrlError for a key that is there twice or has no value."""
    found: dict[str, Value] = {}
    try:
        pairs = parse_qsl(url.query, keep_blank_values=True, strict_parsing=bool(url.query), max_num_fields=64)
    except ValueError:
        raise BadUrlError(text_of(url), f"the query {url.query} is not key=value&key=value", example) from None
    for key, text in pairs:
        if key in found:
            raise BadUrlError(text_of(url), f"{key} is there twice", "drop one")
        found[key] = natural(text)
    return found


def natural(text: str) -> Value:
    """true and false, whole numbers (0x too) and other numbers as such, the rest as text."""
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        return text


def whole(url: SplitResult, key: str, value: Value | None, lowest: int, highest: int, example: str) -> int:
    """A whole number of the query. Raises BadUrlError when it is missing, none, or out of range."""
    if value is None:
        raise BadUrlError(text_of(url), f"{key} is missing", example)
    if isinstance(value, bool) or not isinstance(value, int):
        raise BadUrlError(text_of(url), f"{key} = {value} is not a whole number", example)
    if not lowest <= value <= highest:
        raise BadUrlError(text_of(url), f"{key} = {value} is out of range", f"use {lowest} to {highest}")
    return value


def switch(url: SplitResult, key: str, value: Value) -> bool:
    """A true or false of the query. Raises BadUrlError when it is neither."""
    if not isinstance(value, bool):
        raise BadUrlError(text_of(url), f"{key} = {value} is neither true nor false", f"write {key}=true")
    return value
